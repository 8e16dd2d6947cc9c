// SPDX-License-Identifier: Apache-2.0
// Writes point clouds as PLY (binary little-endian), PCD 0.7 (binary) and KITTI .bin. PLY
// and PCD files contain the same packed points after different headers. KITTI files have
// no header and no additional fields. Fields have the names and types that readers of
// LiDAR data expect: intensity, ring (uint16), time (float32, seconds).
#include <relidar/simulate/point_files.hpp>

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
std::vector<PointFileField> list_fields(const LidarPoints& points) {
    const bool is_empty = points.size() == 0;
    std::vector<PointFileField> fields;
    for (const char* name : {"x", "y", "z", "intensity"}) fields.push_back({name, "float", 4, 'F'});
    if (is_empty || !points.ring.empty()) fields.push_back({"ring", "uint16", 2, 'U'});
    if (is_empty || !points.time_offset_s.empty()) fields.push_back({"time", "float", 4, 'F'});
    if (is_empty || !points.instance.empty()) fields.push_back({"instance", "int", 4, 'I'});
    if (!points.return_number.empty()) fields.push_back({"return", "uint8", 1, 'U'});
    for (const auto& [name, is_integer] : list_columns(points.channels))
        fields.push_back({name, is_integer ? "int" : "float", 4, is_integer ? 'I' : 'F'});
    return fields;
}

void check_lengths(const LidarPoints& points) {
    // Unknown (empty) arrays are allowed, except the intensity.
    const auto check = [&](const char* name, std::size_t found, bool may_be_unknown = true) {
        if (found != points.size() && !(may_be_unknown && found == 0))
            fail("cannot write a point cloud: the array {} has {} values, expected {}, one for each point",
                 name, found, points.size());
    };
    check("intensity", points.intensity.size(), false);
    check("ring", points.ring.size());
    check("time", points.time_offset_s.size());
    check("instance", points.instance.size());
    check("return", points.return_number.size());
    check_channels(points.channels, points.size(), "a point cloud");
}

/// Packs points without gaps, in the order of list_fields().
std::string pack_records(const LidarPoints& points) {
    std::string bytes;
    // 12 + 4 + 2 + 4 + 4 bytes with ring, time and instance
    bytes.reserve(points.size() * 26);
    const auto append_if_present = [&](const auto& values, std::size_t index) {
        if (!values.empty()) append_raw(bytes, values[index]);
    };
    for (std::size_t i = 0; i < points.size(); ++i) {
        append_raw(bytes, points.position_m[i]);
        append_raw(bytes, points.intensity[i]);
        append_if_present(points.ring, i);
        append_if_present(points.time_offset_s, i);
        append_if_present(points.instance, i);
        append_if_present(points.return_number, i);
        append_values(bytes, points.channels, i);
    }
    return bytes;
}

}  // namespace

void write_ply(const fs::path& path, const LidarPoints& points, const FileMetadata& notes) {
    check_lengths(points);
    std::string text = "ply\nformat binary_little_endian 1.0\n";
    for (const auto& note : notes) text += fmt::format("comment {}\n", codecs::metadata_line(note));
    text += fmt::format("element vertex {}\n", points.size());
    for (const PointFileField& field : list_fields(points)) {
        std::string ply_name = field.name;
        for (const char* axis : {"x", "y", "z"})  // normals have the names nx, ny and nz
            if (field.name == std::string("normal_") + axis) ply_name = std::string("n") + axis;
        text += fmt::format("property {} {}\n", field.ply_type, ply_name);
    }
    codecs::write_file(path, text + "end_header\n" + pack_records(points));
}

void write_pcd(const fs::path& path, const LidarPoints& points, const FileMetadata& notes) {
    check_lengths(points);
    std::string header = "# .PCD v0.7 - Point Cloud Data file format\n", names, sizes, types, counts;
    for (const auto& note : notes) header += fmt::format("# {}\n", codecs::metadata_line(note));
    for (const PointFileField& field : list_fields(points)) {
        names += fmt::format(" {}", field.name);
        sizes += fmt::format(" {}", field.bytes);
        types += fmt::format(" {}", field.pcd_type);
        counts += " 1";
    }
    const std::size_t n = points.size();
    header += fmt::format("VERSION 0.7\nFIELDS{}\nSIZE{}\nTYPE{}\nCOUNT{}\n", names, sizes, types, counts);
    // Sensor pose of the points: translation, then quaternion (w x y z).
    const glm::dvec3& t = points.world_from_points.translation;
    const glm::dquat& q = points.world_from_points.rotation;
    std::vector<std::string> viewpoint;
    for (const double v : {t.x, t.y, t.z, q.w, q.x, q.y, q.z}) viewpoint.push_back(fmt::format("{}", v));
    header += fmt::format("WIDTH {}\nHEIGHT 1\nVIEWPOINT {}\nPOINTS {}\nDATA binary\n", n,
                          fmt::join(viewpoint, " "), n);
    codecs::write_file(path, header + pack_records(points));
}

void write_kitti_bin(const fs::path& path, const LidarPoints& points) {
    check_lengths(points);
    codecs::write_file(path, pack_records({points.position_m, points.intensity}));
}

}  // namespace relidar
