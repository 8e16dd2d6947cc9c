// SPDX-License-Identifier: Apache-2.0
// Point clouds as files: PLY (binary little-endian), PCD 0.7 (binary) and KITTI .bin; formats.md, sections a and h.
// PLY and PCD hold the same packed records under different headers; KITTI has neither header nor extra fields.
#include <relidar/export.hpp>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "file_io.hpp"

namespace relidar {
namespace {

using export_detail::append;

/// @throws DataError where an array's length is not the number of points
void check_cloud(const PointCloud& cloud) {
    const std::size_t n = cloud.position_m.size();
    const auto check = [n](const char* name, std::size_t found) {
        if (found != n) throw DataError(fmt::format("point cloud: {} values of {}, expected {}", found, name, n));
    };
    check("intensity", cloud.intensity.size());
    if (!cloud.channel.empty()) check("channel", cloud.channel.size());
    if (!cloud.time_offset_s.empty()) check("time_offset_s", cloud.time_offset_s.size());
    if (!cloud.instance.empty()) check("instance", cloud.instance.size());
}

/// x y z intensity (float32), then channel (uint16), time offset (float32) and instance (int32) where present, a record a point.
std::string packed_records(const PointCloud& cloud) {
    std::string bytes;
    bytes.reserve(cloud.position_m.size() * 26);
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        for (int axis = 0; axis < 3; ++axis) append(bytes, cloud.position_m[i][axis]);
        append(bytes, cloud.intensity[i]);
        if (!cloud.channel.empty()) append(bytes, cloud.channel[i]);
        if (!cloud.time_offset_s.empty()) append(bytes, cloud.time_offset_s[i]);
        if (!cloud.instance.empty()) append(bytes, cloud.instance[i]);
    }
    return bytes;
}

}  // namespace

void write_ply(const std::filesystem::path& path, const PointCloud& cloud) {
    check_cloud(cloud);
    std::string text = "ply\nformat binary_little_endian 1.0\ncomment relidar: metres, sensor frame\n";
    text += fmt::format("element vertex {}\n", cloud.position_m.size());
    text += "property float x\nproperty float y\nproperty float z\nproperty float intensity\n";
    if (!cloud.channel.empty()) text += "property ushort channel\n";
    if (!cloud.time_offset_s.empty()) text += "property float time_offset_s\n";
    if (!cloud.instance.empty()) text += "property int instance\n";
    export_detail::write_file(path, text + "end_header\n" + packed_records(cloud));
}

void write_pcd(const std::filesystem::path& path, const PointCloud& cloud) {
    check_cloud(cloud);
    std::string fields = "x y z intensity", size = "4 4 4 4", type = "F F F F", count = "1 1 1 1";
    const auto add = [&](const char* field, const char* field_size, const char* field_type) {
        fields += fmt::format(" {}", field);
        size += fmt::format(" {}", field_size);
        type += fmt::format(" {}", field_type);
        count += " 1";
    };
    if (!cloud.channel.empty()) add("channel", "2", "U");
    if (!cloud.time_offset_s.empty()) add("time_offset_s", "4", "F");
    if (!cloud.instance.empty()) add("instance", "4", "I");
    const std::size_t n = cloud.position_m.size();
    const std::string header = fmt::format(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {}\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}\nDATA binary\n",
        fields, size, type, count, n, n);
    export_detail::write_file(path, header + packed_records(cloud));
}

void write_kitti_bin(const std::filesystem::path& path, const PointCloud& cloud) {
    check_cloud(cloud);
    PointCloud bare;
    bare.position_m = cloud.position_m;
    bare.intensity = cloud.intensity;
    export_detail::write_file(path, packed_records(bare));
}

}  // namespace relidar
