// SPDX-License-Identifier: Apache-2.0
// For a simulated ray, computes the share of its path that lies in space observed by the
// log. Private to render.
#pragma once

#include <relidar/simulate/render.hpp>

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

/// [rays] 0..1. A path ends at the surface that the ray hits, or at the maximum range.
std::vector<float> observed_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays,
                                   const LogObservedSpace& space);

/// Sets RenderedScan::unseen_share. Uses the channel "seen" if the scan has it, otherwise
/// a sample of the rays. Sets no value if the observed space is unknown.
void set_unseen_share(RenderedScan& scan, const LogObservedSpace& space);

}  // namespace relidar
