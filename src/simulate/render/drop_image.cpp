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

/// Returns one input value of the ray-drop network for a ray. The kernel
/// simulate/render/drop_channels computes equal values.
/// @param channel selects the value (RELIDAR_DROP_*)
/// @param cosine [rays] cosine of the angle of incidence; null if unknown
/// @param sensor_m position of the sensor, an input that all rays share
float drop_input(const RenderedScan& scan, std::uint32_t channel, std::size_t ray,
                 const std::vector<float>* cosine, const glm::vec3& sensor_m) {
    switch (channel) {
        case RELIDAR_DROP_LOG_RANGE: return std::log1p(std::max(scan.median_range_m[ray], 0.0f));
        case RELIDAR_DROP_INTENSITY: return scan.image.intensity[ray];
        case RELIDAR_DROP_LOGIT: {
            const float p =
                std::clamp(scan.image.drop_prob[ray], kLeastProbability, 1.0f - kLeastProbability);
            return std::log(p / (1.0f - p));
        }
        case RELIDAR_DROP_WEIGHT: return scan.weight[ray];
        case RELIDAR_DROP_SPREAD:
            return std::log1p(std::abs(scan.median_range_m[ray] - scan.mean_range_m[ray]));
        case RELIDAR_DROP_COSINE: return cosine ? (*cosine)[ray] : 0.0f;
        case RELIDAR_DROP_ELEVATION: return scan.image.direction[ray].z;
        default: return sensor_m[int(channel - RELIDAR_DROP_ORIGIN)];  // x, y or z
    }
}

}  // namespace

glm::dvec3 first_position(const Log& log) {
    const std::vector<Pose>& poses = log.world_from_vehicle.pose;
    return log.world_offset_m + (poses.empty() ? glm::dvec3(0.0) : poses.front().translation);
}

RayDropImage make_drop_image(const RenderedScan& scan, const std::vector<std::string>& inputs,
                             const glm::dvec3& origin_m) {
    RayDropImage image{scan.image.rows, scan.image.columns, {}, {}};
    image.circular = is_full_turn(image.rows, image.columns, scan.image.direction);
    const glm::vec3 sensor_m(scan.world_from_sensor.translation - origin_m);
    const std::vector<float>* cosine = find_values<float>(scan.channels, kIncidenceChannel);
    const std::size_t n = scan.median_range_m.size();
    image.channels.resize(inputs.size() * n);
    float* plane = image.channels.data();  // values of the current channel, [n]
    for (const std::uint32_t channel : channel_numbers(inputs)) {
        parallel_blocks(
            n, [&](std::size_t ray) { plane[ray] = drop_input(scan, channel, ray, cosine, sensor_m); });
        plane += n;
    }
    return image;
}

}  // namespace relidar
