// SPDX-License-Identifier: Apache-2.0
// Formats scores as tables and as metrics.json. The protocol is always next to the
// scores, because scores of different protocols are not comparable.
#include "evaluate/evaluation.hpp"

#include <algorithm>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"
#include "ranks.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kPeerNote =
    "all pixels; dropped pixels count as 0; ranges are clamped to [1e-6, max_range_m], intensities to [1e-6, "
    "1]; PSNR: the peak is max_range_m or 1; SSIM: uniform window of 7 x 7; Chamfer distance (squared) and "
    "F-score (squared distance below 0.05 m^2): over returned points; a ray returns if drop_prob < 0.4";
constexpr const char* kStrictNote =
    "a ray returns if drop_prob < 0.5; image_*: all pixels, dropped pixels count as 0; depth_* and "
    "intensity_*: pixels that return in both scans; Chamfer distance: sum of both directions; F-score: at 5 "
    "cm and 22.4 cm; drop_*: a dropped ray is a positive; drop_rmse: error of the drop probabilities of all "
    "pixels";
constexpr const char* kPointsNote =
    "like strict/depth_*, cd_* and f_*, but computed from the points that are written to files (setting "
    "render.points, by default the median range) instead of the range image (setting render.range)";
constexpr const char* kRegionsNote =
    "errors of the points of all pixels with a real return, whether the rendered ray returns or drops; "
    "returned: share of these pixels whose rendered ray returns (drop_prob < 0.5); moving_boxes: pixels "
    "inside labelled moving boxes; discovered_boxes: pixels inside moving boxes that the dataset does not "
    "label, but training found";
constexpr const char* kEdgesNote =
    "edges: pixels whose real range differs from that of a neighbour in the row or column by more than 0.5 m "
    "and 5 %; smooth: all other pixels; edges_repeat: the next real scan instead of the rendered scan, over "
    "the frames in which the sensor stands still; share: of the real returns; above_1m: share of the range "
    "errors above 1 m, over pixels that return in both scans; cd_* and f_*: like points/*, over the points "
    "of these pixels";
constexpr const char* kActorsNote =
    "trail point: a point above the ground at a place that a moving box occupies only at other times of the "
    "log; tail_share: share of the simulated points (drop_prob < 0.5) that are trail points; "
    "tail_share_real: the same share of the real points; people_*: labelled moving boxes of people and "
    "cyclists with at least 10 real points; vehicles_*: all other labelled moving boxes with at least 10 "
    "real points; these boxes are enlarged by 0.1 m, without the lowest 0.15 m; bias_m: median of the range "
    "errors, simulated minus real; cd_m: Chamfer distance, sum of both directions; 3cm: share of the "
    "simulated points with a real point within 3 cm; vehicles_points_error: |simulated / real - 1| of the "
    "numbers of points of a vehicle in all frames, median over the vehicles; f1: F1 score of the rays that "
    "return from the box, enlarged by 0.3 m; table of actors: one row for each labelled or discovered moving "
    "box; its numbers of points are sums over the frames, its other values are means weighted by real points";
constexpr const char* kClassesNote =
    "all real returns with a label, whether the rendered ray returns or drops; accuracy: share of these "
    "returns whose rendered class equals the label; mean_iou: intersection over union of a class, mean over "
    "the labels of the frame";
constexpr const char* kRegionColumns[] = {"pixels",      "returned",     "depth_medae_m",
                                          "depth_mae_m", "depth_rmse_m", "intensity_rmse"};

