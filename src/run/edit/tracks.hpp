// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/run/edit.hpp>

namespace relidar {

/// Returns the box of an actor, or of a labelled object that stands still.
/// @throws UsageError if the scene has no such track
/// @throws DataError if the log has no box for it
const BoxTrack& find_actor_box(const SceneWithLogView& scene_and_log, const std::string& track_id);

/// Returns the box of an object that stands still, with the median of its poses at all
/// times of the log. Returns nothing if it moves or has no poses.
std::optional<BoxTrack> make_standing(BoxTrack box, const Log& log);

/// Returns the times of the sweeps. LiDARs that sweep together have the same time.
std::vector<double> list_sweep_times_s(const Log& log);

/// Adds interpolated poses to a track, so that steps are at most `max_step_s` long.
/// Reason: a box is also present up to half a time step before its first and after its
/// last pose. Short steps keep this extra time short.
PoseTrack densify_track(const PoseTrack& track, double max_step_s);

}  // namespace relidar
