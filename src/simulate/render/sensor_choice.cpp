// SPDX-License-Identifier: Apache-2.0
// Selects the sensor to simulate. Also implements range grids, which published results
// use: points are binned into an image with linear elevation and azimuth. The simulation
// bins the simulated points of the real beams in the same way.

#include <cmath>

#include <relidar/log/sensor_files.hpp>
#include <relidar/run/stage_options.hpp>
#include "base/fail.hpp"
#include "simulate/channels/channel_pairs.hpp"

namespace relidar {

namespace {

constexpr float kLeastWeight = 0.05f;  // minimum blending weight of a ray that is projected into the image

RangeLimits configured_limits(const Config& config, const Log& log) {
    return {config.dataset.min_range_m, with_max_range(config, log).dataset.max_range_m};
}

/// Returns no rays if the pattern has different rays in each scan.
template <class Make>
RayTable fixed_rays(const std::optional<SensorPattern>& pattern, const Make& make_table) {
    return pattern && summarise_pattern(*pattern).has_rays_by_time ? RayTable{} : make_table();
}

bool has_rolling_shutter(const Config& config, const Log& log) {
    return config.sensor.rolling_shutter == RollingShutter::yes || log.rolling_shutter;
}

/// Returns a sensor with the rays, beams and limits of a LiDAR of the log.
SimulatedSensor make_log_sensor(const Config& config, const Log& log, int lidar) {
    const Lidar& log_lidar = log.lidars[std::size_t(lidar)];
    const SpinningSensor& sensor = log_lidar.sensor;
    const RangeLimits limits = intersect(sensor.range_limits(), configured_limits(config, log));
    return {.rays = fixed_rays(log_lidar.pattern, [&] { return make_lidar_rays(log_lidar, 0.0); }),
            .is_log_lidar = true,
            .follows_sweeps = config.render.follow_sweeps && !log_lidar.pattern,
            .beams = sensor.beams,
            .pattern = log_lidar.pattern,
            .limits = limits,
            .name = sensor.name,
            .lidar = lidar,
            .rolling_shutter = has_rolling_shutter(config, log),
            .body = {.seen = log_lidar.own_body}};
}

/// Returns a sensor for a range grid. With the method "cast", its rays are the pixels of
/// the grid. With "project", it has the rays of the LiDAR, whose points are binned into
/// the grid.
SimulatedSensor grid_sensor(const RangeImageGrid& grid, const Config& config, const Log& log, int lidar) {
    const std::string& method = config.sensor.grid_method;
    const RangeLimits limits = intersect({0.0, grid.max_range_m}, configured_limits(config, log));
    if (method == "cast")
        return {.rays = make_rays(grid),
                .limits = limits,
                .name = grid.name,
                .lidar = lidar,
                .rolling_shutter = has_rolling_shutter(config, log)};
    if (method != "project") {
        fail<UsageError>("sensor.grid_method: found \"{}\", expected project or cast", method);
    }
    SimulatedSensor choice = make_log_sensor(config, log, lidar);
    choice.grid = grid;
    choice.limits = intersect(choice.limits, limits);
    choice.name = grid.name;
    return choice;
}

/// Returns the pixel of the grid to which the hit point of each ray belongs, or -1.
std::vector<int> pixels_of_rays(const RenderedScan& scan, const RangeImageGrid& grid) {
    std::vector<int> pixels(scan.median_range_m.size(), -1);
    for (std::size_t ray = 0; ray < pixels.size(); ++ray)
        if (scan.median_range_m[ray] > 0.0f && scan.weight[ray] >= kLeastWeight)
            pixels[ray] = project_to_pixel(grid, glm::dvec3(scan.end_of(ray))).value_or(-1);
    return pixels;
}

/// Returns true if a pixel shows a ray rather than another ray. Prefers returned rays. Of
/// two returned rays, the pixel shows the nearer point, and of two dropped rays the one
/// with the lower drop probability. Of equal rays, it shows `other`.
bool is_shown_instead(const RenderedScan& scan, std::size_t ray, std::size_t other) {
    const float drop = scan.image.drop_prob[ray], other_drop = scan.image.drop_prob[other];
    const bool returns = drop < kDropThreshold, other_returns = other_drop < kDropThreshold;
    if (returns != other_returns) return returns;
    return returns ? glm::length(scan.end_of(ray)) < glm::length(scan.end_of(other)) : drop < other_drop;
}

using ShownRays = std::vector<std::optional<std::size_t>>;  // [pixels]
/// Returns the ray that each pixel shows, or nothing for a pixel without rays.
/// @param pixel_of_ray [rays] index of the pixel to which a ray belongs, or -1
ShownRays select_shown_rays(const RenderedScan& scan, const std::vector<int>& pixel_of_ray,
                            std::size_t n_pixels) {
    ShownRays shown_rays(n_pixels);
    for (std::size_t ray = 0; ray < pixel_of_ray.size(); ++ray) {
        if (pixel_of_ray[ray] < 0) continue;
        std::optional<std::size_t>& shown = shown_rays[std::size_t(pixel_of_ray[ray])];
        if (!shown || is_shown_instead(scan, ray, *shown)) shown = ray;
    }
    return shown_rays;
}

}  // namespace

bool is_rolling(const SimulatedSensor& sensor, const Config& config) {
    return sensor.rolling_shutter && config.sensor.rolling_shutter != RollingShutter::no;
}

SimulatedSensor follow_sweep(const SimulatedSensor& sensor, std::span<const Frame> frames,
                             std::span<const Lidar> lidars, double time_s) {
    constexpr double kSameTime_s = 1e-3;  // maximum difference of time stamps of the same sweep
    if (!sensor.follows_sweeps) return sensor;
    const auto is_now = [&](const Frame& f) {
        return f.lidar == sensor.lidar && !f.azimuth_shift_rad.empty() &&
               std::abs(f.time_s - time_s) < kSameTime_s;
    };
    const auto sweep = std::ranges::find_if(frames, is_now);
    const SpinningSensor& head = lidars[std::size_t(sensor.lidar)].sensor;
    // One shift per firing. The rays must belong to the same number of firings.
    if (sweep == frames.end() || sensor.rays.size() != head.beams.size() * sweep->azimuth_shift_rad.size())
        return sensor;
    SimulatedSensor result = sensor;
    result.rays = rotate_firings(std::move(result.rays), head, sweep->azimuth_shift_rad);
    result.follows_sweeps = false;  // another call must not rotate the rays again
    return result;
}

SimulatedSensor make_sensor(const Config& config, const Log& log, int lidar) {
    if (config.sensor.grid == "native") return make_log_sensor(config, log, lidar);
    return grid_sensor(find_grid(config.sensor.grid), config, log, lidar);
}

SimulatedSensor simulate_sensor(const SensorModel& sensor, int lidar) {
    const std::optional<SensorPattern> pattern = other_pattern(sensor);
    return {.rays = fixed_rays(pattern, [&] { return make_rays(sensor); }),
            .pattern = pattern,
            .limits = sensor.limits,
            .name = sensor.name,
            .lidar = lidar};
}

SimulatedSensor simulate_sensor(const MountedSensor& mounted, int lidar) {
    SimulatedSensor choice = simulate_sensor(mounted.sensor, lidar);
    choice.returns = mounted.returns;
    choice.body = mounted.body;
    return choice;
}

SimulatedSensor choose_sensor(const std::string& name, const Config& config, const Log& log, int lidar) {
    if (find_name(name, {"native"})) return make_log_sensor(config, log, lidar);
    if (find_name(name, {kitti360_grid().name})) return grid_sensor(kitti360_grid(), config, log, lidar);
    return simulate_sensor(find_sensor(name, {"native"}), lidar);
}

RenderedScan project_scan(const RenderedScan& scan, const RangeImageGrid& grid) {
    const RayTable pixel_rays = make_rays(grid);
    const std::size_t n = pixel_rays.size();
    check_channels(scan.channels, scan.median_range_m.size(), "a scan that is projected onto the grid");
    const std::vector<int> pixel_of_ray = pixels_of_rays(scan, grid);
    const ShownRays shown_rays = select_shown_rays(scan, pixel_of_ray, n);
    RenderedScan result = empty_scan(pixel_rays, scan);
    result.time_offset_s.assign(n, 0.0f);
    for (std::size_t pixel = 0; pixel < n; ++pixel)
        if (const auto ray = shown_rays[pixel]) result.time_offset_s[pixel] = scan.time_offset_s[*ray];
    const auto fill_channel = [&]<class T>(const ChannelInfo& channel, const std::vector<T>& of_rays,
                                           std::vector<T>& of_pixels) {
        of_pixels.assign(n, empty_value<T>(channel));
        for (std::size_t pixel = 0; pixel < n; ++pixel)
            if (const auto ray = shown_rays[pixel]) of_pixels[pixel] = of_rays[*ray];
        if constexpr (std::is_same_v<T, float>) {
            // A grid has distances from its origin, not from the origin of the ray.
            if (channel.join == ChannelMergeRule::range)
                for (std::size_t pixel = 0; pixel < n; ++pixel)
                    if (const auto ray = shown_rays[pixel])
                        of_pixels[pixel] =
                            glm::length(scan.image.origin[*ray] + of_rays[*ray] * scan.image.direction[*ray]);
            // A pixel has a return if any of its rays returns.
            if (channel.join == ChannelMergeRule::drop)
                for (std::size_t ray = 0; ray < pixel_of_ray.size(); ++ray) {
                    if (pixel_of_ray[ray] < 0) continue;
                    float& drop = of_pixels[std::size_t(pixel_of_ray[ray])];
                    drop = std::min(drop, of_rays[ray]);
                }
        }
    };
    for_all_channels(scan, result, fill_channel);
    return result;
}

RangeImage measured_image(const Config& config, const Scan& scan) {
    RangeImage image;
    RayTable rays;  // one for each pixel
    if (config.sensor.grid == "native") {
        rays = scan.rays;
        image.range_m = to_vector(scan.range_m);
        image.intensity = to_vector(scan.intensity);
    } else {
        // Bins the points of the scan into the pixels of the grid.
        const RangeImageGrid grid = find_grid(config.sensor.grid);
        std::vector<glm::vec3> points;
        std::vector<float> intensity;
        for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
            if (!(scan.range_m[i] > 0.0f)) continue;
            points.push_back(scan.return_point(i));
            intensity.push_back(scan.intensity[i]);
        }
        const ProjectedRangeImage binned = project_points(grid, points, intensity);
        rays = make_rays(grid);
        image.range_m = binned.range_m;
        image.intensity = binned.intensity;
    }
    image.rows = rays.rows;
    image.columns = rays.columns;
    image.origin = to_vector(rays.origin);
    image.direction = to_vector(rays.direction);
    for (const float range : image.range_m) image.drop_prob.push_back(range > 0.0f ? 0.0f : 1.0f);
    return image;
}

}  // namespace relidar
