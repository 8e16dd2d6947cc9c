// SPDX-License-Identifier: Apache-2.0
#include "evaluate/score_table.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/files.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/score/report.hpp>
#include "console.hpp"
#include "evaluate/report_parts.hpp"
#include "output_folder.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using Cells = std::vector<std::string>;

struct ScoredRun {
    std::string name;  ///< Path of the run, as the user typed it on the command line.
    std::string log;
    std::size_t n_frames = 0;  ///< Number of scored held-out frames.
    double training_s = 0.0;
    MetricRow mean;  ///< Mean of each metric over these frames. Empty if the run has no scores.
    nlohmann::json protocol;
};

ScoredRun read_scores(const std::string& path) {
    const fs::path folder = path;
    if (!contains_run(folder))
        throw DataError(
            fmt::format("{} is not a run folder; expected a folder that `relidar train` has written", path));
    ScoredRun run;
    run.name = path.substr(0, path.find_last_not_of('/') + 1);
    if (const std::vector<TrainProgress> log = read_log(folder); !log.empty())
        run.training_s = log.back().seconds;
    std::ifstream file(folder / "metrics.json", std::ios::binary);
    const nlohmann::json json = nlohmann::json::parse(file, nullptr, false);
    if (!json.is_object() || !json.contains("mean") || !json.contains("frames")) return run;
    if (json.contains("dataset") && json["dataset"].is_string()) run.log = json["dataset"].get<std::string>();
    run.n_frames = json["frames"].size();
    run.protocol = json.value("protocol", nlohmann::json::object());
    for (const auto& [name, value] : json["mean"].items())
        if (value.is_number()) run.mean[name] = value.get<double>();
    return run;
}

std::vector<MetricRow> make_scored_rows(const std::vector<ScoredRun>& runs) {
    std::vector<MetricRow> rows;
    for (const ScoredRun& run : runs)
        if (!run.mean.empty()) rows.push_back(run.mean);
    return rows;
}

/// Returns the names of the protocol settings that differ between the runs, such as
/// "grid, range". The table warns about them, because scores of different protocols are
/// not comparable.
std::string describe_protocol_differences(const std::vector<ScoredRun>& runs) {
    std::set<std::string> keys;
    const ScoredRun* first = nullptr;
    for (const ScoredRun& run : runs) {
        if (run.mean.empty()) continue;
        if (!first) first = &run;
        for (const auto& [key, value] : run.protocol.items())
            if (!first->protocol.contains(key) || first->protocol[key] != value) keys.insert(key);
    }
    return fmt::format("{}", fmt::join(keys, ", "));
}

std::string make_protocol_note(const std::vector<ScoredRun>& runs) {
    const std::string keys = describe_protocol_differences(runs);
    return keys.empty()
               ? ""
               : fmt::format("Compare the runs with care, because their protocols differ in {}.", keys);
}

/// Returns the names of the most important metrics for which at least one run has a
/// value.
std::vector<std::string> list_table_metrics(const MetricRow& mean) {
    std::vector<std::string> names;
    for (const ReportKeyMetric& key : key_metrics())
        if (mean.contains(key.metric)) names.push_back(key.metric);
    return names;
}

std::string format_markdown_line(const Cells& cells) {
    std::string line = "|";
    for (std::string cell : cells) {
        for (std::size_t at = 0; (at = cell.find('|', at)) != std::string::npos; at += 2)
            cell.insert(at, "\\");
        line += " " + join_lines(cell) + " |";
    }
    return line + "\n";
}

