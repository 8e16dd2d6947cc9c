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

struct Return {
    float range_m = 0.0f, light = 0.0f;
};

/// Returns of one beam, sorted by range.
using Returns = std::vector<Return>;

/// Replaces each ray by a dense cone of rays, which samples the footprint of the beam.
/// @param divergence_rad divergence of all beams; if 0, each ray keeps its divergence
RayTable make_cone_rays(const RayTable& rays, double divergence_rad) {
    RayTable cone;
    cone.rows = rays.rows;
    cone.columns = rays.columns * kCone;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const glm::dvec3 d(rays.direction[i]),
            side = glm::normalize(
                glm::cross(d, std::abs(d.z) < 0.9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0)));
        for (int k = 0; k < kCone; ++k) {
            const double full_rad = divergence_rad > 0.0 ? divergence_rad : rays.compute_divergence(i);
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
Returns list_ray_returns(const Scan& cone, std::size_t ray) {
    std::vector<std::pair<float, float>> hits;
    for (std::size_t i = ray * kCone; i < (ray + 1) * kCone; ++i)
        if (cone.range_m[i] > 0.0f) hits.emplace_back(cone.range_m[i], std::max(cone.intensity[i], 1e-3f));
    std::sort(hits.begin(), hits.end());
    Returns returns;
    float last_m = -1e9f;
    for (const auto& [range_m, light] : hits) {
        if (range_m - last_m >= kSeparation_m) returns.push_back({});
        returns.back().range_m += range_m * light;
        returns.back().light += light;
        last_m = range_m;
    }
    for (Return& r : returns) r.range_m /= r.light;
    return returns;
}

struct Truth {
    Returns returns;
    float first_m = 0.0f;   ///< Range of the first return. It is 0 if the beam is dropped.
    float second_m = 0.0f;  ///< Range of the second return. It is 0 if there is none.
    bool edge = false;      ///< True if two surfaces each receive at least a tenth of the beam's light.
};

Truth find_true_returns(const Scan& cone, std::size_t ray) {
    Truth truth{list_ray_returns(cone, ray)};
    std::size_t n = 0;
    for (std::size_t i = ray * kCone; i < (ray + 1) * kCone; ++i) n += cone.range_m[i] > 0.0f;
    if (2 * n <= kCone) return truth;
    const auto strongest = std::ranges::max_element(truth.returns, {}, &Return::light);
    truth.first_m = strongest->range_m;
    Return second;
    if (strongest + 1 != truth.returns.end()) {
        second = truth.returns.back();
    } else {
        for (const Return& r : truth.returns)
            if (r.range_m != strongest->range_m && r.light > second.light) second = r;
    }
    if (second.light >= kSecondShare * strongest->light) truth.second_m = second.range_m;
    truth.edge = truth.second_m > 0.0f;
    return truth;
}

struct Score {
    std::size_t edges = 0, in_air = 0, seconds = 0, found = 0, reported = 0, invented = 0;
    double squares = 0.0, absolute = 0.0;
};

float nearest_m(const Returns& returns, float range_m) {
    float best = 1e9f;
    for (const Return& r : returns) best = std::min(best, std::abs(r.range_m - range_m));
    return best;
}

void score_returns(Score& score, const RenderedScan& scan, const Scan& cone) {
    const std::vector<float>& range_m = scan.median_range_m;
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        const Truth truth = find_true_returns(cone, i);
        const bool returns = is_returned(scan.image.drop_prob[i], range_m[i]);
        const float second_m = scan.second_returns.empty() ? 0.0f : scan.second_returns[0].range_m[i];
        score.seconds += truth.second_m > 0.0f;
        score.reported += second_m > 0.0f;
        score.found +=
            truth.second_m > 0.0f && second_m > 0.0f && nearest_m(truth.returns, second_m) < kOnSurface_m;
        score.invented += second_m > 0.0f &&
                          !(truth.returns.size() > 1 && nearest_m(truth.returns, second_m) < kOnSurface_m);
        if (!truth.edge || !returns) continue;
        const double error = double(range_m[i]) - double(truth.first_m);
        ++score.edges;
        score.squares += error * error;
        score.absolute += std::abs(error);
        score.in_air += nearest_m(truth.returns, range_m[i]) > kOnSurface_m;
    }
}

