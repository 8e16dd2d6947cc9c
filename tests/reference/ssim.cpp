// SPDX-License-Identifier: Apache-2.0
// Computes the structural similarity S of a window directly from its equation, with the
// raw moments E[x], E[xx], E[xy]. Double precision suffices for this form.
#include "ssim.hpp"

#include <cmath>
#include <cstddef>

namespace relidar::reference {
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

}  // namespace relidar::reference
