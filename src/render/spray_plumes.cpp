// SPDX-License-Identifier: Apache-2.0
#include "render/spray_plumes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/parallel.hpp"
#include "render/level_ground.hpp"

namespace relidar {
namespace {

constexpr double kTyres = 0.2;            // width of both tracks over that of a vehicle
constexpr double kNarrow_m = 1.2;         // narrower things are cyclists and people, which throw hardly any water up
constexpr double kMostShare = 0.1;        // of the water, as drops that hang
constexpr double kFast_m_s = 30.0;
constexpr double kDrop_m = 1e-4;          // mean diameter
constexpr double kFalls_s = 0.8;          // drops of 0.3 mm, a metre
constexpr double kLength = 3.0;           // times the reach: a twentieth is left
constexpr double kWalks_m_s = 2.0;        // slower things throw nothing up
constexpr double kOwnWidth_m = 1.8, kOwnHeight_m = 1.5, kOwnRear_m = 2.5, kGroundWithin_m = 15.0;

/// Cuts [from, to] to where low <= at + t step <= high.
void cut(double& from, double& to, double at, double step, double low, double high) {
    if (std::abs(step) < 1e-12) {
        if (at < low || at > high) to = from;
        return;
    }
    const double a = (low - at) / step, b = (high - at) / step;
    from = std::max(from, std::min(a, b)), to = std::min(to, std::max(a, b));
}

}  // namespace

std::optional<SprayStretch> Plume::along(const glm::dvec3& origin_m, const glm::dvec3& direction) const {
    const glm::dvec3 left(-ahead.y, ahead.x, 0.0), away_m = origin_m - rear_m;
    const double behind_m = -glm::dot(away_m, ahead), recedes = -glm::dot(direction, ahead);
    double from_m = 0.0, to_m = std::numeric_limits<double>::max();
    cut(from_m, to_m, behind_m, recedes, 0.0, length_m);
    cut(from_m, to_m, glm::dot(away_m, left), glm::dot(direction, left), -0.5 * width_m, 0.5 * width_m);
    cut(from_m, to_m, away_m.z, direction.z, 0.0, height_m);
    if (!(from_m < to_m)) return {};
    return SprayStretch{from_m, to_m, alpha * std::exp(-(behind_m + from_m * recedes) / reach_m), recedes / reach_m};
}

Plume plume_behind(const glm::dvec3& rear_m, const glm::dvec3& velocity, double width_m, double height_m, double film_mm) {
    const double speed = std::hypot(velocity.x, velocity.y), share = kMostShare * std::min(1.0, std::pow(speed / kFast_m_s, 2));
    const double alpha = share * kTyres * 1e-3 * film_mm / (height_m * kDrop_m), reach_m = kFalls_s * speed;
    return {rear_m, {velocity.x / speed, velocity.y / speed, 0.0}, width_m, height_m, kLength * reach_m, alpha, reach_m};
}

std::vector<Plume> plumes_of(const Scene& layout, const std::vector<InstancePose>& placed, const std::vector<InstancePose>& before,
                             const std::vector<bool>& shown, const glm::dvec3& world_offset_m, double film_mm) {
    std::vector<Plume> plumes;
    for (std::size_t i = 1; i < placed.size(); ++i) {   // 0 is the background
        const double passed_s = placed[i].time_s - before[i].time_s;
        if (!shown[i] || !placed[i].present || !before[i].present || !(passed_s > 0.0)) continue;
        const Pose& now = placed[i].world_from_model;
        const glm::dvec3 velocity = (now.translation - before[i].world_from_model.translation) / passed_s;
        if (std::hypot(velocity.x, velocity.y) < kWalks_m_s) continue;
        const glm::dvec3 half_m(layout.models[layout.instances[i].model].half_size_m), ahead = now.rotation * glm::dvec3(1.0, 0.0, 0.0);
        if (2.0 * half_m.y < kNarrow_m) continue;
        const double backwards = glm::dot(ahead, velocity) < 0.0 ? -1.0 : 1.0;
        const glm::dvec3 rear_m = now * glm::dvec3(-backwards * half_m.x, 0.0, -half_m.z);
        plumes.push_back(plume_behind(rear_m + world_offset_m, velocity, 2.0 * half_m.y, 2.0 * half_m.z, film_mm));
    }
    return plumes;
}

std::optional<Plume> own_plume(const RenderedScan& scan, const glm::dvec3& velocity, double film_mm) {
    if (std::hypot(velocity.x, velocity.y) < kWalks_m_s) return {};
    const std::vector<glm::dvec3> up = level_ground(scan);
    std::vector<double> height_m;
    FiringPoses firing(scan);
    for (std::size_t i = 0; i < up.size(); ++i)
        if (up[i].z > 0.0 && scan.median_range_m[i] < kGroundWithin_m) {
            const glm::dvec3 point(scan.image.origin[i] + scan.median_range_m[i] * scan.image.direction[i]);
            height_m.push_back((firing.at(i) * point).z);
        }
    if (height_m.empty()) return {};
    const auto middle = height_m.begin() + std::ptrdiff_t(height_m.size() / 2);
    std::ranges::nth_element(height_m, middle);
    Plume plume = plume_behind({}, velocity, kOwnWidth_m, kOwnHeight_m, film_mm);
    plume.rear_m = scan.world_from_sensor.translation - kOwnRear_m * plume.ahead;
    plume.rear_m.z = *middle;
    return plume;
}

std::vector<std::vector<SprayStretch>> spray_along(const RenderedScan& scan, const std::vector<Plume>& plumes) {
    std::vector<std::vector<SprayStretch>> spray(scan.image.direction.size());
    for_each_block(spray.size(), [&](std::size_t ray) {
        const Pose pose = scan.world_from_firing(ray);
        const glm::dvec3 origin_m = pose * glm::dvec3(scan.image.origin[ray]);
        const glm::dvec3 direction = pose.rotation * glm::dvec3(scan.image.direction[ray]);
        for (const Plume& plume : plumes)
            if (const auto stretch = plume.along(origin_m, direction)) spray[ray].push_back(*stretch);
    });
    return spray;
}

}  // namespace relidar
