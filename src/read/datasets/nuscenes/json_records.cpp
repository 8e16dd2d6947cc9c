// SPDX-License-Identifier: Apache-2.0
#include "read/datasets/nuscenes/json_records.hpp"

#include <cmath>
#include <fstream>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

constexpr std::size_t kBlockBytes = 1 << 20, kMaxRecordBytes = 1 << 20;
// A double represents all integers up to this number exactly.
constexpr double kMaxExactInteger = 9007199254740992.0;

/// Splits a table (an array of objects) into its objects. Reads blocks, because tables
/// can have a gigabyte.
class RecordSplitter {
public:
    explicit RecordSplitter(const std::filesystem::path& file)
        : name_(file.string()), in_(file, std::ios::binary) {
        if (!does_path_exist(file)) throw DataError(name_ + ": no such file");
        if (!in_) throw DataError(name_ + ": the file cannot be read");
    }

    /// Reads the next object of the table into `object_text`. Finds its end by counting
    /// brackets that are not inside quotes.
    /// @return false if the table has no more objects
    bool next_object(std::string& object_text) {
        object_text.clear();
        int depth = 0;
        bool quoted = false, escaped = false;
        for (char c = 0; next_char(c);) {
            if (depth == 0) {
                if (!is_object_start(c)) continue;
                depth = 1;
                object_text = c;
                continue;
            }
            object_text += c;
            if (object_text.size() > kMaxRecordBytes)
                fail("{}: a JSON object is too large, expected at most {} bytes", name_, kMaxRecordBytes);
            if (quoted) {
                if (!escaped && c == '"') quoted = false;
                escaped = !escaped && c == '\\';
            } else if (c == '"') quoted = true;
            else if (c == '{' || c == '[') ++depth;
            else if ((c == '}' || c == ']') && --depth == 0) return true;
        }
        if (depth > 0 || !closed_) fail("{} is truncated, expected an array of objects", name_);
        return false;
    }

private:
    std::string name_;
    std::ifstream in_;
    std::string block_;
    std::size_t at_ = 0;
    bool opened_ = false, closed_ = false;

    /// Reads the next character. Returns false at the end of the file. Keeps only one
    /// block in memory, because tables can have a gigabyte.
    bool next_char(char& character) {
        if (at_ == block_.size()) {
            block_.resize(kBlockBytes);
            in_.read(block_.data(), std::streamsize(block_.size()));
            block_.resize(std::size_t(in_.gcount()));
            at_ = 0;
            if (block_.empty()) return false;
        }
        character = block_[at_++];
        return true;
    }
    /// Checks a character of the array that is outside of its objects.
    /// @return true if the character starts an object
    bool is_object_start(char character) {
        if (character == '{' && opened_ && !closed_) return true;
        const bool blank = character == ' ' || character == '\n' || character == '\r' || character == '\t';
        if (character == '[' && !opened_) opened_ = true;
        else if (character == ']' && opened_ && !closed_) closed_ = true;
        else if (!blank && !(character == ',' && opened_ && !closed_))
            fail(
                "{}: found the character '{}' outside of an object, expected a JSON array of objects: "
                "[{{...}}, {{...}}]",
                name_, quote({&character, 1}));
        return false;
    }
};

}  // namespace

void JsonRecord::fail_value(std::string_view key, const char* expected_description) const {
    fail("{}, key '{}': expected {}", where_, key, expected_description);
}

template <class T>
T JsonRecord::value_of(std::string_view key, const char* expected_description) const {
    T result;
    if (object_[key].get(result) != simdjson::SUCCESS) fail_value(key, expected_description);
    return result;
}

void JsonRecord::copy_numbers(std::string_view key, std::size_t count, double* output_numbers) const {
    const auto list = value_of<simdjson::dom::array>(key, "numbers");
    if (list.size() != count) fail_value(key, count == 3 ? "3 numbers" : "4 numbers");
    for (const simdjson::dom::element element : list)
        // Does not test for infinity or NaN, because JSON cannot store them.
        if (element.get(*output_numbers++) != simdjson::SUCCESS) fail_value(key, "numbers");
}

std::string JsonRecord::read_text(std::string_view key) const {
    return std::string(value_of<std::string_view>(key, "text"));
}

std::string JsonRecord::text_or_empty(std::string_view key) const {
    std::string_view text;
    return object_[key].get(text) == simdjson::SUCCESS ? std::string(text) : "";
}

std::int64_t JsonRecord::rounded_integer(std::string_view key) const {
    const double number = value_of<double>(key, "a number");
    if (!(std::abs(number) < kMaxExactInteger)) fail_value(key, "a number below 2^53");
    return std::llround(number);
}

bool JsonRecord::boolean(std::string_view key) const { return value_of<bool>(key, "true or false"); }

glm::dvec3 JsonRecord::vec3(std::string_view key) const {
    glm::dvec3 v;
    copy_numbers(key, 3, &v.x);
    return v;
}

glm::dquat JsonRecord::unit_quaternion(std::string_view key) const {
    double q[4];
    copy_numbers(key, 4, q);
    const glm::dquat rotation(q[0], q[1], q[2], q[3]);
    if (!(std::abs(glm::length(rotation) - 1.0) < 1e-3)) fail_value(key, "a quaternion of length 1");
    return glm::normalize(rotation);
}

void for_each_record(const std::filesystem::path& file, const std::function<void(const JsonRecord&)>& visit) {
    RecordSplitter splitter(file);
    simdjson::dom::parser parser;
    std::string record;
    // The parser gets one record at a time, so that memory stays small.
    for (std::size_t n = 0; splitter.next_object(record); ++n) {
        const std::string where = fmt::format("{}, record {}", file.string(), n);
        simdjson::dom::object object;
        if (const auto failed = parser.parse(record).get(object); failed != simdjson::SUCCESS)
            fail("{}: {}", where, simdjson::error_message(failed));
        visit(JsonRecord(where, object));
    }
}

}  // namespace relidar
