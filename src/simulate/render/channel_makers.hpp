// SPDX-License-Identifier: Apache-2.0
// Computes the optional channels of a scan. Private to render.
#pragma once

#include "simulate/render/scan_motion.hpp"
#include "simulate/render/seen.hpp"
#include "simulate/shared/render.h"

namespace relidar {

struct RenderedRayValues;

struct ChannelInputs {
    LogObservedSpace log;
    MotionDuringScan motion;
    /// [instances] classes from instance_classes()
    std::vector<std::int32_t> classes = {};
    /// classes of the background; null if they are unknown
    const SurfaceClassLookup* background = nullptr;
};

/// A ray whose blending weights sum up to less hits nothing.
inline constexpr float kMinWeight = 1e-3f;
inline constexpr const char* kIncidenceChannel = "incidence";

/// Returns the class of each instance: 0 for the background, otherwise 1 + ObjectKind.
std::vector<std::int32_t> instance_classes(const Scene& scene, const Log& sequence);
/// Returns true if any channel needs the full rendering result, for example the normals.
bool needs_rendering(const std::vector<ChannelInfo>& channels);
/// Adds the channels that are computed for each traced ray.
/// @param values may be empty if needs_rendering() returns false
void add_ray_channels(RenderedScan& scan, std::span<const shared::MeasuredRay> measured,
                      const RenderedRayValues& values, const std::vector<ChannelInfo>& infos);
/// Adds the channels that are computed for each beam. Must run before a network or random
/// sampling changes the drop probabilities. Leaves out channels without values.
void add_beam_channels(RenderedScan& scan, const ChannelInputs& in, const std::vector<ChannelInfo>& infos);

}  // namespace relidar
