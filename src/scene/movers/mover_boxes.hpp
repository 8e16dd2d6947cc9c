// SPDX-License-Identifier: Apache-2.0
// Fits boxes to the observations of a track. A track has one box size. Private to scene.
#pragma once

#include "scene/movers/mover_tracks.hpp"

namespace relidar {

/// Fits an upright box to the returns of a track, with one pose per frame and x along the
/// motion. The size is the largest visible extent over the track, because only the end
/// near the sensor is measured reliably in each frame.
BoxTrack fit_box(const MoverTrack& track);

/// Enlarges a box if only one side of its object was visible: away from the sensor, to
/// the typical size of a car, a truck or a cyclist. Stores the name of this kind in the
/// box.
void enlarge_box(BoxTrack& box, const MoverTrack& track);

/// Adds poses to a labelled box for the times when the object was observed without a
/// label. The nearest labels give the offset between the box and the visible points.
BoxTrack extend_in_time(const MoverTrack& track, const BoxTrack& label);

/// Returns the speeds of a box in m/s. Each speed is measured over at least half a second
/// before a pose. Returns an empty vector if the track is shorter than half a second.
std::vector<double> speeds_mps(const BoxTrack& box);

}  // namespace relidar
