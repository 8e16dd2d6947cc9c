// SPDX-License-Identifier: Apache-2.0
// Poses between the frames of a log, which a recording has and a Sequence has not.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include <relidar/log/sequence.hpp>

namespace relidar::bag {

/// Nothing where it is not known.
using PoseAt = std::function<std::optional<Pose>(double)>;

/// Starts and turns the rays of each sweep so that they are fired from where the sensor
/// was, although the log's poses are those of its frames and straight between them: in a
/// bend at 10 m/s and 0.5 rad/s that is 5 cm beside. A sweep that this moves by less than
/// a millimetre stays as it is.
/// @param world_from_vehicle  by time, in the log's recentred world
/// @return a note, empty where nothing was moved
std::string place_rays(Sequence& sequence, const PoseAt& world_from_vehicle);

}  // namespace relidar::bag
