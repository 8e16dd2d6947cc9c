// SPDX-License-Identifier: Apache-2.0
// Reads the vertices of PLY files. The data is text or binary little-endian. The vertices
// must be the first element of the file.
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/files/point_table.hpp"

namespace relidar::read {
namespace {

/// Converts a property of a PLY header to a field. Each number type has two names, for
/// example float and float32.
PointField make_ply_field(std::string_view type_name, std::string_view name, const std::string& where) {
    struct PlyScalarType {
        const char *name, *other_name;
        char kind;
        std::size_t size;
    };
    static constexpr PlyScalarType kPlyTypes[] = {{"float", "float32", 'F', 4}, {"double", "float64", 'F', 8},
                                                  {"char", "int8", 'I', 1},     {"short", "int16", 'I', 2},
                                                  {"int", "int32", 'I', 4},     {"uchar", "uint8", 'U', 1},
                                                  {"ushort", "uint16", 'U', 2}, {"uint", "uint32", 'U', 4}};
    for (const PlyScalarType& row : kPlyTypes)
        if (type_name == row.name || type_name == row.other_name)
            return {std::string(name), row.kind, row.size};
    fail("{}: the property '{}' has the type '{}', expected a number type (lists are not supported)", where,
         quote(name), quote(type_name));
}

struct PlyHeader {
    std::string format;
    std::size_t n = 0;
    std::vector<PointField> fields;
    int n_elements = 0;
    std::size_t length = 0;  ///< bytes of the header
};

/// Parses a line of the header. Ignores all elements except the first, because their data
/// follow the points.
void parse_ply_line(std::string_view line, PlyHeader& header, const std::string& where) {
    // "format NAME VERSION", "element NAME COUNT" or "property TYPE NAME"
    std::vector<std::string_view> words = split_words(line);
    words.resize(3);
    const std::string_view keyword = words[0], second = words[1], third = words[2];
    if (keyword == "format") {
        header.format = second;
    } else if (keyword == "element") {
        ++header.n_elements;
        const std::optional<double> n = parse_number(third);
        const bool is_vertex_list = second == "vertex" && n && *n >= 0.0 && *n <= 1e9;
        if (header.n_elements == 1 && !is_vertex_list)
            fail("{}: found '{}', expected 'element vertex N' as the first element", where, quote(line));
        if (header.n_elements == 1) header.n = std::size_t(*n);
    } else if (keyword == "property" && header.n_elements == 1) {
        if (header.fields.size() >= kMostFields)
            fail("{}: found too many properties of a vertex, expected at most {}", where, kMostFields);
        header.fields.push_back(make_ply_field(second, third, where));
    }
}

/// Parses the text header of a PLY file.
PlyHeader parse_ply_header(std::string_view bytes, const std::string& where) {
    if (!bytes.starts_with("ply")) fail("{}: the file does not begin with 'ply', expected a PLY file", where);
    PlyHeader header;
    std::string_view line;
    while (line != "end_header") {
        const std::size_t end = bytes.find('\n', header.length);
        if (end == std::string_view::npos)
            fail("{}: the line end_header is missing, expected the header of a PLY file", where);
        line = trim(bytes.substr(header.length, end - header.length));
        header.length = end + 1;
        parse_ply_line(line, header, where);
    }
    return header;
}

}  // namespace

PointTable parse_ply(const SharedBytes& file, const std::string& where) {
    const PlyHeader header = parse_ply_header(file.bytes, where);
    const std::string_view data = file.bytes.substr(header.length);
    if (header.format == "ascii") return parse_lines(data, header.fields, header.n, where);
    if (header.format == "binary_little_endian")
        return table_of_records(file.share_part(data), header.fields, header.n, PointMemoryLayout::by_point,
                                where);
    fail("{}: found the format '{}', expected ascii or binary_little_endian", where, quote(header.format));
}

}  // namespace relidar::read
