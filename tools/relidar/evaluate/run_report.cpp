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

using ReportFacts = std::vector<std::pair<std::string, std::string>>;  ///< name and text

std::string count_frames(std::size_t count) {
    return fmt::format("{} frame{}", count, count == 1 ? "" : "s");
}

/// Returns the total loss and its terms over the iterations, except terms always 0.
std::vector<ReportCurve> loss_curves(const TrainResult& result) {
    std::vector<ReportCurve> curves{{"loss/total", {}, {}}};
    for (const char* name : kLossTermNames) curves.push_back({std::string("loss/") + name, {}, {}});
    for (const TrainProgress& line : result.log)
        for (std::size_t k = 0; k < curves.size(); ++k) {
            // Curve 0 is the total, curve k is term k - 1.
            curves[k].x.push_back(line.iteration);
            curves[k].y.push_back(k == 0 ? line.loss : line.terms[k - 1]);
        }
    // The loss of a term that the settings do not use is 0 in all iterations.
    std::erase_if(curves, [](const ReportCurve& curve) {
        return std::ranges::all_of(curve.y, [](double loss) { return loss == 0.0; });
    });
    return curves;
}

/// Returns the real and the simulated points of a frame for the 3D view of the report.
/// All points are in the sensor frame at the time of the frame, although each ray has
/// fired from another pose of the moving sensor.
ReportView make_3d_view(const ScoredFrame& frame, const Config& config, const std::string& title,
                        const std::string& real_name) {
    const RangeImage &rendered = frame.rendered.image, &real = frame.real;
    const std::vector<float>& range_m = point_ranges(frame.rendered, config);
    FiringPoseInterpolator sensor(frame.rendered, inverse(frame.rendered.world_from_sensor));
    ReportCloud measured, simulated;
    measured.name = real_name;
    simulated.name = "simulated";
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        const bool has_real = real.range_m[i] > 0.0f,
                   has_simulated = is_ray_returned(rendered.drop_prob[i], range_m[i]);
        const Pose& sensor_from_firing = sensor.pose_of(i);
        // The error is unknown unless the ray returns in both scans.
        const float error_m = has_real && has_simulated ? range_m[i] - real.range_m[i]
                                                        : std::numeric_limits<float>::quiet_NaN();
        const auto add_point = [&](ReportCloud& cloud, const RangeImage& image, float distance_m) {
            const glm::dvec3 firing_m(image.origin[i] + distance_m * image.direction[i]);
            cloud.position_m.push_back(glm::vec3(sensor_from_firing * firing_m));
            cloud.intensity.push_back(image.intensity[i]);
            cloud.error_m.push_back(error_m);
        };
        if (has_real) add_point(measured, real, real.range_m[i]);
        if (has_simulated) add_point(simulated, rendered, range_m[i]);
    }
    return {title, {std::move(measured), std::move(simulated)}};
}

