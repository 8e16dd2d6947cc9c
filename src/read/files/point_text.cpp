// SPDX-License-Identifier: Apache-2.0
// Reads points from text files (CSV, XYZ) and from structured numpy arrays. A header in
// the file can contain the names of the fields.
#include <algorithm>

#include "base/codecs/named_array.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/files/point_table.hpp"

namespace relidar::read {
namespace {

constexpr std::size_t kMostValues = 1 << 20;  // of a field in an element of a numpy array

std::vector<PointField> named_fields(const std::vector<std::string>& names) {
    std::vector<PointField> fields;
    for (const std::string& name : names) fields.push_back({name, 'F', sizeof(double)});
    return fields;
}

/// Returns the fields of a file without a header: the columns that the user names, or x y
/// z and intensity.
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

/// Returns the fields that a header line names. The line may be marked as a comment.
std::vector<PointField> parse_header_names(std::string_view line) {
    std::string_view names = trim(line);
    names.remove_prefix(std::min(names.find_first_not_of("#/ "), names.size()));
    const std::vector<std::string_view> words = split_words(names);
    std::vector<std::string> field_names(words.begin(), words.end());
    for (std::string& name : field_names) std::erase(name, '"');
    return named_fields(field_names);
}

/// Converts a field of a numpy array. Fields without a name, or with the type 'V',
/// contain no data.
PointField convert_field(const codecs::NpyField& field, const std::string& where) {
    const std::string_view type = field.type;
    // The type is byte order, kind and size, for example "<f4". A shorter text has no
    // size.
    const auto size = parse_number(type.substr(std::min<std::size_t>(2, type.size())));
    const auto count = codecs::array_bytes(field.shape, 1);
    if (!size || !(*size >= 1.0 && *size <= 65536.0) || !count || *count > kMostValues)
        fail("{}: the field '{}' has the type '{}', expected numbers", where, quote(field.name), quote(type));
    if (type[0] == '>')
        fail("{}: the field '{}' is big-endian, expected little-endian", where, quote(field.name));
    if (type[1] == 'V' || field.name.empty())
        return {std::string(kPaddingName), 'U', 1, std::size_t(*size) * *count};
    char kind = 'U';  // unsigned integers and truth values
    if (type[1] == 'f') kind = 'F';
    if (type[1] == 'i') kind = 'I';
    return {field.name, kind, std::size_t(*size), *count};
}

}  // namespace

PointTable parse_text(const SharedBytes& file, const std::vector<std::string>& column_names,
                      const std::string& where) {
    std::string text(file.bytes);
    const auto is_separator = [](char c) { return c == ',' || c == ';' || c == '\r' || c == '\t'; };
    std::ranges::replace_if(text, is_separator, ' ');
    std::string_view rest = trim(text);
    const auto first_line = [&] { return rest.substr(0, std::min(rest.find('\n'), rest.size())); };
    const auto skip_line = [&] { rest.remove_prefix(std::min(first_line().size() + 1, rest.size())); };

    // A first line with a single number is the number of points, not a point.
    double n_announced = 0.0;
    std::optional<std::vector<double>> numbers = parse_numbers(first_line());
    if (numbers && numbers->size() == 1) {
        n_announced = numbers->front();
        skip_line();
        numbers = parse_numbers(first_line());
    }
    std::vector<PointField> fields;
    if (numbers) {
        fields = default_fields(numbers->size(), column_names, where);
    } else {
        fields = parse_header_names(first_line());
        skip_line();
    }
    if (fields.size() > kMostFields)
        fail("{}: found {} fields, expected at most {}", where, fields.size(), kMostFields);
    const auto n_points = rest.empty() ? 0 : std::size_t(std::ranges::count(rest, '\n')) + 1;
    if (double(n_points) < n_announced)
        fail("{}: found {} points, expected {} (its first line)", where, n_points, n_announced);
    return parse_lines(rest, fields, n_points, where);
}

PointTable parse_npy_fields(const SharedBytes& file, const codecs::NpyHeader& header,
                            const std::string& where) {
    std::vector<PointField> fields;
    for (const codecs::NpyField& field : header.fields) fields.push_back(convert_field(field, where));
    const std::optional<std::size_t> n = codecs::array_bytes(header.shape, 1);
    return table_of_records(file.share_part(header.values), fields, n.value_or(0),
                            PointMemoryLayout::by_point, where);
}

}  // namespace relidar::read
