// SPDX-License-Identifier: Apache-2.0
// Boxes of what was seen of a thing, one size for a whole track. Private to scene.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>

#include "scene/mover_tracks.hpp"

namespace relidar {

/// The upright box of a track's returns, x along its motion, at the times of its frames.
/// Of what is seen of a thing in a frame its near end is sure; its size is what it showed
/// when it showed most.
BoxTrack box_of(const MoverTrack& track);

/// Fills the size of a box up, away from the sensor, where only a side of it was seen,
/// and says for what kind of thing. The others stay.
void complete_size(BoxTrack& box, const MoverTrack& track);

/// A labelled box with a pose at each time at which its track was seen without the label,
/// before or after. It keeps its size; where it lies about what is seen of it is taken
/// from its labels near by.
BoxTrack continued_box(const MoverTrack& track, const BoxTrack& label);

/// Speeds of a box over half a second or more, to each of its poses before which there is
/// so much; none where the track is shorter.
std::vector<double> speeds_mps(const BoxTrack& box);

}  // namespace relidar
