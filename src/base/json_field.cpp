// SPDX-License-Identifier: Apache-2.0
#include "base/json_field.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

std::string describe_json(const nlohmann::json& value) {
    if (value.is_structured())
        return fmt::format("found {} of {}", value.is_array() ? "an array" : "an object", value.size());
    const std::string text = value.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
    return "found " + (text.size() <= 60 ? text : text.substr(0, 57) + "...");
}

/// Appends the numbers of nested lists in order. Returns the first value that is not a
/// number or is nested too deeply, or null if there is none.
const nlohmann::json* collect_numbers(const nlohmann::json& value, int max_depth,
                                      std::vector<double>& numbers) {
    if (value.is_number()) {
        numbers.push_back(value.get<double>());
        return nullptr;
    }
    if (!value.is_array() || max_depth == 0) return &value;
    for (const nlohmann::json& item : value)
        if (const nlohmann::json* wrong = collect_numbers(item, max_depth - 1, numbers)) return wrong;
    return nullptr;
}

}  // namespace

std::string JsonField::location() const { return name_.empty() ? *file_ : *file_ + ": " + name_; }

void JsonField::reject(const std::string& found, const std::string& expected) const {
    fail("{}: {}, {}", location(), found, expected);
}

bool JsonField::has_member(const std::string& member) const {
    return value_->is_object() && value_->contains(member);
}

std::optional<JsonField> JsonField::find(const std::string& key,
                                         std::initializer_list<const char*> objects) const {
    if (has_member(key)) return at(key);
    for (const char* object : objects)
        if (has_member(object) && at(object).has_member(key)) return at(object).at(key);
    return {};
}

JsonField JsonField::at(const std::string& key) const {
    if (!value_->is_object()) reject(describe_json(*value_), "expected an object");
    const auto it = value_->find(key);
    const std::string name = name_.empty() ? key : name_ + "." + key;
    if (it == value_->end()) fail("{}: the key {} is missing", *file_, name);
    return {*it, *file_, name};
}

JsonField JsonField::at(std::size_t index) const {
    return {value_->at(index), *file_, fmt::format("{}[{}]", name_, index)};
}

bool JsonField::is_string() const { return value_->is_string(); }
bool JsonField::is_array() const { return value_->is_array(); }
std::size_t JsonField::size() const {
    if (!value_->is_array()) reject(describe_json(*value_), "expected an array");
    return value_->size();
}

std::vector<double> JsonField::flat_numbers(int max_depth) const {
    std::vector<double> numbers;
    if (const nlohmann::json* wrong = collect_numbers(*value_, max_depth, numbers))
        reject(wrong->is_array() ? "found lists that are nested too deeply"
                                 : fmt::format("found {}", wrong->type_name()),
               "expected numbers");
    return numbers;
}

void JsonField::check_members(const std::vector<std::string>& known_names) const {
    if (!value_->is_object()) reject(describe_json(*value_), "expected an object");
    for (const auto& [key, value] : value_->items())
        if (std::find(known_names.begin(), known_names.end(), key) == known_names.end())
            reject(fmt::format("found the unknown member '{}'{}", quote(key),
                               did_you_mean(key, known_names, "'")),
                   fmt::format("expected only {}", fmt::join(known_names, ", ")));
}

double JsonField::number() const {
    if (!value_->is_number() || !std::isfinite(value_->get<double>()))
        reject(describe_json(*value_), "expected a finite number");
    return value_->get<double>();
}

double JsonField::number_in(double min_value, double max_value) const {
    const double value = number();
    if (value < min_value || value > max_value)
        reject(describe_json(*value_),
               fmt::format("expected a number from {:.15g} to {:.15g}", min_value, max_value));
    return value;
}

/// Returns an integer between two limits, which are allowed, too.
/// @throws DataError with file and field for other values
std::int64_t JsonField::integer_in(std::int64_t min_value, std::int64_t max_value) const {
    // A number above INT64_MAX would become negative.
    const bool is_too_large =
        value_->is_number_unsigned() && value_->get<std::uint64_t>() > std::uint64_t(INT64_MAX);
    const bool is_integer = value_->is_number_integer() && !is_too_large;
    const std::int64_t value = is_integer ? value_->get<std::int64_t>() : 0;
    if (!is_integer || value < min_value || value > max_value)
        reject(describe_json(*value_),
               fmt::format("expected an integer from {} to {}", min_value, max_value));
    return value;
}

bool JsonField::boolean() const {
    if (!value_->is_boolean()) reject(describe_json(*value_), "expected true or false");
    return value_->get<bool>();
}

std::string JsonField::text() const {
    if (!value_->is_string()) reject(describe_json(*value_), "expected text");
    return value_->get<std::string>();
}

std::string JsonField::short_text(std::size_t max_bytes) const {
    const std::string value_text = text();
    const auto is_control = [](unsigned char character) { return character < 0x20 || character == 0x7F; };
    if (value_text.size() > max_bytes || std::any_of(value_text.begin(), value_text.end(), is_control))
        reject(fmt::format("found {} bytes of text", value_text.size()),
               fmt::format("expected one line of at most {} bytes", max_bytes));
    return value_text;
}

std::vector<double> JsonField::numbers() const {
    return list([](const JsonField& entry) { return entry.number(); });
}

glm::dvec3 JsonField::vector_in(double min_value, double max_value) const {
    const std::array<double, 3> v = numbers<3>();
    for (std::size_t k = 0; k < v.size(); ++k) at(k).number_in(min_value, max_value);
    return {v[0], v[1], v[2]};
}

std::vector<std::size_t> JsonField::sizes() const {
    return list(
        [](const JsonField& entry) { return std::size_t(entry.integer_in(0, std::int64_t(1) << 48)); });
}

/// Parses JSON. Shortens the parser's message to the reason and the position.
/// @param file  path for the message
nlohmann::json parse_json(const std::string& text, const std::string& file) {
    try {
        return nlohmann::json::parse(text);
    } catch (const nlohmann::json::exception& error) {
        std::string why = error.what();
        // Removes the code "[json.exception.parse_error.101] " at the begin.
        if (const std::size_t bracket = why.find("] "); bracket != std::string::npos)
            why.erase(0, bracket + 2);
        // Removes "; last read: ...", which quotes the file and can be very long.
        why = why.substr(0, why.find("; last read"));
        // A message is one line.
        for (char& c : why) c = static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
        fail("{}: the file is not valid JSON, or it is truncated or damaged: {}", file, why);
    }
}

}  // namespace relidar
