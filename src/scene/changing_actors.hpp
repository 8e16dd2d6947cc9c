// SPDX-License-Identifier: Apache-2.0
// Makes surfels of people and cyclists that change from frame to frame without a gait
// (docs/method.md M14). Private to scene.
#pragma once

#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/point_surfels.hpp"

namespace relidar {

/// Surfels of an actor whose shape changes.
struct ChangingSurfels {
    Surfels surfels;
    double period_m = 0.0;  ///< Walked distance after which the motion repeats.
};
/// Makes surfels that are visible only around the time of their frame. Points at places
/// where most frames have a point become surfels that are always visible.
/// @param samples  points in the frame of the box, with the walked distance
/// @param most  maximum number of surfels, except that each frame may have 200
/// @return period 0 and no surfels if there are fewer than three frames, or if the actor
/// walks less than half a metre
ChangingSurfels changing_surfels(const std::vector<Sample>& samples, const InitialiseOptions& options,
                                 double incidence, std::size_t most);

}  // namespace relidar
