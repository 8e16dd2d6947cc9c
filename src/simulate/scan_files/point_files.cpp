// SPDX-License-Identifier: Apache-2.0
// Writes point clouds as PLY (binary little-endian), PCD 0.7 (binary) and KITTI .bin. PLY
// and PCD files contain the same packed points after different headers. KITTI files have
// no header and no additional fields. Fields have the names and types that readers of
// LiDAR data expect: intensity, ring (uint16), time (float32, seconds).
#include <relidar/simulate/point_files.hpp>

#include <algorithm>
#include <cctype>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/codecs/file_io.hpp"

namespace relidar {
namespace {

/// A field of a point, with its types in PLY and PCD. PLY knows the 16-bit type as ushort
/// and as uint16. The files use uint16, because Open3D does not read ushort.
struct Field {
    std::string name;
    const char* ply_type;
    int bytes;
    char pcd_type;
};

std::vector<Field> list_fields(const Points& points) {
    const bool is_empty = points.size() == 0;
    std::vector<Field> fields;
    for (const char* name : {"x", "y", "z", "intensity"}) fields.push_back({name, "float", 4, 'F'});
    if (is_empty || !points.ring.empty()) fields.push_back({"ring", "uint16", 2, 'U'});
    if (is_empty || !points.time_offset_s.empty()) fields.push_back({"time", "float", 4, 'F'});
    if (is_empty || !points.instance.empty()) fields.push_back({"instance", "int", 4, 'I'});
    if (!points.return_number.empty()) fields.push_back({"return", "uint8", 1, 'U'});
    for (const auto& [name, is_integer] : list_channel_numbers(points.channels))
        fields.push_back({name, is_integer ? "int" : "float", 4, is_integer ? 'I' : 'F'});
    return fields;
}

/// Returns the name of a field in a PLY file, where normals have the names nx, ny and nz.
std::string get_ply_name(const std::string& name) {
    for (const char* axis : {"x", "y", "z"})
        if (name == std::string("normal_") + axis) return std::string("n") + axis;
    return name;
}

/// Checks that each array has one value per point. Optional arrays may be empty.
/// @throws DataError if an array has another length
void check_lengths(const Points& points) {
    const auto check = [&](const char* name, std::size_t found, bool may_be_unknown = true) {
        if (found != points.size() && !(may_be_unknown && found == 0))
            throw DataError(fmt::format("cannot write a point cloud: found {} values of {}, expected {}",
                                        found, name, points.size()));
    };
    check("intensity", points.intensity.size(), false);
    check("ring", points.ring.size());
    check("time", points.time_offset_s.size());
    check("instance", points.instance.size());
    check("return", points.return_number.size());
    check_channels(points.channels, points.size(), "a point cloud");
}

/// Packs the fields of each point into bytes, in the order of list_fields().
std::string pack_records(const Points& points) {
    std::string bytes;
    bytes.reserve(points.size() * 26);
    const auto append_known = [&](const auto& values, std::size_t index) {
        if (!values.empty()) append(bytes, values[index]);
    };
    for (std::size_t i = 0; i < points.size(); ++i) {
        append(bytes, points.position_m[i]), append(bytes, points.intensity[i]);
        append_known(points.ring, i), append_known(points.time_offset_s, i);
        append_known(points.instance, i), append_known(points.return_number, i);
        append_channel_values(bytes, points.channels, i);
    }
    return bytes;
}

/// Formats a pose as "tx ty tz qw qx qy qz".
std::string format_viewpoint(const Pose& pose) {
    const glm::dvec3& t = pose.translation;
    const glm::dquat& q = pose.rotation;
    std::vector<std::string> numbers;
    for (const double v : {t.x, t.y, t.z, q.w, q.x, q.y, q.z}) numbers.push_back(fmt::format("{}", v));
    return fmt::format("{}", fmt::join(numbers, " "));
}

}  // namespace

void write_ply(const std::filesystem::path& path, const Points& points, const FileNotes& notes) {
    check_lengths(points);
    std::string text = "ply\nformat binary_little_endian 1.0\n";
    for (const auto& note : notes) text += fmt::format("comment {}\n", report_detail::format_note_line(note));
    text += fmt::format("element vertex {}\n", points.size());
    for (const Field& field : list_fields(points))
        text += fmt::format("property {} {}\n", field.ply_type, get_ply_name(field.name));
    report_detail::write_file(path, text + "end_header\n" + pack_records(points));
}

void write_pcd(const std::filesystem::path& path, const Points& points, const FileNotes& notes) {
    check_lengths(points);
    std::string header = "# .PCD v0.7 - Point Cloud Data file format\n", names, sizes, types, counts;
    for (const auto& note : notes) header += fmt::format("# {}\n", report_detail::format_note_line(note));
    for (const Field& field : list_fields(points)) {
        names += fmt::format(" {}", field.name);
        sizes += fmt::format(" {}", field.bytes);
        types += fmt::format(" {}", field.pcd_type);
        counts += " 1";
    }
    const std::size_t n = points.size();
    header += fmt::format("VERSION 0.7\nFIELDS{}\nSIZE{}\nTYPE{}\nCOUNT{}\n", names, sizes, types, counts);
    header += fmt::format("WIDTH {}\nHEIGHT 1\nVIEWPOINT {}\nPOINTS {}\nDATA binary\n", n,
                          format_viewpoint(points.world_from_points), n);
    report_detail::write_file(path, header + pack_records(points));
}

void write_kitti_bin(const std::filesystem::path& path, const Points& points) {
    check_lengths(points);
    report_detail::write_file(path, pack_records({points.position_m, points.intensity}));
}

}  // namespace relidar
