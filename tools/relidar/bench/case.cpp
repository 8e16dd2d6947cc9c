// SPDX-License-Identifier: Apache-2.0
#include "bench/case.hpp"

#include <fmt/format.h>

#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/render.hpp>

#include "base/fail.hpp"
#include "scene/benchmark_street.hpp"

namespace relidar::cli {

BenchCase street_case(std::uint32_t n_surfels, bool smaller_scales_for_more_surfels, const RayTable& rays) {
    BenchCase bench;
    constexpr unsigned kSeed = 20261120;
    bench.name = "benchmark street";
    bench.rows = rays.rows;
    bench.columns = rays.columns;
    bench.view_origin_m = rays.origin.front();
    // In this street, the sensor frame equals the world frame.
    bench.rays = {to_vector(rays.origin), to_vector(rays.direction)};
    const Surfels surfels = make_street_surfels(n_surfels, kSeed, smaller_scales_for_more_surfels);
    bench.scene = wrap_background(surfels.reorder(kd_tree_order(surfels.mean)));
    bench.config = make_preset("paper");
    // The background is the only instance.
    bench.placed.resize(1);
    return bench;
}

BenchCase case_of_run(const Run& run) {
    if (run.log.frames.empty() || count_surfels(run.scene) == 0)
        fail("cannot render run {}: it has no frames or no surfels; expected at least one of each",
             run.folder.string());
    const Frame& frame =
        run.log.frames[run.split.test.empty() ? 0 : static_cast<std::size_t>(run.split.test.front())];
    const SimulatedSensor sensor = make_sensor(run.config, run.log, frame.lidar);
    RayTable table = sensor.rays;
    // The sensor has no table if its rays differ from scan to scan.
    if (table.size() == 0) table = make_lidar_rays(run.log.lidar_of(frame), frame.time_s);
    if (table.size() == 0)
        fail("run {}: its LiDAR has no beams, so it has no rays; expected at least one ray",
             run.folder.string());
    BenchCase bench;
    bench.name = fmt::format("{}, frame {}", run.folder.string(), frame.index);
    bench.rows = table.rows;
    bench.columns = table.columns;
    const PoseTrack track = run.log.lidar_track(frame.lidar);
    bench.view_origin_m = glm::vec3(track.pose_at(frame.time_s).translation);
    const bool has_rolling_shutter = is_rolling(sensor, run.config);
    for (std::size_t i = 0; i < table.size(); ++i) {
        // With a rolling shutter, the ray starts at the pose of its own firing time.
        const WorldRay ray = make_world_ray(track, frame.time_s, table, i, has_rolling_shutter);
        bench.rays.origin.emplace_back(ray.origin_m);
        bench.rays.direction.emplace_back(ray.direction);
        bench.rays.time_s.push_back(has_rolling_shutter ? table.time_offset_s[i] : 0.0f);
    }
    bench.placed = pose_instances(run.scene, run.log, timing_of(frame));
    bench.scene = with_all_blocks(run.scene);  // A long log has its surfels in several files.
    bench.config = run.config;
    return bench;
}

}  // namespace relidar::cli
