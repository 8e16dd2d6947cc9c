// SPDX-License-Identifier: Apache-2.0
// Reading a JSON file that may hold anything: each value knows the file and the field it
// came from, so that every complaint names both, as in "run/scene.json: frames[3].time_s:
// found null, expected a finite number".
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

namespace relidar {

class JsonField {
public:
    /// @param value must outlive this  @param name of the field, empty for the whole file
    JsonField(const nlohmann::json& value, const std::string& file, std::string name)
        : value_(&value), file_(&file), name_(std::move(name)) {}

    JsonField at(const std::string& key) const;  ///< member of an object
    bool has(const std::string& key) const;      ///< whether an object has such a member
    JsonField at(std::size_t index) const;       ///< entry of an array
    std::size_t size() const;                    ///< of an array
    bool is_text() const;
    bool is_array() const;
    /// @throws DataError where an object has a member that is none of these
    void check_members(const std::vector<std::string>& known) const;
    double number() const;  ///< finite
    double number(double low, double high) const;
    std::int64_t integer(std::int64_t low, std::int64_t high) const;
    bool boolean() const;
    std::string text() const;
    std::string text(std::size_t most) const;  ///< of at most so many bytes, all in one line
    std::vector<double> numbers() const;
    /// The numbers of lists, of at most so many lists in one another, in their order.
    std::vector<double> nested_numbers(int depth) const;
    /// Exactly n numbers.
    template <std::size_t n>
    std::array<double, n> numbers() const {
        const std::vector<double> all = numbers();
        if (all.size() != n)
            fail("found " + std::to_string(all.size()) + " numbers", "expected " + std::to_string(n));
        std::array<double, n> result;
        std::copy(all.begin(), all.end(), result.begin());
        return result;
    }
    std::string where() const;  ///< "file: field", for messages
    /// @throws DataError "file: field: found, expected"
    [[noreturn]] void fail(const std::string& found, const std::string& expected) const;

private:
    const nlohmann::json* value_;
    const std::string* file_;
    std::string name_;
};

/// Parses a JSON text. @throws DataError naming the file and the place where it is
/// malformed
nlohmann::json parse_json(const std::string& text, const std::string& file);

}  // namespace relidar
