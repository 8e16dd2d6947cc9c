// SPDX-License-Identifier: Apache-2.0
// Errors of masked pixels, and distances between the point clouds of two range images.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::metrics {

using PixelMask = std::vector<bool>;
using PixelValues = std::vector<double>;

// any value between 0 and 1, because real drop probabilities are 0 or 1
inline constexpr double kRealDropThreshold = 0.5;
inline constexpr double kMaxIntensity = 1.0;

/// @throws DataError if the images are empty, differ in shape, or have values that are
/// not finite
void check_comparable(const RangeImage& rendered, const RangeImage& real);

PixelMask undropped_mask(const RangeImage& image, double drop_threshold);
/// Drop probability below the threshold, and range above 0 (0: the ray hit no surface).
PixelMask return_mask(const RangeImage& image, double drop_threshold);

PixelMask intersect_masks(const PixelMask& first, const PixelMask& second);

/// All pixels, clamped to [1e-6, maximum]. Pixels outside the mask get 1e-6.
PixelValues clamp_masked(const std::vector<float>& values, const PixelMask& mask, double maximum);
double mean_value(const PixelValues& values);
double mean_square(const PixelValues& values);

/// Adds the root mean square, the mean and the median of absolute errors as
/// <prefix>rmse<unit>, <prefix>mae<unit> and <prefix>medae<unit>, unless there are no
/// pixels.
/// @return mean squared error, or -1 if there are no pixels
double add_errors(MetricValues& row, const std::string& name_prefix, const std::string& unit_suffix,
                  const PixelValues& first, const PixelValues& second);
/// Adds the errors of add_errors() over masked pixels, clamped to [1e-6, maximum].
void add_masked_errors(MetricValues& row, const std::string& name_prefix, const std::string& unit_suffix,
                       const std::vector<float>& first, const std::vector<float>& second,
                       const PixelMask& mask, double maximum);

// sqrt(0.05), because the published code compares squared distances with 0.05
inline constexpr double kPeerThreshold_m = 0.22360679774997896964;

/// Distances to the nearest point of the other cloud. Empty if one of the clouds is.
struct CloudDistances {
    PixelValues to_real, to_rendered;

    bool empty() const { return to_real.empty(); }
    double chamfer() const { return mean_value(to_real) + mean_value(to_rendered); }
    double squared_chamfer() const { return mean_square(to_real) + mean_square(to_rendered); }
    /// Returns the harmonic mean of precision and recall, or 0 if a cloud is empty.
    double compute_f_score(double threshold_m) const;
};
/// Compares the points of masked pixels. Returns nothing if both clouds are empty.
std::optional<CloudDistances> compare_clouds(const RangeImage& rendered, const PixelMask& rendered_mask,
                                             const RangeImage& real, const PixelMask& real_mask);

/// Adds <prefix>{cd_mean_m,cd_sq_m2,f_5cm,f_22cm} of the points of masked pixels.
void add_cloud_metrics(MetricValues& row, const std::string& name_prefix, const RangeImage& rendered,
                       const PixelMask& rendered_mask, const RangeImage& real, const PixelMask& real_mask);

}  // namespace relidar::metrics
