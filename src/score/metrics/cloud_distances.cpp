// SPDX-License-Identifier: Apache-2.0
#include "cloud_distances.hpp"

#include <algorithm>

namespace relidar::metrics {
namespace {

double fraction_below(const PixelValues& distances, double threshold) {
    const auto n = std::count_if(distances.begin(), distances.end(), [=](double d) { return d < threshold; });
    return double(n) / double(distances.size());
}

}  // namespace

PointPositions masked_points(const RangeImage& image, const PixelMask& mask) {
    PointPositions result;
    for (std::size_t i = 0; i < mask.size(); ++i)
        if (mask[i])
            result.push_back(glm::dvec3(image.origin[i]) +
                             double(image.range_m[i]) * glm::dvec3(image.direction[i]));
    return result;
}

CloudDistances::CloudDistances(const PointPositions& rendered, const PointPositions& truth) {
    if (rendered.empty() || truth.empty()) return;
    to_truth = nearest_distances_m(rendered, truth);
    to_rendered = nearest_distances_m(truth, rendered);
}

double CloudDistances::compute_f_score(double threshold_m) const {
    if (!has_distances()) return 0.0;
    const double precision = fraction_below(to_truth, threshold_m),
                 recall = fraction_below(to_rendered, threshold_m);
    return 2.0 * precision * recall / std::max(precision + recall, 1e-12);
}

void add_cloud_metrics(MetricValues& row, const std::string& name_prefix, const RangeImage& rendered,
                       const PixelMask& rendered_mask, const RangeImage& real, const PixelMask& real_mask) {
    const PointPositions a = masked_points(rendered, rendered_mask), b = masked_points(real, real_mask);
    if (a.empty() && b.empty()) return;
    const CloudDistances distances(a, b);
    if (distances.has_distances()) {
        row[name_prefix + "cd_mean_m"] = distances.chamfer();
        row[name_prefix + "cd_sq_m2"] = distances.squared_chamfer();
    }
    row[name_prefix + "f_5cm"] = distances.compute_f_score(kFineThreshold_m);
    row[name_prefix + "f_22cm"] = distances.compute_f_score(kPeerThreshold_m);
}

}  // namespace relidar::metrics
