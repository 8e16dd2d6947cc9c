// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/point_table.hpp"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <tuple>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "log/clouds/other_formats.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostPoints = std::size_t(1) << 24;  // maximum number of points of a scan

struct FieldName {
    std::string_view name;
    PointValue value;
};
/// Field names in lower case and their meanings. If a file has several fields with the
/// same meaning, the name that is listed first is used.
constexpr FieldName kFieldNames[] = {
    {"x", PointValue::x},
    {"y", PointValue::y},
    {"z", PointValue::z},
    {"intensity", PointValue::intensity},
    {"intensities", PointValue::intensity},
    {"i", PointValue::intensity},
    {"reflectivity", PointValue::intensity},
    {"reflectance", PointValue::intensity},
    {"remission", PointValue::intensity},
    {"amplitude", PointValue::intensity},
    {"signal", PointValue::intensity},
    {"ring", PointValue::ring},
    {"rings", PointValue::ring},
    {"channel", PointValue::ring},
    {"line", PointValue::ring},
    {"ring_id", PointValue::ring},
    {"laser_id", PointValue::ring},
    {"laser_number", PointValue::ring},
    {"beam", PointValue::ring},
    {"beam_id", PointValue::ring},
    {"time", PointValue::time},
    {"t", PointValue::time},
    {"timestamp", PointValue::time},
    {"time_stamp", PointValue::time},
    {"offset_time", PointValue::time},
    {"return", PointValue::return_number},
    {"return_number", PointValue::return_number},
    {"return_type", PointValue::return_type},
    {"range", PointValue::range},
    {"distance", PointValue::range},
};
constexpr std::size_t kNotRead = std::size(kFieldNames);

/// Prefixes that some programs add to field names. The search for a name ignores them.
constexpr std::string_view kPrefixes[] = {"scalar_",     "points_", "point_", "position_", "pos_",
                                          "coordinate_", "coord_",  "xyz_",   "vertex_",   "lidar_"};

/// Returns the index of a field name in kFieldNames, or kNotRead if the name is unknown.
std::size_t find_field_index(std::string_view name) {
    const auto* const row = std::ranges::find(kFieldNames, name, &FieldName::name);
    return std::size_t(row - std::begin(kFieldNames));
}

/// Returns the index of a field in kFieldNames, or kNotRead if the field is unknown.
/// Ignores upper case and prefixes of its name.
std::size_t find_row_of_field(std::string_view field) {
    std::string name(trim_spaces(field));
    std::ranges::transform(name, name.begin(),
                           [](unsigned char character) { return char(std::tolower(character)); });
    // VeloView and ParaView store x, y and z as elements 0, 1 and 2 of a vector.
    for (const char axis : {'0', '1', '2'})
        if (name.starts_with("points") && name.ends_with(std::string(":") + axis))
            return std::size_t(axis - '0');
    std::string_view rest = name;
    rest.remove_prefix(std::min(rest.find_last_of("./:") + 1, rest.size()));
    for (const std::string_view prefix : kPrefixes)
        if (rest.starts_with(prefix) && find_field_index(rest) == kNotRead) rest.remove_prefix(prefix.size());
    return find_field_index(rest);
}

struct NumberTypeRow {
    char kind;
    std::size_t size;
    NumberType type;
    std::string_view numpy;  ///< code of the number type in .npy files, for example "f4"
};
constexpr NumberTypeRow kNumberTypes[] = {{'F', 4, NumberType::f4, "f4"}, {'F', 8, NumberType::f8, "f8"},
                                          {'I', 1, NumberType::i1, "i1"}, {'I', 2, NumberType::i2, "i2"},
                                          {'I', 4, NumberType::i4, "i4"}, {'I', 8, NumberType::i8, "i8"},
                                          {'U', 1, NumberType::u1, "u1"}, {'U', 2, NumberType::u2, "u2"},
                                          {'U', 4, NumberType::u4, "u4"}, {'U', 8, NumberType::u8, "u8"}};

NumberType parse_point_type(const PointField& field, const std::string& location) {
    for (const NumberTypeRow& row : kNumberTypes)
        if (row.kind == field.kind && row.size == field.size) return row.type;
    throw DataError(fmt::format(
        "{}: the field '{}' has the type {}{}, expected F4, F8, or I or U with 1, 2, 4 or 8 "
        "bytes",
        location, make_excerpt(field.name), make_excerpt(std::string(1, field.kind)), field.size));
}