/// Describes how the scores were computed: settings that change them, and the definition
/// of each group of metrics. Scores are comparable only if their protocols are equal.
Json protocol_json(const Config& config) {
    const std::string weights = lpips_weights_path();
    const std::string lpips_note =
        weights.empty()
            ? "no weights"
            : "AlexNet, v0.1, computed on metres and intensity, x -> 2 x - 1 without clamping; weights " +
                  weights;
    const bool is_native = config.sensor.grid == "native";
    return {
        {"frames",
         "frames that did not train the scene; each metric is the mean over the frames that have a value"},
        {"grid", config.sensor.grid},
        {"grid_method", is_native ? "rays of the real scan" : config.sensor.grid_method},
        {"range", config.render.range},
        {"points_range", config.render.points == "median" ? "median" : config.render.range},
        {"min_range_m", config.dataset.min_range_m},
        {"max_range_m", config.dataset.max_range_m},
        {"lpips", lpips_note},
        {"peer", kPeerNote},
        {"strict", kStrictNote},
        {"points", kPointsNote},
        {"regions", kRegionsNote},
        {"edges", kEdgesNote},
        {"actors", kActorsNote},
        {"classes", kClassesNote},
        {"drop_threshold", {{"peer", 0.4}, {"strict", 0.5}, {"regions", 0.5}}}};
}

/// Returns true for a metric of complete scans, and false for a metric of a region, such
/// as moving_boxes/depth_mae_m.
bool is_frame_metric(const std::string& metric_name) {
    return metric_name.starts_with("peer/") || metric_name.starts_with("strict/") ||
           metric_name.starts_with("points/") || metric_name.starts_with("actors/") ||
           metric_name.starts_with("classes/");
}

/// Returns the lowest and the highest value of a metric over all frames.
std::pair<double, double> metric_min_max(const Evaluation& result, const std::string& metric_name) {
    // Starts at the mean, which is never outside the range.
    double lowest = result.mean.at(metric_name), highest = lowest;
    for (const ScoredFrame& frame : result.frames) {
        const auto metric = frame.metrics.find(metric_name);
        if (metric == frame.metrics.end()) continue;
        lowest = std::min(lowest, metric->second);
        highest = std::max(highest, metric->second);
    }
    return {lowest, highest};
}

Json actor_scores_json(const std::vector<ActorScore>& actor_scores) {
    Json json = Json::array();
    for (const ActorScore& actor : actor_scores)
        json.push_back({{"track", actor.track}, {"class", actor.category}, {"metrics", actor.metrics}});
    return json;
}

std::string format_metric(const MetricValues& metrics, const std::string& metric_name) {
    return metrics.contains(metric_name) ? format_number(metrics.at(metric_name)) : "-";
}

/// Makes a table of the metrics of complete scans: mean, lowest and highest value over
/// all frames, and mean of the baseline. With a single frame, only its value.
TableRows metric_rows(const Evaluation& result, const Evaluation* baseline) {
    const bool has_several_frames = result.frames.size() > 1;
    TableRows rows{{"metric", has_several_frames ? "mean" : "value"}};
    if (has_several_frames) rows.back().insert(rows.back().end(), {"lowest", "highest"});
    if (baseline) rows.back().push_back(baseline->title);
    for (const auto& [name, mean_value] : result.mean) {
        if (!is_frame_metric(name)) continue;
        rows.push_back({name, format_number(mean_value)});
        const auto [lowest, highest] = metric_min_max(result, name);
        if (has_several_frames)
            rows.back().insert(rows.back().end(), {format_number(lowest), format_number(highest)});
        if (baseline) rows.back().push_back(format_metric(baseline->mean, name));
    }
    return rows;
}

/// Makes a table with a row for each region, which is a set of pixels such as
/// moving_boxes. Metrics of a region are named REGION/METRIC.
TableRows region_rows(const Evaluation& result) {
    TableRows rows{{result.title + ", metrics by region"}};
    for (const char* column : kRegionColumns) rows.back().emplace_back(column);
    std::set<std::string> regions;
    for (const auto& [name, value] : result.mean)
        if (!is_frame_metric(name)) regions.insert(name.substr(0, name.find('/')));
    for (const std::string& region : regions) {
        rows.push_back({region});
        for (const char* column : kRegionColumns)
            rows.back().push_back(format_metric(result.mean, region + "/" + column));
    }
    return rows;
}

