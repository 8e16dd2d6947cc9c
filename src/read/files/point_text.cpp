// SPDX-License-Identifier: Apache-2.0
// Reads points from text files (CSV, XYZ) and from structured numpy arrays. A header in
// the file can contain the names of the fields.
#include <algorithm>
#include <cstring>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/files/point_table.hpp"

namespace relidar::read {
namespace {

constexpr std::size_t kMostTextFields = 1024;
constexpr std::size_t kNpyPrefix = 8;  // size of the magic string and the version of a .npy file

std::vector<PointField> named_fields(const std::vector<std::string>& names) {
    std::vector<PointField> fields;
    for (const std::string& name : names) fields.push_back({name, 'F', sizeof(double)});
    return fields;
}

/// @param n_values_per_line  number of values of a file that has no header
std::vector<PointField> default_fields(std::size_t n_values_per_line,
                                       const std::vector<std::string>& column_names,
                                       const std::string& where) {
    if (column_names.size() == n_values_per_line) return named_fields(column_names);
    if (column_names.empty() && n_values_per_line == 3) return named_fields({"x", "y", "z"});
    if (column_names.empty() && n_values_per_line == 4) return named_fields({"x", "y", "z", "intensity"});
    fail(
        "{}: found {} numbers per line and no header, expected names in the first line, or \"columns\" in "
        "sequence.json",
        where, n_values_per_line);
}

/// Parses the fields of a structured numpy array: [('x', '<f4'), ...].
class NumpyFields {
public:
    NumpyFields(std::string_view text, const std::string& location) : text_(text), where_(location) {}

    /// Parses a list such as [('x', '<f4'), ('rgb', '|u1', (3,))]: name, type and, if a
    /// field has several values, their shape.
    std::vector<PointField> parse_fields() {
        std::vector<PointField> fields;
        expect('[');
        while (!consume(']')) {
            expect('(');
            const std::string name = parse_quoted();
            expect(',');
            fields.push_back(parse_type(name, parse_quoted()));
            if (consume(',') && is_next('(')) fields.back().count *= parse_shape();
            expect(')');
            if (!consume(',') && !is_next(']')) fail_header();
            if (fields.size() > kMostTextFields) fail_header();
        }
        return fields;
    }
    /// Returns the product of a tuple of numbers.
    std::size_t parse_shape() {
        std::size_t n = 1;
        expect('(');
        while (!consume(')')) {
            std::size_t value = 0, n_digits = 0;
            for (is_next(' '); !text_.empty() && text_[0] >= '0' && text_[0] <= '9'; ++n_digits) {
                value = 10 * value + std::size_t(text_[0] - '0');
                text_.remove_prefix(1);
            }
            if (n_digits == 0 || n_digits > 8) fail_header();
            n *= value;
            if (n > std::size_t(1) << 32 || (!consume(',') && !is_next(')'))) fail_header();
        }
        return n;
    }

private:
    std::string_view text_;
    const std::string& where_;