PointTable read_bin(const fs::path& file, const std::vector<std::string>& columns) {
    const SharedBytes data = share_bytes(read_file(file));
    const std::size_t n_bytes = data.bytes.size();
    std::vector<PointField> fields;
    for (const std::string& column : columns) fields.push_back({column, 'F', sizeof(float)});
    const std::size_t record = fields.size() * sizeof(float);
    if (n_bytes % record != 0)
        throw DataError(
            fmt::format("{}: found {} bytes, expected a multiple of {} bytes for points of {} float32 "
                        "values (\"columns\" in sequence.json)",
                        file.string(), n_bytes, record, fields.size()));
    PointTable table = read_packed(data, fields, n_bytes / record, Packing::by_point, file.string());
    // read_head() already reports unread columns, so they are not listed again.
    table.unread.clear();
    return table;
}

PointTable read_npy_points(const fs::path& file, const std::vector<std::string>& columns) {
    if (const SharedBytes bytes = share_bytes(read_file(file)); is_structured_npy(bytes.bytes))
        return read_structured_npy(bytes, file.string());
    NamedArray array = read_npy(file);
    if (array.shape.size() != 2 || array.shape[1] != columns.size())
        throw DataError(fmt::format(
            "{}: found an array of {} dimensions{}, expected the shape [points, {}] (\"columns\" in "
            "sequence.json)",
            file.string(), array.shape.size(),
            array.shape.empty() ? "" : fmt::format(", whose last dimension is {}", array.shape.back()),
            columns.size()));
    check_count(array.shape[0], file.string());
    const auto* known = std::ranges::find(kNumberTypes, array.dtype, &NumberTypeRow::numpy);
    if (known == std::end(kNumberTypes) || array.bytes.size() != array.count() * known->size) {
        const std::vector<double> values = array.as_double();
        array = make_array(array.name, array.shape, values.data(), values.size());
        known = std::ranges::find(kNumberTypes, NumberType::f8, &NumberTypeRow::type);
    }
    const auto memory = std::make_shared<const std::vector<std::byte>>(std::move(array.bytes));
    PointTable table(array.shape[0]);
    table.keep(memory);
    const auto* first = reinterpret_cast<const char*>(memory->data());
    for (std::size_t c = 0; c < columns.size(); ++c)
        if (is_point_field(columns[c]))
            table.add(columns[c], {known->type, first + c * known->size, columns.size() * known->size},
                      file.string());
    return table;
}

}  // namespace

std::optional<PointValue> find_value_of_field(std::string_view name) {
    const std::size_t row = find_row_of_field(name);
    return row == kNotRead ? std::nullopt : std::optional(kFieldNames[row].value);
}

std::vector<std::string> PointTable::names(PointValue value) const {
    // If names differ only in spelling, the one that equals the listed name is first.
    std::vector<std::tuple<std::size_t, bool, std::string>> ranked;
    for (const auto& [name, values] : fields_) {
        const std::size_t row = find_row_of_field(name);
        if (row != kNotRead && kFieldNames[row].value == value)
            ranked.emplace_back(row, name != kFieldNames[row].name, name);
    }
    std::ranges::sort(ranked);
    std::vector<std::string> names;
    for (auto& [row, is_other, name] : ranked) names.push_back(std::move(name));
    return names;
}

void check_count(std::size_t count, const std::string& location) {
    if (count == 0 || count > kMostPoints)
        throw DataError(fmt::format("{}: found {} points, expected 1 to {}", location, count, kMostPoints));
}

const FieldValues* PointTable::find(const std::string& name) const {
    const auto at = fields_.find(name);
    return at == fields_.end() ? nullptr : &at->second;
}

const FieldValues* PointTable::find(PointValue value) const {
    const std::vector<std::string> all = names(value);
    return all.empty() ? nullptr : find(all[0]);
}

void PointTable::add(const std::string& name, const FieldValues& values, const std::string& location) {
    if (!fields_.emplace(name, values).second)
        throw DataError(fmt::format("{}: the field '{}' occurs twice, expected it once", location, name));
}

void PointTable::remove(PointValue value) {
    std::erase_if(fields_, [&](const auto& field) { return find_value_of_field(field.first) == value; });
}

