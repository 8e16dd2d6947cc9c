// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/body_rays.hpp"

#include <relidar/log/classes.hpp>
#include "base/parallel.hpp"

namespace relidar {
namespace {

// Assumption: dark paint, as most returns from the own vehicle have a low intensity.
constexpr float kBodyIntensity = 0.1f;

/// Sets an optional channel of a ray that hits the vehicle's own body.
/// @param is_kept true if the sensor reports such returns
template <class T>
void fill_value(const ChannelInfo& channel, std::vector<T>& values, std::size_t ray, const BodyHit& hit,
                const glm::vec3& direction, bool is_kept) {
    if constexpr (std::is_same_v<T, glm::vec3>) {
        // Vector channels are 0 on the body, except the normal.
        values[ray] = channel.name == "normal" ? glm::vec3(hit.normal) : glm::vec3(0.0f);
    } else {
        // Channels that the body does not define get the value for unknown.
        values[ray] = T(channel.none);
        if (channel.name == "incidence") values[ray] = T(-glm::dot(glm::vec3(hit.normal), direction));
        if (channel.name == "class") values[ray] = T(SurfaceClass::ego);
        if (channel.name == "surfel_drop_prob") values[ray] = is_kept ? T(0) : T(1);
        if (channel.name == "source" && is_kept) values[ray] = T(0);  // ReturnCause::surface
    }
}

}  // namespace

void block_rays(RenderedScan& scan, const VehicleBody& body, const RangeLimits& limits) {
    if (body.boxes.empty()) return;
    parallel_blocks(scan.image.range_m.size(), [&](std::size_t i) {
        const glm::vec3& direction = scan.image.direction[i];
        const std::optional<BodyHit> hit =
            find_body_hit(body.boxes, glm::dvec3(scan.image.origin[i]), glm::dvec3(direction));
        if (!hit) return;
        const float range_m = float(hit->range_m), median_m = scan.median_range_m[i];
        const bool has_surface = scan.weight[i] >= 0.5f || scan.image.drop_prob[i] < kDropThreshold;
        // Something can be between the sensor and the body. Noise moves points of the
        // body.
        if (scan.instance[i] != kOwnVehicleInstance && has_surface && median_m > 0.0f && median_m < range_m)
            return;
        const bool is_kept = body.keeps_points && limits.contains(hit->range_m);
        scan.image.range_m[i] = scan.median_range_m[i] = scan.mean_range_m[i] = range_m;
        scan.image.intensity[i] = is_kept ? kBodyIntensity : 0.0f;
        scan.image.drop_prob[i] = is_kept ? 0.0f : 1.0f;
        scan.weight[i] = 1.0f;
        scan.instance[i] = kOwnVehicleInstance;
        for (AdditionalReturns& second : scan.second_returns) second.range_m[i] = second.intensity[i] = 0.0f;
        for (ScanChannel& channel : scan.channels)
            std::visit([&](auto& values) { fill_value(channel.info, values, i, *hit, direction, is_kept); },
                       channel.values);
    });
}

}  // namespace relidar
