// SPDX-License-Identifier: Apache-2.0
// Declares the search for values of a log that are valid but probably wrong.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::folder {

/// Adds a note for the user about each of these findings:
/// - The vehicle moves faster than any car, so the poses or times are probably wrong.
/// - Some scans of a LiDAR have far fewer returns than the scans before and after them.
/// - All intensities of the log are equal, or those of a LiDAR are tiny or mostly at the
///   maximum.
/// - The times of the frames are probably not in seconds.
/// - The positions of the vehicle were stored in single precision.
/// - Boxes are longer than any vehicle, their times are far from the log, or they follow
///   another convention.
void add_notes_about_implausible_values(LidarSequence& sequence);

}  // namespace relidar::folder
