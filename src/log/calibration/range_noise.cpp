// SPDX-License-Identifier: Apache-2.0
// Estimates the noise of measured ranges as a function of range and angle of incidence.
// Uses second differences of consecutive ranges of one beam. They do not depend on poses
// or on other beams. They also do not depend on the surface, if it is smooth over three
// firings:
//   sigma = 1.4826 median |r_(i-1) - 2 r_i + r_(i+1)| / sqrt(6)
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <relidar/log/calibration.hpp>
#include <relidar/log/log.hpp>

#include "base/geometry/incidence.hpp"
#include "base/median.hpp"
#include "log/calibration/beam_returns.hpp"

namespace relidar {
namespace {

constexpr std::array kRangeBinEnds_m = {10.0, 20.0, 30.0, 45.0, 80.0};
constexpr std::array kCosineBinEnds = {0.3, 0.6, 1.0};
constexpr std::size_t kBins = kRangeBinEnds_m.size() * kCosineBinEnds.size();
constexpr std::size_t kMostNoiseReturns = 3000000, kFewestOfBin = 200;
// Second differences of ranges above this limit are caused by edges and not by noise.
constexpr float kMaxDifference_m = 0.5f;
// Standard deviation / median absolute value of a normal distribution.
constexpr double kSigmaPerMedian = 1.4826;

// [ranges, cosines] index: range bin * number of cosine bins + cosine bin
using DifferencesByBin = std::array<std::vector<float>, kBins>;

/// Returns the index of the first bin that ends at or above a value, or the last bin.
std::size_t find_bin(const auto& bin_upper_ends, double value) {
    return std::min<std::size_t>(
        std::size_t(std::lower_bound(bin_upper_ends.begin(), bin_upper_ends.end(), value) -
                    bin_upper_ends.begin()),
        bin_upper_ends.size() - 1);
}

/// Collects the absolute second differences, in metres, of the ranges of three
/// consecutive firings of a beam, by bin of range and incidence. On a smooth surface they
/// are nearly 0 without noise.
DifferencesByBin collect_differences(const Frame& frame) {
    DifferencesByBin result;
    const Scan& scan = frame.scan;
    const RayTable& rays = scan.rays;
    const RangeImageRays image{.rows = rays.rows,
                               .columns = rays.columns,
                               .origin = rays.origin,
                               .direction = rays.direction,
                               .range_m = scan.range_m,
                               .circular = is_full_turn(rays.rows, rays.columns, rays.direction)};
    const auto columns = std::size_t(std::max(rays.columns, 1));
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        const double cosine = incidence_cosine(image, ray);  // negative: unknown
        // The previous and the next firing of the beam, in the same row. Column 0 follows
        // the last column. Without a full turn, the cosine at both ends is unknown.
        const std::size_t row_begin = ray / columns * columns,
                          left = row_begin + (ray + columns - 1) % columns,
                          right = row_begin + (ray + 1) % columns;
        if (cosine < 0.0 || !(scan.range_m[left] > 0.0f && scan.range_m[right] > 0.0f)) continue;
        const float difference_m =
            std::abs(scan.range_m[left] - 2.0f * scan.range_m[ray] + scan.range_m[right]);
        if (difference_m > kMaxDifference_m) continue;
        const std::size_t range_bin = find_bin(kRangeBinEnds_m, double(scan.range_m[ray])),
                          cosine_bin = find_bin(kCosineBinEnds, cosine);
        result[range_bin * kCosineBinEnds.size() + cosine_bin].push_back(difference_m);
    }
    return result;
}

/// Fills bins with too few returns, whose value is 0. The value comes from the nearest
/// filled bin of the same incidence at a shorter range, or else at a longer range. If
/// there is none, it is the maximum of all bins.
void fill_empty_bins(RangeNoiseTable& noise) {
    // [ranges, cosines]: bin - n_cosines has the same incidence at a shorter range.
    std::vector<double>& sigma_m = noise.sigma_m;
    const std::size_t n_bins = sigma_m.size(), n_cosines = kCosineBinEnds.size();
    for (std::size_t bin = n_cosines; bin < n_bins; ++bin)
        if (sigma_m[bin] == 0.0) sigma_m[bin] = sigma_m[bin - n_cosines];
    // The bins that are still 0 have no filled bin at a shorter range.
    for (std::size_t bin = n_bins - n_cosines; bin-- > 0;)
        if (sigma_m[bin] == 0.0) sigma_m[bin] = sigma_m[bin + n_cosines];
    const double largest_m = *std::ranges::max_element(sigma_m);
    std::ranges::replace(sigma_m, 0.0, largest_m);
}

/// Estimates the standard deviation of the ranges of one LiDAR in each bin. If no bin has
/// enough returns, the table is empty.
/// @param differences  [frames] second differences, from collect_differences()
/// @return the table, and the number of returns from which it was computed
std::pair<RangeNoiseTable, std::size_t> estimate_noise(const std::vector<DifferencesByBin>& differences) {
    RangeNoiseTable noise{.range_m = {kRangeBinEnds_m.begin(), kRangeBinEnds_m.end()},
                          .cosine = {kCosineBinEnds.begin(), kCosineBinEnds.end()},
                          .sigma_m = std::vector<double>(kBins, 0.0)};
    std::size_t n_returns = 0;
    for (std::size_t bin = 0; bin < kBins; ++bin) {
        std::vector<float> bin_differences_m;
        for (const DifferencesByBin& of_frame : differences)
            bin_differences_m.insert(bin_differences_m.end(), of_frame[bin].begin(), of_frame[bin].end());
        n_returns += bin_differences_m.size();
        // kSigmaPerMedian * median |d| is the standard deviation of the second difference
        // d = r_1 - 2 r_2 + r_3. It is sqrt(1 + 4 + 1) times that of a range.
        if (bin_differences_m.size() >= kFewestOfBin)
            noise.sigma_m[bin] = kSigmaPerMedian * double(compute_median(bin_differences_m)) / std::sqrt(6.0);
    }
    if (*std::ranges::max_element(noise.sigma_m) == 0.0) return {};
    fill_empty_bins(noise);
    return {std::move(noise), n_returns};
}

}  // namespace

double RangeNoiseTable::lookup_sigma_m(double measured_range_m, double incidence_cosine) const {
    if (sigma_m.empty()) return 0.0;
    return sigma_m[find_bin(range_m, measured_range_m) * cosine.size() + find_bin(cosine, incidence_cosine)];
}

std::size_t calibrate_noise(Log& log, const std::vector<int>& frame_indices) {
    std::size_t n_used_returns = 0;
    for (std::size_t lidar = 0; lidar < log.lidars.size(); ++lidar) {
        std::vector<int> frames_of_lidar;
        for (const int frame : frame_indices)
            if (log.frames[std::size_t(frame)].lidar == int(lidar)) frames_of_lidar.push_back(frame);
        const auto [noise, n_returns] =
            estimate_noise(map_frames(log, frames_of_lidar, kMostNoiseReturns, collect_differences));
        log.lidars[lidar].range_noise = noise;
        n_used_returns += n_returns;
    }
    return n_used_returns;
}

}  // namespace relidar
