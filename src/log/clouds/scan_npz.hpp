// SPDX-License-Identifier: Apache-2.0
// Reads and writes scans as npz files. A file has every ray, including dropped rays. The
// reader accepts the files of `relidar render --format npz`. scan_exr.cpp reads the same
// data from EXR images.
#pragma once

#include <filesystem>

#include <relidar/base/arrays.hpp>
#include <relidar/log/sequence.hpp>

#include "log/clouds/folder_head.hpp"

namespace relidar::folder {

/// Data about the LiDAR and the frame of an image file, used where the file lacks data.
struct ImageSource {
    const Head& head;
    const HeadLidar& of_head;  ///< the LiDAR as described in sequence.json
    /// the LiDAR with all known properties; defines the rays if the file has no
    /// directions
    const Lidar& lidar;
    double time_s;  ///< time of the frame
};

/// Reads a scan from an npz file.
/// @throws DataError if the file is damaged, an array is missing, or sizes differ
Scan read_scan_npz(const std::filesystem::path& file, const ImageSource& source);
/// Reads a scan from an EXR image. The channels are range, median_range, intensity,
/// drop_prob, time, ring, range_2, intensity_2 ..., and x, y and z of direction and
/// origin.
/// @throws DataError if the file is damaged, a channel is missing, or sizes differ
Scan read_scan_exr(const std::filesystem::path& file, const ImageSource& source);
/// Creates a scan from the named arrays of an npz or EXR file.
/// @param where  file for error messages
Scan scan_of_images(const std::string& where, std::vector<NamedArray> arrays, const ImageSource& source);

/// Writes a scan to an npz file. Reading the file gives exactly the same values, except
/// that a motion-compensated scan gets time 0 for all rays.
void write_scan_npz(const std::filesystem::path& file, const Scan& scan, bool motion_compensated);

/// Checks that the log is marked as motion-compensated if a scan file says so.
/// @param is_deskewed  true: the file states that its points are motion-compensated
/// (deskewed) or in the world frame
/// @throws DataError if the log is not marked accordingly
void check_deskewed(bool is_deskewed, const Head& head, const std::string& where);

/// Converts an intensity from a file to the range 0 to 1.
/// @throws DataError if the intensity is not a number. Without a maximum in
/// sequence.json, also if it is outside 0 to 1.
float unit_intensity(double found, const PointUnits& units, const std::string& where);
/// Converts a point time from a file to seconds relative to the time of its frame.
/// @throws DataError if the result is longer than any sweep
float time_offset(double found, const PointUnits& units, double frame_time_s, const std::string& where);
/// Converts a ring number from a file to an integer.
/// @throws DataError if it is not a valid beam number
std::uint16_t ring_number(double found, const std::string& where);

}  // namespace relidar::folder