/// Appends the frames in a text of frames_json(), which another process has sent. They
/// have scores, but no images.
void append_frames(std::vector<ScoredFrame>& frames, const std::string& json_text) {
    for (const Json& json : Json::parse(json_text)) {
        ScoredFrame& frame = frames.emplace_back();
        frame.frame = json.at("frame");
        frame.lidar = json.at("lidar");
        frame.time_s = json.at("time_s");
        frame.n_rays = json.at("n_rays");
        frame.rendered.trace_ms = json.at("trace_ms");
        frame.metrics = json.at("metrics").get<MetricValues>();
        for (const Json& actor : json.at("actors"))
            frame.actors.push_back(
                {actor.at("track"), actor.at("class"), actor.at("metrics").get<MetricValues>()});
    }
}

}  // namespace

TableRows worst_actor_rows(const Evaluation& result) {
    constexpr std::size_t kMaxActorRows = 20;
    struct ActorColumn {
        const char* title;
        const char* metric;
        int n_decimals;
    };
    constexpr ActorColumn kColumns[] = {{"points", "points", 0},
                                        {"real points", "points_real", 0},
                                        {"median error, m", "range_medae_m", 3},
                                        {"bias, m", "range_bias_m", 3},
                                        {"errors above 0.3 m", "range_above_30cm", 3},
                                        {"F1", "f1", 3},
                                        {"trail points", "tail", 0},
                                        {"real trail points", "tail_real", 0}};
    TableRows rows{{"actor, worst first", "class"}};
    for (const ActorColumn& column : kColumns) rows.back().emplace_back(column.title);
    // The actors are sorted, the worst is first.
    for (std::size_t i = 0; i < std::min(kMaxActorRows, result.actors.size()); ++i) {
        const ActorScore& actor = result.actors[i];
        rows.push_back({actor.track, actor.category});
        for (const auto& [title, metric, n_decimals] : kColumns) {
            const auto value = actor.metrics.find(metric);
            const bool is_known = value != actor.metrics.end();
            rows.back().push_back(is_known ? fmt::format("{:.{}f}", value->second, n_decimals) : "-");
        }
    }
    return rows;
}

TableRows edge_rows(const Evaluation& result) {
    constexpr std::pair<std::string_view, const char*> kRegionTitles[] = {
        {"edges", "at depth edges"},
        {"edges_repeat", "limit: the next real scan while the sensor stands"},
        {"smooth", "elsewhere"}};
    TableRows rows{{"points", "share of returns", "also returned", "errors above 1 m", "Chamfer, m",
                    "F-score, 5 cm", "F-score, 22 cm"}};
    for (const auto& [region, title] : kRegionTitles) {
        const bool has_pixels = result.mean.contains(fmt::format("{}/share", region));
        if (!has_pixels) continue;
        rows.push_back({title});
        for (const char* metric : {"share", "returned", "above_1m", "cd_mean_m", "f_5cm", "f_22cm"})
            rows.back().push_back(format_metric(result.mean, fmt::format("{}/{}", region, metric)));
    }
    return rows;
}

std::string format_scores(const Evaluation& result) {
    struct ScoreColumn {
        const char* name;
        const char* label;
        const char* unit;
    };
    constexpr ScoreColumn kScoreColumns[] = {
        {"points/depth_medae_m", "median range error of points", " m"},
        {"points/cd_mean_m", "distance between point clouds (Chamfer)", " m"},
        {"moving_boxes/depth_medae_m", "median range error on moving objects", " m"},
        {"strict/intensity_rmse", "root mean square error of intensity", ""},
        {"strict/drop_f1", "F1 score of dropped rays, 1 is best", ""},
    };
    std::string text = fmt::format("held-out scans: {}\n", result.frames.size());
    for (const ScoreColumn& score : kScoreColumns)
        if (result.mean.contains(score.name))
            text += fmt::format("  {:<40} {:.3f}{}\n", score.label, result.mean.at(score.name), score.unit);
    return text;
}

