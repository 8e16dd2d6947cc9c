// SPDX-License-Identifier: Apache-2.0
// Computes the observed share of a simulated ray: the share of its path in space that the
// log observed. Private to render.
#pragma once

#include <functional>
#include <vector>

#include <relidar/log/coverage.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// The space that the log observed, and the range limit of the simulated sensor.
struct SeenByLog {
    const Coverage& coverage;   ///< observed space; empty if it is unknown
    glm::dvec3 world_offset_m;  ///< see Sequence::world_offset_m
    double max_range_m;         ///< maximum range of the simulated sensor
};

/// A ray, and the range of the surface that the ray hits.
struct LookingRay {
    Pose dataset_from_firing;
    glm::dvec3 origin_m, direction;  ///< in the sensor frame
    float met_m;                     ///< range of the surface that the ray hits; 0 if the ray hits nothing
};
/// Returns the share of rays that count as unobserved. A ray counts as unobserved if the
/// log observed less than half of its path.
/// @param ray_at returns the ray with an index below `count`
double compute_unseen_share(std::size_t count, const std::function<LookingRay(std::size_t)>& ray_at,
                            const SeenByLog& log);

/// Returns the observed share of the path of each selected ray. The path ends at the
/// surface that the ray hits, or at the maximum range.
/// @return [rays] 0..1
std::vector<float> compute_seen_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays,
                                       const SeenByLog& log);

/// Sets RenderedScan::unseen_share to the share of rays that count as unobserved. Uses
/// the channel "seen" if the scan has it. Otherwise samples kAskedRays rays. Leaves the
/// value empty if the log has no coverage.
void set_unseen_share(RenderedScan& scan, const SeenByLog& log);

}  // namespace relidar
