// SPDX-License-Identifier: Apache-2.0
// Removes false returns at the maximum range. Some drivers and simulators store a ray
// without a return as a point at the maximum range of the sensor.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Turns returns at the maximum range of a LiDAR into dropped rays and adds a note. Real
/// ranges have noise. The largest range of the log stands for dropped rays if many
/// returns have exactly this range, it is a multiple of half a metre, and other returns
/// are nearer.
void remove_drop_markers(Log& sequence);

}  // namespace relidar
