// SPDX-License-Identifier: Apache-2.0
// Some drivers and simulators store rays without a return as points at the maximum range
// of the sensor. Such points are not returns.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Drops returns that mark the maximum range of a LiDAR, and adds a note to the log.
/// Real ranges have noise. So a marker is assumed if many returns have exactly the
/// largest range of the log, this range is a multiple of half a metre, and other returns
/// are nearer.
void drop_far_marker(Sequence& sequence);

}  // namespace relidar
