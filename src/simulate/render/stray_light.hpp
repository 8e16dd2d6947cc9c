// SPDX-License-Identifier: Apache-2.0
// Simulates light of retro-reflectors that other beams receive (blooming). Private to
// render.
#pragma once

#include <vector>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Computes the echo of stray light from retro-reflectors for each ray of a scan. The
/// echo has the range of the reflector and the reflectivity
///   X bloom * integral of (1 deg / angle)^3 over the reflector, deg^2
/// where ln X is normal with mean 0 and standard deviation 3, drawn for each beam. The
/// angle between ray and reflector is clamped to at least 0.5 degrees. Reflectors are
/// surfaces with an intensity of at least 0.95; their area is counted in cells of one
/// square degree. The echo has the range of the reflector with the most power. Other
/// reflectors within 0.5 m of this range add to the echo. See docs/method.md; the
/// constants were measured on a log.
/// @param bloom reflectivity, see Weather::bloom; 0 disables the effect
/// @return [rays] empty echoes for rays without stray light; an empty list if no ray has
/// any
std::vector<Echo> stray_light(const RenderedScan& scan, double bloom, std::uint64_t seed);

}  // namespace relidar
