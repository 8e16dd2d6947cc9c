// SPDX-License-Identifier: Apache-2.0
// Computes the points of a scan on the host. src/CMakeLists.txt compiles this file
// without fused multiply-add, so that the positions are bitwise equal to the positions
// that the device computes.
#include <relidar/simulate/place_points.hpp>

#include "base/parallel.hpp"
#include "simulate/render/sensor_rays.hpp"
#include "simulate/shared/place_point.h"

namespace relidar {
namespace {

constexpr std::size_t kPointsTogether = 4096;  // number of points that one parallel task places

struct RayReturnIndex {
    std::size_t ray;
    std::uint8_t number;
};

/// Lists the returns that become points, in the order of the rays. Second returns
/// directly follow the first return of their ray.
std::vector<RayReturnIndex> select_returns(const RenderedScan& scan, const std::vector<float>& ranges_m,
                                           PointSelection selection) {
    std::vector<RayReturnIndex> returns;
    returns.reserve(ranges_m.size());
    for (std::size_t ray = 0; ray < ranges_m.size(); ++ray) {
        if (selection != PointSelection::rays && !is_ray_returned(scan.image.drop_prob[ray], ranges_m[ray]))
            continue;
        returns.push_back({ray, 1});
        if (selection != PointSelection::returns) continue;
        for (std::size_t k = 0; k < scan.second_returns.size(); ++k)
            if (scan.second_returns[k].range_m[ray] > 0.0f) returns.push_back({ray, std::uint8_t(k + 2)});
    }
    return returns;
}

/// Returns the poses of the sensor during a scan, in the frame of the points. Returns no
/// poses if the points are in the sensor's frame.
SensorPoses sensor_poses(const RenderedScan& scan, const std::optional<Pose>& dataset_from_points) {
    if (!dataset_from_points || scan.time_offset_s.empty()) return {};
    const PoseTrack track =
        scan.track.pose.empty() ? PoseTrack{{scan.time_s}, {scan.world_from_sensor}} : scan.track;
    const auto [first_s, last_s] = std::ranges::minmax(scan.time_offset_s);
    return poses_between(to_frame(track, *dataset_from_points), scan.time_s, double(first_s), double(last_s));
}

/// Returns the last pose before a time, found by bisection. Must select the same pose as
/// shaders/simulate/render/sensor_way.glsl.
const shared::SensorPose& find_pose(const SensorPoses& poses, float time_offset_s) {
    std::size_t k = 0, end = std::max<std::size_t>(poses.size(), 2) - 1;
    while (end - k > 1) {
        const std::size_t middle = (k + end) / 2;
        (poses[middle].time_offset_s <= time_offset_s ? k : end) = middle;
    }
    return poses[k];
}

}  // namespace

LidarPoints place_points(const RenderedScan& scan, const Config& config,
                         const std::optional<Pose>& dataset_from_points, PointSelection selection) {
    const std::vector<float>& range_m = point_ranges(scan, config);
    check_channels(scan.channels, range_m.size(), "a scan");
    const std::vector<RayReturnIndex> returns = select_returns(scan, range_m, selection);
    const SensorPoses poses = sensor_poses(scan, dataset_from_points);
    const std::size_t n = returns.size();
    LidarPoints points{.position_m = std::vector<glm::vec3>(n),
                       .intensity = std::vector<float>(n),
                       .ring = std::vector<std::uint16_t>(n),
                       .time_offset_s = std::vector<float>(n),
                       .instance = std::vector<std::int32_t>(n),
                       .channels = copy_layout(scan.channels),
                       .world_from_points = dataset_from_points.value_or(scan.world_from_sensor),
                       .time_s = scan.time_s};
    if (selection == PointSelection::returns && !scan.second_returns.empty()) points.return_number.resize(n);
    const auto fill_point = [&](std::size_t index) {
        // number 1 is the first return, 2 and higher are entries of second_returns
        const auto [ray, number] = returns[index];
        const AdditionalReturns* second = number > 1 ? &scan.second_returns[number - 2u] : nullptr;
        const float time_offset_s = scan.time_offset_s[ray];
        const glm::vec3 end = shared::compute_ray_end(scan.image.origin[ray], scan.image.direction[ray],
                                                      second ? second->range_m[ray] : range_m[ray]);
        // Without poses, the point stays in the sensor frame at its firing time.
        points.position_m[index] =
            poses.empty() ? end : shared::place_point(find_pose(poses, time_offset_s), time_offset_s, end);
        points.intensity[index] = second ? second->intensity[ray] : scan.image.intensity[ray];
        points.ring[index] = scan.ring[ray];
        points.time_offset_s[index] = time_offset_s;
        // The instance of a second return is unknown.
        points.instance[index] = second ? -1 : scan.instance[ray];
        if (!points.return_number.empty()) points.return_number[index] = number;
    };
    parallel_ranges(n, kPointsTogether, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) fill_point(i);
    });
    for (std::size_t k = 0; k < points.channels.size(); ++k) {
        for (const auto& [ray, number] : returns)
            append_return(points.channels[k], scan.channels[k], ray, number);
        auto* vectors = std::get_if<std::vector<glm::vec3>>(&points.channels[k].values);
        // Rotates normals and similar vectors into the frame of the points.
        if (!vectors || !scan.channels[k].info.turns || poses.empty()) continue;
        for (std::size_t i = 0; i < n; ++i)
            (*vectors)[i] = shared::to_world(find_pose(poses, points.time_offset_s[i]),
                                             points.time_offset_s[i], (*vectors)[i]);
    }
    return points;
}

}  // namespace relidar
