// SPDX-License-Identifier: Apache-2.0
// Evidence for and against motion. What stands has returns at the same places of the world whenever they can be seen; what moves left them
// free, and all that may be there later is something else. Cells that are seen through are only where to look: glass, leaves and edges
// have some too.
#include "scene/mover_evidence.hpp"

#include <algorithm>

namespace relidar {
namespace {

constexpr double kSamePlace_m = 0.2;      // returns of one thing that stands, poses and noise included
constexpr double kClear_m = 0.4;          // of the box, before its place may be expected to be free

}  // namespace

Evidence look_back(const Visibility& visibility, const glm::dvec3& point_m, const BoxTrack& box) {
    const std::vector<double>& times = box.world_from_box.time_s;
    Evidence evidence;
    for (const std::uint32_t view : visibility.views_near(point_m)) {
        if (box.holds(point_m, std::clamp(visibility.time_s(view), times.front(), times.back()), kClear_m)) continue;
        if (visibility.has_return_at(view, point_m, kSamePlace_m)) ++evidence.stayed;
        else if (visibility.look(view, point_m) == Sight::seen_through) ++evidence.left;
    }
    return evidence;
}

Evidence sift(const Visibility& visibility, MoverCluster& cluster, const BoxTrack& box) {
    Evidence sum;
    std::vector<glm::dvec3> kept;
    for (const glm::dvec3& p : cluster.points_m) {
        const Evidence evidence = look_back(visibility, p, box);
        sum += evidence;
        if (!evidence.says_stayed()) kept.push_back(p);
    }
    cluster.points_m = std::move(kept);
    cluster.centre_m = glm::dvec3(0.0);
    for (const glm::dvec3& p : cluster.points_m) cluster.centre_m += p / double(cluster.points_m.size());
    return sum;
}

}  // namespace relidar
