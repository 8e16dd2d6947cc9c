// SPDX-License-Identifier: Apache-2.0
// Estimates from the training frames which rays the sensor itself drops (paper section
// 3.5). Before training, rays that hardly ever return are excluded from the losses,
// otherwise the scene would learn the shadow of the vehicle as a property of the ground.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/log.hpp>

namespace relidar {

/// Returns the drop rates of each beam in azimuth bins of about three columns, for rays
/// that are dropped persistently. Uses intervals of neighbouring bins with at least 60
/// rays. A bin gets the highest rate of the intervals that contain it, but at most its
/// own rate. The rate is 0 if the beam has fewer than 60 rays. It is 1 in a sector of at
/// least 10 degrees in which the beam never fires.
RayDropTable measure_drops(const Log& log, const std::vector<int>& frames);

/// Sets the drop probability to 1 in sectors of at least 10 degrees in which no beam of a
/// LiDAR has a return. The scene has no surfaces there.
/// @param observed_drop_rates  result of measure_drops()
void drop_unobserved(RayDropTable& drop_table, const RayDropTable& observed_drop_rates, const Log& log);

/// Returns true if the beam of this ray was dropped at least 95 % of the time at this
/// azimuth. Training ignores such rays.
bool is_blind_ray(const RayDropTable& observed, const Log& log, const Frame& frame, std::size_t ray);

}  // namespace relidar
