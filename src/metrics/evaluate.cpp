// SPDX-License-Identifier: Apache-2.0
// The two metric protocols of docs/method.md section 8 on one pair of range images.
//   peer    every pixel, dropped ones at 0, clamped; how published tables are made
//   strict  only pixels returned in both; ray drop scored by itself
// Chamfer distance and F-score always use the points of returned pixels only: placing dropped pixels at the origin, as the
// peer's released script does, dilutes the first and inflates the second.
#include <relidar/metrics.hpp>

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {
namespace {

using Mask = std::vector<bool>;
using Values = std::vector<double>;
using Points = std::vector<glm::dvec3>;

constexpr double kRealDropThreshold = 0.5;                      // a real image holds 0 or 1
constexpr double kClampLow = 1e-6;                              // lower end of the peer's clamp, depth and intensity alike
constexpr double kMaxIntensity = 1.0;
constexpr double kMinSquaredError = 1e-20;                      // caps PSNR of identical images at a finite value
constexpr double kFineThreshold_m = 0.05;
constexpr double kPeerThreshold_m = 0.22360679774997896964;     // sqrt(0.05): the peer compares the squared distance with 0.05
constexpr int kSsimWindow = 7;

void check_values(const std::vector<float>& values, std::size_t n, const char* image, const char* array) {
    if (values.size() != n)
        throw DataError(fmt::format("evaluating a range image: {} {} has {} values, expected {}", image, array, values.size(), n));
    const auto bad = std::find_if(values.begin(), values.end(), [](float v) { return !std::isfinite(v); });
    if (bad != values.end())
        throw DataError(fmt::format("evaluating a range image: {} {} is {} at pixel {}, expected a finite value", image, array, *bad,
                                    bad - values.begin()));
}

void check_vectors(const std::vector<glm::vec3>& values, std::size_t n, const char* image, const char* array) {
    if (values.size() != n)
        throw DataError(fmt::format("evaluating a range image: {} {} has {} values, expected {}", image, array, values.size(), n));
}

void check_image(const RangeImage& image, const char* name) {
    if (image.rows <= 0 || image.columns <= 0)
        throw DataError(fmt::format("evaluating a range image: the {} one has {} x {} pixels", name, image.rows, image.columns));
    const std::size_t n = std::size_t(image.rows) * std::size_t(image.columns);
    check_values(image.range_m, n, name, "range_m");
    check_values(image.intensity, n, name, "intensity");
    check_values(image.drop_prob, n, name, "drop_prob");
    check_vectors(image.origin, n, name, "origin");
    check_vectors(image.direction, n, name, "direction");
}

Mask not_dropped(const RangeImage& image, double threshold) {
    Mask mask(image.drop_prob.size());
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = double(image.drop_prob[i]) < threshold;
    return mask;
}

/// A return needs a range: a pixel whose ray met nothing is a drop, whatever its drop probability says.
Mask returned(const RangeImage& image, double threshold) {
    Mask mask = not_dropped(image, threshold);
    for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = mask[i] && image.range_m[i] > 0.0f;
    return mask;
}

double clamped(float value, double high) { return std::clamp(double(value), kClampLow, high); }

/// Every pixel, 0 (hence the clamp's lower end) where the mask is unset.
Values masked(const std::vector<float>& values, const Mask& mask, double high) {
    Values result(values.size());
    for (std::size_t i = 0; i < values.size(); ++i) result[i] = clamped(mask[i] ? values[i] : 0.0f, high);
    return result;
}

/// The pixels of the mask alone.
Values selected(const std::vector<float>& values, const Mask& mask, double high) {
    Values result;
    for (std::size_t i = 0; i < values.size(); ++i)
        if (mask[i]) result.push_back(clamped(values[i], high));
    return result;
}

Points points(const RangeImage& image, const Mask& mask) {
    Points result;
    for (std::size_t i = 0; i < mask.size(); ++i)
        if (mask[i]) result.push_back(glm::dvec3(image.origin[i]) + double(image.range_m[i]) * glm::dvec3(image.direction[i]));
    return result;
}

double mean_of(const Values& values) {
    double sum = 0.0;
    for (double v : values) sum += v;
    return sum / double(values.size());
}

double mean_square(const Values& values) {
    double sum = 0.0;
    for (double v : values) sum += v * v;
    return sum / double(values.size());
}

/// Middle value; mean of the two middle ones for an even count. Reorders its argument.
double median(Values values) {
    const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    if (values.size() % 2 == 1) return *middle;
    return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

/// RMSE, MAE, MedAE; nothing where no pixel is left. @return mean squared error, or -1
double add_errors(MetricRow& row, const std::string& prefix, const std::string& unit, const Values& a, const Values& b) {
    if (a.empty()) return -1.0;
    Values error(a.size());
    for (std::size_t i = 0; i < a.size(); ++i) error[i] = std::abs(a[i] - b[i]);
    const double squared = mean_square(error);
    row[prefix + "rmse" + unit] = std::sqrt(squared);
    row[prefix + "mae" + unit] = mean_of(error);
    row[prefix + "medae" + unit] = median(std::move(error));
    return squared;
}

/// Errors, PSNR and SSIM of whole images. SSIM is left out where it is undefined (image below the window, constant truth).
void add_image(MetricRow& row, const std::string& prefix, const std::string& unit, const Values& a, const Values& truth,
               const RangeImage& shape, double peak) {
    const double squared = add_errors(row, prefix, unit, a, truth);
    row[prefix + "psnr_db"] = 10.0 * std::log10(peak * peak / std::max(squared, kMinSquaredError));
    const auto [low, high] = std::minmax_element(truth.begin(), truth.end());
    if (shape.rows >= kSsimWindow && shape.columns >= kSsimWindow && *high > *low)
        row[prefix + "ssim"] = ssim(a, truth, shape.rows, shape.columns, *high - *low);
}

double share_below(const Values& distances, double threshold) {
    const auto n = std::count_if(distances.begin(), distances.end(), [=](double d) { return d < threshold; });
    return double(n) / double(distances.size());
}

/// Nearest distances both ways between two clouds.
struct CloudDistances {
    Values to_truth, to_rendered;

    CloudDistances(const Points& rendered, const Points& truth) {
        if (rendered.empty() || truth.empty()) return;
        to_truth = nearest_distances(rendered, truth);
        to_rendered = nearest_distances(truth, rendered);
    }
    bool defined() const { return !to_truth.empty(); }
    double chamfer() const { return mean_of(to_truth) + mean_of(to_rendered); }
    double chamfer_squared() const { return mean_square(to_truth) + mean_square(to_rendered); }
    /// Harmonic mean of precision and recall; 0 where one cloud is empty.
    double f_score(double threshold_m) const {
        if (!defined()) return 0.0;
        const double precision = share_below(to_truth, threshold_m), recall = share_below(to_rendered, threshold_m);
        return 2.0 * precision * recall / std::max(precision + recall, 1e-12);
    }
};

void add_peer(MetricRow& row, const RangeImage& rendered, const RangeImage& real, const MetricOptions& options) {
    const Mask kept = not_dropped(rendered, options.peer_drop_threshold);
    const Mask truth = not_dropped(real, kRealDropThreshold);
    add_image(row, "peer/depth_", "_m", masked(rendered.range_m, kept, options.max_range_m),
              masked(real.range_m, truth, options.max_range_m), real, options.max_range_m);
    add_image(row, "peer/intensity_", "", masked(rendered.intensity, kept, kMaxIntensity),
              masked(real.intensity, truth, kMaxIntensity), real, kMaxIntensity);

    const Points a = points(rendered, returned(rendered, options.peer_drop_threshold));
    const Points b = points(real, returned(real, kRealDropThreshold));
    if (a.empty() && b.empty()) return;
    const CloudDistances distances(a, b);
    if (distances.defined()) row["peer/cd_sq_m2"] = distances.chamfer_squared();
    row["peer/f_score"] = distances.f_score(kPeerThreshold_m);
}

/// Ray drop as a classification; positive = dropped.
void add_drop(MetricRow& row, const Mask& rendered, const Mask& real) {
    std::size_t hits = 0, false_drops = 0, missed_drops = 0, equal = 0;
    for (std::size_t i = 0; i < real.size(); ++i) {
        hits += !rendered[i] && !real[i];
        false_drops += !rendered[i] && real[i];
        missed_drops += rendered[i] && !real[i];
        equal += rendered[i] == real[i];
    }
    const auto ratio = [](std::size_t a, std::size_t b) { return double(a) / double(std::max<std::size_t>(b, 1)); };
    row["strict/drop_accuracy"] = ratio(equal, real.size());
    row["strict/drop_precision"] = ratio(hits, hits + false_drops);
    row["strict/drop_recall"] = ratio(hits, hits + missed_drops);
    row["strict/drop_f1"] = ratio(2 * hits, 2 * hits + false_drops + missed_drops);
}

void add_strict(MetricRow& row, const RangeImage& rendered, const RangeImage& real, const MetricOptions& options) {
    const Mask kept = returned(rendered, options.strict_drop_threshold);
    const Mask truth = returned(real, kRealDropThreshold);
    Mask both(truth.size());
    for (std::size_t i = 0; i < both.size(); ++i) both[i] = kept[i] && truth[i];
    add_errors(row, "strict/depth_", "_m", selected(rendered.range_m, both, options.max_range_m),
               selected(real.range_m, both, options.max_range_m));
    add_errors(row, "strict/intensity_", "", selected(rendered.intensity, both, kMaxIntensity),
               selected(real.intensity, both, kMaxIntensity));
    add_drop(row, kept, truth);

    const Points a = points(rendered, kept), b = points(real, truth);
    if (a.empty() && b.empty()) return;
    const CloudDistances distances(a, b);
    if (distances.defined()) {
        row["strict/cd_mean_m"] = distances.chamfer();
        row["strict/cd_sq_m2"] = distances.chamfer_squared();
    }
    row["strict/f_5cm"] = distances.f_score(kFineThreshold_m);
    row["strict/f_22cm"] = distances.f_score(kPeerThreshold_m);
}

}  // namespace

MetricRow evaluate(const RangeImage& rendered, const RangeImage& real, const MetricOptions& options) {
    check_image(rendered, "rendered");
    check_image(real, "real");
    if (rendered.rows != real.rows || rendered.columns != real.columns)
        throw DataError(fmt::format("evaluating a range image: {} x {} pixels rendered, {} x {} real", rendered.rows,
                                    rendered.columns, real.rows, real.columns));
    MetricRow row;
    add_peer(row, rendered, real, options);
    add_strict(row, rendered, real, options);
    return row;
}

MetricRow mean(const std::vector<MetricRow>& rows) {
    MetricRow sum;
    std::map<std::string, int> count;
    for (const MetricRow& row : rows)
        for (const auto& [name, value] : row) {
            sum[name] += value;
            ++count[name];
        }
    for (auto& [name, value] : sum) value /= count[name];
    return sum;
}

}  // namespace relidar
