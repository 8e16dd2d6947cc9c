// SPDX-License-Identifier: Apache-2.0
#include "evaluate/run_report.hpp"

#include <fmt/format.h>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>
#include "console.hpp"
#include "evaluate/evaluation.hpp"
#include "evaluate/pictures.hpp"
#include "evaluate/report_parts.hpp"

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

}  // namespace

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
         "%. "
         "Also returned: share of these real returns that the simulation returns. The limit is the real scan "
         "after each scan in which the sensor stands still, if the log has such scans.",
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
