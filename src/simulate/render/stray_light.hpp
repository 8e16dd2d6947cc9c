// SPDX-License-Identifier: Apache-2.0
// Simulates blooming: light of a retro-reflector that the receivers of other beams
// detect. Private to render.
#pragma once

#include <vector>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Computes for each ray of a scan the echo of stray light from retro-reflectors. The
/// echo has the range of the reflector and the reflectivity
///   X bloom * integral of (1 deg / angle)^3 over the reflector, deg^2
/// where ln X is normal with mean 0 and standard deviation 3. X is drawn for each beam.
/// The angle between ray and reflector is clamped to at least 0.5 degrees. Reflectors are
/// surfaces with an intensity of at least 0.95. Their area is counted in cells of one
/// square degree. The reflector with the most power determines the range of the echo.
/// Other reflectors within 0.5 m of this range add to the echo. The constants were
/// measured on a log, see docs/method.md.
/// @param bloom reflectivity, see Weather::bloom; 0 disables the effect
/// @return [rays] empty echoes for rays without stray light; an empty list if no ray has
/// any
std::vector<Echo> stray_light(const RenderedScan& scan, double bloom, std::uint64_t seed);

}  // namespace relidar
