// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar::test {

struct FilePoint {
    glm::vec3 point_m;
    float intensity;
    std::uint16_t ring;
    double time_s;  ///< time in the log
};
using FilePoints = std::vector<FilePoint>;

/// Returns a cylinder with a radius of 20 m, beam by beam, with 16 beams.
FilePoints make_cylinder(int n_columns, double column_s = 0.0);

/// Returns a PCD file. Fields: x y z float32, intensity uint8 (0 to 255), ring uint16,
/// timestamp float64, and a padding field "_" of 3 bytes.
std::string make_pcd_text(const FilePoints& points);
std::string make_pcd_binary(const FilePoints& points);
std::string make_pcd_compressed(const FilePoints& points);
/// Returns the same file, with DATA `data` and `n_padding` bytes of padding.
std::string make_pcd(const FilePoints& points, const std::string& data, std::size_t n_padding);
/// Returns a PLY file with the properties x y z double, intensity float, channel ushort,
/// t double, red uchar.
std::string make_ply_text(const FilePoints& points);
std::string make_ply_binary(const FilePoints& points);
/// n x float32: x y z intensity ring.
std::string bin(const FilePoints& points);
/// [n, 6] float64: x y z intensity ring timestamp.
std::string npy(const FilePoints& points);

/// Returns a LAS 1.2 file with points of format 1, as in the specification of the ASPRS.
/// Coordinates have a unit of 0.01 mm.
std::string las(const FilePoints& points, double x_offset_m = 0.0, int format = 1);

/// Compresses bytes with LZF. Uses matches of at least 3 bytes at any encodable distance,
/// and literals for the remaining bytes.
std::string compress_lzf(const std::string& bytes);

}  // namespace relidar::test