PointTable read_packed(const SharedBytes& data, const std::vector<PointField>& fields, std::size_t count,
                       Packing packing, const std::string& location) {
    check_count(count, location);
    std::size_t record = 0;
    for (const PointField& field : fields) {
        if (field.size == 0 || field.count == 0)
            throw DataError(fmt::format("{}: field '{}' has no values, expected at least one per point",
                                        location, make_excerpt(field.name)));
        record += field.size * field.count;
    }
    if (data.bytes.size() / count < record)
        throw DataError(
            fmt::format("{}: the file is truncated: found {} bytes of points, expected {} "
                        "points of {} bytes",
                        location, data.bytes.size(), count, record));
    PointTable table(count);
    table.keep(data.memory);
    std::size_t before = 0;  // number of bytes of the previous fields in a point
    for (const PointField& field : fields) {
        const std::size_t width = field.size * field.count;
        if (is_point_field(field.name)) {
            const char* first = data.bytes.data() + (packing == Packing::by_point ? before : before * count);
            table.add(
                field.name,
                {parse_point_type(field, location), first, packing == Packing::by_point ? record : width},
                location);
        } else if (field.name != kPadding) {
            table.unread.push_back(field.name);
        }
        before += width;
    }
    return table;
}

PointTable read_lines(std::string_view text, const std::vector<PointField>& fields, std::size_t n,
                      const std::string& where) {
    check_count(n, where);
    if (n > text.size())
        throw DataError(fmt::format("{}: the file is truncated: found {} bytes of text, expected {} points",
                                    where, text.size(), n));
    struct Column {
        std::size_t place;  ///< index in the line
        const std::string& name;
        std::vector<double> values;
    };
    std::vector<Column> kept;
    std::size_t width = 0;
    for (const PointField& field : fields) {
        if (is_point_field(field.name)) kept.push_back({width, field.name, std::vector<double>(n)});
        width += field.count;
    }
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t end = std::min(text.find('\n'), text.size());
        const auto numbers = parse_numbers(text.substr(0, end));
        if (!numbers || numbers->size() != width)
            throw DataError(fmt::format("{}: point {} is '{}', expected {} numbers", where, i,
                                        make_excerpt(text.substr(0, end)), width));
        for (Column& column : kept) column.values[i] = (*numbers)[column.place];
        text.remove_prefix(std::min(end + 1, text.size()));
    }
    PointTable table(n);
    for (const PointField& field : fields)
        if (!is_point_field(field.name) && field.name != kPadding) table.unread.push_back(field.name);
    for (Column& column : kept) table.add(column.name, NumberType::f8, std::move(column.values), where);
    return table;
}

bool is_point_file(const fs::path& file) {
    const std::string ending = file.extension().string();
    return ending == ".pcd" || ending == ".ply" || ending == ".bin" || ending == ".npy" || ending == ".csv" ||
           ending == ".xyz" || ending == ".las";
}

bool is_image_file(const fs::path& file) { return file.extension() == ".npz" || file.extension() == ".exr"; }

namespace {

/// Returns true if the header of a PCD or PLY file says that relidar wrote
/// motion-compensated points or points in the world frame.
bool is_marked_deskewed(std::string_view bytes) {
    constexpr std::size_t kHeader = 4096;  // number of bytes at the start of the file that are searched
    const std::string_view header = bytes.substr(0, kHeader);
    return header.find(" points_in sensor at time_s") != header.npos ||
           header.find(" points_in world") != header.npos;
}

PointTable read_with_header(const fs::path& file,
                            PointTable (*read)(const SharedBytes& bytes, const std::string& where)) {
    const SharedBytes bytes = share_bytes(read_text(file));
    PointTable table = read(bytes, file.string());
    table.is_deskewed = is_marked_deskewed(bytes.bytes);
    return table;
}

}  // namespace

PointTable read_point_file(const fs::path& file, const std::vector<std::string>& columns) {
    static const std::vector<std::string> kKitti = {"x", "y", "z", "intensity"};
    const std::string ending = file.extension().string();
    if (ending == ".bin") return read_bin(file, columns.empty() ? kKitti : columns);
    if (ending == ".npy") return read_npy_points(file, columns.empty() ? kKitti : columns);
    if (ending == ".pcd") return read_with_header(file, read_pcd);
    if (ending == ".ply") return read_with_header(file, read_ply);
    if (ending == ".las") return read_las(share_bytes(read_file(file)), file.string());
    if (ending == ".csv" || ending == ".xyz")
        return read_text_points(share_bytes(read_file(file)), columns, file.string());
    if (const std::string other = describe_unsupported_format(file); !other.empty())
        throw DataError(fmt::format("{}: {}", file.string(), other));
    throw DataError(
        fmt::format("{}: found the file name ending '{}', expected .npz, .exr, .pcd, .ply, .bin, .npy, "
                    ".las, .csv or .xyz",
                    file.string(), make_excerpt(ending)));
}

}  // namespace relidar::folder
