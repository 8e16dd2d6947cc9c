// SPDX-License-Identifier: Apache-2.0
// A scan as npz: every ray, the dropped ones too. Arrays of `relidar render --format npz` are read as they are.
#pragma once

#include <filesystem>

#include <relidar/sequence.hpp>

#include "dataset/folder_head.hpp"

namespace relidar::folder {

/// @throws DataError for a file that is damaged, lacks an array, or whose arrays are of different sizes
Scan read_scan_npz(const std::filesystem::path& file, const Head& head, double time_s);

/// Bit-equal when it is read again.
void write_scan_npz(const std::filesystem::path& file, const Scan& scan);

/// A file's intensity as 0..1. @throws DataError where it is no number, or brighter than what sequence.json calls bright by default
float unit_intensity(double found, const PointUnits& units, const std::string& where);
/// A file's time of a point as seconds from its frame's. @throws DataError where it is farther from it than any sweep takes
float time_offset(double found, const PointUnits& units, double frame_time_s, const std::string& where);
/// A file's ring. @throws DataError where it is no number of a beam
std::uint16_t ring_number(double found, const std::string& where);

}  // namespace relidar::folder
