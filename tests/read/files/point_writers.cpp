// SPDX-License-Identifier: Apache-2.0
#include "point_writers.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include <relidar/base/math.hpp>

#include "base/codecs/npy.hpp"

namespace relidar::test {
namespace {

template <class... T>
void append(std::string& bytes, T... values) {
    (bytes.append(reinterpret_cast<const char*>(&values), sizeof values), ...);
}

std::uint8_t unpack_byte(float intensity) { return std::uint8_t(std::lround(intensity * 255.0f)); }

std::string make_pcd_header(std::size_t count, const char* data, std::size_t n_padding) {
    return fmt::format(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z _ intensity ring "
        "timestamp\nSIZE 4 4 4 1 1 2 8\nTYPE F F F U U U F\n"
        "COUNT 1 1 1 {} 1 1 1\nWIDTH {}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}\nDATA {}\n",
        n_padding, count, count, data);
}

std::string write_pcd_text(const FilePoints& points, std::size_t n_padding) {
    std::string text = make_pcd_header(points.size(), "ascii", n_padding);
    for (const FilePoint& p : points)
        text += fmt::format("{} {} {} {}{} {} {}\n", p.point_m.x, p.point_m.y, p.point_m.z,
                            std::string("7 7 7 7 ").substr(0, 2 * n_padding), unpack_byte(p.intensity),
                            p.ring, p.time_s);
    return text;
}

std::string write_pcd_binary(const FilePoints& points, std::size_t n_padding) {
    std::string bytes = make_pcd_header(points.size(), "binary", n_padding);
    for (const FilePoint& p : points) {
        append(bytes, p.point_m);
        bytes += std::string(n_padding, '_');
        append(bytes, unpack_byte(p.intensity), p.ring, p.time_s);
    }
    return bytes;
}

std::string write_pcd_compressed(const FilePoints& points, std::size_t n_padding) {
    std::string fields;
    for (int axis = 0; axis < 3; ++axis)
        for (const FilePoint& p : points) append(fields, p.point_m[axis]);
    fields += std::string(n_padding * points.size(), '_');
    for (const FilePoint& p : points) append(fields, unpack_byte(p.intensity));
    for (const FilePoint& p : points) append(fields, p.ring);
    for (const FilePoint& p : points) append(fields, p.time_s);
    const std::string packed = compress_lzf(fields);
    std::string bytes = make_pcd_header(points.size(), "binary_compressed", n_padding);
    append(bytes, std::uint32_t(packed.size()), std::uint32_t(fields.size()));
    return bytes + packed;
}

std::string make_ply_header(std::size_t count, const char* format) {
    return fmt::format(
        "ply\nformat {} 1.0\ncomment by hand\nelement vertex {}\nproperty double x\nproperty float64 "
        "y\nproperty double z\nproperty float intensity\n"
        "property ushort channel\nproperty double t\nproperty uchar red\nelement face 0\nproperty list uchar "
        "int vertex_indices\nend_header\n",
        format, count);
}

}  // namespace

std::string make_pcd_text(const FilePoints& points) { return make_pcd(points, "ascii", 3); }
std::string make_pcd_binary(const FilePoints& points) { return make_pcd(points, "binary", 3); }
std::string make_pcd_compressed(const FilePoints& points) { return make_pcd(points, "binary_compressed", 3); }

std::string make_pcd(const FilePoints& points, const std::string& data, std::size_t n_padding) {
    if (data == "ascii") return write_pcd_text(points, n_padding);
    return data == "binary" ? write_pcd_binary(points, n_padding) : write_pcd_compressed(points, n_padding);
}

std::string make_ply_text(const FilePoints& points) {
    std::string text = make_ply_header(points.size(), "ascii");
    for (const FilePoint& p : points)
        text += fmt::format("{} {} {} {} {} {} 255\n", p.point_m.x, p.point_m.y, p.point_m.z, p.intensity,
                            p.ring, p.time_s);
    return text;
}

std::string make_ply_binary(const FilePoints& points) {
    std::string bytes = make_ply_header(points.size(), "binary_little_endian");
    for (const FilePoint& p : points)
        append(bytes, glm::dvec3(p.point_m), p.intensity, p.ring, p.time_s, std::uint8_t(255));
    return bytes;
}

std::string bin(const FilePoints& points) {
    std::string bytes;
    for (const FilePoint& p : points) append(bytes, p.point_m, p.intensity, float(p.ring));
    return bytes;
}

std::string npy(const FilePoints& points) {
    std::string bytes = codecs::make_npy_header({"points", "f8", {points.size(), 6}, {}});
    for (const FilePoint& p : points)
        append(bytes, glm::dvec3(p.point_m), double(p.intensity), double(p.ring), p.time_s);
    return bytes;
}

FilePoints make_cylinder(int n_columns, double column_s) {
    FilePoints points;
    for (int b = 0; b < 16; ++b)
        for (int c = 0; c < n_columns; ++c) {
            const double a = kPi - (c + 0.5) * 2.0 * kPi / n_columns, e = 0.1 - 0.02 * b;
            const glm::vec3 p(20.0 * std::cos(a), 20.0 * std::sin(a), 20.0 * std::tan(e));
            points.push_back({p, 0.2f, std::uint16_t(b), column_s * c});
        }
    return points;
}

std::string compress_lzf(const std::string& bytes) {
    std::string out, plain;
    std::map<std::string, std::size_t> last;  // last position of each sequence of three bytes
    const auto flush = [&] {
        for (std::size_t at = 0; at < plain.size(); at += 32) {
            const std::string run = plain.substr(at, 32);
            out += char(run.size() - 1);
            out += run;
        }
        plain.clear();
    };
    for (std::size_t at = 0; at < bytes.size();) {
        const std::string key = bytes.substr(at, 3);
        const auto match = last.find(key);
        const std::size_t back = match == last.end() ? 0 : at - match->second;
        std::size_t length = 0;
        if (key.size() == 3 && back > 0 && back <= 8192)
            while (length < 264 && at + length < bytes.size() &&
                   bytes[at + length] == bytes[at + length - back])
                ++length;
        if (key.size() == 3) last[key] = at;
        if (length < 3) {
            plain += bytes[at++];
            continue;
        }
        flush();
        const std::size_t code = length - 2, distance = back - 1;
        out += char((std::min<std::size_t>(code, 7) << 5) | (distance >> 8));
        if (code >= 7) out += char(code - 7);
        out += char(distance & 255);
        at += length;
    }
    flush();
    return out;
}

std::string las(const FilePoints& points, double x_offset_m, int format) {
    constexpr std::size_t kHeader = 227, kRecord = 28;
    std::string bytes("LASF");
    bytes.resize(24);
    bytes += "\x01\x02";
    bytes.resize(94);
    append(bytes, std::uint16_t(kHeader), std::uint32_t(kHeader), std::uint32_t(0), std::uint8_t(format),
           std::uint16_t(kRecord), std::uint32_t(points.size()));
    bytes.resize(131);
    append(bytes, 1e-5, 1e-5, 1e-5, x_offset_m, 0.0, 0.0);
    bytes.resize(kHeader);
    for (const FilePoint& p : points) {
        const glm::dvec3 stored_m = glm::dvec3(p.point_m) - glm::dvec3(x_offset_m, 0.0, 0.0);
        for (int axis = 0; axis < 3; ++axis) append(bytes, std::int32_t(std::lround(1e5 * stored_m[axis])));
        // return 1 of 1; class, angle and user data are 0
        append(bytes, std::uint16_t(unpack_byte(p.intensity)), std::uint32_t(9), std::uint16_t(0), p.time_s);
    }
    return bytes;
}

}  // namespace relidar::test
