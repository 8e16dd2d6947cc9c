// SPDX-License-Identifier: Apache-2.0
#include "tables/text.hpp"

#include <algorithm>
#include <fstream>
#include <functional>
#include <iterator>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using ParsedJson = nlohmann::json;
using Results = std::vector<const TableResult*>;

struct Column {
    const char* title;
    const char* key;  ///< of TableResult::values
    int digits;       ///< behind the point; -1: three significant ones
};

constexpr Column kAsPublished[] = {{"FPS", "fps", -1},
                                   {"memory GB", "memory_gb", -1},
                                   {"depth RMSE", "peer/depth_rmse_m", 4},
                                   {"MedAE", "peer/depth_medae_m", 4},
                                   {"LPIPS", "peer/depth_lpips", 4},
                                   {"SSIM", "peer/depth_ssim", 4},
                                   {"PSNR", "peer/depth_psnr_db", 4},
                                   {"intensity RMSE", "peer/intensity_rmse", 4},
                                   {"MedAE", "peer/intensity_medae", 4},
                                   {"LPIPS", "peer/intensity_lpips", 4},
                                   {"SSIM", "peer/intensity_ssim", 4},
                                   {"PSNR", "peer/intensity_psnr_db", 4},
                                   {"CD", "peer/cd_sq_m2", 4},
                                   {"F-score", "peer/f_score", 4}};
constexpr Column kStrict[] = {{"depth RMSE", "strict/depth_rmse_m", 4},
                              {"MedAE", "strict/depth_medae_m", 4},
                              {"SSIM", "strict/image_depth_ssim", 4},
                              {"PSNR", "strict/image_depth_psnr_db", 4},
                              {"intensity RMSE", "strict/intensity_rmse", 4},
                              {"MedAE", "strict/intensity_medae", 4},
                              {"SSIM", "strict/image_intensity_ssim", 4},
                              {"PSNR", "strict/image_intensity_psnr_db", 4},
                              {"CD m", "strict/cd_mean_m", 4},
                              {"F at 5 cm", "strict/f_5cm", 4},
                              {"drop RMSE", "strict/drop_rmse", 4},
                              {"drop accuracy", "strict/drop_accuracy", 4},
                              {"drop F1", "strict/drop_f1", 4}};
constexpr Column kCost[] = {
    {"held-out frames", "frames", 0}, {"s a scan", "seconds_per_scan", -1}, {"training s", "training_s", -1}, {"in all s", "all_s", -1}};

constexpr const char* kAsPublishedNote =
    "As published (`peer/*`): a pixel returns where its drop probability is below 0.4; errors are over all pixels, dropped ones as 0, so "
    "that a wrong drop is an error of the whole range and RMSE says more of drops than of ranges; depth is cut at 80 m; LPIPS is of "
    "metres, "
    "which its weights were not made for; CD is the sum of both mean squared distances, in m²; the F-score, said to be at 5 cm, is at a "
    "squared distance of 0.05 m², 22.4 cm. One flaw of the authors' program is left out, so that CD and F here are less kind: it also "
    "puts dropped pixels of both clouds at the origin. FPS is of casting the rays of a scan, transfers included, without the network; "
    "memory is the most of the device that training had.\n";
constexpr const char* kStrictNote =
    "Strict: a pixel returns below 0.5; errors are over pixels that return in both images, SSIM and PSNR of whole images; CD is the sum of "
    "both mean distances; drop RMSE is of the probabilities. Nobody else's numbers are known by this protocol.\n";

std::string cell(const MetricRow& values, const Column& column) {
    const auto found = values.find(column.key);
    if (found == values.end()) return "–";
    return column.digits < 0 ? fmt::format("{:.3g}", found->second) : fmt::format("{:.{}f}", found->second, column.digits);
}

std::string line(const std::vector<std::string>& cells) {
    std::string text = "|";
    for (const std::string& c : cells) text += " " + c + " |";
    return text + "\n";
}

/// The head of a table: some texts on the left, then numbers.
std::string head(const std::vector<std::string>& texts, std::span<const Column> columns) {
    std::vector<std::string> titles = texts, rules(texts.size(), "---");
    for (const Column& column : columns) titles.emplace_back(column.title), rules.emplace_back("--:");
    return line(titles) + line(rules);
}

std::string row(std::vector<std::string> cells, const MetricRow& values, std::span<const Column> columns) {
    for (const Column& column : columns) cells.push_back(cell(values, column));
    return line(cells);
}

std::string method(const TableEntry& entry) {
    return fmt::format("relidar, `{}`{}", entry.preset, entry.change ? ", " + entry.change->title : "");
}

