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

#include <relidar/log/sequence.hpp>

#include "base/geometry/incidence.hpp"
#include "base/median.hpp"
#include "log/sequence/beam_returns.hpp"

namespace relidar {
namespace {

constexpr std::array kRangeBinEnds_m = {10.0, 20.0, 30.0, 45.0, 80.0};
constexpr std::array kCosineBinEnds = {0.3, 0.6, 1.0};
constexpr std::size_t kBins = kRangeBinEnds_m.size() * kCosineBinEnds.size();
constexpr std::size_t kMostNoiseReturns = 3000000, kFewestOfBin = 200;
// Second differences of ranges above this limit are caused by edges and not by noise.
constexpr float kMaxDifference_m = 0.5f;
// Standard deviation / median absolute value of a normal distribution.
constexpr double kOfMedian = 1.4826;

using DifferencesByBin = std::array<std::vector<float>, kBins>;

std::size_t find_bin(const auto& bin_upper_ends, double value) {
    return std::min<std::size_t>(
        std::size_t(std::lower_bound(bin_upper_ends.begin(), bin_upper_ends.end(), value) -
                    bin_upper_ends.begin()),
        bin_upper_ends.size() - 1);
}

/// Collects second differences of the ranges of three consecutive firings of a beam, by
/// bin of range and incidence.
DifferencesByBin collect_differences(const Frame& frame) {
    DifferencesByBin result;
    const Scan& scan = frame.scan;
    const RangeImageRays image{
        scan.rays.rows,   scan.rays.columns,
        scan.rays.origin, scan.rays.direction,
        scan.range_m,     is_full_turn(scan.rays.rows, scan.rays.columns, scan.rays.direction)};
    const auto columns = std::size_t(std::max(scan.rays.columns, 1));
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
        const double cosine = incidence_cosine(image, i);
        const std::size_t row = i / columns * columns, left = row + (i + columns - 1) % columns,
                          right = row + (i + 1) % columns;
        if (cosine < 0.0 || !(scan.range_m[left] > 0.0f && scan.range_m[right] > 0.0f)) continue;
        const float difference_m =
            std::abs(scan.range_m[left] - 2.0f * scan.range_m[i] + scan.range_m[right]);
        if (difference_m > kMaxDifference_m) continue;
        const std::size_t b = find_bin(kRangeBinEnds_m, double(scan.range_m[i])) * kCosineBinEnds.size() +
                              find_bin(kCosineBinEnds, cosine);
        result[b].push_back(difference_m);
    }
    return result;
}

/// Fills bins that have too few returns, at the same incidence from the next nearer range
/// or else from the next farther range. If neither exists, uses the maximum of all bins.
void fill_empty_bins(RangeNoiseTable& noise) {
    const std::size_t n_cosines = kCosineBinEnds.size();
    for (std::size_t i = 0; i < noise.sigma_m.size(); ++i)
        if (noise.sigma_m[i] == 0.0 && i >= n_cosines) noise.sigma_m[i] = noise.sigma_m[i - n_cosines];
    for (std::size_t i = noise.sigma_m.size(); i-- > 0;)
        if (noise.sigma_m[i] == 0.0 && i + n_cosines < noise.sigma_m.size())
            noise.sigma_m[i] = noise.sigma_m[i + n_cosines];
    for (std::size_t i = noise.sigma_m.size(); i-- > 0;)
        if (noise.sigma_m[i] == 0.0)
            noise.sigma_m[i] = *std::max_element(noise.sigma_m.begin(), noise.sigma_m.end());
}

/// Estimates the range noise of one LiDAR, and counts the returns that were used. Without
/// a bin of enough returns, the table is empty.
std::pair<RangeNoiseTable, std::size_t> estimate_noise(const std::vector<DifferencesByBin>& differences) {
    RangeNoiseTable noise{{kRangeBinEnds_m.begin(), kRangeBinEnds_m.end()},
                          {kCosineBinEnds.begin(), kCosineBinEnds.end()},
                          std::vector<double>(kBins, 0.0)};
    std::size_t n = 0;
    for (std::size_t b = 0; b < kBins; ++b) {
        std::vector<float> all;
        for (const DifferencesByBin& frame : differences)
            all.insert(all.end(), frame[b].begin(), frame[b].end());
        n += all.size();
        // The second difference of three independent ranges has sqrt(1 + 4 + 1) times
        // their noise.
        if (all.size() >= kFewestOfBin)
            noise.sigma_m[b] = kOfMedian * double(compute_median(all)) / std::sqrt(6.0);
    }
    if (*std::max_element(noise.sigma_m.begin(), noise.sigma_m.end()) == 0.0) return {};
    fill_empty_bins(noise);
    return {std::move(noise), n};
}

}  // namespace

double RangeNoiseTable::lookup_sigma_m(double measured_range_m, double incidence_cosine) const {
    if (sigma_m.empty()) return 0.0;
    return sigma_m[find_bin(range_m, measured_range_m) * cosine.size() + find_bin(cosine, incidence_cosine)];
}

std::size_t calibrate_noise(Log& sequence, const std::vector<int>& frame_indices) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < sequence.lidars.size(); ++i) {
        std::vector<int> lidar_frame_indices;
        for (const int position : frame_indices)
            if (sequence.frames[std::size_t(position)].lidar == int(i))
                lidar_frame_indices.push_back(position);
        const auto [noise, n_returns] =
            estimate_noise(map_frames(sequence, lidar_frame_indices, kMostNoiseReturns, collect_differences));
        sequence.lidars[i].range_noise = noise;
        n += n_returns;
    }
    return n;
}

}  // namespace relidar
