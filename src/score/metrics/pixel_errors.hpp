// SPDX-License-Identifier: Apache-2.0
// Pixels of a range image chosen by a mask, and the errors over them. Private to metrics.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::metrics_detail {

using Mask = std::vector<bool>;
using Values = std::vector<double>;

inline constexpr double kRealDropThreshold = 0.5;  // a real image holds 0 or 1
inline constexpr double kMaxIntensity = 1.0;

/// @throws DataError where the images are empty, differ in shape, or hold a value that is
/// not finite
void check_pair(const RangeImage& rendered, const RangeImage& real);

/// Pixels whose drop probability is below the threshold.
Mask not_dropped(const RangeImage& image, double threshold);
/// Of these, the ones that have a range: a pixel whose ray met nothing is a drop,
/// whatever its drop probability says.
Mask returned(const RangeImage& image, double threshold);

/// Every pixel clamped to [1e-6, high], 0 (hence the clamp's lower end) where the mask is
/// unset.
Values masked(const std::vector<float>& values, const Mask& mask, double high);
/// The pixels of the mask alone, clamped to [1e-6, high].
Values selected(const std::vector<float>& values, const Mask& mask, double high);

double mean_of(const Values& values);
double mean_square(const Values& values);

/// Adds <prefix>rmse<unit>, mae and medae; nothing where no pixel is left. @return mean
/// squared error, or -1
double add_errors(MetricRow& row, const std::string& prefix, const std::string& unit, const Values& a,
                  const Values& b);

}  // namespace relidar::metrics_detail
