// SPDX-License-Identifier: Apache-2.0
// Writes point clouds as PLY (binary little-endian), PCD 0.7 (binary), LAS 1.4 and KITTI
// .bin. PLY and PCD files contain the same packed points after different headers. KITTI
// files have no header and no additional fields. Fields have the names and types that
// readers of LiDAR data expect: intensity, ring (uint16), time (float32, seconds).
#include <relidar/simulate/point_files.hpp>

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/bytes.hpp"
#include "base/codecs/file_io.hpp"
#include "base/fail.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

/// In PLY, the 16-bit type is uint16, because Open3D does not read ushort.
struct PointFileField {
    std::string name;
    const char* ply_type;
    int bytes;
    char pcd_type;
};

/// Lists the fields of a file. Leaves out unknown values, except in a file without
/// points, so that all files of a folder have the same fields.
std::vector<PointFileField> list_fields(const LidarPoints& points, bool has_doubles) {
    const bool is_empty = points.size() == 0;
    std::vector<PointFileField> fields;
    for (const char* name : {"x", "y", "z"})
        fields.push_back({name, has_doubles ? "double" : "float", has_doubles ? 8 : 4, 'F'});
    fields.push_back({"intensity", "float", 4, 'F'});
    if (is_empty || !points.ring.empty()) fields.push_back({"ring", "uint16", 2, 'U'});
    if (is_empty || !points.time_offset_s.empty()) fields.push_back({"time", "float", 4, 'F'});
    if (is_empty || !points.instance.empty()) fields.push_back({"instance", "int", 4, 'I'});
    if (!points.return_number.empty()) fields.push_back({"return", "uint8", 1, 'U'});
    for (const auto& [name, is_integer] : list_columns(points.channels))
        fields.push_back({name, is_integer ? "int" : "float", 4, is_integer ? 'I' : 'F'});
    return fields;
}

/// Checks that each array has one value per point. Unknown (empty) arrays are allowed,
/// except the intensity.
void check_lengths(const LidarPoints& points) {
    enum Presence { kRequired, kOptional };
    const auto check = [&](const char* name, std::size_t n_values, Presence presence = kOptional) {
        if (n_values == points.size() || (presence == kOptional && n_values == 0)) return;
        fail("cannot write a point cloud: the array {} has {} values, expected {}, one for each point", name,
             n_values, points.size());
    };
    check("intensity", points.intensity.size(), kRequired);
    check("ring", points.ring.size());
    check("time", points.time_offset_s.size());
    check("instance", points.instance.size());
    check("return", points.return_number.size());
    check_channels(points.channels, points.size(), "a point cloud");
}

/// Packs points without gaps, in the order of list_fields().
/// @param world_origin_m origin of positions in the world, which get double precision
std::string pack_records(const LidarPoints& points, const std::optional<glm::dvec3>& world_origin_m) {
    std::string bytes;
    const auto append_if_present = [&](const auto& values, std::size_t index) {
        if (!values.empty()) append_raw(bytes, values[index]);
    };
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (world_origin_m) append_raw(bytes, *world_origin_m + glm::dvec3(points.position_m[i]));
        else append_raw(bytes, points.position_m[i]);
        append_raw(bytes, points.intensity[i]);
        append_if_present(points.ring, i);
        append_if_present(points.time_offset_s, i);
        append_if_present(points.instance, i);
        append_if_present(points.return_number, i);
        append_values(bytes, points.channels, i);
    }
    return bytes;
}

// Sizes and numbers of the LAS 1.4 specification.
constexpr std::uint16_t kLasHeaderBytes = 375, kLasRecordBytes = 30, kLasWktEncoding = 16;
constexpr std::uint16_t kLasWktRecord = 2112, kLasExtraBytesRecord = 4, kLasNotesRecord = 1;
constexpr std::uint8_t kLasPointFormat = 6;
constexpr double kLasStep_m = 1e-4;

void append_padded(std::string& bytes, std::string text, std::size_t length) {
    text.resize(length);
    bytes += text;
}

/// Returns a variable length record of a LAS file.
std::string las_record(const char* user, std::uint16_t number, std::string data) {
    if (data.size() > UINT16_MAX) data.resize(UINT16_MAX);
    std::string bytes(2, '\0');
    append_padded(bytes, user, 16);
    append_raw(bytes, number);
    append_raw(bytes, std::uint16_t(data.size()));
    append_padded(bytes, "", 32);
    return bytes + data;
}

