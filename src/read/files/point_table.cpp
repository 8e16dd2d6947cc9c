// SPDX-License-Identifier: Apache-2.0
#include "read/files/point_table.hpp"

#include <algorithm>
#include <cctype>
#include <iterator>
#include <tuple>

#include <fmt/ranges.h>

#include <relidar/base/arrays.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/files/other_formats.hpp"

namespace relidar::read {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostPoints = std::size_t(1) << 24;  // maximum number of points of a scan

/// Field names in lower case. The first name that a file has wins.
const std::map<PointAttribute, std::vector<std::string_view>> kFieldNames{
    {PointAttribute::x, {"x"}},
    {PointAttribute::y, {"y"}},
    {PointAttribute::z, {"z"}},
    {PointAttribute::intensity,
     {"intensity", "intensities", "i", "reflectivity", "reflectance", "remission", "amplitude", "signal"}},
    {PointAttribute::ring,
     {"ring", "rings", "channel", "line", "ring_id", "laser_id", "laser_number", "beam", "beam_id"}},
    {PointAttribute::time, {"time", "t", "timestamp", "time_stamp", "offset_time"}},
    {PointAttribute::return_number, {"return", "return_number"}},
    {PointAttribute::return_type, {"return_type"}},
    {PointAttribute::range, {"range", "distance"}}};

struct FieldMeaning {
    PointAttribute attribute;
    std::size_t rank;  ///< index in the list of names; 0 is preferred
};

constexpr std::string_view kNamePrefixes[] = {"scalar_",     "points_", "point_", "position_", "pos_",
                                              "coordinate_", "coord_",  "xyz_",   "vertex_",   "lidar_"};

std::optional<FieldMeaning> find_exact_field(std::string_view field_name) {
    for (const auto& [attribute, names] : kFieldNames) {
        const auto name = std::ranges::find(names, field_name);
        if (name != names.end()) return FieldMeaning{attribute, std::size_t(name - names.begin())};
    }
    return std::nullopt;
}

/// Returns the meaning of a field by its name, or nothing for unknown fields. Ignores
/// upper case, and one or more prefixes such as "scalar_".
std::optional<FieldMeaning> find_meaning(std::string_view field_name) {
    std::string name(trim(field_name));
    std::ranges::transform(name, name.begin(),
                           [](unsigned char character) { return char(std::tolower(character)); });
    // VeloView and ParaView store x, y and z as elements 0, 1 and 2 of a vector:
    // "points:0". The enum PointAttribute begins with x, y and z.
    for (const char axis : {'0', '1', '2'})
        if (name.starts_with("points") && name.ends_with(std::string(":") + axis))
            return FieldMeaning{PointAttribute(axis - '0'), 0};
    // Removes a path such as "cloud/", and prefixes while the rest is no known name.
    std::string_view rest = name;
    rest.remove_prefix(std::min(rest.find_last_of("./:") + 1, rest.size()));
    for (const std::string_view prefix : kNamePrefixes)
        if (rest.starts_with(prefix) && !find_exact_field(rest)) rest.remove_prefix(prefix.size());
    return find_exact_field(rest);
}

struct ScalarTypeEntry {
    char kind;
    std::size_t size;
    ScalarType type;
    std::string_view numpy;  ///< code of the number type in .npy files, for example "f4"
};
constexpr ScalarTypeEntry kNumberTypes[] = {{'F', 4, ScalarType::f4, "f4"}, {'F', 8, ScalarType::f8, "f8"},
                                            {'I', 1, ScalarType::i1, "i1"}, {'I', 2, ScalarType::i2, "i2"},
                                            {'I', 4, ScalarType::i4, "i4"}, {'I', 8, ScalarType::i8, "i8"},
                                            {'U', 1, ScalarType::u1, "u1"}, {'U', 2, ScalarType::u2, "u2"},
                                            {'U', 4, ScalarType::u4, "u4"}, {'U', 8, ScalarType::u8, "u8"}};

ScalarType field_scalar_type(const PointField& field, const std::string& where) {
    for (const ScalarTypeEntry& row : kNumberTypes)
        if (row.kind == field.kind && row.size == field.size) return row.type;
    fail("{}: the field '{}' has the type {}{}, expected F4, F8, or I or U with 1, 2, 4 or 8 bytes", where,
         quote(field.name), quote(std::string(1, field.kind)), field.size);
}

/// Returns true if a file has the point format of the dataset NCLT. There, the last byte
/// of a point is the laser number of an HDL-32E, 0 to 31. In float32 points, this byte
/// has the sign and exponent of a number, so it is 0, or at least 32 for usual numbers.
bool is_nclt_file(std::string_view bytes) {
    constexpr std::size_t kRecordBytes = 8, kLaserAt = 7, kMaxLasers = 32;
    const std::size_t n = bytes.size() / kRecordBytes;
    std::size_t n_not_zero = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const auto laser = static_cast<unsigned char>(bytes[i * kRecordBytes + kLaserAt]);
        if (laser >= kMaxLasers) return false;
        if (laser > 0) ++n_not_zero;
    }
    return bytes.size() % kRecordBytes == 0 && 2 * n_not_zero > n;
}

