// SPDX-License-Identifier: Apache-2.0
// relidar_bench_rig scores a run that was trained on a synthetic street recorded by a rig
// of LiDARs. It compares the held-out sweeps of each LiDAR with rays cast into the exact
// street. For LiDARs with two returns it casts a cone of rays per beam.
//
//   relidar_bench_rig RUN [--aside METRES]
//
// --aside also scores exact scans of the street from a position that is shifted to the
// left and up.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/log/sensor_pattern.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "street_of.hpp"

namespace {

using namespace relidar;

constexpr float kOnSurface_m = 0.3f;

struct RigScanScore {
    /// Range errors of rays that have a return in both the rendered scan and the exact
    /// scan of the synthetic street.
    std::vector<double> errors_m;
    double squares = 0.0;
    /// Numbers of rays, of rays that return or drop like the exact ray, of exact second
    /// returns, of those that are found, of rendered second returns, and of wrong ones.
    std::size_t rays = 0, drops_right = 0, second_returns = 0, detected = 0, reported = 0, invented = 0;
};

double percentage(std::size_t count, std::size_t total) {
    return total ? 100.0 * double(count) / double(total) : 0.0;
}

struct ScanRanges {
    /// [rays] metres, 0 for no return. `second_m` is empty without second returns.
    std::vector<float> range_m, second_m;
};

ScanRanges return_ranges(const RenderedScan& scan) {
    ScanRanges ranges{scan.median_range_m,
                      scan.second_returns.empty() ? std::vector<float>{} : scan.second_returns[0].range_m};
    for (std::size_t i = 0; i < ranges.range_m.size(); ++i)
        if (!is_ray_returned(scan.image.drop_prob[i], ranges.range_m[i])) ranges.range_m[i] = 0.0f;
    return ranges;
}

ScanRanges return_ranges(const Scan& scan) {
    const std::vector<float> second_m =
        scan.second_returns.empty() ? std::vector<float>{} : scan.second_returns[0].range_m;
    return {{scan.range_m.begin(), scan.range_m.end()}, second_m};
}

/// Compares the second return of a ray with the exact scan of the synthetic street, and
/// counts the result.
/// @param exact_returns has only second returns with at least a tenth of the beam's light
void add_second_return(RigScanScore& score, const ScanRanges& rendered_returns,
                       const ScanRanges& exact_returns, std::size_t ray) {
    const float exact_m = exact_returns.second_m[ray], reported_m = rendered_returns.second_m[ray];
    const bool exists = exact_m > 0.0f, is_reported = reported_m > 0.0f;
    // Both surfaces are right, because the sensor may report them in either order.
    const float error_m =
        std::min(std::abs(reported_m - exact_m), std::abs(reported_m - exact_returns.range_m[ray]));
    const bool is_right = exists && is_reported && error_m < kOnSurface_m;
    if (exists) ++score.second_returns;
    if (is_reported) ++score.reported;
    if (is_right) ++score.detected;
    if (is_reported && !is_right) ++score.invented;
}

/// Compares a scan with the exact scan of the street along the same rays. Range 0 means
/// that a ray has no return.
void add_comparison(RigScanScore& score, const ScanRanges& rendered_returns,
                    const ScanRanges& exact_returns) {
    for (std::size_t i = 0; i < exact_returns.range_m.size(); ++i) {
        const double rendered_m = rendered_returns.range_m[i], exact_m = exact_returns.range_m[i];
        const bool returns = rendered_m > 0.0, should_return = exact_m > 0.0;
        ++score.rays;
        if (returns == should_return) ++score.drops_right;
        if (returns && should_return) {
            score.errors_m.push_back(std::abs(rendered_m - exact_m));
            score.squares += score.errors_m.back() * score.errors_m.back();
        }
        if (!exact_returns.second_m.empty()) add_second_return(score, rendered_returns, exact_returns, i);
    }
}

/// Returns a row of the table: median and root mean square of the range errors, shares of
/// right drops and of second returns. Sorts the errors.
std::string format_row(const std::string& name, RigScanScore& score) {
    std::sort(score.errors_m.begin(), score.errors_m.end());
    if (score.errors_m.empty()) return fmt::format("| {} | {} | no ray returned |\n", name, score.rays);
    std::string second_return_cells = "– | – | –";
    if (score.second_returns > 0)
        second_return_cells = fmt::format("{} | {:.1f} % | {:.1f} %", score.second_returns,
                                          percentage(score.detected, score.second_returns),
                                          percentage(score.invented, score.reported));
    const double median_m = score.errors_m[score.errors_m.size() / 2],
                 root_mean_square_m = std::sqrt(score.squares / double(score.errors_m.size()));
    return fmt::format("| {} | {} | {:.4f} m | {:.2f} m | {:.1f} % | {} |\n", name, score.rays, median_m,
                       root_mean_square_m, percentage(score.drops_right, score.rays), second_return_cells);
}

/// Casts rays into the synthetic street and returns their exact ranges. If the sensor
/// reports two returns, casts each beam as a cone of several rays.
/// @param lateral_offset_m distance by which the sensor is shifted to the left and also
/// upwards, metres
ScanRanges cast_exact_ranges(const StreetOptions& street, RayTable rays, const PoseTrack& world_from_sensor,
                             double time_s, const SimulatedSensor& sensor, float lateral_offset_m = 0.0f) {
    for (glm::vec3& origin : rays.origin) origin += lateral_offset_m * glm::vec3(0.0f, 1.0f, 1.0f);
    const double max_range_m = nominal_max_range_m(sensor.name).value_or(sensor.limits.max_m);
    Scan scan = sensor.returns == 2 ? cast_street_beams(street, rays, world_from_sensor, time_s, max_range_m)
                                    : cast_street_rays(street, rays, world_from_sensor, time_s);
    limit_ranges(scan, sensor.limits);
    return return_ranges(scan);
}

/// Prints the scores of each LiDAR, and of exact scans shifted by an offset above 0.
void print_rig_scores(const std::string& run_folder, float lateral_offset_m) {
    Run run = load_run(run_folder);
    const StreetOptions street = read_street(run);
    const auto rig = read_sensor_rig(street.rig);
    if (!rig)
        throw UsageError(
            fmt::format("cannot use the run {}: its synthetic street was recorded without a sensor rig; "
                        "expected a run of a street whose street.toml has an entry rig = FILE",
                        run_folder));
    Device device(apply_environment({}));
    ScanRenderer renderer(device, run.scene, run.config, run.log);
    std::vector<RigScanScore> scores(run.log.lidars.size()), shifted_scores(scores.size());
    for (const int position : run.split.test) {
        const Frame& frame = run.log.frames[std::size_t(position)];
        const Lidar& lidar = run.log.lidar_of(frame);
        const auto mounted = std::ranges::find(*rig, lidar.name, &MountedSensor::name);
        SimulatedSensor sensor = make_sensor(run.config, run.log, frame.lidar);
        sensor.returns = mounted != rig->end() ? mounted->returns : 1;
        const RayTable rays = make_lidar_rays(lidar, frame.time_s);
        const PoseTrack track = run.log.lidar_track(frame.lidar);
        const ScanRanges truth = cast_exact_ranges(street, rays, track, frame.time_s, sensor);
        add_comparison(scores[std::size_t(frame.lidar)], return_ranges(renderer.render(sensor, frame.time_s)),
                       truth);
        if (lateral_offset_m > 0.0f)
            add_comparison(shifted_scores[std::size_t(frame.lidar)],
                           cast_exact_ranges(street, rays, track, frame.time_s, sensor, lateral_offset_m),
                           truth);
    }
    fmt::print(
        "| LiDAR | rays | median range error | RMSE | correct drops | second returns | reported correctly | "
        "reported but wrong |\n"
        "|---|--:|--:|--:|--:|--:|--:|--:|\n");
    for (std::size_t lidar_index = 0; lidar_index < scores.size(); ++lidar_index) {
        const std::string& name = run.log.lidars[lidar_index].name;
        fmt::print("{}", format_row(name, scores[lidar_index]));
        const std::string shifted_name =
            fmt::format("{}, exact scan of the street from {:g} cm to the left and above", name,
                        100.0f * lateral_offset_m);
        if (lateral_offset_m > 0.0f) fmt::print("{}", format_row(shifted_name, shifted_scores[lidar_index]));
    }
}

}  // namespace

int main(int argc, char** argv) {
    float aside_m = 0.0f;
    if (argc == 4 && argv[2] == std::string("--aside")) {
        aside_m = std::strtof(argv[3], nullptr);
        argc = 2;
    }
    return relidar::run_on_argument(argc, argv,
                                    [&](const std::string& run) { print_rig_scores(run, aside_m); });
}
