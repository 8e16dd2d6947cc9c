// SPDX-License-Identifier: Apache-2.0
// Computes the inputs of a ray-drop network from a rendered scan.
#include <cmath>

#include "base/parallel.hpp"
#include "simulate/render/channel_makers.hpp"
#include "simulate/render/sensor_rays.hpp"

namespace relidar {
namespace {

// Limits probabilities to 1e-4 ... 1 - 1e-4, and so the logits to -9.2 ... 9.2.
constexpr float kLeastProbability = 1e-4f;

/// Returns a function that computes one input value of the ray-drop network for a ray.
/// `channel` selects the value (RELIDAR_DROP_*). The kernel simulate/render/drop_channels
/// computes equal values.
RayFunction drop_input(const RenderedScan& scan, std::uint32_t channel, const glm::vec3& origin_m) {
    if (channel == RELIDAR_DROP_LOG_RANGE)
        return [&](std::size_t index) { return std::log1p(std::max(scan.median_range_m[index], 0.0f)); };
    if (channel == RELIDAR_DROP_INTENSITY)
        return [&](std::size_t index) { return scan.image.intensity[index]; };
    if (channel == RELIDAR_DROP_LOGIT)
        return [&](std::size_t index) {
            const float p =
                std::clamp(scan.image.drop_prob[index], kLeastProbability, 1.0f - kLeastProbability);
            return std::log(p / (1.0f - p));
        };
    if (channel == RELIDAR_DROP_WEIGHT) return [&](std::size_t index) { return scan.weight[index]; };
    if (channel == RELIDAR_DROP_SPREAD)
        return [&](std::size_t index) {
            return std::log1p(std::abs(scan.median_range_m[index] - scan.mean_range_m[index]));
        };
    if (channel == RELIDAR_DROP_COSINE) {
        const std::vector<float>* cosine = find_values<float>(scan.channels, kIncidenceChannel);
        return [cosine](std::size_t index) { return cosine ? (*cosine)[index] : 0.0f; };
    }
    if (channel == RELIDAR_DROP_ELEVATION)
        return [&](std::size_t index) { return scan.image.direction[index].z; };
    return [of_all = origin_m[int(channel - RELIDAR_DROP_ORIGIN)]](std::size_t) { return of_all; };
}

}  // namespace

glm::dvec3 first_position(const Log& log) {
    const std::vector<Pose>& poses = log.world_from_vehicle.pose;
    return log.world_offset_m + (poses.empty() ? glm::dvec3(0.0) : poses.front().translation);
}

RayDropImage make_drop_image(const RenderedScan& scan, const std::vector<std::string>& inputs,
                             const glm::dvec3& first_vehicle_position_m) {
    RayDropImage image{scan.image.rows, scan.image.columns, {}, {}};
    image.circular = is_full_turn(image.rows, image.columns, scan.image.direction);
    const glm::vec3 origin_m(scan.world_from_sensor.translation - first_vehicle_position_m);
    const std::size_t n = scan.median_range_m.size();
    image.channels.resize(inputs.size() * n);
    // One plane of n values per channel.
    std::size_t first = 0;
    for (const std::uint32_t number : channel_numbers(inputs)) {
        const auto channel = drop_input(scan, number, origin_m);
        parallel_blocks(n, [&](std::size_t index) { image.channels[first + index] = channel(index); });
        first += n;
    }
    return image;
}

}  // namespace relidar
