// SPDX-License-Identifier: Apache-2.0
// The points of a scan on the host.
#include <relidar/render.hpp>

namespace relidar {

PointScan returned_points(const RenderedScan& scan, const Config& config, const Pose& dataset_from_points) {
    PointScan result{{}, dataset_from_points, scan.time_s, scan.image.range_m.size(), scan.unseen_share};
    const Pose points_from_dataset = inverse(dataset_from_points);
    const bool stands = scan.track.pose.size() < 2;
    const Pose standing = points_from_dataset * (scan.time_offset_s.empty() ? scan.world_from_sensor : scan.world_from_firing(0));
    const std::vector<float>& range_m = point_ranges(scan, config);
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        if (!returned(scan.image.drop_prob[i], range_m[i])) continue;
        const Pose points_from_firing = stands ? standing : points_from_dataset * scan.world_from_firing(i);
        const glm::dvec3 seen_m = glm::dvec3(scan.image.origin[i]) + double(range_m[i]) * glm::dvec3(scan.image.direction[i]);
        result.points.push_back({.position_m = glm::vec3(points_from_firing * seen_m),
                                 .intensity = scan.image.intensity[i],
                                 .time_offset_s = scan.time_offset_s[i],
                                 .ring = scan.ring[i],
                                 .instance = scan.instance[i]});
    }
    return result;
}

}  // namespace relidar
