// SPDX-License-Identifier: Apache-2.0
// Reads JSON tables, which are arrays of objects. A table can have a gigabyte, so only
// one object is in memory at a time.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include <simdjson.h>

#include <relidar/base/math.hpp>

namespace relidar {

/// An object of a table, valid only during the callback. Throws a DataError with file,
/// record and key if a value is missing or has another type.
class JsonRecord {
public:
    JsonRecord(std::string where, simdjson::dom::object object) : where_(std::move(where)), object_(object) {}

    std::string read_text(std::string_view key) const;
    /// Returns an empty text if the key is missing or has no text.
    std::string text_or_empty(std::string_view key) const;
    /// Returns a number as an integer. Rounds, because some tables contain fractions of a
    /// microsecond.
    std::int64_t rounded_integer(std::string_view key) const;
    bool boolean(std::string_view key) const;
    glm::dvec3 vec3(std::string_view key) const;
    /// Returns three lists of three numbers, row by row. Returns no numbers for any other
    /// value.
    std::vector<double> matrix_or_empty(std::string_view key) const;
    /// stored as w, x, y, z
    glm::dquat unit_quaternion(std::string_view key) const;
    Pose read_pose() const { return {unit_quaternion("rotation"), vec3("translation")}; }

private:
    std::string where_;
    simdjson::dom::object object_;

    [[noreturn]] void fail_value(std::string_view key, const char* expected_description) const;
    template <class T>
    T value_of(std::string_view key, const char* expected_description) const;
    void copy_numbers(std::string_view key, std::size_t count, double* output_numbers) const;
};

/// Calls `visit` for every object of a JSON table.
/// @throws DataError if the file is not an array of objects
void for_each_record(const std::filesystem::path& file, const std::function<void(const JsonRecord&)>& visit);

}  // namespace relidar
