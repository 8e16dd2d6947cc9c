// SPDX-License-Identifier: Apache-2.0
// What a ray-drop network sees of a rendered scan.
#include <algorithm>
#include <cmath>
#include <functional>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/render.hpp>

#include "core/incidence.hpp"
#include "core/parallel.hpp"

namespace relidar {
namespace {

constexpr float kLeastProbability = 1e-4f;   // of either answer: logits stay within 9.2

float logit(float probability) {
    const float p = std::clamp(probability, kLeastProbability, 1.0f - kLeastProbability);
    return std::log(p / (1.0f - p));
}

/// What one channel is of a ray, by the channel's name.
std::function<float(std::size_t)> channel_of(const RenderedScan& scan, const ImageRays& surfaces, const std::string& name,
                                             const glm::vec3& origin_m) {
    if (name == "log_range") return [&](std::size_t i) { return std::log1p(std::max(surfaces.range_m[i], 0.0f)); };
    if (name == "intensity") return [&](std::size_t i) { return scan.image.intensity[i]; };
    if (name == "drop_logit") return [&](std::size_t i) { return logit(scan.image.drop_prob[i]); };
    if (name == "weight") return [&](std::size_t i) { return scan.weight[i]; };
    if (name == "spread") return [&](std::size_t i) { return std::log1p(std::abs(surfaces.range_m[i] - scan.mean_range_m[i])); };
    if (name == "incidence") return [&](std::size_t i) { return float(std::max(incidence_cosine(surfaces, i), 0.0)); };
    for (int axis = 0; axis < 3; ++axis) {
        if (name == std::string("direction_") + "xyz"[axis]) return [&, axis](std::size_t i) { return scan.image.direction[i][axis]; };
        if (name == std::string("origin_") + "xyz"[axis]) return [&, axis](std::size_t) { return origin_m[axis]; };
    }
    throw DataError(fmt::format("refining ray-drop: the network asks for \"{}\", which this relidar does not render", name));
}

}  // namespace

glm::dvec3 first_origin(const Sequence& sequence) {
    const std::vector<Pose>& poses = sequence.world_from_vehicle.pose;
    return sequence.world_offset_m + (poses.empty() ? glm::dvec3(0.0) : poses.front().translation);
}

DropImage drop_image(const RenderedScan& scan, const std::vector<std::string>& channels, const glm::dvec3& first_origin_m) {
    DropImage image{scan.image.rows, scan.image.columns, {}, {}};
    const std::vector<float>& surface_m = scan.median_range_m;
    const ImageRays surfaces{image.rows, image.columns, scan.image.origin, scan.image.direction, surface_m};
    const glm::vec3 origin_m(scan.world_from_sensor.translation - first_origin_m);
    const std::size_t n = surface_m.size();
    image.channels.resize(channels.size() * n);
    for (std::size_t c = 0; c < channels.size(); ++c) {
        const auto channel = channel_of(scan, surfaces, channels[c], origin_m);
        for_each_block(n, [&](std::size_t i) { image.channels[c * n + i] = channel(i); });
    }
    return image;
}

}  // namespace relidar
