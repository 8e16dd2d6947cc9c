// SPDX-License-Identifier: Apache-2.0
// Computes the metrics of two protocols for a rendered and a real range image
// (docs/method.md section 8).
//   peer    all pixels, dropped pixels set to 0, values clamped; used by published tables
//   strict  only pixels returned in both images; ray-drop has separate metrics
// Chamfer distance and F-score use only the points of returned pixels. The published
// script of the peer protocol places dropped pixels at the origin instead. This lowers
// the Chamfer distance and raises the F-score.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "base/parallel.hpp"
#include "score/metrics/image_errors.hpp"

namespace relidar {
namespace {

using namespace metrics;

// so that the PSNR of identical images is finite
constexpr double kMinSquaredError = 1e-20;
constexpr int kSsimWindow = 7;
// smaller images would be empty after the pooling layers
constexpr int kLpipsEdge = 31;

/// Adds errors, PSNR, SSIM and LPIPS of the full images of ranges and of intensities, in
/// which dropped pixels are 0. Leaves SSIM out if the real image is constant, or smaller
/// than the SSIM window.
/// @param drop_threshold  rendered pixels with at least this drop probability are dropped
/// @param lpips  null: no LPIPS
void add_image_metrics(MetricValues& row, const std::string& prefix, const RangeImage& rendered,
                       const RangeImage& real, double drop_threshold, double max_range_m,
                       const Lpips* lpips) {
    const PixelMask rendered_mask = undropped_mask(rendered, drop_threshold);
    const PixelMask real_mask = undropped_mask(real, kRealDropThreshold);
    const int edge = std::min(real.rows, real.columns);
    const auto add_metrics_of = [&](std::vector<float> RangeImage::*values, double maximum,
                                    const std::string& name, const char* unit) {
        const PixelValues rendered_values = clamp_masked(rendered.*values, rendered_mask, maximum);
        const PixelValues real_values = clamp_masked(real.*values, real_mask, maximum);
        const double squared_error = add_errors(row, name, unit, rendered_values, real_values);
        row[name + "psnr_db"] =
            10.0 * std::log10(maximum * maximum / std::max(squared_error, kMinSquaredError));
        // As the published code does, SSIM uses the dynamic range of the real image.
        const auto [low, high] = std::ranges::minmax(real_values);
        if (edge >= kSsimWindow && high > low)
            row[name + "ssim"] =
                compute_ssim(rendered_values, real_values, real.rows, real.columns, high - low);
        if (lpips && edge >= kLpipsEdge)
            row[name + "lpips"] =
                lpips->compute_distance(rendered_values, real_values, real.rows, real.columns);
    };
    add_metrics_of(&RangeImage::range_m, max_range_m, prefix + "depth_", "_m");
    add_metrics_of(&RangeImage::intensity, kMaxIntensity, prefix + "intensity_", "");
}

/// Adds the metrics of published papers (docs/method.md section 8): full images in which
/// dropped pixels are 0, and distances of the point clouds.
void add_published(MetricValues& row, const RangeImage& rendered, const RangeImage& real,
                   const MetricOptions& options) {
    const double threshold = options.peer_drop_threshold;
    add_image_metrics(row, "peer/", rendered, real, threshold, options.max_range_m, options.lpips);
    const auto distances = compare_clouds(rendered, return_mask(rendered, threshold), real,
                                          return_mask(real, kRealDropThreshold));
    if (!distances) return;  // neither image has points
    // Not if only one image has points.
    if (!distances->empty()) row["peer/cd_sq_m2"] = distances->squared_chamfer();
    row["peer/f_score"] = distances->compute_f_score(kPeerThreshold_m);
}

/// Adds metrics of a classifier that predicts for each pixel whether its ray is dropped.
/// "Dropped" is the positive class.
void add_drop_metrics(MetricValues& row, const PixelMask& rendered_returns, const PixelMask& real_returns) {
    std::size_t true_drops = 0, false_drops = 0, missed_drops = 0;
    for (std::size_t i = 0; i < real_returns.size(); ++i) {
        const bool rendered_drop = !rendered_returns[i], real_drop = !real_returns[i];
        if (rendered_drop && real_drop) ++true_drops;
        if (rendered_drop && !real_drop) ++false_drops;
        if (!rendered_drop && real_drop) ++missed_drops;
    }
    const std::size_t n_equal = real_returns.size() - false_drops - missed_drops;
    const auto ratio = [](std::size_t part, std::size_t total) {
        return double(part) / double(std::max<std::size_t>(total, 1));
    };
    row["strict/drop_accuracy"] = ratio(n_equal, real_returns.size());
    row["strict/drop_precision"] = ratio(true_drops, true_drops + false_drops);
    row["strict/drop_recall"] = ratio(true_drops, true_drops + missed_drops);
    row["strict/drop_f1"] = ratio(2 * true_drops, 2 * true_drops + false_drops + missed_drops);
}

/// Computes range errors of the pixels with a return in both images. Also computes
/// distances between the rendered and the real point cloud.
void add_point_metrics(MetricValues& row, const std::string& name_prefix, const RangeImage& rendered,
                       const RangeImage& real, const MetricOptions& options) {
    const PixelMask rendered_returns = return_mask(rendered, options.strict_drop_threshold),
                    real_returns = return_mask(real, kRealDropThreshold);
    add_masked_errors(row, name_prefix + "depth_", "_m", rendered.range_m, real.range_m,
                      intersect_masks(rendered_returns, real_returns), options.max_range_m);
    add_cloud_metrics(row, name_prefix, rendered, rendered_returns, real, real_returns);
}

/// Adds metrics that separate errors of ranges and intensities from errors of ray-drop:
/// most values are compared only where both images have a return. Leaves out LPIPS.
void add_strict(MetricValues& row, const RangeImage& rendered, const RangeImage& real,
                const MetricOptions& options) {
    const PixelMask rendered_returns = return_mask(rendered, options.strict_drop_threshold);
    const PixelMask real_returns = return_mask(real, kRealDropThreshold);
    add_masked_errors(row, "strict/intensity_", "", rendered.intensity, real.intensity,
                      intersect_masks(rendered_returns, real_returns), kMaxIntensity);
    add_drop_metrics(row, rendered_returns, real_returns);
    // Errors of the drop probability, without a threshold.
    PixelValues drop_error(real.drop_prob.size());
    for (std::size_t i = 0; i < drop_error.size(); ++i)
        drop_error[i] = double(rendered.drop_prob[i]) - double(real.drop_prob[i]);
    row["strict/drop_rmse"] = std::sqrt(mean_square(drop_error));
    add_image_metrics(row, "strict/image_", rendered, real, options.strict_drop_threshold,
                      options.max_range_m, nullptr);
    add_point_metrics(row, "strict/", rendered, real, options);
}

}  // namespace

MetricValues evaluate(const RangeImage& rendered, const RangeImage& real, const MetricOptions& options) {
    check_comparable(rendered, real);
    MetricValues row;
    add_published(row, rendered, real, options);
    add_strict(row, rendered, real, options);
    return row;
}

MetricValues evaluate_points(const RangeImage& rendered, const RangeImage& real,
                             const MetricOptions& options) {
    check_comparable(rendered, real);
    MetricValues row;
    add_point_metrics(row, "points/", rendered, real, options);
    return row;
}

std::vector<MetricValues> evaluate_all(const std::vector<RangeImageComparison>& images,
                                       const MetricOptions& options) {
    std::vector<MetricValues> rows(images.size());
    parallel_for(static_cast<int>(images.size()), [&](int index) {
        const RangeImageComparison& c = images[static_cast<std::size_t>(index)];
        MetricValues& row = rows[static_cast<std::size_t>(index)];
        row = evaluate(*c.rendered, *c.real, options);
        // Regions are scored with the points' ranges if these differ from the image's.
        RangeImage points = *c.rendered;
        if (!c.point_range_m.empty()) points.range_m = c.point_range_m;
        row.merge(evaluate_regions(points, *c.real, c.regions, options));
        if (!c.point_range_m.empty()) row.merge(evaluate_points(points, *c.real, options));
    });
    return rows;
}

MetricValues mean_metrics(const std::vector<MetricValues>& metric_rows) {
    MetricValues sum;
    std::map<std::string, int> count;
    for (const MetricValues& row : metric_rows)
        for (const auto& [name, value] : row) {
            sum[name] += value;
            ++count[name];
        }
    for (auto& [name, value] : sum) value /= count[name];
    return sum;
}

MetricValues score_classes(const std::vector<std::int32_t>& rendered, std::span<const SurfaceClass> real) {
    // Pixels of each class: in both images, in at least one image, in the real image.
    std::array<double, kSurfaceClasses> n_both{}, n_either{}, n_real{};
    double n = 0.0, n_equal = 0.0;
    for (std::size_t i = 0; i < real.size(); ++i) {
        if (real[i] == SurfaceClass::unknown) continue;
        const auto label = std::size_t(real[i]);
        n += 1.0;
        n_real[label] += 1.0;
        n_either[label] += 1.0;
        const bool has_rendered_class = rendered[i] >= 0;
        if (rendered[i] == std::int32_t(label)) {
            n_equal += 1.0;
            n_both[label] += 1.0;
        } else if (has_rendered_class) n_either[std::size_t(rendered[i])] += 1.0;
    }
    if (n == 0.0) return {};
    // IoU (intersection over union) of a class, averaged over the classes that occur.
    double iou_sum = 0.0, n_classes = 0.0;
    for (std::size_t k = 0; k < kSurfaceClasses; ++k)
        if (n_real[k] > 0.0) {
            iou_sum += n_both[k] / n_either[k];
            n_classes += 1.0;
        }
    return {{"classes/accuracy", n_equal / n}, {"classes/mean_iou", iou_sum / n_classes}};
}

}  // namespace relidar
