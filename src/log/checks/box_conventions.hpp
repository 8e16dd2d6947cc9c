// SPDX-License-Identifier: Apache-2.0
// Declares the search for boxes that belong to the vehicle itself or that follow another
// convention.
#pragma once

#include <string>

#include <relidar/log/sequence.hpp>

namespace relidar::checks {

/// Removes boxes around a LiDAR or the vehicle's origin, with a note. Trackers and
/// simulators label the recording vehicle itself.
void remove_ego_boxes(Log& sequence);

/// Returns the probable fault of the boxes, or an empty text. Compares the points in the
/// boxes with the points in boxes of other conventions.
std::string describe_fault(const Log& sequence);

}  // namespace relidar::checks