/// Reads a .bin file that contains float32 values, point by point.
PointTable read_floats(const fs::path& bin_file, const std::vector<std::string>& column_names) {
    const SharedBytes data = share_bytes(read_file(bin_file));
    const std::size_t n_bytes = data.bytes.size();
    std::vector<PointField> fields;
    for (const std::string& column : column_names) fields.push_back({column, 'F', sizeof(float)});
    if (is_nclt_file(data.bytes))
        fail(
            "{}: found points of NCLT (uint16 x, y, z, uint8 intensity, laser), expected float32; convert x, "
            "y, z to metres (value * 0.005 - 100), negate y and z, and set \"columns\": [\"x\", \"y\", "
            "\"z\", \"intensity\", \"ring\"]",
            bin_file.string());
    const std::size_t point_bytes = fields.size() * sizeof(float);
    if (n_bytes % point_bytes != 0)
        fail(
            "{}: found {} bytes, expected a multiple of {} bytes: {} float32 values (\"columns\" in "
            "sequence.json)",
            bin_file.string(), n_bytes, point_bytes, fields.size());
    PointTable table =
        table_of_records(data, fields, n_bytes / point_bytes, PointMemoryLayout::by_point, bin_file.string());
    // The user already got a note about unread columns when sequence.json was read.
    table.unread.clear();
    return table;
}

/// Adds the columns of an array [points, columns] to a table with the same number of
/// points. Adds only columns that relidar reads. The table keeps the memory of the array,
/// and each column is a view of it.
void add_columns(PointTable& table, NamedArray array, const std::vector<std::string>& column_names,
                 const std::string& where) {
    const auto* type = std::ranges::find(kNumberTypes, array.dtype, &ScalarTypeEntry::numpy);
    if (type == std::end(kNumberTypes)) {  // for example 16-bit floats
        const std::vector<double> values = array.to_doubles();
        array = make_array(array.name, array.shape, values.data(), values.size());
        type = std::ranges::find(kNumberTypes, ScalarType::f8, &ScalarTypeEntry::type);
    }
    const auto memory = std::make_shared<const std::vector<std::byte>>(std::move(array.bytes));
    table.keep_alive(memory);
    const auto* first_row = reinterpret_cast<const char*>(memory->data());
    const std::size_t row_bytes = column_names.size() * type->size;
    for (std::size_t c = 0; c < column_names.size(); ++c)
        if (is_known_field(column_names[c]))
            table.add_value_field(column_names[c], {type->type, first_row + c * type->size, row_bytes},
                                  where);
}

/// Makes a table from a 2D array with one row per point and one column per name.
PointTable table_of_array(NamedArray array, const std::vector<std::string>& column_names,
                          const std::string& where) {
    if (array.shape.size() != 2 || array.shape[1] != column_names.size())
        fail(
            "{}: found an array of {} dimensions{}, expected the shape [points, {}] with the columns {}; set "
            "\"columns\" in sequence.json to the columns of the array",
            where, array.shape.size(),
            array.shape.empty() ? "" : fmt::format(", whose last dimension is {}", array.shape.back()),
            column_names.size(), fmt::join(column_names, ", "));
    check_point_count(array.shape[0], where);
    PointTable table(array.shape[0]);
    add_columns(table, std::move(array), column_names, where);
    return table;
}

/// Reads a .npy file: a 2D array, or an array whose elements have named fields.
PointTable read_npy_points(const fs::path& file, const std::vector<std::string>& column_names) {
    const SharedBytes bytes = share_bytes(read_file(file));
    codecs::NpyHeader header;
    try {
        header = codecs::parse_npy_header(bytes.bytes);
    } catch (const DataError& error) {
        fail("{}: {}", file.string(), error.what());
    }
    if (header.type.empty()) return parse_npy_fields(bytes, header, file.string());
    return table_of_array(read_npy(file), column_names, file.string());
}

/// Returns the array of points by its usual names, or null.
const NamedArray* find_points(const std::vector<NamedArray>& arrays) {
    for (const char* name : {"points", "xyz", "point_cloud", "pointcloud", "arr_0"})
        if (const NamedArray* array = find_array(arrays, name); array && array->shape.size() >= 2)
            return array;
    return nullptr;
}