/// Returns a bar chart. Each row is an interval of the real range, and its bands are the
/// shares of rays with small and large errors (RangeErrorCounts::kErrorEdges_m).
ReportBars error_by_range(const Evaluation& result, const std::string& title) {
    ReportBars bars{.title = title,
                    .note =
                        "Each row: rays that return in the real scan, by the range error of the simulated "
                        "ray. Missed: the simulated ray does not return.",
                    .bands = {"below 5 cm", "5 to 20 cm", "20 cm to 1 m", "above 1 m", "missed"},
                    .rows = {}};
    constexpr auto& kEdges_m = RangeErrorCounts::kRangeEdges_m;
    for (std::size_t interval = 0; interval + 1 < kEdges_m.size(); ++interval) {
        ReportBars::Row row{.name = fmt::format("{} to {} m", kEdges_m[interval], kEdges_m[interval + 1]),
                            .share = std::vector<double>(RangeErrorCounts::kErrorBins)};
        // Sums the numbers of rays of all frames, which then become shares.
        for (const ScoredFrame& frame : result.frames)
            for (std::size_t band = 0; band < row.share.size(); ++band) {
                row.count += frame.range_errors.rays[interval][band];
                row.share[band] += frame.range_errors.rays[interval][band];
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

/// Returns the facts in the report of a training: input, settings, sizes and times.
/// @param args command line as the user typed it
ReportFacts training_facts(const Run& run, const TrainResult& trained, const Device& device,
                           const std::string& args) {
    const int n_iterations = trained.log.empty() ? 0 : trained.log.back().iteration;
    const double iterations_per_s = trained.train_s > 0.0 ? n_iterations / trained.train_s : 0.0;
    const auto& sensor = run.config.sensor;
    const bool is_native = sensor.grid == "native";
    return {{"Command", args},
            {"Log", run.log.source},
            {"Preset", run.config.preset},
            {"Image", is_native ? "native" : sensor.grid + ", " + sensor.grid_method},
            {"Range", run.config.render.range},
            {"Surfels", fmt::format("{}", count_surfels(run.scene))},
            {"Iterations", fmt::format("{} of {}", n_iterations, run.config.train.iterations)},
            {"Initialisation", format_duration(trained.initialise_s)},
            {"Training",
             fmt::format("{} ({:.2f} iterations/s)", format_duration(trained.train_s), iterations_per_s)},
            {"Device", device.info().name},
            {"Driver", device.info().driver},
            {"Traversal", device.backend() == RayTracingBackend::software ? "software" : "ray query"},
            {"Peak device memory", format_bytes(trained.peak_device_bytes)},
            {"relidar", RELIDAR_VERSION}};
}

/// Appends the quality of the result to the summary of a report.
void extend_summary(Report& report, const Evaluation& result) {
    const std::string quality = quality_sentence(result.mean);
    if (quality.empty() || !report.summary.ends_with('.')) return;
    report.summary.pop_back();
    report.summary +=
        fmt::format("; on {} that did not train the scene, {}.", count_frames(result.frames.size()), quality);
}

/// Adds tables of the scores at depth edges and of the moving objects.
void add_score_tables(Report& report, const Evaluation& result, const std::string& column) {
    report.tables.push_back(
        {fmt::format("Depth edges, {}", column),
         "A pixel is at an edge if its real range differs from that of a neighbour by more than 0.5 m and 5 "
         "%. Also returned: share of these real returns that the simulation returns. The limit is the real "
         "scan after each scan in which the sensor stands still, if the log has such scans.",
         edge_rows(result)});
    report.tables.push_back(
        {fmt::format("Moving objects, {}", column),
         "Points of all frames in each moving box. The box with the highest share of errors above 0.3 m is "
         "first. Bias: median of simulated minus real ranges. F1: agreement on which rays return from the "
         "box, 1 is best. Trail points: points at places that the object occupies only at other times.",
         worst_actor_rows(result)});
}

/// Shows one frame as points and as images.
void add_example_frame(Report& report, const ScoredFrame& frame, const Config& config,
                       const EvaluationLabels& labels) {
    const std::string name = fmt::format("Frame {}, {}", frame.frame, labels.column);
    report.views.push_back(make_3d_view(frame, config, name + ": points", labels.real));
    for (ReportFigure& figure : comparison_figures(frame, name, labels.real, config.dataset.max_range_m))
        report.figures.push_back(std::move(figure));
}

}  // namespace

/// Returns the metrics that reports and tables show first, with a name and an explanation
/// for readers who do not know the names in metrics.json.
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

/// Returns the report of a training: facts, curves of the losses and times of the
/// kernels. The scores are missing, because add_evaluation() adds them later.
Report training_report(const Run& run, const TrainResult& trained, const Device& device,
                       const std::string& args) {
    const SpinningSensor& sensor = run.log.lidars[0].sensor;
    Report report;
    report.title = "relidar: " + run.log.name;
    report.summary = fmt::format("{} of a {} x {} LiDAR became {} surfels in {} of training.",
                                 count_frames(run.split.train.size()), sensor.beams.size(), sensor.columns,
                                 count_surfels(run.scene), format_duration(trained.train_s));
    report.facts = training_facts(run, trained, device, args);
    const std::vector<BoxTrack> masked = find_unmodelled(run.scene, run.log, run.config.init);
    if (!masked.empty())
        report.facts.emplace_back("Moving objects that are not trained", format_box_list(masked));
    report.curves = loss_curves(trained);
    const MetricValues kernel_ms = mean_kernel_ms(trained.times);
    if (!kernel_ms.empty())
        report.timings_ms.emplace_back("Training: mean time of one kernel launch", kernel_ms);
    return report;
}

/// Returns the report of `relidar eval`, which scores an existing run.
Report evaluation_report(const Run& run, const Evaluation& result, const Device& device,
                         const std::string& args) {
    Report report;
    report.title = "relidar: " + run.log.name + ", scored";
    report.summary = fmt::format("A scene of {} surfels, rendered in {:.2f} s per frame.",
                                 count_surfels(run.scene), result.trace_ms / 1000.0);
    report.facts = {{"Command", args},
                    {"Run", run.folder.string()},
                    {"Log", run.log.source},
                    {"Device", device.info().name},
                    {"Driver", device.info().driver},
                    {"relidar", RELIDAR_VERSION}};
    add_evaluation(report, result, run, {"held out", "real"});
    return report;
}

void add_evaluation(Report& report, const Evaluation& result, const Run& run,
                    const EvaluationLabels& labels) {
    if (result.frames.empty()) return;
    const bool is_first_call = report.metrics.empty();
    if (is_first_call) extend_summary(report, result);

    report.key_metrics = key_metrics();
    report.metrics.emplace_back(fmt::format("{} ({})", labels.column, count_frames(result.frames.size())),
                                result.mean);
    report.facts.emplace_back(fmt::format("Rendering, {}", labels.column),
                              fmt::format("{:.1f} ms per frame", result.trace_ms));
    if (!result.kernel_ms.empty())
        report.timings_ms.emplace_back(
            fmt::format("Rendering, {}: mean time of one kernel launch", labels.column), result.kernel_ms);

    report.bars.push_back(error_by_range(result, fmt::format("Errors by range, {}", labels.column)));
    add_score_tables(report, result, labels.column);
    // Only the middle frame still has its images (ScoredFrame::rendered).
    add_example_frame(report, result.frames[result.frames.size() / 2], run.config, labels);
}

}  // namespace relidar::cli
