// SPDX-License-Identifier: Apache-2.0
// Corrects the rays of a log for motion between frames. Recordings contain vehicle poses
// between frames, but a Log stores one pose per frame.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include <relidar/log/log.hpp>

namespace relidar::read {

/// Returns the vehicle pose at a time in seconds. Returns nothing if the pose is unknown.
using PoseLookup = std::function<std::optional<Pose>(double)>;

/// Moves each ray to the true sensor position. A log interpolates linearly between the
/// poses of its frames. In a curve at 10 m/s and 0.5 rad/s, the interpolated position is
/// wrong by 5 cm. Sweeps with an error below a millimetre are not changed.
/// @param find_vehicle_pose  vehicle pose by time, in the world frame of the log
/// @return a note, or an empty string if no sweep was changed
std::string correct_rays(Log& log, const PoseLookup& find_vehicle_pose);

}  // namespace relidar::read