std::string format_markdown(const std::vector<ScoredRun>& runs) {
    const std::vector<MetricRow> rows = make_scored_rows(runs);
    const MetricRow mean_row = mean(rows);
    const std::vector<std::string> metrics = list_table_metrics(mean_row);
    const auto line = [&](Cells cells, const MetricRow& values) {
        for (const std::string& name : metrics)
            cells.push_back(values.contains(name) ? format_short_number(values.at(name)) : "-");
        return format_markdown_line(cells);
    };
    Cells head{"run", "log", "held-out frames", "training s"}, rule{"---", "---", "--:", "--:"};
    head.insert(head.end(), metrics.begin(), metrics.end());
    rule.resize(head.size(), "--:");
    std::string text = format_markdown_line(head) + format_markdown_line(rule);
    for (const ScoredRun& run : runs)
        text += run.mean.empty() ? line({run.name, "no scores", "-", format_short_number(run.training_s)}, {})
                                 : line({run.name, run.log, fmt::format("{}", run.n_frames),
                                         format_short_number(run.training_s)},
                                        run.mean);
    if (rows.size() > 1) text += line({fmt::format("mean of {} runs", rows.size()), "", "", ""}, mean_row);
    const std::string note = make_protocol_note(runs);
    return note.empty() ? text : text + "\n" + note + "\n";
}

std::string quote_csv_text(const std::string& text) {
    std::string quoted = "\"";
    for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
    return quoted + "\"";
}

std::string format_csv(const std::vector<ScoredRun>& runs) {
    const MetricRow metrics = mean(make_scored_rows(runs));
    std::string text = "run,log,frames,training_s";
    for (const auto& [name, value] : metrics) text += "," + name;
    text += "\n";
    for (const ScoredRun& run : runs) {
        text += fmt::format("{},{},{},{}", quote_csv_text(run.name), quote_csv_text(run.log), run.n_frames,
                            run.training_s);
        for (const auto& [name, value] : metrics)
            text += run.mean.contains(name) ? fmt::format(",{}", run.mean.at(name)) : ",";
        text += "\n";
    }
    return text;
}

void write_page(const fs::path& file, const std::vector<ScoredRun>& runs) {
    const std::vector<MetricRow> rows = make_scored_rows(runs);
    Report report;
    report.title = fmt::format("relidar: scores of {} runs", runs.size());
    report.summary =
        fmt::format("{} of {} runs have scores. {}", rows.size(), runs.size(), make_protocol_note(runs));
    report.key_metrics = key_metrics();
    std::set<std::string> logs;
    for (const ScoredRun& run : runs) {
        report.facts.emplace_back(
            run.name, run.mean.empty() ? "no scores"
                                       : fmt::format("{}, {} held-out frames, {} of training", run.log,
                                                     run.n_frames, format_duration(run.training_s)));
        if (run.mean.empty()) continue;
        logs.insert(fmt::format("{} {}", run.log, run.n_frames));
        report.metrics.emplace_back(run.name, run.mean);
    }
    report.same_scans = logs.size() < 2 && describe_protocol_differences(runs).empty();
    if (rows.size() > 1) report.metrics.emplace_back("mean", mean(rows));
    write_report(file, report);
}

/// Checks that every run has scores.
/// @throws DataError if a run has no scores; the message names the run
void check_scored(const std::vector<ScoredRun>& runs) {
    const auto missing =
        std::find_if(runs.begin(), runs.end(), [](const ScoredRun& run) { return run.mean.empty(); });
    if (missing == runs.end()) return;
    throw DataError(fmt::format(
        "{} of {} runs have no scores in their metrics.json, for example {}; `relidar eval {}` computes them",
        runs.size() - make_scored_rows(runs).size(), runs.size(), missing->name,
        quote_shell_word(missing->name)));
}

}  // namespace

void write_score_tables(const std::vector<std::string>& runs, const std::vector<std::string>& files) {
    for (const fs::path file : files)
        if (file.extension() != ".md" && file.extension() != ".csv" && file.extension() != ".html")
            throw UsageError(fmt::format(
                "--table: found {}; expected a file name that ends in .md, .csv or .html", file.string()));
    std::vector<ScoredRun> scored;
    for (const std::string& run : runs) scored.push_back(read_scores(run));
    for (const fs::path file : files) {
        if (file.extension() == ".html") write_page(file, scored);
        else write_text(file, file.extension() == ".md" ? format_markdown(scored) : format_csv(scored));
    }
    check_scored(scored);
}

}  // namespace relidar::cli
