// SPDX-License-Identifier: Apache-2.0
#include "read/datasets/nuscenes/json_records.hpp"

#include <cmath>
#include <fstream>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

constexpr std::size_t kMaxRecordBytes = 1 << 20;
// A double represents all integers up to this number exactly.
constexpr double kMaxExactInteger = 9007199254740992.0;

/// Returns the text of an object, without the separators before it.
std::string_view strip_separators(std::string_view text, const std::string& file) {
    const std::size_t begin = text.find_first_not_of("[, \t\r\n");
    if (text[begin] != '{')
        fail(
            "{}: found the character '{}' outside of an object, expected a JSON array of objects: "
            "[{{...}}, {{...}}]",
            file, quote(text.substr(begin, 1)));
    return text.substr(begin);
}

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

std::vector<double> JsonRecord::matrix_or_empty(std::string_view key) const {
    std::vector<double> numbers;
    simdjson::dom::array rows, row;
    if (object_[key].get(rows) != simdjson::SUCCESS) return {};
    for (const simdjson::dom::element element : rows) {
        if (element.get(row) != simdjson::SUCCESS || row.size() != 3) return {};
        for (const simdjson::dom::element value : row)
            if (value.get(numbers.emplace_back()) != simdjson::SUCCESS) return {};
    }
    return numbers.size() == 9 ? numbers : std::vector<double>{};
}

glm::dquat JsonRecord::unit_quaternion(std::string_view key) const {
    double q[4];
    copy_numbers(key, 4, q);
    const glm::dquat rotation(q[0], q[1], q[2], q[3]);
    if (!(std::abs(glm::length(rotation) - 1.0) < 1e-3)) fail_value(key, "a quaternion of length 1");
    return glm::normalize(rotation);
}

void for_each_record(const std::filesystem::path& file, const std::function<void(const JsonRecord&)>& visit) {
    const std::string name = file.string();
    if (!does_path_exist(file)) fail("{}: no such file", name);
    std::ifstream in(file, std::ios::binary);
    simdjson::dom::parser parser;
    simdjson::error_code failed = simdjson::SUCCESS;
    // Reads up to the next closing brace, and appends it to the text of the record until
    // this parses as an object. After a brace inside the object, it does not parse yet.
    std::string text, part;
    std::size_t n_records = 0;
    while (text.size() < kMaxRecordBytes && std::getline(in, part, '}') && !in.eof()) {
        text.append(part).push_back('}');  // getline() removed the brace
        simdjson::dom::object object;
        failed = parser.parse(strip_separators(text, name)).get(object);
        if (failed != simdjson::SUCCESS) continue;
        visit(JsonRecord(fmt::format("{}, record {}", name, n_records++), object));
        text.clear();
    }
    if (!text.empty()) fail("{}, record {}: {}", name, n_records, simdjson::error_message(failed));
    // The last part is the text after the last brace of the file, where no object may be.
    if (!trim(part).ends_with(']') || part.find('{') != part.npos)
        fail("{} is truncated, expected an array of objects", name);
}

}  // namespace relidar