void run(const std::string& folder, const std::string& sensor_name, double divergence_mrad,
         int device_index) {
    Run run = load_run(folder);
    const SensorModel model = find_sensor(sensor_name);
    const RayTable rays = make_rays(model);
    const double divergence_rad = 1e-3 * divergence_mrad;
    const SyntheticOptions street = read_street_options(run);
    Device device(apply_environment_variables({.index = device_index}));
    std::vector<Scan> cones;
    for (const int position : run.split.test) {
        const double time_s = run.sequence.frames[std::size_t(position)].time_s;
        cones.push_back(cast_synthetic_street(street, make_cone_rays(rays, divergence_rad),
                                              run.sequence.world_from_sensor(0), time_s));
        drop_outside_limits(cones.back(),
                            intersect_limits(model.limits, run.sequence.lidars[0].sensor.range_limits()));
    }
    fmt::print("{}: {} rays, divergence {:.2f} mrad, {} held-out frames of {}\n\n", model.name, rays.size(),
               divergence_rad > 0.0 ? divergence_mrad : 1e3 * rays.find_largest_divergence(), cones.size(),
               folder);
    fmt::print(
        "| sub-rays | edge beams | RMSE | MAE | in the air | second returns | found | invented, of reported "
        "|\n|--:|--:|--:|--:|--:|--:|--:|--:|\n");
    for (const int n : {1, 5, 9}) {
        run.config.sensor.sub_rays = n;
        run.config.sensor.returns = n > 1 ? 2 : 1;
        run.config.sensor.divergence_mrad = 1e3 * divergence_rad;
        ScanRenderer renderer(device, run);
        Score score;
        for (std::size_t f = 0; f < cones.size(); ++f) {
            SensorChoice choice = make_sensor_choice(model);
            choice.limits = intersect_limits(model.limits, run.sequence.lidars[0].sensor.range_limits());
            score_returns(score,
                          renderer.render(choice, run.sequence.frames[std::size_t(run.split.test[f])].time_s),
                          cones[f]);
        }
        const auto share = [](std::size_t part, std::size_t whole) {
            return whole ? 100.0 * double(part) / double(whole) : 0.0;
        };
        const double edges = double(std::max<std::size_t>(score.edges, 1));
        fmt::print("| {} | {} | {:.3f} m | {:.3f} m | {:.1f} % | {} | {:.1f} % | {:.1f} % |\n", n,
                   score.edges, std::sqrt(score.squares / edges), score.absolute / edges,
                   share(score.in_air, score.edges), score.seconds, share(score.found, score.seconds),
                   share(score.invented, score.reported));
    }
}

}  // namespace

int main(int argc, char** argv) {
    std::string folder, sensor = "OS1-64";
    double divergence_mrad = 0.0;
    int device = -1;
    CLI::App app("sub-rays and second returns against a synthetic street cast with the same divergence",
                 "relidar_bench_footprints");
    app.add_option("RUN", folder,
                   "run trained on a synthetic street, such as DIR/run of `relidar demo --out DIR`")
        ->required();
    app.add_option("--sensor", sensor, "as of `relidar render`");
    app.add_option("--divergence", divergence_mrad,
                   "full beam divergence, milliradians (default: the sensor's own)");
    app.add_option("--device", device, "as of `relidar render`");
    CLI11_PARSE(app, argc, argv);
    try {
        run(folder, sensor, divergence_mrad, device);
    } catch (const Error& error) {
        fmt::print(stderr, "relidar_bench_footprints: {}\n", error.what());
        return static_cast<int>(error.code());
    }
}
