// SPDX-License-Identifier: Apache-2.0
// Corrects the rays of a log with vehicle poses at times between frames. Recordings have
// such poses, but a Sequence stores only one pose per frame.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include <relidar/log/sequence.hpp>

namespace relidar::bag {

/// Returns the vehicle pose at a time, or nothing if the pose is unknown.
using PoseAt = std::function<std::optional<Pose>(double)>;

/// Moves and rotates the rays of each sweep so that they start at the true sensor
/// position. A log has only the poses of its frames and interpolates linearly between
/// them. In a curve at 10 m/s and 0.5 rad/s, the interpolation causes an error of 5 cm.
/// Sweeps with an error below a millimetre are not changed.
/// @param world_from_vehicle  vehicle pose by time, in the recentred world of the log
/// @return a note, or an empty string if no sweep was changed
std::string place_rays(Sequence& sequence, const PoseAt& world_from_vehicle);

}  // namespace relidar::bag
