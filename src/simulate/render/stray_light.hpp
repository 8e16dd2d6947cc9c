// SPDX-License-Identifier: Apache-2.0
// Computes the light of retro-reflectors that is scattered into other beams. Private to
// render.
#pragma once

#include <vector>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Computes the stray light of retro-reflectors along the rays of a scan. Stray light
/// looks like a return at the range of the reflector, with the reflectivity
///   X bloom * integral of (1 deg / angle)^3 over the reflector, in deg^2
/// ln X is normally distributed with mean 0 and standard deviation 3, and differs for
/// each beam. The angle is at least half a degree. Reflectors are returns with 0.95 or
/// more of the largest intensity; they are collected in squares of one degree. Of several
/// reflectors, the one with the most power determines the range. Reflectors within half a
/// metre of this range are added to it. (docs/method.md, measured on a log)
/// @param bloom  reflectivity, Weather::bloom; 0: no stray light
/// @return [rays] stray light, zero for rays without any; empty if no ray has any
std::vector<Echo> stray_light(const RenderedScan& scan, double bloom, std::uint64_t seed);

}  // namespace relidar
