// SPDX-License-Identifier: Apache-2.0
// Point clouds as files: PLY (binary little-endian), PCD 0.7 (binary) and KITTI .bin. PLY
// and PCD hold the same packed records under different headers; KITTI has neither header
// nor extra fields. Names and types of fields are those that readers of spinning LiDARs
// look for: intensity, ring (uint16), time (float32, seconds).
#include <relidar/simulate/point_cloud.hpp>

#include <algorithm>
#include <cctype>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/codecs/file_io.hpp"

namespace relidar {
namespace {

/// A field of a record, as both headers call it. (PLY has two names of 16 bits, ushort
/// and uint16: Open3D reads the second alone.)
struct Field {
    std::string name;
    const char* ply_type;
    int bytes;
    char pcd_type;
};

std::vector<Field> fields_of(const PointCloud& cloud) {
    std::vector<Field> fields;
    for (const char* name : {"x", "y", "z", "intensity"}) fields.push_back({name, "float", 4, 'F'});
    if (cloud.ring) fields.push_back({"ring", "uint16", 2, 'U'});
    if (cloud.time) fields.push_back({"time", "float", 4, 'F'});
    if (cloud.instance) fields.push_back({"instance", "int", 4, 'I'});
    if (cloud.return_number) fields.push_back({"return", "uint8", 1, 'U'});
    for (const auto& [name, is_integer] : numbers_of(cloud.channels))
        fields.push_back({name, is_integer ? "int" : "float", 4, is_integer ? 'I' : 'F'});
    return fields;
}

/// Normals have names of their own in PLY.
std::string ply_name(const std::string& name) {
    for (const char* axis : {"x", "y", "z"})
        if (name == std::string("normal_") + axis) return std::string("n") + axis;
    return name;
}

/// @throws DataError where an array's length is not the number of points
void check_cloud(const PointCloud& cloud) {
    const std::size_t n = cloud.position_m.size();
    const auto check = [n](const char* name, std::size_t found) {
        if (found != n)
            throw DataError(fmt::format("point cloud: {} values of {}, expected {}", found, name, n));
    };
    check("intensity", cloud.intensity.size());
    if (cloud.ring) check("ring", cloud.ring->size());
    if (cloud.time) check("time", cloud.time->size());
    if (cloud.instance) check("instance", cloud.instance->size());
    if (cloud.return_number) check("return", cloud.return_number->size());
    check_channels(cloud.channels, n, "a point cloud");
}

/// A record a point, in the order of fields_of().
std::string packed_records(const PointCloud& cloud) {
    std::string bytes;
    bytes.reserve(cloud.position_m.size() * 26);
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        for (int axis = 0; axis < 3; ++axis) append(bytes, cloud.position_m[i][axis]);
        append(bytes, cloud.intensity[i]);
        if (cloud.ring) append(bytes, (*cloud.ring)[i]);
        if (cloud.time) append(bytes, (*cloud.time)[i]);
        if (cloud.instance) append(bytes, (*cloud.instance)[i]);
        if (cloud.return_number) append(bytes, (*cloud.return_number)[i]);
        append_row(bytes, cloud.channels, i);
    }
    return bytes;
}

/// "tx ty tz qw qx qy qz"
std::string viewpoint(const Pose& pose) {
    const glm::dvec3& t = pose.translation;
    const glm::dquat& q = pose.rotation;
    std::vector<std::string> numbers;
    for (const double v : {t.x, t.y, t.z, q.w, q.x, q.y, q.z}) numbers.push_back(fmt::format("{}", v));
    return fmt::format("{}", fmt::join(numbers, " "));
}

}  // namespace

void write_ply(const std::filesystem::path& path, const PointCloud& cloud) {
    check_cloud(cloud);
    std::string text = "ply\nformat binary_little_endian 1.0\n";
    for (const auto& note : cloud.notes) text += fmt::format("comment {}\n", export_detail::note_line(note));
    text += fmt::format("element vertex {}\n", cloud.position_m.size());
    for (const Field& field : fields_of(cloud))
        text += fmt::format("property {} {}\n", field.ply_type, ply_name(field.name));
    export_detail::write_file(path, text + "end_header\n" + packed_records(cloud));
}

void write_pcd(const std::filesystem::path& path, const PointCloud& cloud) {
    check_cloud(cloud);
    std::string header = "# .PCD v0.7 - Point Cloud Data file format\n", names, sizes, types, counts;
    for (const auto& note : cloud.notes) header += fmt::format("# {}\n", export_detail::note_line(note));
    for (const Field& field : fields_of(cloud)) {
        names += fmt::format(" {}", field.name);
        sizes += fmt::format(" {}", field.bytes);
        types += fmt::format(" {}", field.pcd_type);
        counts += " 1";
    }
    const std::size_t n = cloud.position_m.size();
    header += fmt::format("VERSION 0.7\nFIELDS{}\nSIZE{}\nTYPE{}\nCOUNT{}\n", names, sizes, types, counts);
    header += fmt::format("WIDTH {}\nHEIGHT 1\nVIEWPOINT {}\nPOINTS {}\nDATA binary\n", n,
                          viewpoint(cloud.world_from_points), n);
    export_detail::write_file(path, header + packed_records(cloud));
}

void write_kitti_bin(const std::filesystem::path& path, const PointCloud& cloud) {
    check_cloud(cloud);
    export_detail::write_file(path, packed_records({cloud.position_m, cloud.intensity}));
}

}  // namespace relidar
