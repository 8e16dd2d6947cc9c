// SPDX-License-Identifier: Apache-2.0
// relidar_bench_footprints measures the benefit of sub-rays and second returns on a
// trained synthetic street. As ground truth, it casts a cone of 64 exact rays per beam
// into the street and separates the returns of the beam. It compares only beams at edges.
// It reports the error of the first return and the share of first returns between two
// surfaces. It also reports the numbers of correct, missed and false second returns.
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

constexpr int kCone = 64;
constexpr double kGolden_rad = 2.399963229728653;
constexpr float kSeparation_m = 0.5f, kSecondShare = 0.1f;
// A point floats in the air if its range differs by more than this from the range of
// every surface in the beam.
constexpr float kOnSurface_m = 0.3f;

struct BeamReturn {
    float range_m = 0.0f, light = 0.0f;
};

/// Returns of one beam, sorted by range.
using BeamReturns = std::vector<BeamReturn>;

/// Replaces each ray by a dense cone of rays, which samples the footprint of the beam.
/// @param beam_divergence_rad divergence of all beams; if 0, each ray keeps its
/// divergence
RayTable replace_rays_by_ray_cones(const RayTable& rays, double beam_divergence_rad) {
    RayTable cone;
    cone.rows = rays.rows;
    cone.columns = rays.columns * kCone;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const glm::dvec3 d(rays.direction[i]),
            side = glm::normalize(
                glm::cross(d, std::abs(d.z) < 0.9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0)));
        for (int k = 0; k < kCone; ++k) {
            const double full_rad =
                beam_divergence_rad > 0.0 ? beam_divergence_rad : rays.get_beam_divergence_rad(i);
            const double angle = 0.5 * full_rad * std::sqrt((k + 0.5) / kCone);
            const glm::dvec3 off =
                std::cos(k * kGolden_rad) * side + std::sin(k * kGolden_rad) * glm::cross(d, side);
            cone.direction.emplace_back(std::cos(angle) * d + std::sin(angle) * off);
            cone.origin.push_back(rays.origin[i]);
            cone.time_offset_s.push_back(rays.time_offset_s[i]);
            cone.channel.push_back(rays.channel[i]);
        }
    }
    return cone;
}

/// Computes the returns of a beam from its cone of rays. After sorting by range,
/// neighbouring rays belong to the same return if their ranges differ by less than
/// kSeparation_m.
BeamReturns merge_cone_ranges_into_returns(const Scan& cone_scan, std::size_t beam_index) {
    std::vector<std::pair<float, float>> hits;
    for (std::size_t i = beam_index * kCone; i < (beam_index + 1) * kCone; ++i)
        if (cone_scan.range_m[i] > 0.0f)
            hits.emplace_back(cone_scan.range_m[i], std::max(cone_scan.intensity[i], 1e-3f));
    std::sort(hits.begin(), hits.end());
    BeamReturns returns;
    float last_m = -1e9f;
    for (const auto& [range_m, light] : hits) {
        if (range_m - last_m >= kSeparation_m) returns.push_back({});
        returns.back().range_m += range_m * light;
        returns.back().light += light;
        last_m = range_m;
    }
    for (BeamReturn& r : returns) r.range_m /= r.light;
    return returns;
}

struct TrueBeamReturns {
    BeamReturns returns;
    float first_m = 0.0f;   ///< Range of the first return. It is 0 if the beam is dropped.
    float second_m = 0.0f;  ///< Range of the second return. It is 0 if there is none.
    bool edge = false;      ///< True if two surfaces each receive at least a tenth of the beam's light.
};

TrueBeamReturns find_true_first_and_second_return(const Scan& cone_scan, std::size_t beam_index) {
    TrueBeamReturns truth{merge_cone_ranges_into_returns(cone_scan, beam_index)};
    std::size_t n = 0;
    for (std::size_t i = beam_index * kCone; i < (beam_index + 1) * kCone; ++i)
        n += cone_scan.range_m[i] > 0.0f;
    if (2 * n <= kCone) return truth;
    const auto strongest = std::ranges::max_element(truth.returns, {}, &BeamReturn::light);
    truth.first_m = strongest->range_m;
    BeamReturn second;
    if (strongest + 1 != truth.returns.end()) {
        second = truth.returns.back();
    } else {
        for (const BeamReturn& r : truth.returns)
            if (r.range_m != strongest->range_m && r.light > second.light) second = r;
    }
    if (second.light >= kSecondShare * strongest->light) truth.second_m = second.range_m;
    truth.edge = truth.second_m > 0.0f;
    return truth;
}

struct FootprintScore {
    std::size_t edges = 0, in_air = 0, second_returns = 0, detected = 0, reported = 0, invented = 0;
    double squares = 0.0, absolute = 0.0;
};

float compute_distance_to_nearest_return_m(const BeamReturns& returns, float range_m) {
    float best = 1e9f;
    for (const BeamReturn& r : returns) best = std::min(best, std::abs(r.range_m - range_m));
    return best;
}

