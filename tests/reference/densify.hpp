// SPDX-License-Identifier: Apache-2.0
// Densifies surfels in double, surfel by surfel, as docs/method.md section 6 describes.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

namespace relidar::reference {

/// Activated parameters of a surfel.
struct DensifiedSurfel {
    glm::dvec3 mean{0.0};
    glm::dvec4 rotation{1.0, 0.0, 0.0, 0.0};  ///< w, x, y, z, not normalised
    glm::dvec2 scale{1.0};
    double opacity = 0.0;
    bool finite = true;
    std::optional<double> scale_w{};  ///< set for a 3D Gaussian only
};

enum class Fate { invalid, faint, large, outside, keep, clone, split, share };

struct DensifyRules {
    double min_opacity = 0.0;
    double max_scale = 1e30;
    double clone_scale = 0.0;
    double gradient_threshold = 1e30;
    glm::dvec3 half_size{0.0};  ///< 0 = unbounded
    bool share = false;         ///< grow by sharing the opacity
    std::uint32_t key = 0;      ///< key of the random numbers
};

/// Decides whether a surfel is kept, copied, split or removed.
/// @param mean_gradient mean gradient norm over the batches that saw the surfel, 0 if
/// none did
/// @param item index for the random numbers
Fate fate_of(const DensifiedSurfel& surfel, double mean_gradient, const DensifyRules& rules,
             std::uint32_t item);

/// Returns two normally distributed numbers from PCG4D and the Box-Muller transform.
glm::dvec2 random_normal2(std::uint32_t key, std::uint32_t item, std::uint32_t draw);

/// Returns a point of a surfel at `z`, in units of its scales. Only 3D Gaussians use z_w.
glm::dvec3 point_of(const DensifiedSurfel& surfel, const glm::dvec2& z, double z_w);

/// Distributes n_new copies in proportion to the weights. Copy j belongs to the first
/// surfel with c n_new + phase >= (j + 1) W, where c is the cumulative weight up to and
/// including the surfel and W is the total weight.
/// @return number of copies of each surfel
std::vector<std::uint32_t> copies_of(const std::vector<std::uint32_t>& weight, std::uint32_t n_new,
                                     std::uint32_t phase);

/// Parameters of each of n surfels that together replace one surfel.
struct SharedSurfel {
    double opacity;
    double scale_factor;
};
/// Computes the opacity and scale of `n` surfels that together replace one surfel of the
/// given opacity. Uses the double sum over binomials as printed in the paper, with 1 / (k
/// + 1) for the area of a surfel.
SharedSurfel share(double opacity, int n);

}  // namespace relidar::reference