/// In the order of the results, those that are rows of the same line of a table of means.
std::vector<Results> by_method(const std::vector<TableResult>& results, const std::function<bool(const TableEntry&)>& wanted) {
    std::vector<Results> groups;
    for (const TableResult& result : results) {
        if (!wanted(*result.entry)) continue;
        const auto same = std::find_if(groups.begin(), groups.end(),
                                       [&](const Results& group) { return method(*group.front()->entry) == method(*result.entry); });
        if (same == groups.end())
            groups.push_back({&result});
        else
            same->push_back(&result);
    }
    return groups;
}

/// Mean of those that have numbers, and of how many: "3 of 10".
std::pair<MetricRow, std::string> mean_of(const Results& group, std::size_t n_published) {
    std::vector<MetricRow> rows;
    for (const TableResult* result : group)
        if (!result->values.empty()) rows.push_back(result->values);
    return {mean(rows), fmt::format("{} of {}", rows.size(), n_published)};
}

std::size_t count_parts(const std::string& kind) {
    const std::vector<PublishedPart> parts = published_parts();
    return std::size_t(std::count_if(parts.begin(), parts.end(), [&](const PublishedPart& part) { return part.kind == kind; }));
}

std::string dataset_tables(const std::vector<TableResult>& results, const std::string& kind) {
    const std::size_t n = count_parts(kind);
    const std::vector<Results> groups =
        by_method(results, [&](const TableEntry& entry) { return entry.part.kind == kind && !entry.change; });
    if (groups.empty()) return "";
    std::string text = kind == "waymo" ? "\n## Table 1: Waymo Open, 64 × 2650\n\n" : "\n## Table 2: KITTI-360, 66 × 1030\n\n";
    text += head({"method", "parts"}, kAsPublished);
    for (const PublishedRow& published : published_rows(kind))
        text += row({published.method + ", as printed", fmt::format("{}", n)}, published.values, kAsPublished);
    std::string strict = head({"method", "parts"}, kStrict), parts = head({"part", "method", "state"}, kCost),
                of_parts = head({"part", "method"}, kAsPublished);
    for (const Results& group : groups) {
        const auto [values, of] = mean_of(group, n);
        text += row({method(*group.front()->entry), of}, values, kAsPublished);
        strict += row({method(*group.front()->entry), of}, values, kStrict);
        for (const TableResult* result : group) {
            parts += row({result->entry->part.name, method(*result->entry), result->state}, result->values, kCost);
            of_parts += row({result->entry->part.name, method(*result->entry)}, result->values, kAsPublished);
        }
    }
    return text + "\nStrict:\n\n" + strict + "\nEach part, as published:\n\n" + of_parts + "\n" + parts;
}

std::string ablation_table(const std::vector<TableResult>& results) {
    const std::vector<Results> groups =
        by_method(results, [](const TableEntry& entry) { return entry.part.kind == "kitti360" && entry.part.is_dynamic; });
    if (groups.empty()) return "";
    std::string text = "\n## Ablation: dynamic parts of KITTI-360\n\n" + head({"method", "parts"}, kAsPublished);
    text += row({"LiDAR-RT, as printed (the means of Table 2)", "10"}, published_rows("kitti360").back().values, kAsPublished);
    for (const Ablation& change : ablations()) text += row({change.title + ", as printed", "6"}, change.values, kAsPublished);
    for (const Results& group : groups) {
        const auto [values, of] = mean_of(group, 6);
        text += row({method(*group.front()->entry), of}, values, kAsPublished);
    }
    return text;
}

/// Without Markdown.
std::string plain(std::string text) {
    std::erase(text, '`');
    return text;
}

/// Text as one cell of a CSV.
std::string csv_text(const std::string& text) {
    std::string quoted = "\"";
    for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
    return quoted + "\"";
}

ParsedJson read_json(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return ParsedJson::parse(in, nullptr, false);
}

double number_at(const ParsedJson& json, const char* group, const char* key) {
    const ParsedJson* from = !*group ? &json : json.contains(group) ? &json[group] : nullptr;
    return from && from->contains(key) && (*from)[key].is_number() ? (*from)[key].get<double>() : 0.0;
}

/// What a part should have and the run's scene.json has not. @param n_test  frames that were scored
std::string lack_of(const PublishedPart& part, const ParsedJson& scene, double n_test) {
    const double n_frames = number_at(scene, "counts", "frames");
    std::string lacks;
    if (n_frames < part.n_frames || n_test < part.n_test_frames)
        lacks = fmt::format("{} of {} frames were there, {} of {} to be held out", n_frames, part.n_frames, n_test, part.n_test_frames);
    if (part.is_dynamic && number_at(scene, "counts", "boxes") == 0.0)
        lacks += std::string(lacks.empty() ? "" : "; ") + "no box was labelled: what moves is in the background";
    return lacks;
}

