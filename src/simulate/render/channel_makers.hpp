// SPDX-License-Identifier: Apache-2.0
// Computes the optional channels of a scan. Private to render.
#pragma once

#include <span>
#include <vector>

#include <relidar/log/channels.hpp>
#include <relidar/simulate/render.hpp>
#include "simulate/render/seen.hpp"
#include "simulate/shared/render.h"

namespace relidar {

struct Rendering;

/// A ray with a smaller weight counts as having hit nothing.
inline constexpr float kMinWeight = 1e-3f;
/// Name of a channel that ray-drop networks also read.
inline constexpr const char* kIncidence = "incidence";

/// Returns whether any of the channels needs the Rendering of the rays.
bool needs_rendering(const std::vector<ChannelInfo>& wanted);
/// Adds the channels that are computed for each traced ray.
/// @param scan scan of these rays; image, poses and times are set
/// @param rendering empty unless needs_rendering()
void add_ray_channels(RenderedScan& scan, std::span<const shared::MeasuredRay> measured,
                      const Rendering& rendering, const std::vector<ChannelInfo>& wanted);
/// Adds the channels that are computed from joined beams. They must be computed before a
/// network or a random sample changes the drop probabilities. Channels without values are
/// left out.
void add_scan_channels(RenderedScan& scan, const SeenByLog& log, const std::vector<ChannelInfo>& wanted);

}  // namespace relidar
