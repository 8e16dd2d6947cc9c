// SPDX-License-Identifier: Apache-2.0
// Computes structural similarity with the defaults of scikit-image, which published LiDAR
// tables use: a uniform 7 x 7 window, sample covariance (divided by 48), K1 = 0.01, K2 =
// 0.03, and the mean over the pixels whose window is inside the image.
//   S = (2 ma mb + C1) (2 cov + C2) / ((ma^2 + mb^2 + C1) (va + vb + C2))
//   with C1 = (K1 L)^2, C2 = (K2 L)^2
// Adds the values of a window along rows first, then along columns. Prefix sums would be
// faster, but less precise.
#include <relidar/score/metrics.hpp>

#include <algorithm>
#include <array>

#include "base/fail.hpp"

namespace relidar {
namespace {

constexpr int kWindowPixels = 7;

/// over a window of two images a and b: a, b, a^2, b^2 and a*b
struct SsimWindowSums {
    std::array<double, 5> sum{};

    void add_pair(double first, double second) {
        const std::array<double, 5> term{first, second, first * first, second * second, first * second};
        for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += term[k];
    }
    void add_moments(const SsimWindowSums& other) {
        for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += other.sum[k];
    }
};

/// Returns the SSIM of a window from its sums. Variances have the divisor n - 1, as in
/// scikit-image.
double window_ssim(const SsimWindowSums& window_sums, double c1, double c2) {
    constexpr double n = kWindowPixels * kWindowPixels;
    constexpr double bessel_factor = n / (n - 1.0);
    const auto& [sum_a, sum_b, sum_aa, sum_bb, sum_ab] = window_sums.sum;
    const double mean_a = sum_a / n, mean_b = sum_b / n;
    const double variance_a = bessel_factor * (sum_aa / n - mean_a * mean_a);
    const double variance_b = bessel_factor * (sum_bb / n - mean_b * mean_b);
    const double covariance = bessel_factor * (sum_ab / n - mean_a * mean_b);
    return (2.0 * mean_a * mean_b + c1) * (2.0 * covariance + c2) /
           ((mean_a * mean_a + mean_b * mean_b + c1) * (variance_a + variance_b + c2));
}

/// Returns the sums over every 7 consecutive pixels of each row.
/// @return [rows * (columns - 6)]
std::vector<SsimWindowSums> row_window_sums(const std::vector<double>& first_image,
                                            const std::vector<double>& second_image, int rows, int columns) {
    const int width = columns - kWindowPixels + 1;
    std::vector<SsimWindowSums> sums(std::size_t(rows) * std::size_t(width));
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < width; ++column) {
            const std::size_t first = std::size_t(row) * std::size_t(columns) + std::size_t(column);
            SsimWindowSums& sum = sums[std::size_t(row) * std::size_t(width) + std::size_t(column)];
            for (std::size_t k = 0; k < kWindowPixels; ++k)
                sum.add_pair(first_image[first + k], second_image[first + k]);
        }
    return sums;
}

}  // namespace

double compute_ssim(const std::vector<double>& first_image, const std::vector<double>& second_image, int rows,
                    int columns, double data_range) {
    const std::size_t n = std::size_t(std::max(rows, 0)) * std::size_t(std::max(columns, 0));
    const bool is_large_enough = rows >= kWindowPixels && columns >= kWindowPixels;
    const bool is_complete = first_image.size() == n && second_image.size() == n;
    if (!is_large_enough || !is_complete || !(data_range > 0.0))
        fail(
            "cannot compute the structural similarity: found {} x {} pixels, images of {} and {} values and "
            "a data range of {}, expected at least 7 x 7 pixels, a value for each, and a positive range",
            rows, columns, first_image.size(), second_image.size(), data_range);
    // Small numbers that avoid a division by 0: C1 = (K1 L)^2 and C2 = (K2 L)^2 with
    // K1 = 0.01, K2 = 0.03 and L = data_range.
    const double c1 = 0.01 * data_range * 0.01 * data_range, c2 = 0.03 * data_range * 0.03 * data_range;
    const std::vector<SsimWindowSums> sums = row_window_sums(first_image, second_image, rows, columns);
    const int width = columns - kWindowPixels + 1, height = rows - kWindowPixels + 1;
    double total = 0.0;
    for (int row = 0; row < height; ++row)
        for (int column = 0; column < width; ++column) {
            // Adds 7 rows of `sums`, each of which is over 7 columns.
            SsimWindowSums window;
            for (int k = 0; k < kWindowPixels; ++k)
                window.add_moments(sums[std::size_t(row + k) * std::size_t(width) + std::size_t(column)]);
            total += window_ssim(window, c1, c2);
        }
    return total / (double(width) * double(height));
}

}  // namespace relidar
