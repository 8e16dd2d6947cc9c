// SPDX-License-Identifier: Apache-2.0
// Light of retro-reflectors that ends in other beams; private to render.
#pragma once

#include <vector>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// What stray light of retro-reflectors looks like along the rays of a scan: a return at
/// the reflector's range, of reflectivity
///   X bloom * integral of (1 deg / angle)^3 over the reflector, deg^2,   ln X normal of mean 0 and deviation 3, a deviate for each beam
/// the angle at least half a degree. Reflectors are what returns 0.95 or more of the
/// scale of intensities; what does is counted in squares of a degree. Of several the one
/// with the most power, with what is within half a metre of its range. (docs/method.md,
/// measured on a log)
/// @param bloom  reflectivity, Weather::bloom; 0: none
/// @return [rays] of nothing where there is none; empty where no ray has any
std::vector<Echo> stray_light(const RenderedScan& scan, double bloom, std::uint64_t seed);

}  // namespace relidar
