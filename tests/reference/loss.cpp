// SPDX-License-Identifier: Apache-2.0
// Implements the loss terms of the reference (docs/method.md section 5; M6). The
// cross-entropy uses softplus, because extreme logits would otherwise overflow or have no
// derivative. With x = drop - hit, the cross-entropy is ln(1 + e^x) - y x, and its
// derivative is beta - y.
#include "loss.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace relidar::reference {
namespace {

double sign(double value) {
    if (value > 0.0) return 1.0;
    return value < 0.0 ? -1.0 : 0.0;
}

double softplus(double value) { return std::max(value, 0.0) + std::log1p(std::exp(-std::abs(value))); }

}  // namespace

double drop_probability(double hit_logit, double drop_logit) {
    return 1.0 / (1.0 + std::exp(hit_logit - drop_logit));
}

LossTerms evaluate_loss(const std::vector<Pixel>& pixels, const std::vector<Target>& targets,
                        const LossWeights& weights, DepthKind kind, std::vector<PixelGradient>* d_pixels) {
    if (pixels.size() != targets.size())
        throw std::logic_error("evaluate_loss: pixels and targets differ in length");
    std::vector<PixelGradient> d(pixels.size());
    double n_returned = 0.0;
    for (const Target& target : targets) n_returned += target.range_m > 0.0 ? 1.0 : 0.0;
    const double n_rays = double(pixels.size());
    LossTerms terms;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
        const Pixel& p = pixels[i];
        const bool returned = targets[i].range_m > 0.0;
        if (returned && (kind == DepthKind::blended || p.weight > 0.0)) {
            const double scale = kind == DepthKind::blended ? 1.0 : 1.0 / p.weight;
            const double residual = scale * p.depth - targets[i].range_m;
            terms.depth += std::abs(residual) / n_returned;
            d[i].depth = weights.depth * sign(residual) * scale / n_returned;
            if (kind == DepthKind::normalised) d[i].weight = -d[i].depth * p.depth * scale;
        }
        if (returned) {
            const double residual = p.intensity - targets[i].intensity, delta = weights.intensity_delta;
            // Part of the residual with a quadratic loss. The loss of the remainder is
            // linear.
            const double within = std::min(std::abs(residual), delta);
            terms.intensity +=
                (std::abs(residual) - within + (delta > 0.0 ? within * within / (2.0 * delta) : 0.0)) /
                n_returned;
            d[i].intensity =
                weights.intensity * sign(residual) * (within < delta ? within / delta : 1.0) / n_returned;
        }
        const double x = p.drop_logit - p.hit_logit, y = returned ? 0.0 : 1.0;
        terms.drop += (softplus(x) - y * x) / n_rays;
        d[i].drop_logit = weights.drop * (drop_probability(p.hit_logit, p.drop_logit) - y) / n_rays;
        d[i].hit_logit = -d[i].drop_logit;
    }
    terms.total =
        weights.depth * terms.depth + weights.intensity * terms.intensity + weights.drop * terms.drop;
    if (d_pixels != nullptr) *d_pixels = std::move(d);
    return terms;
}

double compute_likelihood_loss(const std::vector<Pixel>& pixels, const std::vector<Target>& targets,
                               double floor, std::vector<PixelGradient>* d_pixels) {
    std::vector<PixelGradient> d(pixels.size());
    double sum = 0.0, n_returned = 0.0;
    for (const Target& target : targets) n_returned += target.range_m > 0.0 ? 1.0 : 0.0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
        if (!(targets[i].range_m > 0.0)) continue;
        const double mixture = floor + (1.0 - floor) * pixels[i].likelihood;
        sum -= std::log(mixture) / n_returned;
        d[i].likelihood = -(1.0 - floor) / mixture / n_returned;
    }
    if (d_pixels != nullptr) *d_pixels = std::move(d);
    return sum;
}

}  // namespace relidar::reference
