// SPDX-License-Identifier: Apache-2.0
// Densification in double, surfel by surfel, from docs/method.md section 6.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

namespace relidar::reference {

/// A surfel's parameters, activated.
struct DensifiedSurfel {
    glm::dvec3 mean{0.0};
    glm::dvec4 rotation{1.0, 0.0, 0.0, 0.0};  ///< w, x, y, z, unnormalised
    glm::dvec2 scale{1.0};
    double opacity = 0.0;
    bool finite = true;
    std::optional<double> scale_w{};  ///< of a 3D Gaussian
};

enum class Fate { invalid, faint, large, outside, keep, clone, split };

struct DensifyRules {
    double min_opacity = 0.0;
    double max_scale = 1e30;
    double clone_scale = 0.0;
    double gradient_threshold = 1e30;
    glm::dvec3 half_size{0.0};  ///< 0 = unbounded
    std::uint32_t key = 0;      ///< of the random numbers
};

/// @param mean_gradient mean norm over the batches that saw it, 0 where none did @param
/// item index for random numbers
Fate fate_of(const DensifiedSurfel& surfel, double mean_gradient, const DensifyRules& rules,
             std::uint32_t item);

/// The two normal deviates of PCG4D and Box-Muller.
glm::dvec2 random_normal2(std::uint32_t key, std::uint32_t item, std::uint32_t draw);

/// A point of a surfel, in units of its scales; z_w counts for a 3D Gaussian alone.
glm::dvec3 point_of(const DensifiedSurfel& surfel, const glm::dvec2& z, double z_w);

/// Who gets copies 0 ... n_new - 1, each looked up alone: copy j goes to the first surfel
/// with cumulative weight c (its own included), c n_new + phase >= (j + 1) W. @return
/// copies of each
std::vector<std::uint32_t> copies_of(const std::vector<std::uint32_t>& weight, std::uint32_t n_new,
                                     std::uint32_t phase);

}  // namespace relidar::reference
