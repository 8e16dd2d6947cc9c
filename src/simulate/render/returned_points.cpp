// SPDX-License-Identifier: Apache-2.0
// The points of a scan on the host.
#include <algorithm>

#include <relidar/simulate/render.hpp>

#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr std::size_t kRaysTogether = 16384;  // so many that the poses of a row are worth keeping

/// [n] Where the rays that return meet something, in the frame of the points.
std::vector<glm::vec3> placed_returns(const RenderedScan& scan, const std::vector<float>& range_m,
                                      const Pose& points_from_dataset) {
    std::vector<glm::vec3> position_m(range_m.size());
    for_each_part(range_m.size(), kRaysTogether, [&](std::size_t begin, std::size_t end) {
        FiringPoses points_from_firing(scan, points_from_dataset);
        for (std::size_t i = begin; i < end; ++i) {
            if (!returned(scan.image.drop_prob[i], range_m[i])) continue;
            const glm::dvec3 seen_m =
                glm::dvec3(scan.image.origin[i]) + double(range_m[i]) * glm::dvec3(scan.image.direction[i]);
            position_m[i] = glm::vec3(points_from_firing.at(i) * seen_m);
        }
    });
    return position_m;
}

}  // namespace

PointScan returned_points(const RenderedScan& scan, const Config& config, const Pose& dataset_from_points) {
    const std::vector<float>& range_m = point_ranges(scan, config);
    const std::vector<glm::vec3> position_m = placed_returns(scan, range_m, inverse(dataset_from_points));
    PointScan result{{}, dataset_from_points, scan.time_s, range_m.size(), scan.unseen_share};
    result.points.reserve(range_m.size());
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        if (!returned(scan.image.drop_prob[i], range_m[i])) continue;
        result.points.push_back({.position_m = position_m[i],
                                 .intensity = scan.image.intensity[i],
                                 .time_offset_s = scan.time_offset_s[i],
                                 .ring = scan.ring[i],
                                 .instance = scan.instance[i]});
    }
    return result;
}

}  // namespace relidar