/// Describes a field that follows the standard fields of each LAS point.
std::string describe_extra(const PointFileField& field) {
    constexpr char kUint16 = 3, kInt32 = 6, kFloat = 9;
    std::string bytes(2, '\0');
    bytes += field.bytes == 2 ? kUint16 : field.pcd_type == 'I' ? kInt32 : kFloat;
    bytes += '\0';
    append_padded(bytes, field.name.substr(0, 31), 32);
    append_padded(bytes, "", 192 - bytes.size());
    return bytes;
}

/// Points in the layout of a LAS file, and the summary that its header needs. A position
/// is stored as whole steps of kLasStep_m from `offset_m`.
struct LasPoints {
    glm::dvec3 offset_m{0.0}, min_m{INFINITY}, max_m{-INFINITY};
    std::array<std::uint64_t, 15> n_by_return{};  ///< numbers of first, second, ... returns
    std::string records = {};

    /// Appends the position of a point to the records.
    /// @param relative_m position relative to `offset_m`
    void append_position(const glm::dvec3& relative_m, std::size_t point) {
        constexpr double kMaxDistance_m = 200'000.0;  // limit of 32-bit steps
        glm::dvec3 rounded_m;
        for (int axis = 0; axis < 3; ++axis) {
            if (!(std::abs(relative_m[axis]) < kMaxDistance_m))
                fail("cannot write LAS: point {} is {} m from the origin, expected less than {} m", point,
                     relative_m[axis], kMaxDistance_m);
            const auto step = std::int32_t(std::lround(relative_m[axis] / kLasStep_m));
            append_raw(records, step);
            rounded_m[axis] = offset_m[axis] + kLasStep_m * step;
        }
        min_m = glm::min(min_m, rounded_m);
        max_m = glm::max(max_m, rounded_m);
    }
};

/// Packs points as records of point format 6 with extra bytes.
LasPoints pack_las(const LidarPoints& points, const glm::dvec3& origin_m) {
    LasPoints las{.offset_m = glm::round(origin_m)};
    const auto return_number = [&](std::size_t i) {
        return i < points.return_number.size() ? points.return_number[i] : std::uint8_t(1);
    };
    std::size_t n_returns = 1;  // of the current ray
    for (std::size_t i = 0; i < points.size(); ++i) {
        las.append_position(origin_m - las.offset_m + glm::dvec3(points.position_m[i]), i);
        const std::uint8_t number = return_number(i);
        if (number == 1) {
            // The second and further returns of the ray follow directly.
            n_returns = 1;
            while (i + n_returns < points.size() && return_number(i + n_returns) > 1) ++n_returns;
        }
        ++las.n_by_return[number - 1u];
        const float intensity = std::clamp(points.intensity[i], 0.0f, 1.0f);
        append_raw(las.records, std::uint16_t(std::lround(65535.0f * intensity)));
        append_raw(las.records, std::uint8_t(number | n_returns << 4));  // 4 bits each
        append_padded(las.records, "", 7);  // flags, class, user data, scan angle, source
        const double offset_s = points.time_offset_s.empty() ? 0.0 : double(points.time_offset_s[i]);
        append_raw(las.records, points.time_s + offset_s);
        if (!points.ring.empty()) append_raw(las.records, points.ring[i]);
        if (!points.instance.empty()) append_raw(las.records, points.instance[i]);
        append_values(las.records, points.channels, i);
    }
    if (points.size() == 0) las.min_m = las.max_m = las.offset_m;
    return las;
}

}  // namespace

void write_ply(const fs::path& path, const LidarPoints& points, const FileMetadata& notes,
               const std::optional<glm::dvec3>& world_origin_m) {
    check_lengths(points);
    std::string text = "ply\nformat binary_little_endian 1.0\n";
    for (const auto& note : notes) text += fmt::format("comment {}\n", codecs::metadata_line(note));
    text += fmt::format("element vertex {}\n", points.size());
    for (const PointFileField& field : list_fields(points, world_origin_m.has_value())) {
        std::string ply_name = field.name;
        for (const char* axis : {"x", "y", "z"})  // normals have the names nx, ny and nz
            if (field.name == std::string("normal_") + axis) ply_name = std::string("n") + axis;
        text += fmt::format("property {} {}\n", field.ply_type, ply_name);
    }
    codecs::write_file(path, text + "end_header\n" + pack_records(points, world_origin_m));
}

