// SPDX-License-Identifier: Apache-2.0
// Computes the optional channels of a scan. Private to render.
#pragma once

#include <relidar/simulate/render.hpp>

#include "simulate/channels/scan_motion.hpp"
#include "simulate/shared/render.h"

namespace relidar {

struct LogObservedSpace {
    const ObservedVoxelSet& coverage;  ///< observed space; empty if it is unknown
    glm::dvec3 world_offset_m;         ///< see Log::world_offset_m
    double max_range_m;                ///< maximum range of the simulated sensor
};

struct RayWithSurfaceRange {
    Pose dataset_from_firing;
    glm::dvec3 origin_m, direction;  ///< in the sensor frame
    float met_m;                     ///< range of the surface that the ray hits; 0 if the ray hits nothing
};
using RaySource = std::function<RayWithSurfaceRange(std::size_t)>;
/// Returns the share of rays of whose path the log observed less than half.
double unobserved_share(std::size_t n_rays, const RaySource& get_ray, const LogObservedSpace& space);

/// Sets RenderedScan::unseen_share. Uses the channel "seen" if the scan has it, otherwise
/// a sample of the rays. Sets no value if the observed space is unknown.
void set_unseen_share(RenderedScan& scan, const LogObservedSpace& space);

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
std::vector<std::int32_t> instance_classes(const Scene& scene, const Log& log);
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
