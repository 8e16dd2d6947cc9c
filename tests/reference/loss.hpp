// SPDX-License-Identifier: Apache-2.0
// Computes the loss terms (docs/method.md section 5; Eq. 11) in double, and their
// derivatives.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "render.hpp"

namespace relidar::reference {

// L1 of depth, L1 or Huber loss of intensity (both only for rays with a return), and
// cross-entropy of the ray-drop probability beta = softmax(hit, drop) (M6).

struct LossWeights {
    double depth = 0.1;
    double intensity = 0.1;
    double drop = 0.01;
    double intensity_delta = 0.0;  ///< delta of the Huber loss; 0: L1
};

/// Rendered value that the depth term compares with the measured range.
enum class DepthKind { blended, normalised };  ///< D, or D / W (rays with W = 0 are skipped)

struct Target {
    double range_m = 0.0;  ///< 0 = dropped
    double intensity = 0.0;
};

struct LossTerms {
    double depth = 0.0;  ///< mean |depth - range| over returned rays, metres
    /// mean of |intensity - measured|, or of the Huber loss, over rays with a return
    double intensity = 0.0;
    /// mean of -[y ln beta + (1 - y) ln(1 - beta)] over all rays, where y = 1 for dropped
    /// rays
    double drop = 0.0;
    double total = 0.0;  ///< weighted sum
};

/// Computes all loss terms. The derivative of |x| at 0 is 0.
/// @param d_pixels if not null, receives d(total)/d(pixel) [n]
LossTerms evaluate_loss(const std::vector<Pixel>& pixels, const std::vector<Target>& targets,
                        const LossWeights& weights, DepthKind kind,
                        std::vector<PixelGradient>* d_pixels = nullptr);

/// Returns the mean of -ln(floor + (1 - floor) S) over the rays with a return, where S is
/// the likelihood of the pixel (M12).
/// @param d_pixels [n] if not null, receives the derivatives
double compute_likelihood_loss(const std::vector<Pixel>& pixels, const std::vector<Target>& targets,
                               double floor, std::vector<PixelGradient>* d_pixels = nullptr);

/// Returns the drop probability beta from the two blended logits (M6).
double drop_probability(double hit_logit, double drop_logit);

// The Chamfer distance between a simulated and a measured scan compares all pairs of
// points (Eq. 11).

/// A ray with a simulated and a measured range. A range of 0 means that the ray has no
/// point.
struct ChamferRay {
    glm::dvec3 origin_m{0.0};
    glm::dvec3 direction{0.0};
    double simulated_m = 0.0;
    double measured_m = 0.0;
};

/// Returns (sum over simulated of min |a - b|^2 + sum over measured of min |a - b|^2) /
/// min(number of simulated points, number of measured points). Returns 0 if a cloud is
/// empty.
/// @param d_simulated if not null, receives the derivative with respect to the simulated
/// ranges [n], with the nearest pairs fixed
double compute_chamfer_loss(const std::vector<ChamferRay>& rays, std::vector<double>* d_simulated = nullptr);

// Structural similarity of two intensity images (Wang et al. 2004). The window has 11 x
// 11 pixels and a Gaussian of 1.5 pixels, normalised over the pixels with a known value.

struct Image {
    int rows = 0;
    int columns = 0;
    bool circular = false;       ///< the first column is adjacent to the last column
    std::vector<double> x;       ///< [rows,columns] rendered
    std::vector<double> y;       ///< [rows,columns] measured
    std::vector<bool> is_known;  ///< [rows,columns] unknown pixels are ignored
};

/// Computes the structural similarity loss.
/// @param d_x if not null, receives the derivative with respect to x [rows,columns]
/// @return mean of 1 - S over the pixels with a known value, or 0 if no pixel has a known
/// value
double compute_ssim_loss(const Image& image, std::vector<double>* d_x = nullptr);

// The penalty for leaving the box of an actor.

struct Box {
    std::array<double, 3> half_size_m{};
    double largest_scale_m = 0.0;
};

struct BoxedSurfel {
    std::array<double, 3> mean{};  ///< box frame, metres
    std::array<double, 2> log_scale{};
    std::optional<double> log_scale_w{};  ///< third scale of a 3D Gaussian
};

/// Returns sum over x, y, z of max(0, |mean| / half - 1), plus sum over scales of max(0,
/// scale / largest - 1). Adds `scale` times the derivative to `gradient`.
double compute_box_loss(const BoxedSurfel& surfel, const Box& box, double scale, BoxedSurfel& gradient);

}  // namespace relidar::reference
