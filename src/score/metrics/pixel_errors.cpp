// SPDX-License-Identifier: Apache-2.0
#include "pixel_errors.hpp"
#include "base/fail.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::metrics {
namespace {

// of ranges and intensities in the published protocol (docs/method.md section 8)
constexpr double kClampLow = 1e-6;

double clamp_value(float value, double maximum) { return std::clamp(double(value), kClampLow, maximum); }

template <typename T>
void require_count(const std::vector<T>& values, std::size_t count, const char* whose, const char* array) {
    if (values.size() != count)
        fail("cannot compare range images: array {1} of the {0} image has {2} values, expected {3}", whose,
             array, values.size(), count);
}

void check_pixels(const std::vector<float>& values, std::size_t count, const char* whose, const char* array) {
    require_count(values, count, whose, array);
    const auto bad = std::find_if(values.begin(), values.end(), [](float v) { return !std::isfinite(v); });
    if (bad != values.end())
        fail(
            "cannot compare range images: array {1} of the {0} image is {2} at pixel {3}, expected a finite "
            "value",
            whose, array, *bad, bad - values.begin());
}

void check_image(const RangeImage& image, const char* image_name) {
    if (image.rows <= 0 || image.columns <= 0)
        fail("cannot compare range images: the {} image has {} x {} pixels, expected at least one pixel",
             image_name, image.rows, image.columns);
    const std::size_t n = std::size_t(image.rows) * std::size_t(image.columns);
    check_pixels(image.range_m, n, image_name, "range_m");
    check_pixels(image.intensity, n, image_name, "intensity");
    check_pixels(image.drop_prob, n, image_name, "drop_prob");
    require_count(image.origin, n, image_name, "origin");
    require_count(image.direction, n, image_name, "direction");
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

/// Adds the root mean square, the mean and the median of the absolute errors.
/// @return mean squared error, or -1 without values
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
    PixelValues a, b;
    for (std::size_t i = 0; i < mask.size(); ++i)
        if (mask[i]) {
            a.push_back(clamp_value(first[i], maximum));
            b.push_back(clamp_value(second[i], maximum));
        }
    add_errors(row, name_prefix, unit_suffix, a, b);
}

}  // namespace relidar::metrics
