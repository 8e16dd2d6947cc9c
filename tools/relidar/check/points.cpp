// SPDX-License-Identifier: Apache-2.0
// Checks the point cloud of a simulated scan. The points that the GPU computes must equal
// the points that the CPU computes from the same scan.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/read/dataset.hpp>
#include <relidar/simulate/place_points.hpp>
#include "check/checks.hpp"

namespace relidar::cli {

/// Compares points that the device places with points that the CPU places from a
/// rendered image of the same scan.
CheckResult check_points(CheckedDevice& tested) {
    const DeviceInfo& info = tested.default_device().info();
    if (!info.software && !info.ray_query)
        return unsupported_check("the device cannot trace rays, neither by ray query nor in software");
    const Log log = make_street_log({.n_frames = 3, .rows = 16, .columns = 128});
    const Scene scene = init_scene(log, {0, 1, 2}, {});
    const Config config;
    ScanRenderer renderer(tested.default_device(), scene, config, log);
    const SimulatedSensor sensor = choose_sensor("VLP-16:128x10", config, log);
    const PoseTrack track = shift_track(log.lidar_track(0), log.world_offset_m);
    const double time_s = log.frames[1].time_s;
    renderer.submit_points(sensor, {time_s, track}, time_s);
    const LidarPoints actual = renderer.wait_for_points().points;
    const LidarPoints expected =
        place_points(renderer.render(sensor, {time_s, track}), config, track.pose_at(time_s));
    if (actual.size() != expected.size() || actual.size() == 0)
        return failed_check(
            fmt::format("found {} points, expected {} points", actual.size(), expected.size()));
    double error_m = 0.0;
    for (std::size_t i = 0; i < actual.size(); ++i) {
        const double distance_m = glm::distance(actual.position_m[i], expected.position_m[i]);
        // Stays infinite after the first point that is not finite.
        error_m = std::isfinite(distance_m) ? std::max(error_m, distance_m) : HUGE_VAL;
    }
    return compare_error(error_m, 1e-4);
}

}  // namespace relidar::cli
