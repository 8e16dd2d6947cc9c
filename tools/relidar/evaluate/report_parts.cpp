// SPDX-License-Identifier: Apache-2.0
#include "evaluate/report_parts.hpp"

#include <algorithm>
#include <limits>

#include <fmt/format.h>

#include <relidar/simulate/render.hpp>
#include "evaluate/evaluation.hpp"

namespace relidar::cli {

ReportView make_3d_view(const ScoredFrame& frame, const Config& config, const std::string& title,
                        const std::string& label_of_real_points_name) {
    const RangeImage &rendered = frame.rendered.image, &real = frame.real;
    const std::vector<float>& range_m = point_ranges(frame.rendered, config);
    // Pose of the sensor at each firing, relative to its pose at the frame time.
    FiringPoseInterpolator sensor(frame.rendered, inverse(frame.rendered.world_from_sensor));
    ReportCloud measured{label_of_real_points_name, {}, {}, {}}, simulated{"simulated", {}, {}, {}};
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        const bool has_real = real.range_m[i] > 0.0f,
                   has_simulated = is_ray_returned(rendered.drop_prob[i], range_m[i]);
        const Pose& sensor_from_firing = sensor.pose_of(i);
        // The error is unknown unless the ray returns in both scans.
        const float error_m = has_real && has_simulated ? range_m[i] - real.range_m[i]
                                                        : std::numeric_limits<float>::quiet_NaN();
        const auto add = [&](ReportCloud& cloud, const RangeImage& image, float range) {
            cloud.position_m.push_back(
                glm::vec3(sensor_from_firing * glm::dvec3(image.origin[i] + range * image.direction[i])));
            cloud.intensity.push_back(image.intensity[i]);
            cloud.error_m.push_back(error_m);
        };
        if (has_real) add(measured, real, real.range_m[i]);
        if (has_simulated) add(simulated, rendered, range_m[i]);
    }
    return {title, {std::move(measured), std::move(simulated)}};
}

/// Returns a bar chart with the shares of rays with small and large errors, for each
/// interval of the real range.
ReportBars error_by_range(const Evaluation& result, const std::string& title) {
    ReportBars bars{title,
                    "Each row: rays that return in the real scan, by the range error of the simulated ray. "
                    "Missed: the simulated ray does not return.",
                    {"below 5 cm", "5 to 20 cm", "20 cm to 1 m", "above 1 m", "missed"},
                    {}};
    constexpr auto& kEdges_m = RangeErrorCounts::kRangeEdges_m;
    for (std::size_t r = 0; r + 1 < kEdges_m.size(); ++r) {
        ReportBars::Row row{fmt::format("{} to {} m", kEdges_m[r], kEdges_m[r + 1]), 0.0,
                            std::vector<double>(RangeErrorCounts::kErrorBins)};
        for (const ScoredFrame& frame : result.frames)
            for (std::size_t band = 0; band < row.share.size(); ++band) {
                row.count += frame.range_errors.rays[r][band];
                row.share[band] += frame.range_errors.rays[r][band];
            }
        for (double& share : row.share) share /= std::max(row.count, 1.0);
        bars.rows.push_back(std::move(row));
    }
    return bars;
}

std::vector<ReportKeyMetric> key_metrics() {
    return {
        {"points/depth_medae_m", "Typical range error, m",
         "median of the absolute error over rays that return in both scans; less is better"},
        {"points/depth_rmse_m", "Range error with outliers, m",
         "root mean square error, dominated by missed edges; less is better"},
        {"moving_boxes/depth_medae_m", "Typical range error on moving objects, m",
         "median of the absolute error inside labelled boxes of moving objects; less is better"},
        {"range_40_80_m/depth_medae_m", "Typical range error far away, m",
         "median error of ranges from 40 to 80 m; less is better"},
        {"strict/intensity_mae", "Intensity error",
         "mean over rays that return in both scans, for intensities from 0 to 1; less is better"},
        {"strict/drop_accuracy", "Rays that return or drop as in the real scan",
         "share of all rays for which this is true; 1 is best"},
        {"strict/drop_rmse", "Error of drop probabilities", "root mean square over all rays; less is better"},
        {"strict/drop_recall", "Dropped rays that were predicted",
         "of the rays that drop in the real scan, the share that also drops in the simulation; 1 is best"},
        {"points/cd_mean_m", "Distance between the two point clouds, m",
         "mean distance to the nearest point of the other cloud, summed over both directions; less is "
         "better"},
        {"points/f_22cm", "Points within 22 cm of the other point cloud",
         "F-score: harmonic mean of the shares of simulated and of real points; 1 is best"},
        {"peer/depth_psnr_db", "PSNR of the range image, dB",
         "peak signal-to-noise ratio as in the tables of LiDAR-RT, dropped rays as 0 m; more is better"}};
}

std::string quality_sentence(const MetricValues& mean_metrics) {
    const auto error = mean_metrics.find("points/depth_medae_m"),
               drops = mean_metrics.find("strict/drop_accuracy");
    if (error == mean_metrics.end() || drops == mean_metrics.end()) return "";
    return fmt::format(
        "half of all ranges are within {:.1f} cm of the real ones, and {:.1f} % of all rays return or drop "
        "as in the real scan",
        100.0 * error->second, 100.0 * drops->second);
}

}  // namespace relidar::cli
