// SPDX-License-Identifier: Apache-2.0
// A scan as npz: every ray, the dropped ones too. Arrays of `relidar render --format npz`
// are read as they are; scan_exr.cpp reads the same from EXR.
#pragma once

#include <filesystem>

#include <relidar/base/arrays.hpp>
#include <relidar/log/sequence.hpp>

#include "log/clouds/folder_head.hpp"

namespace relidar::folder {

/// Where images are from, and what they do not say themselves.
struct ImageSource {
    const Head& head;
    const HeadLidar& of_head;  ///< the LiDAR as sequence.json has it
    const Lidar& lidar;  ///< the same with what was completed; gives images without directions their rays
    double time_s;       ///< of the frame
};

/// @throws DataError for a file that is damaged, lacks an array, or whose arrays are of
/// different sizes
Scan read_scan_npz(const std::filesystem::path& file, const ImageSource& source);
/// The same from channels: range, median_range, intensity, drop_prob, time, ring,
/// range_2, intensity_2 ..., and x, y and z of direction and origin. @throws DataError
/// likewise
Scan read_scan_exr(const std::filesystem::path& file, const ImageSource& source);
/// What both have in common. @param where  file, for messages
Scan scan_of_images(const std::string& where, std::vector<NamedArray> arrays, const ImageSource& source);

/// Bit-equal when it is read again, except that all times of a motion-compensated scan
/// are 0.
void write_scan_npz(const std::filesystem::path& file, const Scan& scan, bool motion_compensated);

/// @param is_deskewed  the file says that its points are deskewed or in the world
/// @throws DataError if the log's head does not say that too
void check_deskewed(bool is_deskewed, const Head& head, const std::string& where);

/// A file's intensity as 0..1. @throws DataError where it is no number, or brighter than
/// what sequence.json calls bright by default
float unit_intensity(double found, const PointUnits& units, const std::string& where);
/// A file's time of a point as seconds from its frame's. @throws DataError where it is
/// farther from it than any sweep takes
float time_offset(double found, const PointUnits& units, double frame_time_s, const std::string& where);
/// A file's ring. @throws DataError where it is no number of a beam
std::uint16_t ring_number(double found, const std::string& where);

}  // namespace relidar::folder
