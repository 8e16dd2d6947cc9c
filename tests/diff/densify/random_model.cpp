// SPDX-License-Identifier: Apache-2.0
#include "random_model.hpp"

#include <cmath>
#include <limits>
#include <random>

namespace relidar::test {

Scene make_random_model_scene(const std::vector<std::uint32_t>& counts, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<float> normal;
    Scene scene;
    for (std::size_t m = 0; m < counts.size(); ++m) {
        const auto first = std::uint32_t(scene.surfels.size());
        scene.models.push_back({m == 0 ? "background" : "car", first, counts[m],
                                m == 0 ? glm::vec3(0.0f) : glm::vec3(2.0f, 1.0f, 0.8f)});
        scene.instances.push_back({std::uint32_t(m), m == 0 ? "" : "car"});
        scene.surfels.resize(first + counts[m]);
        for (std::uint32_t i = first; i < first + counts[m]; ++i) {
            const float spread = m == 0 ? 20.0f : 0.8f;
            scene.surfels.mean[i] = spread * glm::vec3(normal(random), normal(random), normal(random));
            scene.surfels.rotation[i] = {normal(random), normal(random), normal(random), normal(random)};
            scene.surfels.log_scale[i] = {-3.0f + normal(random), -3.0f + normal(random)};
            scene.surfels.opacity_logit[i] = -2.0f + 3.0f * normal(random);
            for (std::size_t k = 0; k < kShFloats; ++k)
                scene.surfels.sh[i * kShFloats + k] = k == 0 ? float(i) : normal(random);
        }
    }
    return scene;
}

void fill_with_nan(Surfels& surfels) {
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN(),
                    kInfinity = std::numeric_limits<float>::infinity();
    for (std::size_t i = 0; i < surfels.size(); i += 20) {
        if (i % 3 == 0) surfels.mean[i].y = i % 2 ? kNan : kInfinity;
        else if (i % 3 == 1) surfels.sh[i * kShFloats + 47] = kNan;
        else surfels.opacity_logit[i] = kNan;
    }
}

reference::DensifiedSurfel densify_surfel(const Surfels& surfels, std::size_t index) {
    bool finite = std::isfinite(surfels.mean[index].x + surfels.mean[index].y + surfels.mean[index].z +
                                surfels.opacity_logit[index]);
    for (std::size_t k = 0; k < kShFloats; ++k)
        finite = finite && std::isfinite(surfels.sh[index * kShFloats + k]);
    return {glm::dvec3(surfels.mean[index]),
            glm::dvec4(surfels.rotation[index]),
            glm::exp(glm::dvec2(surfels.log_scale[index])),
            1.0 / (1.0 + std::exp(-double(surfels.opacity_logit[index]))),
            finite,
            properties_of(surfels.primitive).third_scale
                ? std::optional(std::exp(double(surfels.log_scale_w[index])))
                : std::nullopt};
}

std::uint32_t get_tag(const Surfels& surfels, std::size_t index) {
    return std::uint32_t(surfels.sh[index * kShFloats]);
}

}  // namespace relidar::test