/// Takes the numbers of a row that is done. @param seconds  of all commands of its job
void take_scores(TableResult& result, const fs::path& run, double seconds) {
    const ParsedJson scores = read_json(result.entry->scores), training = read_json(run / "metrics.json"),
                     scene = read_json(run / "scene.json");
    if (!scores.is_object() || !training.is_object() || !scene.is_object() || !scores.contains("mean")) {
        result.state = result.entry->scores.string() + ": no scores in it";
        return;
    }
    for (const auto& [name, value] : scores["mean"].items())
        if (value.is_number()) result.values[name] = value.get<double>();
    const double trace_ms = number_at(scores, "timings", "trace_ms");
    result.values["frames"] = scores.contains("frames") ? double(scores["frames"].size()) : 0.0;
    if (trace_ms > 0.0) result.values["fps"] = 1000.0 / trace_ms;
    result.values["seconds_per_scan"] = 1e-3 * trace_ms;
    result.values["memory_gb"] = 1e-9 * number_at(training, "", "peak_device_bytes");
    const std::vector<TrainProgress> log = read_log(run);
    if (!log.empty()) result.values["training_s"] = log.back().seconds;
    result.values["all_s"] = seconds;
    if (scores.contains("device") && scores["device"].is_string()) result.device = scores["device"].get<std::string>();
    result.lacks = lack_of(result.entry->part, scene, result.values["frames"]);
    if (!result.lacks.empty()) result.state = "done, but " + result.lacks;
}

}  // namespace

std::vector<TableResult> collect_results(const std::vector<TableEntry>& entries, const std::vector<JobReport>& reports) {
    std::vector<TableResult> results;
    for (const TableEntry& entry : entries) {
        TableResult& result = results.emplace_back();
        result.entry = &entry;
        if (!entry.missing.empty()) result.state = "missing: " + one_line(entry.missing);
        if (!entry.missing.empty()) continue;
        const auto report =
            std::find_if(reports.begin(), reports.end(), [&](const JobReport& r) { return r.job->job.name == entry.job.name; });
        if (report == reports.end()) continue;
        result.state = report->phase == "failed" ? "failed: " + one_line(report->state.message) : report->phase;
        if (report->phase == "done") take_scores(result, report->job->run, report->state.seconds);
    }
    return results;
}

std::string tables_markdown(const std::vector<TableResult>& results, const TablesOptions& options, const std::string& command_line) {
    std::set<std::string> devices;
    for (const TableResult& result : results)
        if (!result.device.empty()) devices.insert(result.device);
    std::string text = fmt::format("# The tables of LiDAR-RT (CVPR 2025)\n\n`{}`, relidar {}, {}{}.\n\n", command_line, RELIDAR_VERSION,
                                   utc_now(), devices.empty() ? "" : fmt::format(", on {}", fmt::join(devices, "; ")));
    text += "Rows \"as printed\" are the paper's, on its card, means over all parts. " +
            (options.sets.empty()
                 ? std::string("Presets are as they are.")
                 : fmt::format("Settings over the presets, so that rows are not theirs: `{}`.", fmt::join(options.sets, "`, `"))) +
            " docs/paper.md of relidar says where presets differ from the paper.\n\n";
    text += std::string(kAsPublishedNote) + "\n" + kStrictNote;
    text += dataset_tables(results, "waymo") + dataset_tables(results, "kitti360");
    return options.ablation ? text + ablation_table(results) : text;
}

std::string table_csv(const std::vector<TableResult>& results, const std::string& kind, bool changes) {
    std::vector<Column> columns(std::begin(kAsPublished), std::end(kAsPublished));
    columns.insert(columns.end(), std::begin(kStrict), std::end(kStrict));
    columns.insert(columns.end(), std::begin(kCost), std::end(kCost));
    std::string text = "method,part,state";
    for (const Column& column : columns) text += std::string(",") + column.key;
    text += "\n";
    const auto add = [&](const std::string& who, const std::string& part, const std::string& state, const MetricRow& values) {
        text += csv_text(who) + "," + part + "," + csv_text(state);
        for (const Column& column : columns) {
            const auto found = values.find(column.key);
            text += found == values.end() ? "," : fmt::format(",{}", found->second);
        }
        text += "\n";
    };
    if (changes)
        for (const Ablation& change : ablations()) add(change.title, "all", "printed", change.values);
    else
        for (const PublishedRow& published : published_rows(kind)) add(published.method, "all", "printed", published.values);
    for (const TableResult& result : results)
        if (result.entry->part.kind == kind && (result.entry->change != nullptr) == changes)
            add(plain(method(*result.entry)), result.entry->part.name, result.state, result.values);
    return text;
}

}  // namespace relidar::cli
