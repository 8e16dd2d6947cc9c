// SPDX-License-Identifier: Apache-2.0
#include "bench/case.hpp"

#include <fmt/format.h>

#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/render.hpp>

#include "base/fail.hpp"
#include "scene/benchmark_street.hpp"

namespace relidar::cli {

BenchCase make_synthetic_street_benchmark(std::uint32_t n_surfels, bool smaller_scales_for_more_surfels,
                                          const RayTable& rays) {
    BenchCase bench;
    bench.name = "benchmark street";
    bench.rows = rays.rows;
    bench.columns = rays.columns;
    bench.view_origin_m = rays.origin.front();
    // In this street, the sensor frame equals the world frame.
    bench.rays = {to_vector(rays.origin), to_vector(rays.direction)};
    const Surfels surfels =
        make_benchmark_street_surfels(n_surfels, 20261120, smaller_scales_for_more_surfels);
    bench.scene = make_background_scene(surfels.reorder(compute_kd_tree_order(surfels.mean)));
    bench.config = make_preset_config("paper");
    bench.placed.resize(1);
    return bench;
}

BenchCase make_benchmark_from_run(const TrainedRun& run) {
    if (run.sequence.frames.empty() || count_surfels(run.scene) == 0)
        fail("cannot render run {}: it has no frames or no surfels; expected at least one of each",
             run.folder.string());
    const LidarFrame& frame =
        run.sequence.frames[run.split.test.empty() ? 0 : static_cast<std::size_t>(run.split.test.front())];
    const SimulatedSensor sensor = make_sensor_from_config(run.config, run.sequence, frame.lidar);
    RayTable table = sensor.rays;
    if (table.size() == 0) table = make_nominal_rays(run.sequence.get_lidar(frame), frame.time_s);
    if (table.size() == 0)
        fail("run {}: its LiDAR has no beams, so it has no rays; expected at least one ray",
             run.folder.string());
    BenchCase bench;
    bench.name = fmt::format("{}, frame {}", run.folder.string(), frame.index);
    bench.rows = table.rows;
    bench.columns = table.columns;
    const PoseTrack track = run.sequence.get_world_from_sensor(frame.lidar);
    bench.view_origin_m = glm::vec3(track.interpolate_pose(frame.time_s).translation);
    const bool rolls = fires_rays_at_different_times(sensor, run.config);
    for (std::size_t i = 0; i < table.size(); ++i) {
        const WorldRay ray = make_world_ray(track, frame.time_s, table, i, rolls);
        bench.rays.origin.emplace_back(ray.origin_m);
        bench.rays.direction.emplace_back(ray.direction);
        bench.rays.time_s.push_back(rolls ? table.time_offset_s[i] : 0.0f);
    }
    bench.placed = compute_instance_poses(run.scene, run.sequence, get_sweep_timing_of_frame(frame));
    bench.scene = copy_scene_with_all_blocks_loaded(run.scene);
    bench.config = run.config;
    return bench;
}

}  // namespace relidar::cli
