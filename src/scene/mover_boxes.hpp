// SPDX-License-Identifier: Apache-2.0
// Fits boxes to the observations of a track, with one size per track. Private to scene.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>

#include "scene/mover_tracks.hpp"

namespace relidar {

/// Returns the upright box of a track's returns at the times of its frames, with x along
/// the motion. In each frame, only the end near the sensor is certain. The size is the
/// largest visible extent over the track.
BoxTrack box_of(const MoverTrack& track);

/// Enlarges a box away from the sensor if only one side of the object was visible. Stores
/// the kind of object whose size was used. Other boxes are unchanged.
void complete_size(BoxTrack& box, const MoverTrack& track);

/// Returns a labelled box with additional poses at the times when its track was seen
/// without a label. The box keeps its size. Its offset from the visible points is taken
/// from the nearest labels.
BoxTrack continued_box(const MoverTrack& track, const BoxTrack& label);

/// Returns the speeds of a box in m/s, each measured over at least half a second before
/// one of its poses. Returns an empty vector if the track is shorter.
std::vector<double> speeds_mps(const BoxTrack& box);

}  // namespace relidar
