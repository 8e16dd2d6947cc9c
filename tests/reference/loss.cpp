// SPDX-License-Identifier: Apache-2.0
// Implements the loss terms of the reference (docs/method.md section 5; M6). The
// cross-entropy uses softplus, because extreme logits would otherwise overflow or have no
// derivative. With x = drop - hit, the cross-entropy is ln(1 + e^x) - y x, and its
// derivative is beta - y.
#include "loss.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
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

namespace {

struct Point {
    std::size_t ray;
    glm::dvec3 position_m;
};

std::vector<Point> points(const std::vector<ChamferRay>& rays, double ChamferRay::*range) {
    std::vector<Point> result;
    for (std::size_t i = 0; i < rays.size(); ++i)
        if (rays[i].*range > 0.0)
            result.push_back({i, rays[i].origin_m + rays[i].*range * rays[i].direction});
    return result;
}

double squared(const glm::dvec3& vector) { return glm::dot(vector, vector); }

const Point& nearest(const Point& query, const std::vector<Point>& cloud) {
    return *std::min_element(cloud.begin(), cloud.end(), [&](const Point& first, const Point& second) {
        return squared(first.position_m - query.position_m) < squared(second.position_m - query.position_m);
    });
}

}  // namespace

double compute_chamfer_loss(const std::vector<ChamferRay>& rays, std::vector<double>* d_simulated) {
    const std::vector<Point> simulated = points(rays, &ChamferRay::simulated_m),
                             measured = points(rays, &ChamferRay::measured_m);
    std::vector<double> d(rays.size());
    double sum = 0.0;
    const double n = double(std::min(simulated.size(), measured.size()));
    const auto add_pair = [&](const Point& first, const Point& second) {
        const glm::dvec3 difference = first.position_m - second.position_m;
        sum += squared(difference);
        d[first.ray] += 2.0 * glm::dot(difference, rays[first.ray].direction) / n;
    };
    if (n > 0.0) {
        for (const Point& a : simulated) add_pair(a, nearest(a, measured));
        for (const Point& b : measured) add_pair(nearest(b, simulated), b);
    }
    if (d_simulated != nullptr) *d_simulated = std::move(d);
    return n > 0.0 ? sum / n : 0.0;
}

namespace {

struct Neighbour {
    std::size_t pixel;
    double weight;
};

/// Returns the pixels with a known value in the window around a pixel. The weights sum to
/// 1.
std::vector<Neighbour> window(const Image& image, int row, int column) {
    std::vector<Neighbour> result;
    double sum = 0.0;
    for (int r = row - 5; r <= row + 5; ++r)
        for (int c = column - 5; c <= column + 5; ++c) {
            const bool wraps = image.circular && image.columns > 10;
            const int at = wraps ? (c % image.columns + image.columns) % image.columns : c;
            if (r < 0 || r >= image.rows || at < 0 || at >= image.columns) continue;
            const std::size_t pixel = std::size_t(r) * std::size_t(image.columns) + std::size_t(at);
            if (!image.is_known[pixel]) continue;
            const double weight =
                std::exp(-((r - row) * (r - row) + (c - column) * (c - column)) / (2.0 * 1.5 * 1.5));
            result.push_back({pixel, weight});
            sum += weight;
        }
    for (Neighbour& n : result) n.weight /= sum;
    return result;
}

/// Returns the structural similarity S of a window and adds scale * dS/dx to `d_x`.
double similarity(const Image& image, const std::vector<Neighbour>& neighbours, double scale,
                  std::vector<double>& d_x) {
    double ex = 0, ey = 0, exx = 0, eyy = 0, exy = 0;
    for (const auto& [q, w] : neighbours) {
        const double x = image.x[q], y = image.y[q];
        ex += w * x;
        ey += w * y;
        exx += w * x * x;
        eyy += w * y * y;
        exy += w * x * y;
    }
    const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
    const double a1 = 2 * ex * ey + c1, a2 = 2 * (exy - ex * ey) + c2, b1 = ex * ex + ey * ey + c1,
                 b2 = exx - ex * ex + eyy - ey * ey + c2;
    const double s = a1 * a2 / (b1 * b2);
    const double d_ex = 2 * ey * (a2 - a1) / (b1 * b2) - 2 * ex * s * (1 / b1 - 1 / b2), d_exx = -s / b2,
                 d_exy = 2 * a1 / (b1 * b2);
    for (const auto& [q, w] : neighbours)
        d_x[q] += scale * w * (d_ex + 2 * image.x[q] * d_exx + image.y[q] * d_exy);
    return s;
}

}  // namespace

double compute_ssim_loss(const Image& image, std::vector<double>* d_x) {
    std::vector<double> d(image.x.size());
    double n_known_pixels = 0.0, loss = 0.0;
    for (const bool is_known : image.is_known) n_known_pixels += is_known;
    for (int row = 0; row < image.rows; ++row)
        for (int column = 0; column < image.columns; ++column)
            if (image.is_known[std::size_t(row) * std::size_t(image.columns) + std::size_t(column)])
                loss += (1.0 - similarity(image, window(image, row, column), -1.0 / n_known_pixels, d)) /
                        n_known_pixels;
    if (d_x != nullptr) *d_x = std::move(d);
    return loss;
}

double compute_box_loss(const BoxedSurfel& surfel, const Box& box, double scale, BoxedSurfel& gradient) {
    double loss = 0.0;
    for (std::size_t a = 0; a < 3; ++a)
        if (std::abs(surfel.mean[a]) > box.half_size_m[a]) {
            loss += std::abs(surfel.mean[a]) / box.half_size_m[a] - 1.0;
            gradient.mean[a] += scale * (surfel.mean[a] > 0.0 ? 1.0 : -1.0) / box.half_size_m[a];
        }
    const auto add_scale = [&](double log_scale) {
        const double relative = std::exp(log_scale) / box.largest_scale_m;
        if (relative <= 1.0) return 0.0;
        loss += relative - 1.0;
        return scale * relative;
    };
    for (std::size_t a = 0; a < 2; ++a) gradient.log_scale[a] += add_scale(surfel.log_scale[a]);
    if (surfel.log_scale_w)
        gradient.log_scale_w = gradient.log_scale_w.value_or(0.0) + add_scale(*surfel.log_scale_w);
    return loss;
}

}  // namespace relidar::reference
