// SPDX-License-Identifier: Apache-2.0
// Selects the sensor to simulate. Also implements range grids, because published results
// use them. Such a dataset bins real points into an image with linear elevation and
// azimuth. The simulation bins the simulated points of the real beams in the same way.
#include <relidar/simulate/render.hpp>

#include <algorithm>
#include <cmath>
#include <type_traits>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/run/stage_options.hpp>
#include "simulate/render/channel_pairs.hpp"
#include "simulate/render/empty_scan.hpp"

namespace relidar {

namespace {

/// A simulated ray becomes a point of the grid only if its blending weight is at least
/// this value.
constexpr float kLeastWeight = 0.05f;

RangeLimits make_configured_limits(const Config& config, const Sequence& sequence) {
    return {config.dataset.min_range_m, use_farthest_return(config, sequence).dataset.max_range_m};
}

/// Returns the rays of a sensor, or no rays if the sensor has different rays in every
/// scan.
template <class Make>
RayTable make_rays_of(const std::optional<SensorPattern>& pattern, const Make& make) {
    return pattern && describe_pattern(*pattern).has_rays_by_time ? RayTable{} : make();
}

/// Returns true if the rays of the simulated sensor fire at different times (a rolling
/// shutter). Either the setting requires a rolling shutter, or the LiDARs of the log have
/// one.
bool has_rolling_shutter_of_log(const Config& config, const Sequence& sequence) {
    return config.sensor.rolling_shutter == RollingShutter::yes || sequence.rolling_shutter;
}

SensorChoice get_log_sensor(const Config& config, const Sequence& sequence, int lidar) {
    const Lidar& own = sequence.lidars[std::size_t(lidar)];
    const SpinningSensor& sensor = own.sensor;
    const RangeLimits limits =
        intersect_limits(sensor.range_limits(), make_configured_limits(config, sequence));
    return {.rays = make_rays_of(own.pattern, [&] { return make_nominal_rays(own, 0.0); }),
            .is_own = true,
            .follows_sweeps = config.render.follow_sweeps && !own.pattern,
            .beams = sensor.beams,
            .pattern = own.pattern,
            .limits = limits,
            .name = sensor.name,
            .lidar = lidar,
            .rolling_shutter = has_rolling_shutter_of_log(config, sequence)};
}

SensorChoice make_grid_choice(const RangeGrid& grid, const Config& config, const Sequence& sequence,
                              int lidar) {
    const std::string& method = config.sensor.grid_method;
    const RangeLimits limits =
        intersect_limits({0.0, grid.max_range_m}, make_configured_limits(config, sequence));
    if (method == "cast")
        return {.rays = make_rays(grid),
                .limits = limits,
                .name = grid.name,
                .lidar = lidar,
                .rolling_shutter = has_rolling_shutter_of_log(config, sequence)};
    if (method != "project") {
        throw UsageError(fmt::format("sensor.grid_method: found \"{}\", expected project or cast", method));
    }
    SensorChoice choice = get_log_sensor(config, sequence, lidar);
    choice.grid = grid;
    choice.limits = intersect_limits(choice.limits, limits);
    choice.name = grid.name;
    return choice;
}

/// Copies all values of a ray to a cell of the grid, except drop probabilities.
void copy_pixel(const RenderedScan& source_scan, std::size_t source, RenderedScan& target_scan,
                std::size_t cell) {
    const glm::vec3 &origin = source_scan.image.origin[source],
                    &direction = source_scan.image.direction[source];
    for_each_pair(
        source_scan, target_scan,
        [&]<class T>(const ChannelInfo& channel, const std::vector<T>& of_rays, std::vector<T>& of_cells) {
            if constexpr (std::is_same_v<T, float>) {
                if (channel.join == ChannelJoin::drop) return;
                if (channel.join == ChannelJoin::range)
                    return void(of_cells[cell] = glm::length(origin + of_rays[source] * direction));
            }
            of_cells[cell] = of_rays[source];
        });
    target_scan.time_offset_s[cell] = source_scan.time_offset_s[source];
}

/// Sets the drop probability of a cell to the smallest drop probability of its rays,
/// because one return is enough to fill the cell.
void join_drops(const RenderedScan& source_scan, std::size_t source, RenderedScan& target_scan,
                std::size_t cell) {
    for_each_pair(
        source_scan, target_scan,
        [&]<class T>(const ChannelInfo& channel, const std::vector<T>& of_rays, std::vector<T>& of_cells) {
            if constexpr (std::is_same_v<T, float>)
                if (channel.join == ChannelJoin::drop)
                    of_cells[cell] = std::min(of_cells[cell], of_rays[source]);
        });
}

}  // namespace

bool has_rolling_shutter(const SensorChoice& sensor, const Config& config) {
    return sensor.rolling_shutter && config.sensor.rolling_shutter != RollingShutter::no;
}

SensorChoice align_sensor_with_sweep(const SensorChoice& sensor, std::span<const Frame> frames,
                                     std::span<const Lidar> lidars, double time_s) {
    constexpr double kSameTime_s = 1e-3;
    if (!sensor.follows_sweeps) return sensor;
    const auto is_now = [&](const Frame& f) {
        return f.lidar == sensor.lidar && !f.azimuth_shift_rad.empty() &&
               std::abs(f.time_s - time_s) < kSameTime_s;
    };
    const auto sweep = std::ranges::find_if(frames, is_now);
    const SpinningSensor& head = lidars[std::size_t(sensor.lidar)].sensor;
    if (sweep == frames.end() || sensor.rays.size() != head.beams.size() * sweep->azimuth_shift_rad.size())
        return sensor;
    SensorChoice result = sensor;
    result.rays = shift_azimuths(std::move(result.rays), head, sweep->azimuth_shift_rad);
    result.follows_sweeps = false;
    return result;
}

SensorChoice make_configured_sensor(const Config& config, const Sequence& sequence, int lidar) {
    if (config.sensor.grid == "native") return get_log_sensor(config, sequence, lidar);
    return make_grid_choice(find_grid(config.sensor.grid), config, sequence, lidar);
}

SensorChoice make_sensor_choice(const SensorModel& sensor, int lidar) {
    const std::optional<SensorPattern> pattern = get_fixed_pattern(sensor);
    return {.rays = make_rays_of(pattern, [&] { return make_rays(sensor); }),
            .pattern = pattern,
            .limits = sensor.limits,
            .name = sensor.name,
            .lidar = lidar};
}

SensorChoice make_sensor_choice(const MountedSensor& mounted, int lidar) {
    SensorChoice choice = make_sensor_choice(mounted.sensor, lidar);
    choice.returns = mounted.returns;
    return choice;
}

SensorChoice choose_sensor(const std::string& name_or_file, const Config& config, const Sequence& sequence,
                           int lidar) {
    if (find_known_name(name_or_file, {"native"})) return get_log_sensor(config, sequence, lidar);
    if (find_known_name(name_or_file, {make_kitti360_grid().name}))
        return make_grid_choice(make_kitti360_grid(), config, sequence, lidar);
    return make_sensor_choice(find_sensor(name_or_file, {"native"}), lidar);
}

RenderedScan project_scan(const RenderedScan& scan, const RangeGrid& grid) {
    const RayTable cells = make_rays(grid);
    const std::size_t n = cells.size();
    check_channels(scan.channels, scan.median_range_m.size(), "a scan that is binned");
    RenderedScan result = make_scan_without_measurements(cells, scan);
    for_each_pair(scan, result,
                  [n]<class T>(const ChannelInfo& channel, const std::vector<T>&, std::vector<T>& of_cells) {
                      of_cells.assign(n, get_missing_value<T>(channel));
                  });
    result.time_offset_s.assign(n, 0.0f);
    // [cells] drop probability of the ray whose values are stored in the cell; 2 if the
    // cell has no ray yet
    std::vector<float> winner_drop(n, 2.0f);
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i) {
        if (!(scan.median_range_m[i] > 0.0f) || scan.weight[i] < kLeastWeight) continue;
        const glm::vec3 point = scan.image.origin[i] + scan.median_range_m[i] * scan.image.direction[i];
        const std::optional<int> cell = project(grid, glm::dvec3(point));
        if (!cell) continue;
        const std::size_t c = std::size_t(*cell);
        const float drop = scan.image.drop_prob[i];
        join_drops(scan, i, result, c);
        const bool returns = drop < kDropThreshold, winner_returns = winner_drop[c] < kDropThreshold;
        const bool is_nearer = glm::length(point) < result.median_range_m[c];
        const bool wins = returns != winner_returns ? returns : returns ? is_nearer : drop < winner_drop[c];
        if (!wins && winner_drop[c] < 1.5f) continue;
        winner_drop[c] = drop;
        copy_pixel(scan, i, result, c);
    }
    return result;
}

RangeImage make_real_image(const Config& config, const Scan& scan) {
    RangeImage image;
    if (config.sensor.grid == "native") {
        image = {scan.rays.rows,
                 scan.rays.columns,
                 to_vector(scan.range_m),
                 to_vector(scan.intensity),
                 {},
                 to_vector(scan.rays.origin),
                 to_vector(scan.rays.direction)};
    } else {
        const RangeGrid grid = find_grid(config.sensor.grid);
        std::vector<glm::vec3> points;
        std::vector<float> intensity;
        for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
            if (!(scan.range_m[i] > 0.0f)) continue;
            points.push_back(scan.point(i));
            intensity.push_back(scan.intensity[i]);
        }
        const GridImage binned = project_points(grid, points, intensity);
        const RayTable cells = make_rays(grid);
        image = {grid.rows,
                 grid.columns,
                 binned.range_m,
                 binned.intensity,
                 {},
                 to_vector(cells.origin),
                 to_vector(cells.direction)};
    }
    for (const float range : image.range_m) image.drop_prob.push_back(range > 0.0f ? 0.0f : 1.0f);
    return image;
}

}  // namespace relidar
