// SPDX-License-Identifier: Apache-2.0
// relidar_bench_air counts the points of a trained synthetic street that float in the
// air. It tests the recorded and shifted poses of the sensor. A point is on a surface if
// the exact street has any surface within 5 cm of the point.
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "street_of.hpp"

namespace {

using namespace relidar;

constexpr float kOnSurface_m = 0.05f, kFar_m = 0.3f;  // limits of the distances that are counted
// Number of test rays that start at a point in all directions. They are dense enough that
// one of them is within 7 degrees of the normal of any surface.
constexpr std::size_t kRaysPerPoint = 256;
constexpr std::size_t kPointsPerCast = 4096;  // Number of points whose test rays are cast together.

/// Returns directions that are evenly distributed on the sphere (Fibonacci spiral).
std::array<glm::vec3, kRaysPerPoint> sphere_directions() {
    std::array<glm::vec3, kRaysPerPoint> directions;
    for (std::size_t i = 0; i < kRaysPerPoint; ++i) {
        // Equal steps of the height z cut the sphere into zones of equal area.
        const double z = 1.0 - 2.0 * (double(i) + 0.5) / double(kRaysPerPoint);
        // The azimuth advances by the golden angle.
        const double azimuth_rad = double(i) * kPi * (3.0 - std::sqrt(5.0)), radius = std::sqrt(1.0 - z * z);
        directions[i] = {float(radius * std::cos(azimuth_rad)), float(radius * std::sin(azimuth_rad)),
                         float(z)};
    }
    return directions;
}

/// What a scan of the exact street needs, in addition to its rays.
struct StreetScanSetup {
    const StreetOptions& street;
    const PoseTrack& world_from_sensor;
    double time_s;

    Scan cast_rays(const RayTable& rays) const {
        return cast_street_rays(street, rays, world_from_sensor, time_s);
    }
};

/// Rays of a simulated scan with their ranges. `truth` has the exact ranges of the
/// synthetic street along the same rays.
struct SimulatedRayRanges {
    const RayTable& rays;
    const std::vector<float>& range_m;
    const Scan& truth;

    glm::vec3 point_on_ray(std::size_t ray, float distance_m) const {
        return rays.origin[ray] + distance_m * rays.direction[ray];
    }
};

/// Adds test rays ("probes") for the point of a simulated ray: from the point in all
/// directions, and back to it from kOnSurface_m and kFar_m. They fire at the time of this
/// ray, because cars of the street move.
void add_probes(RayTable& probes, const SimulatedRayRanges& simulated, std::size_t ray) {
    static const std::array<glm::vec3, kRaysPerPoint> directions = sphere_directions();
    const glm::vec3 point_m = simulated.point_on_ray(ray, simulated.range_m[ray]);
    for (const float distance_m : {0.0f, kOnSurface_m, kFar_m})
        for (const glm::vec3& direction : directions) {
            probes.origin.push_back(point_m + distance_m * direction);
            probes.direction.push_back(distance_m > 0.0f ? -direction : direction);
            probes.time_offset_s.push_back(simulated.rays.time_offset_s[ray]);
            probes.channel.push_back(simulated.rays.channel[ray]);
        }
}

/// Returns the distance of each point to the nearest surface of the street at the firing
/// time of its ray, or infinity. The surface is where a test ray ends. Surfaces are
/// one-sided, and a point may be some millimetres behind a surface, so test rays go from
/// the point and towards it.
std::vector<float> street_distances(const StreetScanSetup& setup, const SimulatedRayRanges& simulated,
                                    const std::vector<std::size_t>& ray_indices) {
    std::vector<float> nearest_m(ray_indices.size(), std::numeric_limits<float>::infinity());
    for (std::size_t first = 0; first < ray_indices.size(); first += kPointsPerCast) {
        RayTable probes;
        std::vector<std::size_t> point_of_probe;  // index into `ray_indices`
        for (std::size_t k = first; k < std::min(first + kPointsPerCast, ray_indices.size()); ++k) {
            add_probes(probes, simulated, ray_indices[k]);
            point_of_probe.resize(probes.size(), k);  // The new probes belong to point k.
        }
        probes.rows = 1;
        probes.columns = int(probes.size());
        const Scan around = setup.cast_rays(probes);
        for (std::size_t probe = 0; probe < probes.size(); ++probe) {
            if (!(around.range_m[probe] > 0.0f)) continue;
            const std::size_t k = point_of_probe[probe], ray = ray_indices[k];
            const glm::vec3 point_m = simulated.point_on_ray(ray, simulated.range_m[ray]);
            nearest_m[k] = std::min(nearest_m[k], glm::distance(around.return_point(probe), point_m));
        }
    }
    return nearest_m;
}

/// Numbers of points: all, more than 5 cm from any surface, more than 30 cm from any
/// surface, and with a range error above 5 cm.
struct AirPointCounts {
    std::size_t points = 0, in_air = 0, far_out = 0, at_another_range = 0;

