// SPDX-License-Identifier: Apache-2.0
// Finds the place of a recording on the earth from the positions of an antenna.
#include "read/bag/choose.hpp"

#include <algorithm>
#include <cmath>

#include "base/fail.hpp"

namespace relidar::bag {
namespace {

// The heading is uncertain if the antenna stays this close to its mean position.
constexpr double kMinSpread_m = 2.0;
constexpr double kMaxResidualShare = 0.2;  // of the spread

}  // namespace

FoundPlace find_place(const FixTopic& fixes, const ChosenPoses& poses, const FrameTree& frames) {
    if (!has_proj())
        return {{}, "positions on the earth are not read, because relidar was built without PROJ"};
    const Georeference plane{
        fixes.samples.front().position, {}, local_tangent_crs(fixes.samples.front().position)};
    const GeoConverter earth(plane);
    const Pose antenna = frames.find_constant(poses.vehicle, fixes.frame).value_or(Pose{});
    std::vector<glm::dvec3> world_m, plane_m;
    glm::dvec3 world_mean_m(0.0), plane_mean_m(0.0);
    for (const FixTopic::Sample& fix : fixes.samples) {
        const double t_s = 1e-9 * double(fix.time_ns(poses.clock) - poses.poses_zero_ns);
        if (!poses.path->covers_time(t_s)) continue;
        world_m.push_back(poses.path->compute_pose_at(t_s) * antenna.translation);
        plane_m.push_back(earth.to_dataset(fix.position));
        world_mean_m += world_m.back();
        plane_mean_m += plane_m.back();
    }
    const double n = std::max(1.0, double(world_m.size()));
    world_mean_m /= n;
    plane_mean_m /= n;
    // Least squares for a rotation about the vertical axis.
    double cross = 0.0, dot = 0.0, spread = 0.0, residual = 0.0;
    for (std::size_t i = 0; i < world_m.size(); ++i) {
        const glm::dvec2 w(world_m[i] - world_mean_m), p(plane_m[i] - plane_mean_m);
        cross += w.x * p.y - w.y * p.x;
        dot += glm::dot(w, p);
        spread += glm::dot(w, w);
    }
    const glm::dquat rotation = glm::angleAxis(std::atan2(cross, dot), glm::dvec3(0.0, 0.0, 1.0));
    for (std::size_t i = 0; i < world_m.size(); ++i) {
        const glm::dvec2 error(plane_m[i] - plane_mean_m - rotation * (world_m[i] - world_mean_m));
        residual += glm::dot(error, error);
    }
    const double spread_m = std::sqrt(spread / n), residual_m = std::sqrt(residual / n);
    if (!(spread_m >= kMinSpread_m && residual_m <= kMaxResidualShare * spread_m))
        return {{},
                fmt::format("the place on the earth is unknown: {} positions extend over {:.2f} m and are "
                            "{:.2f} m from the path",
                            world_m.size(), spread_m, residual_m)};
    return {Georeference{earth.to_geodetic(plane_mean_m), world_mean_m, plane.crs, rotation},
            fmt::format("the place on the earth is that of {} positions, which are {:.2f} m from the path",
                        world_m.size(), residual_m)};
}

}  // namespace relidar::bag
