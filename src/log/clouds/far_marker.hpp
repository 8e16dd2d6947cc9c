// SPDX-License-Identifier: Apache-2.0
// Removes false returns at the maximum range. Some drivers and simulators store a ray
// without a return as a point at the maximum range of the sensor.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Finds returns that mark dropped rays by the maximum range of the LiDAR. Turns these
/// returns into dropped rays and adds a note to the log. Real ranges have noise. So the
/// largest range of the log is such a mark if many returns have exactly this range, it is
/// a multiple of half a metre, and other returns are nearer.
void drop_fake_max_range_returns(LidarSequence& sequence);

}  // namespace relidar
