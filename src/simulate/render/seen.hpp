// SPDX-License-Identifier: Apache-2.0
// How much of what rays look at the log has seen. Private to render.
#pragma once

#include <functional>
#include <vector>

#include <relidar/log/coverage.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// What the log has seen of the scene.
struct SeenByLog {
    const Coverage& coverage;   ///< empty: not known
    glm::dvec3 world_offset_m;  ///< Sequence::world_offset_m
    double max_range_m;         ///< of the simulated sensor
};

/// A ray, and what it meets.
struct LookingRay {
    Pose dataset_from_firing;
    glm::dvec3 origin_m, direction;  ///< sensor frame
    float met_m;                     ///< of the dominant surface; 0: nothing
};
/// Of n rays the share that looks where the log did not. @param ray_at  of each number
/// below n
double unseen_share(std::size_t n, const std::function<LookingRay(std::size_t)>& ray_at,
                    const SeenByLog& log);

/// [rays] Share of the way of some rays of a scan, to what they meet or to the end of
/// their range, along which rays of the log have looked.
std::vector<float> seen_shares(const RenderedScan& scan, const std::vector<std::size_t>& rays,
                               const SeenByLog& log);

/// Says what share of the rays looks where the log did not (RenderedScan::unseen_share):
/// by the channel "seen" where the scan has it, else by kAskedRays of them. Nothing where
/// it is not known.
void tell_unseen(RenderedScan& scan, const SeenByLog& log);

}  // namespace relidar