std::string format_metrics(const Evaluation& result, const Evaluation* baseline) {
    TableRows rows = metric_rows(result, baseline);
    const bool has_lpips = std::any_of(result.mean.begin(), result.mean.end(),
                                       [](const auto& metric) { return metric.first.ends_with("_lpips"); });
    // Says why both metrics are missing: the user must download the network's weights.
    if (!has_lpips)
        for (const char* name : {"peer/depth_lpips", "peer/intensity_lpips"}) {
            rows.push_back({name, "no weights"});
            rows.back().resize(rows.front().size());
        }

    std::string text =
        format_scores(result) + "\n" + format_table(rows) + "\n" + format_table(region_rows(result));
    if (baseline) text += "\n" + format_table(region_rows(*baseline));
    for (const TableRows& table : {edge_rows(result), worst_actor_rows(result)}) {
        const bool has_scores = table.size() > 1;  // the first row has the titles
        if (has_scores) text += "\n" + format_table(table);
    }
    return text +
           fmt::format("\npeer     {}\nstrict   {}\npoints   {}\nregions  {}\nedges    {}\nactors   {}\n",
                       kPeerNote, kStrictNote, kPointsNote, kRegionsNote, kEdgesNote, kActorsNote);
}

Json frames_json(const Evaluation& result) {
    Json frames = Json::array();
    for (const ScoredFrame& frame : result.frames)
        frames.push_back({{"frame", frame.frame},
                          {"lidar", frame.lidar},
                          {"time_s", frame.time_s},
                          {"n_rays", frame.n_rays},
                          {"trace_ms", frame.rendered.trace_ms},
                          {"metrics", frame.metrics},
                          {"actors", actor_scores_json(frame.actors)}});
    return frames;
}

EvaluationProvenance describe_source(const Run& run, const Device& device, double seconds) {
    return {absolute_path(run.folder.string()), device.info().name, device.peak_bytes(), seconds};
}

std::string metrics_json(const Evaluation& result, const Config& config, const EvaluationProvenance& source) {
    Json json = {{"format", "relidar metrics"},
                 {"version", 1},
                 {"relidar", RELIDAR_VERSION},
                 {"scored", result.title},
                 {"run", source.run},
                 {"dataset", config.dataset.path},
                 {"protocol", protocol_json(config)},
                 {"mean", result.mean},
                 {"actors", actor_scores_json(result.actors)},
                 {"frames", frames_json(result)},
                 {"timings",
                  {{"kernel_ms", result.kernel_ms},
                   {"trace_ms", result.trace_ms},
                   {"mrays_per_s", result.mrays_per_s},
                   {"seconds", source.seconds}}},
                 {"device", source.device},
                 {"peak_device_bytes", source.peak_device_bytes}};
    if (source.baseline)
        json["baseline"] = {{"scored", source.baseline->title},
                            {"mean", source.baseline->mean},
                            {"frames", frames_json(*source.baseline)}};
    // Replaces invalid UTF-8, which paths may contain, instead of throwing an error.
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

/// Collects the scores of all MPI processes in the first process. The images stay in
/// their process, because they are large.
Evaluation gather_evaluation(const Evaluation& local_evaluation, const MpiProcessGroup& ranks) {
    if (ranks.size() == 1) return local_evaluation;
    const std::vector<std::string> frames_of_rank = ranks.gather_texts(frames_json(local_evaluation).dump());
    if (!ranks.is_first()) return local_evaluation;
    // The first process has its own frames with their images.
    std::vector<ScoredFrame> frames = local_evaluation.frames;
    for (std::size_t rank = 1; rank < frames_of_rank.size(); ++rank)
        append_frames(frames, frames_of_rank[rank]);
    Evaluation result = summarise(std::move(frames), {});
    result.title = local_evaluation.title;
    result.kernel_ms = local_evaluation.kernel_ms;
    return result;
}

}  // namespace relidar::cli