/// Reads an array "points" whose last dimension is the columns, and further arrays with a
/// value per point.
PointTable read_npz_points(const fs::path& file, const std::vector<std::string>& column_names) {
    const std::vector<NamedArray> arrays = read_npz(file);
    const NamedArray* points_array = find_points(arrays);
    if (!points_array)
        fail("{}: the array 'points' is missing, expected it in every scan file", file.string());
    // The array can be an image of points, [rows, columns, values]. It becomes a list.
    NamedArray points = *points_array;
    const std::size_t width = points.shape.back();
    points.shape = {width == 0 ? 0 : points.element_count() / width, width};
    std::vector<std::string> columns = column_names;
    if (columns.empty()) columns = {"x", "y", "z"};
    if (column_names.empty() && width != 3) columns.emplace_back("intensity");
    PointTable table = table_of_array(std::move(points), columns, file.string());
    for (const NamedArray& array : arrays) {
        const bool is_new = &array != points_array && !table.find_field(array.name);
        if (is_new && is_known_field(array.name) && array.element_count() == table.n)
            add_columns(table, array, {array.name}, file.string());
    }
    return table;
}

}  // namespace

std::optional<PointAttribute> find_attribute(std::string_view field_name) {
    const auto meaning = find_meaning(field_name);
    return meaning ? std::optional(meaning->attribute) : std::nullopt;
}

std::vector<std::string> PointTable::list_fields(PointAttribute attribute) const {
    // Sort keys: rank of the known name; true if the name is spelled differently; name.
    std::vector<std::tuple<std::size_t, bool, std::string>> ranked;
    for (const auto& [name, values] : fields_)
        if (const auto meaning = find_meaning(name); meaning && meaning->attribute == attribute)
            ranked.emplace_back(meaning->rank, name != kFieldNames.at(attribute)[meaning->rank], name);
    std::ranges::sort(ranked);
    std::vector<std::string> names;
    for (auto& [rank, is_other, name] : ranked) names.push_back(std::move(name));
    return names;
}

void check_point_count(std::size_t n_points, const std::string& where) {
    if (n_points == 0 || n_points > kMostPoints)
        fail("{}: found {} points, expected 1 to {}", where, n_points, kMostPoints);
}

const PointFieldView* PointTable::find_field(const std::string& field_name) const {
    const auto at = fields_.find(field_name);
    return at == fields_.end() ? nullptr : &at->second;
}

const PointFieldView* PointTable::find_field(PointAttribute attribute) const {
    const std::vector<std::string> all = list_fields(attribute);
    return all.empty() ? nullptr : find_field(all[0]);
}

void PointTable::add_value_field(const std::string& name, const PointFieldView& values,
                                 const std::string& where) {
    if (!fields_.emplace(name, values).second)
        fail("{}: the field '{}' occurs twice, expected it once", where, name);
}

void PointTable::remove_fields(PointAttribute attribute) {
    std::erase_if(fields_, [&](const auto& field) { return find_attribute(field.first) == attribute; });
}

PointTable table_of_records(const SharedBytes& data, const std::vector<PointField>& fields,
                            std::size_t n_points, PointMemoryLayout memory_layout, const std::string& where) {
    check_point_count(n_points, where);
    std::size_t point_bytes = 0;
    for (const PointField& field : fields) {
        if (field.size == 0 || field.count == 0)
            fail("{}: field '{}' has no values, expected at least one per point", where, quote(field.name));
        point_bytes += field.size * field.count;
    }
    if (data.bytes.size() / n_points < point_bytes)
        fail("{}: the file is truncated: found {} bytes of points, expected {} points of {} bytes", where,
             data.bytes.size(), n_points, point_bytes);
    PointTable table(n_points);
    table.keep_alive(data.memory);
    // By point, the values of a field are `point_bytes` apart. By field, they are
    // contiguous and start after all values of the previous fields.
    const bool is_by_point = memory_layout == PointMemoryLayout::by_point;
    std::size_t n_before = 0;  // number of bytes of the previous fields in a point
    for (const PointField& field : fields) {
        const std::size_t width = field.size * field.count;
        if (is_known_field(field.name)) {
            const char* first = data.bytes.data() + (is_by_point ? n_before : n_before * n_points);
            const std::size_t step = is_by_point ? point_bytes : width;
            table.add_value_field(field.name, {field_scalar_type(field, where), first, step}, where);
        } else if (field.name != kPaddingName) {
            table.unread.push_back(field.name);
        }
        n_before += width;
    }
    return table;
}

std::vector<std::string_view> split_words(std::string_view line) {
    std::vector<std::string_view> words;
    for (line = trim(line); !line.empty(); line = trim(line)) {
        const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
        words.push_back(line.substr(0, end));
        line.remove_prefix(end);
    }
    return words;
}