    [[noreturn]] void fail_header() const {
        fail(
            "{}: cannot read the list of fields in the header of the npy file, expected a list such as "
            "[('x', '<f4'), ('y', '<f4')]",
            where_);
    }
    bool is_next(char expected_character) {
        while (!text_.empty() && (text_[0] == ' ' || text_[0] == '\n')) text_.remove_prefix(1);
        return !text_.empty() && text_[0] == expected_character;
    }
    bool consume(char expected_character) {
        if (!is_next(expected_character)) return false;
        text_.remove_prefix(1);
        return true;
    }
    void expect(char expected_character) {
        if (!consume(expected_character)) fail_header();
    }
    std::string parse_quoted() {
        expect('\'');
        const std::size_t end = std::min(text_.find('\''), text_.size());
        const std::string text(text_.substr(0, end));
        text_.remove_prefix(end);
        expect('\'');
        return text;
    }
    /// Fields without a name, or with the type 'V', contain no data.
    PointField parse_type(const std::string& field_name, const std::string& type_code) const {
        const auto size =
            parse_number(std::string_view(type_code).substr(std::min<std::size_t>(2, type_code.size())));
        if (type_code.size() < 3 || !size || !(*size >= 1.0 && *size <= 65536.0)) fail_header();
        if (type_code[0] == '>')
            fail("{}: the field '{}' is big-endian, expected little-endian", where_, quote(field_name));
        if (type_code[1] == 'V' || field_name.empty())
            return {std::string(kPaddingName), 'U', 1, std::size_t(*size)};
        char kind = 'U';
        if (type_code[1] == 'f') kind = 'F';
        else if (type_code[1] == 'i') kind = 'I';
        return {field_name, kind, std::size_t(*size)};
    }
};

}  // namespace

PointTable parse_text(const SharedBytes& file, const std::vector<std::string>& column_names,
                      const std::string& where) {
    std::string text(file.bytes);
    std::ranges::replace_if(
        text,
        [](char character) {
            return character == ',' || character == ';' || character == '\r' || character == '\t';
        },
        ' ');
    std::string_view rest = trim(text);
    const auto first_line = [&] { return rest.substr(0, std::min(rest.find('\n'), rest.size())); };
    const auto skip_line = [&] { rest.remove_prefix(std::min(first_line().size() + 1, rest.size())); };
    std::vector<PointField> fields;
    // A first line with a single number is the number of points, not a point.
    double n_announced = 0.0;
    if (const auto numbers = parse_numbers(first_line()); numbers && numbers->size() == 1) {
        n_announced = numbers->front();
        skip_line();
    }
    if (const auto numbers = parse_numbers(first_line()); numbers) {
        fields = default_fields(numbers->size(), column_names, where);
    } else {
        // The header may be marked as a comment.
        std::string_view names = trim(first_line());
        names.remove_prefix(std::min(names.find_first_not_of("#/ "), names.size()));
        for (std::string& name : split_words(names)) {
            std::erase(name, '"');
            fields.push_back({std::move(name), 'F', sizeof(double)});
        }
        skip_line();
    }
    if (fields.size() > kMostTextFields)
        fail("{}: found {} fields, expected at most {}", where, fields.size(), kMostTextFields);
    const auto n = rest.empty() ? 0 : std::size_t(std::ranges::count(rest, '\n')) + 1;
    if (double(n) < n_announced)
        fail("{}: found {} points, expected {} (its first line)", where, n, n_announced);
    return parse_lines(rest, fields, n, where);
}

bool is_structured(std::string_view bytes) {
    const std::string_view header = bytes.substr(0, 256);
    const std::size_t at = header.find("'descr':");
    return header.starts_with("\x93NUMPY") && at != header.npos &&
           trim(header.substr(at + 8)).starts_with('[');
}

/// Reads a .npy file with named fields. The file consists of a prefix, the length of
/// the header, the header (a Python dictionary as text) and one record per point.
PointTable parse_npy(const SharedBytes& file, const std::string& where) {
    const std::string_view bytes = file.bytes;
    // Version 1 of the format stores the length in 2 bytes, later versions in 4 bytes.
    const std::size_t n_length = bytes.size() > kNpyPrefix && bytes[6] == 1 ? 2 : 4;
    if (bytes.size() < kNpyPrefix + n_length) fail("{}: the npy header is truncated", where);
    std::uint32_t length = 0;
    std::memcpy(&length, bytes.data() + kNpyPrefix, n_length);
    const std::size_t start = kNpyPrefix + n_length;
    if (length > bytes.size() - start) fail("{}: the npy header is truncated", where);
    const std::string_view header = bytes.substr(start, length);
    const std::size_t fields_at = header.find("'descr':"), shape_at = header.find("'shape':");
    if (fields_at == header.npos || shape_at == header.npos)
        fail("{}: the npy header has no descr or no shape, expected both", where);
    const std::vector<PointField> fields = NumpyFields(header.substr(fields_at + 8), where).parse_fields();
    const std::size_t n = NumpyFields(header.substr(shape_at + 8), where).parse_shape();
    return table_of_records(file.share_part(bytes.substr(start + length)), fields, n,
                            PointMemoryLayout::by_point, where);
}

}  // namespace relidar::read