void add_scan_to_footprint_score(FootprintScore& score, const RenderedScan& rendered_scan,
                                 const Scan& exact_cone_scan) {
    const std::vector<float>& range_m = rendered_scan.median_range_m;
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        const TrueBeamReturns truth = find_true_first_and_second_return(exact_cone_scan, i);
        const bool returns = is_ray_returned(rendered_scan.image.drop_prob[i], range_m[i]);
        const float second_m =
            rendered_scan.second_returns.empty() ? 0.0f : rendered_scan.second_returns[0].range_m[i];
        score.second_returns += truth.second_m > 0.0f;
        score.reported += second_m > 0.0f;
        score.detected += truth.second_m > 0.0f && second_m > 0.0f &&
                          compute_distance_to_nearest_return_m(truth.returns, second_m) < kOnSurface_m;
        score.invented += second_m > 0.0f &&
                          !(truth.returns.size() > 1 &&
                            compute_distance_to_nearest_return_m(truth.returns, second_m) < kOnSurface_m);
        if (!truth.edge || !returns) continue;
        const double error = double(range_m[i]) - double(truth.first_m);
        ++score.edges;
        score.squares += error * error;
        score.absolute += std::abs(error);
        score.in_air += compute_distance_to_nearest_return_m(truth.returns, range_m[i]) > kOnSurface_m;
    }
}

void print_footprint_scores(const std::string& run_folder, const std::string& sensor_name,
                            double divergence_mrad, int device_index) {
    TrainedRun run = load_run(run_folder);
    const SensorModel model = find_sensor(sensor_name);
    const RayTable rays = make_rays(model);
    const double divergence_rad = 1e-3 * divergence_mrad;
    const SyntheticOptions street = read_street_options_of_run(run);
    Device device(apply_environment_variables({.index = device_index}));
    std::vector<Scan> cones;
    for (const int position : run.split.test) {
        const double time_s = run.sequence.frames[std::size_t(position)].time_s;
        cones.push_back(cast_rays_into_synthetic_street(street,
                                                        replace_rays_by_ray_cones(rays, divergence_rad),
                                                        run.sequence.get_world_from_sensor(0), time_s));
        remove_returns_outside_limits(
            cones.back(), intersect_range_limits(model.limits, run.sequence.lidars[0].sensor.range_limits()));
    }
    fmt::print("{}: {} rays, divergence {:.2f} mrad, {} held-out frames of {}\n\n", model.name, rays.size(),
               divergence_rad > 0.0 ? divergence_mrad : 1e3 * rays.find_max_divergence_rad(), cones.size(),
               run_folder);
    fmt::print(
        "| sub-rays | edge beams | RMSE | MAE | in the air | second returns | reported correctly | reported "
        "but wrong "
        "|\n|--:|--:|--:|--:|--:|--:|--:|--:|\n");
    for (const int n : {1, 5, 9}) {
        run.config.sensor.sub_rays = n;
        run.config.sensor.returns = n > 1 ? 2 : 1;
        run.config.sensor.divergence_mrad = 1e3 * divergence_rad;
        ScanRenderer renderer(device, run);
        FootprintScore score;
        for (std::size_t f = 0; f < cones.size(); ++f) {
            SimulatedSensor choice = make_simulated_sensor(model);
            choice.limits =
                intersect_range_limits(model.limits, run.sequence.lidars[0].sensor.range_limits());
            add_scan_to_footprint_score(
                score, renderer.render(choice, run.sequence.frames[std::size_t(run.split.test[f])].time_s),
                cones[f]);
        }
        const auto share = [](std::size_t part, std::size_t whole) {
            return whole ? 100.0 * double(part) / double(whole) : 0.0;
        };
        const double edges = double(std::max<std::size_t>(score.edges, 1));
        fmt::print("| {} | {} | {:.3f} m | {:.3f} m | {:.1f} % | {} | {:.1f} % | {:.1f} % |\n", n,
                   score.edges, std::sqrt(score.squares / edges), score.absolute / edges,
                   share(score.in_air, score.edges), score.second_returns,
                   share(score.detected, score.second_returns), share(score.invented, score.reported));
    }
}

}  // namespace

int main(int argc, char** argv) {
    std::string folder, sensor = "OS1-64";
    double divergence_mrad = 0.0;
    int device = -1;
    CLI::App app(
        "compares sub-rays and second returns with rays cast into the synthetic street with the same "
        "divergence",
        "relidar_bench_footprints");
    app.add_option("RUN", folder,
                   "run trained on a synthetic street, such as DIR/run of `relidar demo --out DIR`")
        ->required();
    app.add_option("--sensor", sensor, "as of `relidar render`");
    app.add_option("--divergence", divergence_mrad,
                   "full beam divergence in milliradians (default: the value of the sensor)");
    app.add_option("--device", device, "as of `relidar render`");
    CLI11_PARSE(app, argc, argv);
    try {
        print_footprint_scores(folder, sensor, divergence_mrad, device);
    } catch (const Error& error) {
        fmt::print(stderr, "relidar_bench_footprints: {}\n", error.what());
        return static_cast<int>(error.code());
    }
}
