// SPDX-License-Identifier: Apache-2.0
// Computes which share of the paths of rays the log observed. Private to render.
#pragma once

#include <functional>
#include <vector>

#include <relidar/log/coverage.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// The space that the log observed.
struct SeenByLog {
    const Coverage& coverage;   ///< observed space; empty if it is unknown
    glm::dvec3 world_offset_m;  ///< see Sequence::world_offset_m
    double max_range_m;         ///< maximum range of the simulated sensor
};

/// A ray and the range of the surface that it hits.
struct LookingRay {
    Pose dataset_from_firing;
    glm::dvec3 origin_m, direction;  ///< in the sensor frame
    float met_m;                     ///< range of the dominant surface; 0 if the ray hits nothing
};
/// Returns the share of n rays for which the log observed less than half of the ray's
/// path.
/// @param ray_at returns the ray with an index below n
double unseen_share(std::size_t n, const std::function<LookingRay(std::size_t)>& ray_at,
                    const SeenByLog& log);

/// Returns for some rays of a scan the share of each ray's path that the log observed
/// [rays]. The path ends at the surface that the ray hits, or at the maximum range.
std::vector<float> seen_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays,
                               const SeenByLog& log);

/// Sets RenderedScan::unseen_share. Uses the channel "seen" if the scan has it, otherwise
/// a sample of kAskedRays rays. Leaves the share empty if the log has no coverage.
void tell_unseen(RenderedScan& scan, const SeenByLog& log);

}  // namespace relidar
