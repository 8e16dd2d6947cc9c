// SPDX-License-Identifier: Apache-2.0
#include "score/metrics/image_errors.hpp"

#include <algorithm>
#include <cmath>

#include "base/fail.hpp"
#include "base/geometry/nearest_place.hpp"
#include "base/parallel.hpp"

namespace relidar::metrics {
namespace {

// of ranges and intensities in the published protocol (docs/method.md section 8)
constexpr double kClampLow = 1e-6;
constexpr double kFineThreshold_m = 0.05;

/// Checks that all arrays of an image have one finite value per pixel.
/// @param image_name for error messages: "rendered" or "real"
void check_image(const RangeImage& image, const char* image_name) {
    if (image.rows <= 0 || image.columns <= 0)
        fail("cannot compare range images: the {} image has {} x {} pixels, expected at least one pixel",
             image_name, image.rows, image.columns);
    const auto check_size = [&](const char* array, std::size_t size) {
        if (size != std::size_t(image.rows) * std::size_t(image.columns))
            fail("cannot compare range images: array {} of the {} image has {} values, expected {} x {}",
                 array, image_name, size, image.rows, image.columns);
    };
    const auto check_values = [&](const char* array, const std::vector<float>& values) {
        check_size(array, values.size());
        const auto bad = std::ranges::find_if(values, [](float value) { return !std::isfinite(value); });
        if (bad != values.end())
            fail(
                "cannot compare range images: array {} of the {} image is {} at pixel {}, expected a finite "
                "value",
                array, image_name, *bad, bad - values.begin());
    };
    check_values("range_m", image.range_m);
    check_values("intensity", image.intensity);
    check_values("drop_prob", image.drop_prob);
    check_size("origin", image.origin.size());
    check_size("direction", image.direction.size());
}

std::vector<glm::dvec3> masked_points(const RangeImage& image, const PixelMask& mask) {
    std::vector<glm::dvec3> result;
    for (std::size_t i = 0; i < mask.size(); ++i)
        if (mask[i])
            result.push_back(glm::dvec3(image.origin[i]) +
                             double(image.range_m[i]) * glm::dvec3(image.direction[i]));
    return result;
}

double clamp_value(float value, double maximum) { return std::clamp(double(value), kClampLow, maximum); }

double fraction_below(const PixelValues& distances, double threshold) {
    const auto n = std::ranges::count_if(distances, [=](double d) { return d < threshold; });
    return double(n) / double(distances.size());
}

}  // namespace

void check_comparable(const RangeImage& rendered, const RangeImage& real) {
    check_image(rendered, "rendered");
    check_image(real, "real");
    if (rendered.rows == real.rows && rendered.columns == real.columns) return;
    fail("cannot compare range images: the rendered image has {} x {} pixels, but the real image has {} x {}",
         rendered.rows, rendered.columns, real.rows, real.columns);
}

PixelMask undropped_mask(const RangeImage& image, double drop_threshold) {
    PixelMask mask(image.drop_prob.size());
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = double(image.drop_prob[i]) < drop_threshold;
    return mask;
}

PixelMask return_mask(const RangeImage& image, double drop_threshold) {
    PixelMask mask = undropped_mask(image, drop_threshold);
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = mask[i] && image.range_m[i] > 0.0f;
    return mask;
}

PixelMask intersect_masks(const PixelMask& first, const PixelMask& second) {
    PixelMask mask(first.size());
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = first[i] && second[i];
    return mask;
}

PixelValues clamp_masked(const std::vector<float>& values, const PixelMask& mask, double maximum) {
    PixelValues result(values.size());
    for (std::size_t i = 0; i < values.size(); ++i)
        result[i] = clamp_value(mask[i] ? values[i] : 0.0f, maximum);
    return result;
}

double mean_value(const PixelValues& values) {
    double sum = 0.0;
    for (double v : values) sum += v;
    return sum / double(values.size());
}

double mean_square(const PixelValues& values) {
    double sum = 0.0;
    for (double v : values) sum += v * v;
    return sum / double(values.size());
}

double add_errors(MetricValues& row, const std::string& name_prefix, const std::string& unit_suffix,
                  const PixelValues& first, const PixelValues& second) {
    if (first.empty()) return -1.0;
    PixelValues error(first.size());
    for (std::size_t i = 0; i < first.size(); ++i) error[i] = std::abs(first[i] - second[i]);
    const double squared = mean_square(error);
    row[name_prefix + "rmse" + unit_suffix] = std::sqrt(squared);
    row[name_prefix + "mae" + unit_suffix] = mean_value(error);
    const auto middle = error.begin() + std::ptrdiff_t(error.size() / 2);
    std::nth_element(error.begin(), middle, error.end());
    // The median of an even number of errors is the mean of the two middle errors.
    double median = *middle;
    if (error.size() % 2 == 0) median = 0.5 * (*middle + *std::max_element(error.begin(), middle));
    row[name_prefix + "medae" + unit_suffix] = median;
    return squared;
}

void add_masked_errors(MetricValues& row, const std::string& name_prefix, const std::string& unit_suffix,
                       const std::vector<float>& first, const std::vector<float>& second,
                       const PixelMask& mask, double maximum) {
    PixelValues masked_first, masked_second;
    for (std::size_t i = 0; i < mask.size(); ++i)
        if (mask[i]) {
            masked_first.push_back(clamp_value(first[i], maximum));
            masked_second.push_back(clamp_value(second[i], maximum));
        }
    add_errors(row, name_prefix, unit_suffix, masked_first, masked_second);
}

double CloudDistances::compute_f_score(double threshold_m) const {
    if (empty()) return 0.0;
    const double precision = fraction_below(to_real, threshold_m),
                 recall = fraction_below(to_rendered, threshold_m);
    return 2.0 * precision * recall / std::max(precision + recall, 1e-12);
}

std::optional<CloudDistances> compare_clouds(const RangeImage& rendered, const PixelMask& rendered_mask,
                                             const RangeImage& real, const PixelMask& real_mask) {
    const std::vector<glm::dvec3> rendered_points = masked_points(rendered, rendered_mask),
                                  real_points = masked_points(real, real_mask);
    if (rendered_points.empty() && real_points.empty()) return {};
    if (rendered_points.empty() || real_points.empty()) return CloudDistances{};
    return CloudDistances{.to_real = nearest_distances_m(rendered_points, real_points),
                          .to_rendered = nearest_distances_m(real_points, rendered_points)};
}

void add_cloud_metrics(MetricValues& row, const std::string& name_prefix, const RangeImage& rendered,
                       const PixelMask& rendered_mask, const RangeImage& real, const PixelMask& real_mask) {
    const auto distances = compare_clouds(rendered, rendered_mask, real, real_mask);
    if (!distances) return;     // neither image has points
    if (!distances->empty()) {  // both images have points
        row[name_prefix + "cd_mean_m"] = distances->chamfer();
        row[name_prefix + "cd_sq_m2"] = distances->squared_chamfer();
    }
    row[name_prefix + "f_5cm"] = distances->compute_f_score(kFineThreshold_m);
    row[name_prefix + "f_22cm"] = distances->compute_f_score(kPeerThreshold_m);
}

}  // namespace relidar::metrics

namespace relidar {

std::vector<double> nearest_distances_m(const std::vector<glm::dvec3>& from,
                                        const std::vector<glm::dvec3>& to) {
    std::vector<double> distance(from.size());
    if (from.empty()) return distance;
    if (to.empty())
        fail("cannot search nearest points: there are {} query points, but no target point", from.size());
    for (const std::vector<glm::dvec3>* points : {&from, &to})
        for (const glm::dvec3& point : *points) {
            const bool is_finite = std::isfinite(point.x + point.y + point.z);
            if (!is_finite)
                fail("cannot search nearest points: found the point ({}, {}, {}), expected finite metres",
                     point.x, point.y, point.z);
        }
    // In double precision, because the points of a log can be far from the origin.
    const NearestPointFinder<double> targets(to);
    parallel_blocks(from.size(),
                    [&](std::size_t i) { distance[i] = std::sqrt(targets.nearest_distance_sq(from[i])); });
    return distance;
}

}  // namespace relidar
