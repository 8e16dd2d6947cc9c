// SPDX-License-Identifier: Apache-2.0
// Selects pixels of range images by masks and computes errors over these pixels. Private
// to metrics.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::metrics_detail {

using Mask = std::vector<bool>;
using Values = std::vector<double>;

// A pixel of a real image is dropped above this drop probability. Any threshold works,
// because real drop probabilities are 0 or 1.
inline constexpr double kRealDropThreshold = 0.5;
inline constexpr double kMaxIntensity = 1.0;

/// Checks that a rendered and a real image can be compared.
/// @throws DataError if the images are empty, differ in shape, or contain a value that is
/// not finite
void check_pair(const RangeImage& rendered, const RangeImage& real);

/// Returns a mask of the pixels whose drop probability is below the threshold.
Mask make_return_mask(const RangeImage& image, double threshold);
/// Returns a mask of the pixels that have a return: the drop probability is below the
/// threshold and the range is above 0. The range 0 means that the ray hit no surface.
Mask make_positive_range_mask(const RangeImage& image, double threshold);

/// Returns all pixels, clamped to [1e-6, high]. Pixels outside the mask get the lowest
/// value.
Values clamp_masked_values(const std::vector<float>& values, const Mask& mask, double high);
/// Returns only the values of pixels in the mask, clamped to [1e-6, high].
Values select_values(const std::vector<float>& values, const Mask& mask, double high);

double compute_values_mean(const Values& values);
double compute_mean_square(const Values& values);

/// Adds the metrics <prefix>rmse<unit>, <prefix>mae<unit> and <prefix>medae<unit> to the
/// row. Adds nothing if there are no pixels.
/// @return mean squared error, or -1 if there are no pixels
double add_errors(MetricRow& row, const std::string& prefix, const std::string& unit, const Values& first,
                  const Values& second);

}  // namespace relidar::metrics_detail