void write_pcd(const fs::path& path, const LidarPoints& points, const FileMetadata& notes,
               const std::optional<glm::dvec3>& world_origin_m) {
    check_lengths(points);
    std::string header = "# .PCD v0.7 - Point Cloud Data file format\n", names, sizes, types, counts;
    for (const auto& note : notes) header += fmt::format("# {}\n", codecs::metadata_line(note));
    for (const PointFileField& field : list_fields(points, world_origin_m.has_value())) {
        names += fmt::format(" {}", field.name);
        sizes += fmt::format(" {}", field.bytes);
        types += fmt::format(" {}", field.pcd_type);
        counts += " 1";
    }
    const std::size_t n = points.size();
    header += fmt::format("VERSION 0.7\nFIELDS{}\nSIZE{}\nTYPE{}\nCOUNT{}\n", names, sizes, types, counts);
    // Sensor pose of the points: translation, then quaternion (w x y z).
    const Pose view = world_origin_m ? Pose{} : points.world_from_points;
    const glm::dvec3& t = view.translation;
    const glm::dquat& q = view.rotation;
    std::vector<std::string> viewpoint;
    for (const double v : {t.x, t.y, t.z, q.w, q.x, q.y, q.z}) viewpoint.push_back(fmt::format("{}", v));
    header += fmt::format("WIDTH {}\nHEIGHT 1\nVIEWPOINT {}\nPOINTS {}\nDATA binary\n", n,
                          fmt::join(viewpoint, " "), n);
    codecs::write_file(path, header + pack_records(points, world_origin_m));
}

void write_las(const fs::path& path, const LidarPoints& points, const FileMetadata& notes,
               const std::optional<glm::dvec3>& world_origin_m, const std::string& wkt) {
    check_lengths(points);
    std::string text, extra, records;
    for (const auto& note : notes) text += codecs::metadata_line(note) + "\n";
    std::uint16_t record_bytes = kLasRecordBytes;
    for (const PointFileField& field : list_fields(points, false)) {
        constexpr std::array kStandard{"x", "y", "z", "intensity", "time", "return"};
        if (std::ranges::find(kStandard, field.name) != kStandard.end()) continue;
        extra += describe_extra(field);
        record_bytes = std::uint16_t(record_bytes + field.bytes);
    }
    records += las_record("relidar", kLasNotesRecord, text);
    if (!extra.empty()) records += las_record("LASF_Spec", kLasExtraBytesRecord, extra);
    if (!wkt.empty()) records += las_record("LASF_Projection", kLasWktRecord, wkt + '\0');
    const std::uint32_t n_records = 1u + (extra.empty() ? 0u : 1u) + (wkt.empty() ? 0u : 1u);
    const LasPoints las = pack_las(points, world_origin_m.value_or(glm::dvec3(0.0)));
    std::string bytes = "LASF";
    append_raw(bytes, std::uint16_t(0));
    append_raw(bytes, kLasWktEncoding);
    append_padded(bytes, "", 16);
    bytes += {1, 4};  // version
    append_padded(bytes, "relidar", 32);
    append_padded(bytes, "relidar " RELIDAR_VERSION, 32);
    append_padded(bytes, "", 4);  // no date, so that equal points give equal files
    append_raw(bytes, kLasHeaderBytes);
    append_raw(bytes, std::uint32_t(kLasHeaderBytes + records.size()));
    append_raw(bytes, n_records);
    append_raw(bytes, kLasPointFormat);
    append_raw(bytes, record_bytes);
    append_padded(bytes, "", 24);  // counts of older versions
    append_raw(bytes, glm::dvec3(kLasStep_m));
    append_raw(bytes, las.offset_m);
    for (int axis = 0; axis < 3; ++axis) {
        append_raw(bytes, las.max_m[axis]);
        append_raw(bytes, las.min_m[axis]);
    }
    append_padded(bytes, "", 20);  // no waveforms and no extended records
    append_raw(bytes, std::uint64_t(points.size()));
    append_raw(bytes, las.n_by_return);
    codecs::write_file(path, bytes + records + las.records);
}

void write_kitti_bin(const fs::path& path, const LidarPoints& points) {
    check_lengths(points);
    codecs::write_file(path, pack_records({points.position_m, points.intensity}, {}));
}

}  // namespace relidar
