// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <relidar/score/metrics.hpp>
#include "pixel_errors.hpp"

namespace relidar::metrics {

using PointPositions = std::vector<glm::dvec3>;

inline constexpr double kFineThreshold_m = 0.05;
// sqrt(0.05), because the published code compares squared distances with 0.05
inline constexpr double kPeerThreshold_m = 0.22360679774997896964;

PointPositions masked_points(const RangeImage& image, const PixelMask& mask);

/// to the nearest point of the other cloud, in both directions
struct CloudDistances {
    PixelValues to_truth, to_rendered;

    CloudDistances(const PointPositions& rendered, const PointPositions& truth);
    bool has_distances() const { return !to_truth.empty(); }
    double chamfer() const { return mean_value(to_truth) + mean_value(to_rendered); }
    double squared_chamfer() const { return mean_square(to_truth) + mean_square(to_rendered); }
    /// Returns the harmonic mean of precision and recall, or 0 if a cloud is empty.
    double compute_f_score(double threshold_m) const;
};

/// Adds <prefix>{cd_mean_m,cd_sq_m2,f_5cm,f_22cm} of the points of masked pixels.
void add_cloud_metrics(MetricValues& row, const std::string& name_prefix, const RangeImage& rendered,
                       const PixelMask& rendered_mask, const RangeImage& real, const PixelMask& real_mask);

}  // namespace relidar::metrics
