// SPDX-License-Identifier: Apache-2.0
// Computes the features of a ray for the decision tree that predicts intensities. The
// first features are rendered values at the ray and around it. The other features compare
// known and rendered intensities of earlier rays, in the same beam and in the beams
// above. Used only in src/log/scatter.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include <relidar/log/scatter.hpp>

namespace relidar::scatter {

/// Offset from a ray to another ray of the range image. Negative rows are above the ray.
struct RayOffset {
    int rows, columns;
};
/// Rectangle in the range image, as offsets to its top left and bottom right ray.
struct RayWindow {
    RayOffset first, last;
};

constexpr std::array<RayOffset, 4> kAdjacentOffsets{{{0, -1}, {0, 1}, {-1, 0}, {1, 0}}};
constexpr std::array<RayWindow, 2> kSmoothingWindows{{{{0, -4}, {0, 4}}, {{-2, 0}, {2, 0}}}};
/// Neighbouring rays whose residuals (known minus rendered intensity) are features.
/// Lasers in adjacent rows fire alternately, so the ray two rows above is more similar.
constexpr std::array<RayOffset, 7> kResidualOffsets{
    {{0, -1}, {0, -2}, {0, -3}, {0, -4}, {-1, 0}, {-2, 0}, {-4, 0}}};
constexpr std::array<RayOffset, 10> kLevelOffsets{
    {{0, -1}, {0, -2}, {0, -3}, {0, -4}, {-1, -1}, {-1, 0}, {-1, 1}, {-2, -1}, {-2, 0}, {-2, 1}}};
constexpr std::array<RayWindow, 5> kMeanWindows{
    {{{0, -2}, {0, -1}}, {{0, -4}, {0, -1}}, {{0, -8}, {0, -1}}, {{-1, -2}, {-1, 2}}, {{-3, -3}, {-1, 3}}}};
constexpr std::array<RayWindow, 2> kSizeWindows{{{{0, -8}, {0, -1}}, {{-2, -3}, {-1, 3}}}};

/// The features use known intensities of rays to the left and, in the rows above, of rays
/// up to this many columns to the right.
constexpr int kMaxColumnsAhead = 3;
constexpr bool is_known_before(RayOffset s) { return s.columns <= (s.rows < 0 ? kMaxColumnsAhead : -1); }
static_assert(std::ranges::all_of(kMeanWindows, is_known_before, &RayWindow::last) &&
              std::ranges::all_of(kSizeWindows, is_known_before, &RayWindow::last) &&
              std::ranges::all_of(kLevelOffsets, is_known_before) &&
              std::ranges::all_of(kResidualOffsets, is_known_before));

constexpr std::size_t kRenderedFeatures = 5;  // intensity, range, spread, cosine, elevation
constexpr std::size_t kFeatures = kRenderedFeatures + 2 * kAdjacentOffsets.size() + kSmoothingWindows.size() +
                                  kResidualOffsets.size() + kLevelOffsets.size() + kMeanWindows.size() +
                                  kSizeWindows.size();
using RayFeatures = std::array<float, kFeatures>;

/// Computes the features with which a decision tree predicts the intensity of a ray.
class RayFeatureExtractor {
public:
    /// Stores references. The caller may fill in values of `known` later.
    /// @param known  [rows*columns] kNoIntensity where the intensity is unknown
    RayFeatureExtractor(const RenderedIntensityImage& rendered, std::span<const float> known)
        : scan_(rendered), known_intensities_(known) {}

    RayFeatures compute_features(int row, int column) const {
        RayFeatures result;
        for (std::size_t k = 0; k < kFeatures; ++k) result[k] = compute_feature(k, row, column);
        return result;
    }

    /// Returns one feature. A path through the decision tree needs only a few features.
    float compute_feature(std::size_t feature_index, int row, int column) const {
        const auto at = [&](RayOffset s) {
            return pixel_index(std::clamp(row + s.rows, 0, scan_.rows - 1), column + s.columns);
        };
        // Intensities are sampled from left to right. A neighbour left of column 0 wraps
        // to the right edge, which is sampled later, so it counts as unknown.
        const auto level = [&](RayOffset s) {
            const bool is_beyond_end = !scan_.circular && column + s.columns >= scan_.columns;
            return row + s.rows < 0 || column + s.columns < 0 || is_beyond_end ? kNoIntensity
                                                                               : known_intensities_[at(s)];
        };
        const auto residual = [&](RayOffset s) {
            const float known_intensity = level(s);
            return known_intensity == kNoIntensity ? known_intensity
                                                   : known_intensity - scan_.intensity[at(s)];
        };
        const auto size = [&](RayOffset s) {
            const float r = residual(s);
            return r == kNoIntensity ? r : std::abs(r);
        };
        /// Returns true if `feature_index` is in the current group of `count` features.
        /// Otherwise subtracts `count`, so that it counts from the next group.
        const auto is_of = [&](std::size_t count) {
            return feature_index < count || (feature_index -= count, false);
        };
        if (is_of(kRenderedFeatures)) return rendered_feature(feature_index, pixel_index(row, column));
        if (is_of(kAdjacentOffsets.size())) return scan_.intensity[at(kAdjacentOffsets[feature_index])];
        if (is_of(kAdjacentOffsets.size()))
            return log_range_ratio(at(kAdjacentOffsets[feature_index]), pixel_index(row, column));
        if (is_of(kSmoothingWindows.size()))
            return window_mean(kSmoothingWindows[feature_index],
                               [&](RayOffset s) { return scan_.intensity[at(s)]; });
        if (is_of(kResidualOffsets.size())) return residual(kResidualOffsets[feature_index]);
        if (is_of(kLevelOffsets.size())) return level(kLevelOffsets[feature_index]);
        if (is_of(kMeanWindows.size())) return window_mean(kMeanWindows[feature_index], residual);
        return window_mean(kSizeWindows[feature_index], size);
    }

private:
    const RenderedIntensityImage& scan_;
    const std::span<const float> known_intensities_;

    std::size_t pixel_index(int row, int column) const {
        const int columns = scan_.columns;
        // Divisions are slow, so the column is wrapped only if it is outside the range
        // image.
        if (!scan_.circular) column = std::clamp(column, 0, columns - 1);
        if (column < 0 || column >= columns) column = (column % columns + columns) % columns;
        return std::size_t(row) * std::size_t(columns) + std::size_t(column);
    }
    float rendered_feature(std::size_t feature_index, std::size_t ray) const {
        const std::array<const std::vector<float>*, kRenderedFeatures> values{
            &scan_.intensity, &scan_.range_m, &scan_.spread_m, &scan_.cosine, &scan_.elevation_rad};
        return (*values[feature_index])[ray];
    }
    /// Returns log(range of another ray / range of this ray).
    float log_range_ratio(std::size_t other_ray_index, std::size_t ray) const {
        return scan_.range_m[other_ray_index] > 0.0f && scan_.range_m[ray] > 0.0f
                   ? std::log(scan_.range_m[other_ray_index] / scan_.range_m[ray])
                   : kNoIntensity;
    }
    /// Returns the mean of the known values in a window, or kNoIntensity if there are
    /// none.
    template <class Value>
    static float window_mean(const RayWindow& window, const Value& get_value) {
        float sum = 0.0f;
        int n = 0;
        for (int row = window.first.rows; row <= window.last.rows; ++row)
            for (int column = window.first.columns; column <= window.last.columns; ++column) {
                const float v = get_value({row, column});
                if (v != kNoIntensity) {
                    sum += v;
                    ++n;
                }
            }
        return n > 0 ? sum / float(n) : kNoIntensity;
    }
};

}  // namespace relidar::scatter
