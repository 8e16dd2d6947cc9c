// SPDX-License-Identifier: Apache-2.0
#include "base/parallel.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

// Assumption: dark paint, as most returns from the own vehicle have a low intensity.
constexpr float kBodyIntensity = 0.1f;

/// Returns the value of an optional channel for a ray that hits the vehicle's own body.
/// @param direction unit vector of the ray
/// @param is_kept true if the sensor reports such returns
template <class T>
T value_on_body(const ChannelInfo& channel, const BodyHit& hit, const glm::vec3& direction, bool is_kept) {
    if constexpr (std::is_same_v<T, glm::vec3>) {
        return channel.name == "normal" ? glm::vec3(hit.normal) : glm::vec3(0.0f);
    } else {
        if (channel.name == "incidence") return T(-glm::dot(glm::vec3(hit.normal), direction));
        if (channel.name == "class") return T(SurfaceClass::ego);
        if (channel.name == "surfel_drop_prob") return is_kept ? T(0) : T(1);
        if (channel.name == "source" && is_kept) return T(ReturnCause::surface);
        return T(channel.none);  // the value for rays that have none in this channel
    }
}

/// Returns true if a surface is between the sensor and the hit point on the body. A point
/// of the body itself can also be nearer, because of noise.
bool is_body_hidden(const RenderedScan& scan, std::size_t ray, float body_range_m) {
    if (scan.instance[ray] == kOwnVehicleInstance) return false;
    const float median_m = scan.median_range_m[ray];
    // A ray with less than half of its weight has a return in weather.
    const bool has_surface = scan.weight[ray] >= 0.5f || scan.image.drop_prob[ray] < kDropThreshold;
    return has_surface && median_m > 0.0f && median_m < body_range_m;
}

}  // namespace

void block_rays(RenderedScan& scan, const VehicleBody& body, const RangeLimits& limits) {
    if (body.boxes.empty()) return;
    parallel_blocks(scan.image.range_m.size(), [&](std::size_t i) {
        const glm::vec3& direction = scan.image.direction[i];
        const std::optional<BodyHit> hit =
            find_body_hit(body.boxes, glm::dvec3(scan.image.origin[i]), glm::dvec3(direction));
        if (!hit || is_body_hidden(scan, i, float(hit->range_m))) return;
        const float range_m = float(hit->range_m);
        const bool is_kept = body.keeps_points && limits.contains(hit->range_m);
        scan.image.range_m[i] = scan.median_range_m[i] = scan.mean_range_m[i] = range_m;
        scan.image.intensity[i] = is_kept ? kBodyIntensity : 0.0f;
        scan.image.drop_prob[i] = is_kept ? 0.0f : 1.0f;
        scan.weight[i] = 1.0f;
        scan.instance[i] = kOwnVehicleInstance;
        for (AdditionalReturns& second : scan.second_returns) second.range_m[i] = second.intensity[i] = 0.0f;
        for (ScanChannel& channel : scan.channels)
            std::visit(
                [&]<class T>(std::vector<T>& values) {
                    values[i] = value_on_body<T>(channel.info, *hit, direction, is_kept);
                },
                channel.values);
    });
}

}  // namespace relidar