PointTable parse_lines(std::string_view text, const std::vector<PointField>& fields, std::size_t n_points,
                       const std::string& where) {
    check_point_count(n_points, where);
    // A point has at least one byte of text, so this limits the memory for its values.
    if (n_points > text.size())
        fail("{}: the file is truncated: found {} bytes of text, expected {} points", where, text.size(),
             n_points);
    struct Column {
        std::size_t index_in_line;
        const std::string& name;
        std::vector<double> values;
    };
    std::vector<Column> columns;
    std::size_t n_values = 0;  // in a line
    for (const PointField& field : fields) {
        if (is_known_field(field.name))
            columns.push_back({n_values, field.name, std::vector<double>(n_points)});
        n_values += field.count;
    }
    for (std::size_t i = 0; i < n_points; ++i) {
        const std::size_t end = std::min(text.find('\n'), text.size());
        const auto numbers = parse_numbers(text.substr(0, end));
        if (!numbers || numbers->size() != n_values)
            fail("{}: point {} is '{}', expected {} numbers", where, i, quote(text.substr(0, end)), n_values);
        for (Column& column : columns) column.values[i] = (*numbers)[column.index_in_line];
        text.remove_prefix(std::min(end + 1, text.size()));
    }
    PointTable table(n_points);
    for (const PointField& field : fields)
        if (!is_known_field(field.name) && field.name != kPaddingName) table.unread.push_back(field.name);
    for (Column& column : columns)
        table.add_value_field(column.name, ScalarType::f8, std::move(column.values), where);
    return table;
}

bool is_point_file(const fs::path& file) {
    const std::string ending = file.extension().string();
    return ending == ".pcd" || ending == ".ply" || ending == ".bin" || ending == ".npy" || ending == ".csv" ||
           ending == ".xyz" || ending == ".las";
}

bool is_image_file(const fs::path& file) { return file.extension() == ".npz" || file.extension() == ".exr"; }

namespace {

/// Reads a file whose header may say that its points are not in the sensor frame.
PointTable read_with_header(const fs::path& file,
                            PointTable (*parse_points)(const SharedBytes& bytes, const std::string& where)) {
    const SharedBytes bytes = share_bytes(read_text_file(file));
    PointTable table = parse_points(bytes, file.string());
    // If points are motion-compensated or in the world frame, relidar writes one of two
    // texts that start with "points_in" to the header.
    constexpr std::size_t kSearchedBytes = 4096;
    const std::string_view header = bytes.bytes.substr(0, kSearchedBytes);
    table.is_deskewed = header.find(" points_in sensor at time_s") != header.npos ||
                        header.find(" points_in world") != header.npos;
    return table;
}

}  // namespace

bool has_npz_points(const std::vector<fs::path>& scan_files) {
    const auto file = std::ranges::find(scan_files, ".npz", [](const fs::path& f) { return f.extension(); });
    std::vector<NamedArray> arrays;
    try {
        if (file != scan_files.end()) arrays = read_npz(*file);
    } catch (const DataError&) {
        return false;  // the error is reported when the scan is read
    }
    // Only scans that consist of rays have an array of ranges.
    if (arrays.empty() || find_array(arrays, "range")) return false;
    if (find_points(arrays)) return true;
    std::vector<std::string> names;
    for (const NamedArray& array : arrays) names.push_back(array.name);
    fail("{}: found the arrays {}; expected 'range' and 'directions' (rays), or 'points'", file->string(),
         fmt::join(names, ", "));
}

PointTable read_point_file(const fs::path& file, const std::vector<std::string>& column_names) {
    static const std::vector<std::string> kKittiColumns = {"x", "y", "z", "intensity"};
    const std::string ending = file.extension().string();
    if (ending == ".bin") return read_floats(file, column_names.empty() ? kKittiColumns : column_names);
    if (ending == ".npy") return read_npy_points(file, column_names.empty() ? kKittiColumns : column_names);
    if (ending == ".npz") return read_npz_points(file, column_names);
    if (ending == ".pcd") return read_with_header(file, parse_pcd);
    if (ending == ".ply") return read_with_header(file, parse_ply);
    if (ending == ".las") return parse_las(share_bytes(read_file(file)), file.string());
    if (ending == ".csv" || ending == ".xyz")
        return parse_text(share_bytes(read_file(file)), column_names, file.string());
    if (const std::string other = describe_format(file); !other.empty()) fail("{}: {}", file.string(), other);
    fail("{}: found a file '{}', expected .npz, .exr, .pcd, .ply, .bin, .npy, .las, .csv or .xyz",
         file.string(), quote(ending));
}

}  // namespace relidar::read
