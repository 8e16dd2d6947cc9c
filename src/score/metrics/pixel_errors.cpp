// SPDX-License-Identifier: Apache-2.0
// Computes errors over selected pixels of a rendered and a real range image.
#include "pixel_errors.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar::metrics_detail {
namespace {

// The published evaluation protocol ("peer") clamps ranges and intensities to at least
// this value.
constexpr double kClampLow = 1e-6;

double clamp_value(float value, double high) { return std::clamp(double(value), kClampLow, high); }

/// Returns the median of values. For an even number of values, returns the mean of the
/// two middle values.
double median(Values values) {
    const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    if (values.size() % 2 == 1) return *middle;
    return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

void check_values(const std::vector<float>& values, std::size_t count, const char* image, const char* array) {
    if (values.size() != count)
        throw DataError(fmt::format(
            "cannot compare range images: array {1} of the {0} image has {2} values, expected {3}", image,
            array, values.size(), count));
    const auto bad = std::find_if(values.begin(), values.end(), [](float v) { return !std::isfinite(v); });
    if (bad != values.end())
        throw DataError(fmt::format(
            "cannot compare range images: array {1} of the {0} image is {2} at pixel {3}, expected a "
            "finite value",
            image, array, *bad, bad - values.begin()));
}

void check_vectors(const std::vector<glm::vec3>& values, std::size_t count, const char* image,
                   const char* array) {
    if (values.size() != count)
        throw DataError(fmt::format(
            "cannot compare range images: array {1} of the {0} image has {2} values, expected {3}", image,
            array, values.size(), count));
}

void check_image(const RangeImage& image, const char* name) {
    if (image.rows <= 0 || image.columns <= 0)
        throw DataError(
            fmt::format("cannot compare range images: the {} image has {} x {} pixels, expected at least one "
                        "pixel",
                        name, image.rows, image.columns));
    const std::size_t n = std::size_t(image.rows) * std::size_t(image.columns);
    check_values(image.range_m, n, name, "range_m");
    check_values(image.intensity, n, name, "intensity");
    check_values(image.drop_prob, n, name, "drop_prob");
    check_vectors(image.origin, n, name, "origin");
    check_vectors(image.direction, n, name, "direction");
}

}  // namespace

void check_pair(const RangeImage& rendered, const RangeImage& real) {
    check_image(rendered, "rendered");
    check_image(real, "real");
    if (rendered.rows == real.rows && rendered.columns == real.columns) return;
    throw DataError(
        fmt::format("cannot compare range images: the rendered image has {} x {} pixels, but the real image "
                    "has {} x {}",
                    rendered.rows, rendered.columns, real.rows, real.columns));
}

Mask make_return_mask(const RangeImage& image, double threshold) {
    Mask mask(image.drop_prob.size());
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = double(image.drop_prob[i]) < threshold;
    return mask;
}

Mask make_positive_range_mask(const RangeImage& image, double threshold) {
    Mask mask = make_return_mask(image, threshold);
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = mask[i] && image.range_m[i] > 0.0f;
    return mask;
}

Values clamp_masked_values(const std::vector<float>& values, const Mask& mask, double high) {
    Values result(values.size());
    for (std::size_t i = 0; i < values.size(); ++i) result[i] = clamp_value(mask[i] ? values[i] : 0.0f, high);
    return result;
}

Values select_values(const std::vector<float>& values, const Mask& mask, double high) {
    Values result;
    for (std::size_t i = 0; i < values.size(); ++i)
        if (mask[i]) result.push_back(clamp_value(values[i], high));
    return result;
}

double compute_values_mean(const Values& values) {
    double sum = 0.0;
    for (double v : values) sum += v;
    return sum / double(values.size());
}

double compute_mean_square(const Values& values) {
    double sum = 0.0;
    for (double v : values) sum += v * v;
    return sum / double(values.size());
}

double add_errors(MetricRow& row, const std::string& prefix, const std::string& unit, const Values& first,
                  const Values& second) {
    if (first.empty()) return -1.0;
    Values error(first.size());
    for (std::size_t i = 0; i < first.size(); ++i) error[i] = std::abs(first[i] - second[i]);
    const double squared = compute_mean_square(error);
    row[prefix + "rmse" + unit] = std::sqrt(squared);
    row[prefix + "mae" + unit] = compute_values_mean(error);
    row[prefix + "medae" + unit] = median(std::move(error));
    return squared;
}

}  // namespace relidar::metrics_detail
