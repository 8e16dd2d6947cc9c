// SPDX-License-Identifier: Apache-2.0
// relidar_bench_rig scores a run that was trained on a synthetic street recorded by a rig
// of LiDARs. It compares the held-out sweeps of each LiDAR with rays cast into the exact
// street. For LiDARs with two returns it casts a cone of rays per beam. It also replaces
// the first LiDAR by another sensor and scores that sensor.
#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/dataset.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "street_of.hpp"

namespace {

using namespace relidar;

constexpr float kOnSurface_m = 0.3f;

struct Score {
    /// Range errors of rays that return in both the exact scan and the rendered scan.
    std::vector<double> errors_m;
    double squares = 0.0;
    std::size_t rays = 0, returns = 0, missed = 0, behind = 0, drops_right = 0, seconds = 0, found = 0,
                reported = 0, invented = 0;
};

double format_percent(std::size_t count, std::size_t total) {
    return total ? 100.0 * double(count) / double(total) : 0.0;
}

/// Ranges of a scan, either rendered or cast into the exact synthetic street.
struct Returns {
    /// [rays] range in metres, 0 for no return. `second_m` is empty if the sensor has no
    /// second returns.
    std::vector<float> range_m, second_m;
};

Returns extract_returns(const RenderedScan& scan) {
    Returns r{scan.median_range_m,
              scan.second_returns.empty() ? std::vector<float>{} : scan.second_returns[0].range_m};
    for (std::size_t i = 0; i < r.range_m.size(); ++i)
        if (!is_returned(scan.image.drop_prob[i], r.range_m[i])) r.range_m[i] = 0.0f;
    return r;
}

Returns extract_returns(const Scan& scan) {
    const std::vector<float> second_m =
        scan.second_returns.empty() ? std::vector<float>{} : scan.second_returns[0].range_m;
    return {{scan.range_m.begin(), scan.range_m.end()}, second_m};
}

/// Compares the second return of ray `index` with the exact scan, and counts the result.
/// @param truth exact scan; its second returns have at least a tenth of the beam's light
void score_second_return(Score& score, const Returns& scan, const Returns& truth, std::size_t index) {
    const float is_m = truth.second_m[index], reported_m = scan.second_m[index];
    const bool right =
        is_m > 0.0f && reported_m > 0.0f &&
        std::min(std::abs(reported_m - is_m), std::abs(reported_m - truth.range_m[index])) < kOnSurface_m;
    score.seconds += is_m > 0.0f;
    score.reported += reported_m > 0.0f;
    score.found += right;
    score.invented += reported_m > 0.0f && !right;
}

void score_returns(Score& score, const Returns& scan, const Returns& truth) {
    for (std::size_t i = 0; i < truth.range_m.size(); ++i) {
        const bool returns = scan.range_m[i] > 0.0f, is_there = truth.range_m[i] > 0.0f;
        ++score.rays;
        score.drops_right += returns == is_there;
        score.returns += is_there;
        score.missed += is_there && !returns;
        score.behind += is_there && returns && scan.range_m[i] > truth.range_m[i] + kOnSurface_m;
        if (returns && is_there) {
            score.errors_m.push_back(std::abs(double(scan.range_m[i]) - double(truth.range_m[i])));
            score.squares += score.errors_m.back() * score.errors_m.back();
        }
        if (!truth.second_m.empty()) score_second_return(score, scan, truth, i);
    }
}

std::string format_score_row(const std::string& name, Score& s) {
    std::sort(s.errors_m.begin(), s.errors_m.end());
    if (s.errors_m.empty()) return fmt::format("| {} | {} | nothing returned |\n", name, s.rays);
    const std::string seconds = s.seconds == 0 ? std::string("– | – | –")
                                               : fmt::format("{} | {:.1f} % | {:.1f} %", s.seconds,
                                                             format_percent(s.found, s.seconds),
                                                             format_percent(s.invented, s.reported));
    return fmt::format("| {} | {} | {:.4f} m | {:.2f} m | {:.1f} % | {} |\n", name, s.rays,
                       s.errors_m[s.errors_m.size() / 2], std::sqrt(s.squares / double(s.errors_m.size())),
                       format_percent(s.drops_right, s.rays), seconds);
}

/// Casts rays into the exact synthetic street and returns their ranges. A beam with two
/// returns is cast as a cone of rays.
/// @param lateral_offset_m shift of the sensor to the left and upwards, metres
Returns cast_exact_returns(const SyntheticOptions& street, RayTable rays, const PoseTrack& track,
                           double time_s, const SensorChoice& sensor, float lateral_offset_m = 0.0f) {
    for (glm::vec3& origin : rays.origin) origin += lateral_offset_m * glm::vec3(0.0f, 1.0f, 1.0f);
    Scan scan = sensor.returns == 2 ? cast_synthetic_beams(street, rays, track, time_s)
                                    : cast_synthetic_street(street, rays, track, time_s);
    drop_outside_limits(scan, sensor.limits);
    return extract_returns(scan);
}

/// Renders the held-out sweeps with another sensor than the one in the log, and scores
/// them. The sensor replaces the first LiDAR.
void score_other_sensor(ScanRenderer& renderer, const Run& run, const SyntheticOptions& street,
                        const std::string& name) {
    const SensorChoice sensor = choose_sensor(name, run.config, run.sequence);
    if (sensor.rays.direction.empty())
        throw UsageError(
            fmt::format("{}: the rays change from scan to scan, expected a sensor with constant rays", name));
    const PoseTrack track = run.sequence.world_from_sensor(0);
    Score score;
    for (const int position : run.split.test) {
        const Frame& frame = run.sequence.frames[std::size_t(position)];
        if (frame.lidar != 0) continue;
        score_returns(score, extract_returns(renderer.render(sensor, frame.time_s)),
                      cast_exact_returns(street, sensor.rays, track, frame.time_s, sensor));
    }
    std::sort(score.errors_m.begin(), score.errors_m.end());
    if (score.errors_m.empty())
        throw DataError(fmt::format("{}: nothing returned, expected some returns", name));
    fmt::print("| {} | {} | {} | {:.1f} % | {:.1f} % | {:.4f} m | {:.2f} m | {:.1f} % |\n", name, score.rays,
               score.returns, format_percent(score.missed, score.returns),
               format_percent(score.behind, score.returns), score.errors_m[score.errors_m.size() / 2],
               std::sqrt(score.squares / double(score.errors_m.size())),
               format_percent(score.drops_right, score.rays));
}

void run(const std::string& folder, int device_index, float lateral_offset_m,
         const std::vector<std::string>& other_sensors) {
    Run run = load_run(folder);
    const SyntheticOptions street = read_street_options(run);
    const auto rig = find_rig(street.rig);
    if (!rig)
        throw UsageError(
            fmt::format("{}: its street was not logged by a rig, expected one with rig = FILE", folder));
    Device device(apply_environment_variables({.index = device_index}));
    ScanRenderer renderer(device, run.scene, run.config, run.sequence);
    std::vector<Score> scores(run.sequence.lidars.size()), beside(scores.size());
    for (const int position : run.split.test) {
        const Frame& frame = run.sequence.frames[std::size_t(position)];
        const Lidar& lidar = run.sequence.get_lidar(frame);
        const auto mounted = std::ranges::find(*rig, lidar.name, &MountedSensor::name);
        SensorChoice sensor = make_configured_sensor(run.config, run.sequence, frame.lidar);
        sensor.returns = mounted != rig->end() ? mounted->returns : 1;
        const RayTable rays = make_nominal_rays(lidar, frame.time_s);
        const PoseTrack track = run.sequence.world_from_sensor(frame.lidar);
        const Returns truth = cast_exact_returns(street, rays, track, frame.time_s, sensor);
        score_returns(scores[std::size_t(frame.lidar)],
                      extract_returns(renderer.render(sensor, frame.time_s)), truth);
        if (lateral_offset_m > 0.0f)
            score_returns(beside[std::size_t(frame.lidar)],
                          cast_exact_returns(street, rays, track, frame.time_s, sensor, lateral_offset_m),
                          truth);
    }
    fmt::print(
        "| LiDAR | rays | median range error | RMSE | drops right | second returns | found | of those "
        "reported, not there |\n"
        "|---|--:|--:|--:|--:|--:|--:|--:|\n");
    for (std::size_t l = 0; l < scores.size(); ++l) {
        const std::string& name = run.sequence.lidars[l].name;
        fmt::print("{}", format_score_row(name, scores[l]));
        const std::string from =
            fmt::format("{}, the street from {:g} cm to the left and above", name, 100.0f * lateral_offset_m);
        if (lateral_offset_m > 0.0f) fmt::print("{}", format_score_row(from, beside[l]));
    }
    if (!other_sensors.empty())
        fmt::print(
            "\n| instead of {} | rays | returns | missed | {} m behind and more | median range error | RMSE "
            "| drops right |\n"
            "|---|--:|--:|--:|--:|--:|--:|--:|\n",
            run.sequence.lidars[0].name, kOnSurface_m);
    for (const std::string& other : other_sensors) score_other_sensor(renderer, run, street, other);
}

}  // namespace

int main(int argc, char** argv) {
    std::string folder;
    int device = -1;
    float aside_m = 0.0f;
    std::vector<std::string> others;
    CLI::App app("held-out sweeps of each LiDAR of a rig against the synthetic street itself",
                 "relidar_bench_rig");
    app.add_option("RUN", folder, "run trained on a street.toml with rig = FILE")->required();
    app.add_option("--device", device, "as of `relidar render`");
    app.add_option("--aside", aside_m,
                   "also score the street itself, cast from this many metres to the left and above");
    app.add_option(
        "--sensor", others,
        "also score these in the place of the first LiDAR: names of `relidar list sensors`, or files");
    CLI11_PARSE(app, argc, argv);
    try {
        run(folder, device, aside_m, others);
    } catch (const Error& error) {
        fmt::print(stderr, "relidar_bench_rig: {}\n", error.what());
        return static_cast<int>(error.code());
    }
}
