// SPDX-License-Identifier: Apache-2.0
// How the channels that a scan may have are made. Private to render.
#pragma once

#include <span>
#include <vector>

#include <relidar/log/channels.hpp>
#include <relidar/simulate/render.hpp>
#include "simulate/render/seen.hpp"
#include "simulate/shared/render.h"

namespace relidar {

struct Rendering;

/// A ray of less weight met nothing that has a range.
inline constexpr float kMinWeight = 1e-3f;
/// Name of the channel that ray-drop networks read too.
inline constexpr const char* kIncidence = "incidence";

/// Returns whether any of the channels needs the Rendering of the rays.
bool needs_rendering(const std::vector<ChannelInfo>& wanted);
/// Adds the channels that are made of single rays.
/// @param scan  of these rays; image, pose and time are set @param rendering  empty
/// unless needs_rendering()
void add_ray_channels(RenderedScan& scan, std::span<const shared::MeasuredRay> measured,
                      const Rendering& rendering, const std::vector<ChannelInfo>& wanted);
/// Adds those that are made of the scan of whole beams, before a network or a seed
/// changes its drops. What is not known is left out.
void add_scan_channels(RenderedScan& scan, const SeenByLog& log, const std::vector<ChannelInfo>& wanted);

}  // namespace relidar
