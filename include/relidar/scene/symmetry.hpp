// SPDX-License-Identifier: Apache-2.0
// Completes the unobserved sides of vehicles. A vehicle is symmetric about the x-z plane
// of its box, so an unobserved side looks like the mirror image of the observed side.
#pragma once

#include <relidar/log/sequence.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// Returns true for objects that are assumed to be symmetric: labelled vehicles, and
/// objects without a label that are at least 3 m long.
bool is_vehicle(const BoxTrack& box);

/// Returns a copy of the surfels, mirrored at the x-z plane: y becomes -y.
Surfels mirror_surfels(Surfels surfels);

/// Completes a symmetric object. Surfels of an unobserved patch are replaced by mirrored
/// surfels of the other side, if the other side was observed. The new surfels are
/// appended. Does nothing if both sides were observed and differ by more than 0.15 m.
/// @return number of surfels that were added
std::size_t mirror_unobserved(Surfels& surfels, ObservedBoxSurface& surface);

}  // namespace relidar
