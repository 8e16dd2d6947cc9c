// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/point_table.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "base/files.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostPoints = std::size_t(1) << 24;  // as many as a scan may have rays

template <class T>
double get(const char* bytes) {
    T value;
    std::memcpy(&value, bytes, sizeof value);
    return static_cast<double>(value);
}

using Get = double (*)(const char*);
Get getter(const PointField& field, const std::string& where) {
    struct Row {
        char kind;
        std::size_t size;
        Get get;
    };
    static constexpr Row kRows[] = {{'F', 4, get<float>},         {'F', 8, get<double>},
                                    {'I', 1, get<std::int8_t>},   {'I', 2, get<std::int16_t>},
                                    {'I', 4, get<std::int32_t>},  {'I', 8, get<std::int64_t>},
                                    {'U', 1, get<std::uint8_t>},  {'U', 2, get<std::uint16_t>},
                                    {'U', 4, get<std::uint32_t>}, {'U', 8, get<std::uint64_t>}};
    for (const Row& row : kRows)
        if (row.kind == field.kind && row.size == field.size) return row.get;
    throw DataError(
        fmt::format("{}: field '{}' of type {}{}, expected F4, F8 or I or U of 1, 2, 4 or 8 bytes", where,
                    excerpt(field.name), excerpt(std::string(1, field.kind)), field.size));
}

void check_count(std::size_t n, const std::string& where) {
    if (n == 0 || n > kMostPoints)
        throw DataError(fmt::format("{}: {} points, expected 1 to {}", where, n, kMostPoints));
}

std::vector<double>& add_field(PointTable& table, const std::string& name, const std::string& where) {
    const auto [at, is_new] = table.fields.try_emplace(name, table.n);
    if (!is_new) throw DataError(fmt::format("{}: field '{}' twice, expected it once", where, name));
    return at->second;
}

PointTable read_bin(const fs::path& file, const std::vector<std::string>& columns) {
    const std::string bytes = read_file(file);
    std::vector<PointField> fields;
    for (const std::string& column : columns) fields.push_back({column, 'F', sizeof(float)});
    const std::size_t record = fields.size() * sizeof(float);
    if (bytes.size() % record != 0)
        throw DataError(
            fmt::format("{}: {} bytes, expected a multiple of {}: {} float32 a point (\"columns\")",
                        file.string(), bytes.size(), record, fields.size()));
    return read_packed(bytes, fields, bytes.size() / record, Packing::by_point, file.string());
}

PointTable read_npy_points(const fs::path& file, const std::vector<std::string>& columns) {
    const NamedArray array = read_npy(file);
    if (array.shape.size() != 2 || array.shape[1] != columns.size())
        throw DataError(fmt::format(
            "{}: an array of {} dimensions{}, expected [points, {}] (\"columns\")", file.string(),
            array.shape.size(),
            array.shape.empty() ? "" : fmt::format(", the last of {}", array.shape.back()), columns.size()));
    check_count(array.shape[0], file.string());
    const std::vector<double> values = array.as_double();
    PointTable table{array.shape[0], {}};
    for (std::size_t c = 0; c < columns.size(); ++c) {
        if (!is_point_field(columns[c])) continue;
        std::vector<double>& field = add_field(table, columns[c], file.string());
        for (std::size_t i = 0; i < table.n; ++i) field[i] = values[i * columns.size() + c];
    }
    return table;
}

}  // namespace

bool is_point_field(std::string_view name) {
    static constexpr std::string_view kNames[] = {
        "x",    "y", "z",         "intensity",  "reflectivity", "ring",   "channel",       "line",
        "time", "t", "timestamp", "time_stamp", "offset_time",  "return", "return_number", "return_type"};
    return std::find(std::begin(kNames), std::end(kNames), name) != std::end(kNames);
}

const std::vector<double>* PointTable::find(std::initializer_list<const char*> names) const {
    for (const char* name : names)
        if (const auto at = fields.find(name); at != fields.end()) return &at->second;
    return nullptr;
}

PointTable read_packed(std::string_view bytes, const std::vector<PointField>& fields, std::size_t n,
                       Packing packing, const std::string& where) {
    check_count(n, where);
    std::size_t record = 0;
    for (const PointField& field : fields) record += field.size * field.count;
    if (bytes.size() / n < record)
        throw DataError(fmt::format("{}: truncated: {} bytes of points, expected {} x {}", where,
                                    bytes.size(), n, record));
    PointTable table{n, {}};
    std::size_t before = 0;  // bytes of the fields before this one, of a point
    for (const PointField& field : fields) {
        const std::size_t width = field.size * field.count;
        if (is_point_field(field.name)) {
            const Get get = getter(field, where);
            const char* first = bytes.data() + (packing == Packing::by_point ? before : before * n);
            const std::size_t step = packing == Packing::by_point ? record : width;
            std::vector<double>& values = add_field(table, field.name, where);
            for (std::size_t i = 0; i < n; ++i) values[i] = get(first + i * step);
        }
        before += width;
    }
    return table;
}

PointTable read_lines(std::string_view text, const std::vector<PointField>& fields, std::size_t n,
                      const std::string& where) {
    check_count(n, where);
    if (n > text.size())
        throw DataError(
            fmt::format("{}: truncated: {} bytes of text, expected {} points", where, text.size(), n));
    PointTable table{n, {}};
    std::vector<std::pair<std::size_t, std::vector<double>*>> kept;  // place in the line
    std::size_t width = 0;
    for (const PointField& field : fields) {
        if (is_point_field(field.name)) kept.emplace_back(width, &add_field(table, field.name, where));
        width += field.count;
    }
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t end = std::min(text.find('\n'), text.size());
        const auto numbers = parse_numbers(text.substr(0, end));
        if (!numbers || numbers->size() != width)
            throw DataError(fmt::format("{}: point {}: '{}', expected {} numbers", where, i,
                                        excerpt(text.substr(0, end)), width));
        for (const auto& [place, values] : kept) (*values)[i] = (*numbers)[place];
        text.remove_prefix(std::min(end + 1, text.size()));
    }
    return table;
}

bool is_point_file(const fs::path& file) {
    const std::string ending = file.extension().string();
    return ending == ".pcd" || ending == ".ply" || ending == ".bin" || ending == ".npy";
}

bool is_image_file(const fs::path& file) { return file.extension() == ".npz" || file.extension() == ".exr"; }

namespace {

/// Returns true if relidar wrote the point cloud and deskewed it or moved it to the
/// world.
bool says_deskewed(std::string_view bytes) {
    constexpr std::size_t kHeader = 4096;  // bytes that are looked at
    const std::string_view header = bytes.substr(0, kHeader);
    return header.find(" points_in sensor at time_s") != header.npos ||
           header.find(" points_in world") != header.npos;
}

PointTable read_with_header(const fs::path& file,
                            PointTable (*read)(const std::string& bytes, const std::string& where)) {
    const std::string bytes = read_text(file);
    PointTable table = read(bytes, file.string());
    table.is_deskewed = says_deskewed(bytes);
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
    throw DataError(fmt::format("{}: the ending '{}', expected .npz, .exr, .pcd, .ply, .bin or .npy",
                                file.string(), excerpt(ending)));
}

}  // namespace relidar::folder
