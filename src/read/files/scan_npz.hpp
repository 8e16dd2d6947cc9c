// SPDX-License-Identifier: Apache-2.0
// Reads and writes scans as npz files. A file contains every ray, including dropped rays.
// The reader accepts the files of `relidar render --format npz`. scan_exr.cpp reads the
// same data from EXR images.
#pragma once

#include <filesystem>

#include <relidar/base/arrays.hpp>
#include <relidar/log/log.hpp>

#include "read/files/point_units.hpp"

namespace relidar::read {

/// What an image file does not contain.
struct ImageContext {
    const PointFileUnits& units;
    bool motion_compensated;  ///< what sequence.json says of all scans
    bool lowest_first;        ///< true if row 0 is the lowest beam
    /// Its sensor model defines the rays if the file contains no ray directions.
    const Lidar& lidar;
    double time_s;  ///< time of the frame
};

/// Reads a scan from an EXR image. The channels are range, median_range, intensity,
/// drop_prob, time, ring, range_2, intensity_2 and so on. The direction and the origin of
/// rays have the channels x, y and z.
Scan read_scan_exr(const std::filesystem::path& file, const ImageContext& image_context);
/// Reads a scan from an npz file or an EXR image.
/// @throws DataError if the file is damaged, an array is missing, or array sizes differ
Scan read_scan_image(const std::filesystem::path& file, const ImageContext& image_context);
/// Creates a scan from the named arrays of an npz or EXR file.
Scan scan_from_arrays(const std::string& where, std::vector<NamedArray> arrays, const ImageContext& context);

/// Writes a scan to an npz file without loss. If the scan is motion-compensated, all rays
/// get the time 0.
void write_scan_npz(const std::filesystem::path& file, const Scan& scan, bool motion_compensated);

/// Checks that sequence.json does not contradict a file.
/// @param is_deskewed  true if points are motion-compensated or in the world frame
/// @param is_declared  true if sequence.json says that all scans are motion-compensated
/// @throws DataError if the points are motion-compensated and not declared so
void check_deskewing(bool is_deskewed, bool is_declared, const std::string& where);

/// Scales an intensity from a file to the range 0 to 1.
/// @throws DataError if it is not a number, or if it is outside 0 to 1 and sequence.json
/// contains no maximum intensity
float scale_intensity(double file_value, const PointFileUnits& units, const std::string& where);
/// No sweep is longer, and no point is farther in time from its frame.
inline constexpr float kMaxTimeOffset_s = 10.0f;

/// Converts the time of a point or ray to seconds relative to the time of the frame.
/// @throws DataError if the result is longer than any sweep can be
float frame_offset_s(double file_value, const PointFileUnits& units, double frame_time_s,
                     const std::string& where);
/// Converts a ring number from a file to an integer.
/// @throws DataError if the number is not a valid beam number
std::uint16_t convert_ring(double file_value, const std::string& where);

}  // namespace relidar::read
