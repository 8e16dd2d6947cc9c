// SPDX-License-Identifier: Apache-2.0
// Reads JSON files whose content is not trusted. Each value stores its file and field, so
// that every error message contains both: "run/scene.json: frames[3].time_s: found null,
// expected a finite number".
#pragma once

#include <array>
#include <initializer_list>
#include <optional>
#include <string>
#include <vector>

#include <glm/vec3.hpp>
#include <nlohmann/json_fwd.hpp>

namespace relidar {

class JsonField {
public:
    /// @param value must outlive this object
    /// @param name empty for the root value
    JsonField(const nlohmann::json& value, const std::string& file, std::string name)
        : value_(&value), file_(&file), name_(std::move(name)) {}

    JsonField at(const std::string& key) const;  ///< Returns a member of an object.
    bool has_member(const std::string& member) const;
    /// Returns a member of this object, or of one of its members `objects`.
    std::optional<JsonField> find(const std::string& key, std::initializer_list<const char*> objects) const;
    JsonField at(std::size_t index) const;  ///< Returns an entry of an array.
    std::size_t size() const;               ///< Returns the number of entries of an array.
    bool is_string() const;
    bool is_array() const;
    void check_members(const std::vector<std::string>& known_names) const;
    double number() const;  ///< Returns a finite number.
    double number_in(double min_value, double max_value) const;
    std::int64_t integer_in(std::int64_t min_value, std::int64_t max_value) const;
    bool boolean() const;
    std::string text() const;
    /// @throws DataError if the text has more than `max_bytes` bytes or contains line
    /// breaks
    std::string short_text(std::size_t max_bytes) const;
    std::vector<double> numbers() const;
    std::vector<std::size_t> sizes() const;  ///< Returns a list of integers of at least 0.
    std::vector<double> flat_numbers(int max_depth) const;
    /// Returns an array of three numbers, each within the limits.
    glm::dvec3 vector_in(double min_value, double max_value) const;
    /// Returns parse(entry) for each entry of an array.
    template <class Parse>
    auto list(const Parse& parse) const {
        std::vector<decltype(parse(*this))> values;
        for (std::size_t i = 0; i < size(); ++i) values.push_back(parse(at(i)));
        return values;
    }
    template <std::size_t n>
    std::array<double, n> numbers() const {
        const std::vector<double> all = numbers();
        if (all.size() != n)
            reject("found " + std::to_string(all.size()) + " numbers", "expected " + std::to_string(n));
        std::array<double, n> result;
        std::copy(all.begin(), all.end(), result.begin());
        return result;
    }
    std::string location() const;  ///< Returns "file: field" for error messages.
    [[noreturn]] void reject(const std::string& found, const std::string& expected) const;

private:
    const nlohmann::json* value_;
    const std::string* file_;
    std::string name_;
};

nlohmann::json parse_json(const std::string& text, const std::string& file);

}  // namespace relidar
