// SPDX-License-Identifier: Apache-2.0
#include "evaluate/run_report.hpp"

#include <algorithm>
#include <limits>

#include <fmt/format.h>

#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>
#include "console.hpp"
#include "evaluate/evaluation.hpp"
#include "evaluate/pictures.hpp"

namespace relidar::cli {
namespace {

std::string count_frames(std::size_t count) {
    return fmt::format("{} frame{}", count, count == 1 ? "" : "s");
}

/// Returns the total loss and its terms over the iterations, without terms that are
/// always 0.
std::vector<ReportCurve> loss_curves(const TrainResult& result) {
    std::vector<ReportCurve> curves{{"loss/total", {}, {}}};
    for (const char* name : kLossTermNames) curves.push_back({std::string("loss/") + name, {}, {}});
    std::vector<bool> used(curves.size(), false);
    for (const TrainProgress& p : result.log) {
        for (std::size_t k = 0; k < curves.size(); ++k) {
            // Curve 0 is the total, curve k is term k - 1.
            const double value = k == 0 ? p.loss : p.terms[k - 1];
            used[k] = used[k] || value != 0.0;
            curves[k].x.push_back(p.iteration);
            curves[k].y.push_back(value);
        }
    }
    std::vector<ReportCurve> result_curves;
    for (std::size_t k = 0; k < curves.size(); ++k) {
        if (used[k]) result_curves.push_back(std::move(curves[k]));
    }
    return result_curves;
}

/// Real and simulated points in the sensor frame at the time of the frame.
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

std::string quality_sentence(const MetricValues& mean_metrics) {
    const auto error = mean_metrics.find("points/depth_medae_m"),
               drops = mean_metrics.find("strict/drop_accuracy");
    if (error == mean_metrics.end() || drops == mean_metrics.end()) return "";
    return fmt::format(
        "half of all ranges are within {:.1f} cm of the real ones, and {:.1f} % of all rays return or drop "
        "as in the real scan",
        100.0 * error->second, 100.0 * drops->second);
}

}  // namespace

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

Report training_report(const Run& run, const TrainResult& trained, const Device& device,
                       const std::string& args) {
    const int done = trained.log.empty() ? 0 : trained.log.back().iteration;
    const SpinningSensor& sensor = run.sequence.lidars[0].sensor;
    Report report;
    report.title = "relidar: " + run.sequence.name;
    report.summary = fmt::format("{} of a {} x {} LiDAR became {} surfels in {} of training.",
                                 count_frames(run.split.train.size()), sensor.beams.size(), sensor.columns,
                                 count_surfels(run.scene), format_duration(trained.train_s));
    report.facts = {{"Command", args},
                    {"Log", run.sequence.source},
                    {"Preset", run.config.preset},
                    {"Image", run.config.sensor.grid == "native"
                                  ? "native"
                                  : run.config.sensor.grid + ", " + run.config.sensor.grid_method},
                    {"Range", run.config.render.range},
                    {"Surfels", fmt::format("{}", count_surfels(run.scene))},
                    {"Iterations", fmt::format("{} of {}", done, run.config.train.iterations)},
                    {"Initialisation", format_duration(trained.initialise_s)},
                    {"Training", fmt::format("{} ({:.2f} iterations/s)", format_duration(trained.train_s),
                                             trained.train_s > 0.0 ? done / trained.train_s : 0.0)},
                    {"Device", device.info().name},
                    {"Driver", device.info().driver},
                    {"Traversal", device.backend() == RayTracingBackend::software ? "software" : "ray query"},
                    {"Peak device memory", format_bytes(trained.peak_device_bytes)},
                    {"relidar", RELIDAR_VERSION}};
    if (const std::vector<BoxTrack> masked = find_unmodelled(run.scene, run.sequence, run.config.init);
        !masked.empty())
        report.facts.emplace_back("Moving objects that are not trained", format_box_list(masked));
    report.curves = loss_curves(trained);
    if (const MetricValues times = mean_kernel_ms(trained.times); !times.empty())
        report.timings_ms.emplace_back("Training: mean time of one kernel launch", times);
    return report;
}

Report evaluation_report(const Run& run, const Evaluation& result, const Device& device,
                         const std::string& args) {
    Report report;
    report.title = "relidar: " + run.sequence.name + ", scored";
    report.summary = fmt::format("A scene of {} surfels, rendered in {:.2f} s per frame.",
                                 count_surfels(run.scene), result.trace_ms / 1000.0);
    report.facts = {{"Command", args},
                    {"Run", run.folder.string()},
                    {"Log", run.sequence.source},
                    {"Device", device.info().name},
                    {"Driver", device.info().driver},
                    {"relidar", RELIDAR_VERSION}};
    add_evaluation(report, result, run, {"held out", "real"});
    return report;
}

void add_evaluation(Report& report, const Evaluation& result, const Run& run,
                    const EvaluationLabels& labels) {
    if (result.frames.empty()) return;
    // True only in the first call: the report has no metrics yet.
    if (const std::string good = quality_sentence(result.mean);
        report.metrics.empty() && !good.empty() && report.summary.ends_with('.')) {
        report.summary.pop_back();
        report.summary += fmt::format("; on {} that did not train the scene, {}.",
                                      count_frames(result.frames.size()), good);
    }
    report.key_metrics = key_metrics();
    report.metrics.emplace_back(fmt::format("{} ({})", labels.column, count_frames(result.frames.size())),
                                result.mean);
    report.facts.emplace_back(fmt::format("Rendering, {}", labels.column),
                              fmt::format("{:.1f} ms per frame", result.trace_ms));
    if (!result.kernel_ms.empty())
        report.timings_ms.emplace_back(
            fmt::format("Rendering, {}: mean time of one kernel launch", labels.column), result.kernel_ms);
    // The middle frame is shown as an example.
    const ScoredFrame& shown = result.frames[result.frames.size() / 2];
    const std::string name = fmt::format("Frame {}, {}", shown.frame, labels.column);
    report.views.push_back(make_3d_view(shown, run.config, name + ": points", labels.real));
    report.bars.push_back(error_by_range(result, fmt::format("Errors by range, {}", labels.column)));
    report.tables.push_back(
        {fmt::format("Depth edges, {}", labels.column),
         "A pixel is at an edge if its real range differs from that of a neighbour by more than 0.5 m and 5 "
         "%. Also returned: share of these real returns that the simulation returns. The limit is the real "
         "scan after each scan in which the sensor stands still, if the log has such scans.",
         edge_rows(result)});
    report.tables.push_back(
        {fmt::format("Moving objects, {}", labels.column),
         "Points of all frames in each moving box. The box with the highest share of errors above 0.3 m is "
         "first. Bias: median of simulated minus real ranges. F1: agreement on which rays return from the "
         "box, 1 is best. Trail points: points at places that the object occupies only at other times.",
         worst_actor_rows(result)});
    for (ReportFigure& figure : comparison_figures(shown, name, labels.real, run.config.dataset.max_range_m))
        report.figures.push_back(std::move(figure));
}

}  // namespace relidar::cli
