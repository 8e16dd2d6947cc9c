// SPDX-License-Identifier: Apache-2.0
// Scans as npz with every ray, including dropped rays. Arrays of `relidar render --format
// npz` can be read directly. scan_exr.cpp reads the same data from EXR.
#pragma once

#include <filesystem>

#include <relidar/base/arrays.hpp>
#include <relidar/log/sequence.hpp>

#include "log/clouds/folder_head.hpp"

namespace relidar::folder {

/// Context of images, for data that they do not contain.
struct ImageSource {
    const Head& head;
    const HeadLidar& of_head;  ///< the LiDAR in sequence.json
    const Lidar& lidar;        ///< the completed LiDAR, which defines the rays of images without directions
    double time_s;             ///< time of the frame
};

/// Reads a scan.
/// @throws DataError if the file is damaged, an array is missing, or sizes differ
Scan read_scan_npz(const std::filesystem::path& file, const ImageSource& source);
/// Reads a scan from EXR channels: range, median_range, intensity, drop_prob, time, ring,
/// range_2, intensity_2 ..., and x, y and z of direction and origin.
/// @throws DataError as read_scan_npz()
Scan read_scan_exr(const std::filesystem::path& file, const ImageSource& source);
/// Creates a scan from arrays. Used for both formats.
/// @param where  file for error messages
Scan scan_of_images(const std::string& where, std::vector<NamedArray> arrays, const ImageSource& source);

/// Writes a scan. Reading it again gives identical bits, except that all times of a
/// motion-compensated scan are 0.
void write_scan_npz(const std::filesystem::path& file, const Scan& scan, bool motion_compensated);

/// Checks that the file and the log's head agree about deskewed points.
/// @param is_deskewed  true: the file states that its points are deskewed or in the world
/// frame
/// @throws DataError if the log's head does not state this
void check_deskewed(bool is_deskewed, const Head& head, const std::string& where);

/// Converts an intensity of a file to 0..1.
/// @throws DataError if it is not a number, or larger than the default maximum of
/// sequence.json
float unit_intensity(double found, const PointUnits& units, const std::string& where);
/// Converts a point time of a file to seconds relative to its frame.
/// @throws DataError if the difference is longer than any sweep
float time_offset(double found, const PointUnits& units, double frame_time_s, const std::string& where);
/// Converts a ring number of a file.
/// @throws DataError if it is not a valid beam number
std::uint16_t ring_number(double found, const std::string& where);

}  // namespace relidar::folder
