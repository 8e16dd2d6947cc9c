// SPDX-License-Identifier: Apache-2.0
// relidar_bench_air counts the points of a trained synthetic street that float in the
// air. It tests the recorded and shifted poses of the sensor. A point is on a surface if
// the exact street has any surface within 5 cm of the point.
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "street_of.hpp"

namespace {

using namespace relidar;

constexpr float kOnSurface_m = 0.05f, kFar_m = 0.3f;
// Number of test rays that start at a point in all directions. They are dense enough that
// one of them is within 7 degrees of the normal of any surface.
constexpr std::size_t kProbes = 256;
constexpr std::size_t kTogether = 4096;  // Number of points whose test rays are cast together.

/// Returns directions that are evenly distributed on the sphere (Fibonacci spiral).
std::array<glm::vec3, kProbes> make_directions_all_around() {
    std::array<glm::vec3, kProbes> directions;
    for (std::size_t i = 0; i < kProbes; ++i) {
        const double z = 1.0 - 2.0 * (double(i) + 0.5) / double(kProbes),
                     turn = double(i) * kPi * (3.0 - std::sqrt(5.0));
        const double r = std::sqrt(1.0 - z * z);
        directions[i] = {float(r * std::cos(turn)), float(r * std::sin(turn)), float(z)};
    }
    return directions;
}

/// Exact synthetic street, path of the sensor, and time of a scan.
struct Place {
    const SyntheticOptions& street;
    const PoseTrack& world_from_sensor;
    double time_s;
};

/// Simulated rays and their ranges, and the exact ranges of the street along the same
/// rays.
struct RayEnds {
    const RayTable& rays;
    const std::vector<float>& range_m;
    const Scan& truth;

    glm::vec3 at(std::size_t index, float range) const {
        return rays.origin[index] + range * rays.direction[index];
    }
};

/// Returns the distance of each point to the nearest surface of the street at the firing
/// time of its ray. Returns infinity if no test ray hits a surface. Surfaces of the
/// street are one-sided, and a point may be some millimetres behind a surface. Therefore
/// test rays are cast from the point in all directions, and also back to the point from
/// all directions. The rays back to the point start at two distances: kOnSurface_m and
/// kFar_m.
std::vector<float> measure_distances(const Place& place, const RayEnds& points,
                                     const std::vector<std::size_t>& chosen) {
    static const std::array<glm::vec3, kProbes> directions = make_directions_all_around();
    std::vector<float> nearest(chosen.size(), std::numeric_limits<float>::infinity());
    for (std::size_t first = 0; first < chosen.size(); first += kTogether) {
        RayTable probes;
        std::vector<std::size_t> probe_targets;  // [probes] index into `chosen`
        for (std::size_t k = first; k < std::min(first + kTogether, chosen.size()); ++k) {
            const std::size_t i = chosen[k];
            const glm::vec3 point = points.at(i, points.range_m[i]);
            for (const float from_m : {0.0f, kOnSurface_m, kFar_m}) {
                for (const glm::vec3& direction : directions) {
                    probes.origin.push_back(point + from_m * direction);
                    probes.direction.push_back(from_m > 0.0f ? -direction : direction);
                    probes.time_offset_s.push_back(points.rays.time_offset_s[i]);
                    probes.channel.push_back(points.rays.channel[i]);
                    probe_targets.push_back(k);
                }
            }
        }
        probes.rows = 1;
        probes.columns = static_cast<int>(probe_targets.size());
        const Scan around =
            cast_synthetic_street(place.street, probes, place.world_from_sensor, place.time_s);
        for (std::size_t j = 0; j < probe_targets.size(); ++j) {
            const std::size_t i = chosen[probe_targets[j]];
            if (around.range_m[j] > 0.0f)
                nearest[probe_targets[j]] =
                    std::min(nearest[probe_targets[j]],
                             glm::distance(around.point(j), points.at(i, points.range_m[i])));
        }
    }
    return nearest;
}

struct Count {
    std::size_t points = 0, in_air = 0, far_out = 0, at_another_range = 0;

    /// Counts the points of a scan, and how many of them float in empty space.
    /// @param ends  simulated and true ranges of the rays
    /// @param scan  the same scan; its drop probabilities select the rays with a return
    void add(const Place& place, const RayEnds& ends, const RenderedScan& scan) {
        const std::vector<float>& range_m = ends.range_m;
        std::vector<std::size_t> doubtful;
        for (std::size_t i = 0; i < range_m.size(); ++i) {
            if (!is_returned(scan.image.drop_prob[i], range_m[i])) continue;
            ++points;
            if (std::abs(range_m[i] - ends.truth.range_m[i]) > kOnSurface_m) doubtful.push_back(i);
        }
        at_another_range += doubtful.size();
        for (const float d : measure_distances(place, ends, doubtful)) {
            in_air += d > kOnSurface_m;
            far_out += d > kFar_m;
        }
    }
    std::string row(const std::string& name) const {
        const auto share = [&](std::size_t count) {
            return 100.0 * double(count) / double(std::max<std::size_t>(points, 1));
        };
        return fmt::format("| {} | {} | {:.2f} % | **{:.2f} %** | {:.2f} % |\n", name, points,
                           share(at_another_range), share(in_air), share(far_out));
    }
};

void run(const std::string& folder, int device_index) {
    const Run run = load_run(folder);
    const SyntheticOptions street = read_street_options(run);
    Device device(apply_environment_variables({.index = device_index}));
    ScanRenderer renderer(device, run);
    fmt::print(
        "| sensor | points | other range than the street's by 5 cm | in the air by 5 cm | by 30 cm "
        "|\n|---|--:|--:|--:|--:|\n");
    const std::vector<std::pair<std::string, glm::dvec3>> offsets{{"where it was", {0, 0, 0}},
                                                                  {"1 m to the left", {0, 1, 0}},
                                                                  {"2 m to the left", {0, 2, 0}},
                                                                  {"2 m left, 1 m up", {0, 2, 1}}};
    for (const auto& [name, offset_m] : offsets) {
        Count points, image;
        for (const int position : run.split.test) {
            const Frame& frame = run.sequence.frames[std::size_t(position)];
            const SensorChoice sensor = make_configured_sensor(run.config, run.sequence, frame.lidar);
            const RayTable rays = make_nominal_rays(run.sequence.get_lidar(frame), frame.time_s);
            const Pose offset{{1, 0, 0, 0}, offset_m};
            const PoseTrack track = mount_on_track(run.sequence.world_from_sensor(frame.lidar), offset);
            const RenderedScan scan = renderer.render(sensor, frame.time_s, offset);
            const Place place{street, track, frame.time_s};
            const Scan truth = cast_synthetic_street(street, rays, track, frame.time_s);
            points.add(place, {rays, scan.median_range_m, truth}, scan);
            image.add(place, {rays, scan.image.range_m, truth}, scan);
        }
        fmt::print("{}{}", points.row(name + ", points"), image.row(name + ", image"));
    }
}

}  // namespace

int main(int argc, char** argv) {
    std::string folder;
    int device = -1;
    CLI::App app(
        "points in the air of a trained synthetic street, from where its sensor was and from beside there",
        "relidar_bench_air");
    app.add_option("RUN", folder, "run trained on a folder with street.toml")->required();
    app.add_option("--device", device, "as of `relidar render`");
    CLI11_PARSE(app, argc, argv);
    try {
        run(folder, device);
    } catch (const Error& error) {
        fmt::print(stderr, "relidar_bench_air: {}\n", error.what());
        return static_cast<int>(error.code());
    }
}
