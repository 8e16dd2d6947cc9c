// SPDX-License-Identifier: Apache-2.0
// Implements densification in double, surfel by surfel, from docs/method.md section 6.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

namespace relidar::reference {

struct DensifiedSurfel {
    glm::dvec3 mean{0.0};
    glm::dvec4 rotation{1.0, 0.0, 0.0, 0.0};  ///< quaternion w, x, y, z, unnormalised
    glm::dvec2 scale{1.0};
    double opacity = 0.0;
    bool finite = true;
    std::optional<double> scale_w{};  ///< third scale of a 3D Gaussian
};

enum class Fate { invalid, faint, large, outside, keep, clone, split };

struct DensifyRules {
    double min_opacity = 0.0;
    double max_scale = 1e30;
    double clone_scale = 0.0;
    double gradient_threshold = 1e30;
    glm::dvec3 half_size{0.0};  ///< half size of the actor's box, 0 = unbounded
    std::uint32_t key = 0;      ///< key of the random numbers
};

/// Decides whether densification keeps, removes, clones or splits a surfel.
/// @param mean_gradient mean gradient norm over the batches in which the surfel was
/// visible; 0 if it was never visible
/// @param item index for random numbers
Fate decide_fate(const DensifiedSurfel& surfel, double mean_gradient, const DensifyRules& rules,
                 std::uint32_t item);

/// Returns two normal random numbers from PCG4D and Box-Muller.
glm::dvec2 normal_pair(std::uint32_t key, std::uint32_t item, std::uint32_t draw);

/// Returns a point of a surfel from coordinates in units of the surfel's scales. `z_w` is
/// used only for a 3D Gaussian.
glm::dvec3 sample_point(const DensifiedSurfel& surfel, const glm::dvec2& z, double z_w);

/// Distributes the copies 0 ... n_new - 1 to surfels. Each copy is computed separately.
/// Copy j belongs to the first surfel whose cumulative weight c satisfies c n_new + phase
/// >= (j + 1) W, where W is the sum of all weights.
/// @return number of copies of each surfel
std::vector<std::uint32_t> count_copies(const std::vector<std::uint32_t>& weight, std::uint32_t n_new,
                                        std::uint32_t phase);

}  // namespace relidar::reference
