// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Replaces the values of rays that hit the own vehicle before they hit another surface.
/// Their range is that of an ideal ray. They are dropped unless the body keeps its
/// points. Can be called again after noise or weather have changed values.
/// @param limits  a hit outside these limits has no return
void block_rays(RenderedScan& scan, const VehicleBody& body, const RangeLimits& limits);

}  // namespace relidar
