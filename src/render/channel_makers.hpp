// SPDX-License-Identifier: Apache-2.0
// How the channels that a scan may have are made. Private to render.
#pragma once

#include <vector>

#include <relidar/channels.hpp>
#include <relidar/render.hpp>
#include "render/seen.hpp"

namespace relidar {

struct Rendering;

/// A ray of less weight met nothing that has a range.
inline constexpr float kMinWeight = 1e-3f;

/// Whether any of the channels is made of what single rays collected.
bool wants_ray_channels(const std::vector<ChannelInfo>& wanted);
/// Adds the channels that are made of what single rays collected. @param scan  of these rays: image, place and time are there
void add_ray_channels(RenderedScan& scan, const Rendering& rendering, const std::vector<ChannelInfo>& wanted);
/// Adds those that are made of the scan of whole beams, before a network or a seed changes its drops. What is not known is left out.
void add_scan_channels(RenderedScan& scan, const SeenByLog& log, const std::vector<ChannelInfo>& wanted);

}  // namespace relidar