    /// Counts the points of a scan, and how many of them float in empty space. Only
    /// points with a range error are compared with the street, because this is slow.
    void add_points(const StreetScanSetup& setup, const SimulatedRayRanges& simulated,
                    const RenderedScan& rendered_scan) {
        const std::vector<float>& range_m = simulated.range_m;
        std::vector<std::size_t> doubtful;
        for (std::size_t i = 0; i < range_m.size(); ++i) {
            if (!is_ray_returned(rendered_scan.image.drop_prob[i], range_m[i])) continue;
            ++points;
            if (std::abs(range_m[i] - simulated.truth.range_m[i]) > kOnSurface_m) doubtful.push_back(i);
        }
        at_another_range += doubtful.size();
        for (const float d : street_distances(setup, simulated, doubtful)) {
            in_air += d > kOnSurface_m;
            far_out += d > kFar_m;
        }
    }
    std::string format_row(const std::string& scan_name) const {
        const auto share = [&](std::size_t count) {
            return 100.0 * double(count) / double(std::max<std::size_t>(points, 1));
        };
        return fmt::format("| {} | {} | {:.2f} % | **{:.2f} %** | {:.2f} % |\n", scan_name, points,
                           share(at_another_range), share(in_air), share(far_out));
    }
};

/// Prints, for each shift of the sensor, the shares of points that float in the air, away
/// from all surfaces of the street. Counts the points that are written to files (median
/// ranges) and those of the range image (mean ranges) apart.
void print_air_table(const std::string& run_folder) {
    const Run run = load_run(run_folder);
    const StreetOptions street = read_street(run);
    Device device(apply_environment({}));
    ScanRenderer renderer(device, run);
    fmt::print(
        "| sensor | points | range error above 5 cm | more than 5 cm in the air | more than 30 cm in the air "
        "|\n|---|--:|--:|--:|--:|\n");
    const std::vector<std::pair<std::string, glm::dvec3>> offsets{{"original position", {0, 0, 0}},
                                                                  {"1 m to the left", {0, 1, 0}},
                                                                  {"2 m to the left", {0, 2, 0}},
                                                                  {"2 m left, 1 m up", {0, 2, 1}}};
    for (const auto& [name, offset_m] : offsets) {
        const Pose offset{{1, 0, 0, 0}, offset_m};
        AirPointCounts file_points, image_points;
        for (const int position : run.split.test) {
            const Frame& frame = run.log.frames[std::size_t(position)];
            const SimulatedSensor sensor = make_sensor(run.config, run.log, frame.lidar);
            const RayTable rays = make_lidar_rays(run.log.lidar_of(frame), frame.time_s);
            const PoseTrack track = mount_track(run.log.lidar_track(frame.lidar), offset);
            const StreetScanSetup setup{street, track, frame.time_s};
            const Scan truth = setup.cast_rays(rays);
            const RenderedScan scan = renderer.render(sensor, frame.time_s, offset);
            file_points.add_points(setup, {rays, scan.median_range_m, truth}, scan);
            image_points.add_points(setup, {rays, scan.image.range_m, truth}, scan);
        }
        fmt::print("{}{}", file_points.format_row(name + ", points"),
                   image_points.format_row(name + ", image"));
    }
}

}  // namespace

int main(int argc, char** argv) { return relidar::run_on_argument(argc, argv, print_air_table); }
