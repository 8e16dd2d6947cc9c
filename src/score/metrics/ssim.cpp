// SPDX-License-Identifier: Apache-2.0
// Computes structural similarity with the defaults of scikit-image, which published LiDAR
// tables use. These are a uniform 7 x 7 window, sample covariance (divided by 48), K1 =
// 0.01, K2 = 0.03, and the mean over the pixels whose window is inside the image.
//   S = (2 ma mb + C1) (2 cov + C2) / ((ma^2 + mb^2 + C1) (va + vb + C2)),   C1 = (K1 L)^2, C2 = (K2 L)^2
// The sums over a window are computed along rows first, then along columns. Prefix sums
// would be faster, but less precise.
#include <relidar/score/metrics.hpp>

#include <array>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

constexpr int kWindow = 7;

/// Sums over a window of two images a and b, as needed for SSIM: of a, b, a^2, b^2 and
/// a*b.
struct Moments {
    std::array<double, 5> sum{};

    void add(double first, double second) {
        const std::array<double, 5> term{first, second, first * first, second * second, first * second};
        for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += term[k];
    }
    void add(const Moments& other) {
        for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += other.sum[k];
    }
};

double compute_similarity(const Moments& window, double c1, double c2) {
    constexpr double n = kWindow * kWindow;
    constexpr double sample = n / (n - 1.0);
    const double ma = window.sum[0] / n, mb = window.sum[1] / n;
    const double va = sample * (window.sum[2] / n - ma * ma);
    const double vb = sample * (window.sum[3] / n - mb * mb);
    const double cov = sample * (window.sum[4] / n - ma * mb);
    return (2.0 * ma * mb + c1) * (2.0 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
}

/// For each row, returns the sums over every 7 consecutive pixels.
/// @return [rows * (columns - 6)]
std::vector<Moments> sum_along_rows(const std::vector<double>& a, const std::vector<double>& second, int rows,
                                    int columns) {
    const int width = columns - kWindow + 1;
    std::vector<Moments> sums(std::size_t(rows) * std::size_t(width));
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < width; ++column) {
            const std::size_t first = std::size_t(row) * std::size_t(columns) + std::size_t(column);
            Moments& sum = sums[std::size_t(row) * std::size_t(width) + std::size_t(column)];
            for (std::size_t k = 0; k < kWindow; ++k) sum.add(a[first + k], second[first + k]);
        }
    return sums;
}

void check(std::size_t n_a, std::size_t n_b, int rows, int columns, double data_range) {
    if (rows < kWindow || columns < kWindow)
        throw DataError(
            fmt::format("cannot compute the structural similarity: the image has {} x {} pixels, expected at "
                        "least 7 x 7",
                        rows, columns));
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    if (n_a != n || n_b != n)
        throw DataError(fmt::format(
            "cannot compute the structural similarity: the images have {} and {} values, expected {} "
            "values each",
            n_a, n_b, n));
    if (!(data_range > 0.0))
        throw DataError(
            fmt::format("cannot compute the structural similarity: the data range is {}, expected a positive "
                        "number",
                        data_range));
}

}  // namespace

double compute_ssim(const std::vector<double>& first, const std::vector<double>& second, int rows,
                    int columns, double data_range) {
    check(first.size(), second.size(), rows, columns, data_range);
    const double c1 = 0.01 * data_range * 0.01 * data_range, c2 = 0.03 * data_range * 0.03 * data_range;
    const std::vector<Moments> sums = sum_along_rows(first, second, rows, columns);
    const int width = columns - kWindow + 1, height = rows - kWindow + 1;
    double total = 0.0;
    for (int row = 0; row < height; ++row)
        for (int column = 0; column < width; ++column) {
            Moments window;
            for (int k = 0; k < kWindow; ++k)
                window.add(sums[std::size_t(row + k) * std::size_t(width) + std::size_t(column)]);
            total += compute_similarity(window, c1, c2);
        }
    return total / (double(width) * double(height));
}

}  // namespace relidar
