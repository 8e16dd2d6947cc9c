// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Adds interpolated poses to a track, so that steps are at most `max_step_s` long.
/// Reason: a box is also present up to half a time step before its first and after its
/// last pose. Short steps keep this extra time short.
PoseTrack densify_track(const PoseTrack& track, double max_step_s);

}  // namespace relidar
