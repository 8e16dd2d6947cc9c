// SPDX-License-Identifier: Apache-2.0
#include "base/parallel.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

// Assumption: dark paint, as most returns from the own vehicle have a low intensity.
constexpr float kBodyIntensity = 0.1f;

/// A part of the body that a ray hits.
struct BlockingPart {
    float range_m;
    float intensity;   ///< of its return; 0 without a return
    bool is_returned;  ///< true if the sensor reports the return
    glm::vec3 normal;
};

/// Returns what a ray hits of the body. Of a body that a LiDAR has seen, only the
/// distance is known, so its surface faces the sensor.
std::optional<BlockingPart> find_blocking_part(const VehicleBody& body, const glm::vec3& origin_m,
                                               const glm::vec3& direction, const RangeLimits& limits) {
    if (!body.seen.empty()) {
        const glm::dvec3 seen_direction = body.seen_from_sensor * glm::dvec3(direction);
        const std::size_t cell = BodyTable::cell_of(glm::vec3(seen_direction));
        const float range_m = body.seen.range_m[cell], intensity = body.seen.intensity[cell];
        const bool is_returned = intensity != BodyTable::kNoReturn && limits.contains(double(range_m));
        if (range_m > 0.0f)
            return BlockingPart{range_m, is_returned ? intensity : 0.0f, is_returned, -direction};
    }
    const std::optional<BodyHit> hit = find_body_hit(body.boxes, glm::dvec3(origin_m), glm::dvec3(direction));
    if (!hit) return std::nullopt;
    const bool is_returned = body.keeps_points && limits.contains(hit->range_m);
    return BlockingPart{float(hit->range_m), is_returned ? kBodyIntensity : 0.0f, is_returned,
                        glm::vec3(hit->normal)};
}

/// Returns the value of an optional channel for a ray that hits the vehicle's own body.
/// @param direction unit vector of the ray
template <class T>
T value_on_body(const ChannelInfo& channel, const BlockingPart& part, const glm::vec3& direction) {
    if constexpr (std::is_same_v<T, glm::vec3>) {
        return channel.name == "normal" ? part.normal : glm::vec3(0.0f);
    } else {
        if (channel.name == "incidence") return T(-glm::dot(part.normal, direction));
        if (channel.name == "class") return T(SurfaceClass::ego);
        if (channel.name == "surfel_drop_prob") return part.is_returned ? T(0) : T(1);
        if (channel.name == "source" && part.is_returned) return T(ReturnCause::surface);
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
    if (body.empty()) return;
    parallel_blocks(scan.image.range_m.size(), [&](std::size_t i) {
        const glm::vec3& direction = scan.image.direction[i];
        const std::optional<BlockingPart> part =
            find_blocking_part(body, scan.image.origin[i], direction, limits);
        if (!part || is_body_hidden(scan, i, part->range_m)) return;
        scan.image.range_m[i] = scan.median_range_m[i] = scan.mean_range_m[i] = part->range_m;
        scan.image.intensity[i] = part->intensity;
        scan.image.drop_prob[i] = part->is_returned ? 0.0f : 1.0f;
        scan.weight[i] = 1.0f;
        scan.instance[i] = kOwnVehicleInstance;
        for (AdditionalReturns& second : scan.second_returns) second.range_m[i] = second.intensity[i] = 0.0f;
        for (ScanChannel& channel : scan.channels)
            std::visit(
                [&]<class T>(std::vector<T>& values) {
                    values[i] = value_on_body<T>(channel.info, *part, direction);
                },
                channel.values);
    });
}

}  // namespace relidar
