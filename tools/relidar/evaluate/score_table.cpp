// SPDX-License-Identifier: Apache-2.0
#include "evaluate/score_table.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <set>

#include <nlohmann/json.hpp>

#include <relidar/base/files.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/score/report.hpp>
#include "base/fail.hpp"
#include "console.hpp"
#include "evaluate/run_report.hpp"
#include "output_folder.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using TextCells = std::vector<std::string>;

struct ScoredRun {
    std::string name;  ///< Path of the run, as the user typed it on the command line.
    std::string log;
    std::size_t n_frames = 0;  ///< Number of scored held-out frames.
    double training_s = 0.0;
    MetricValues mean;  ///< Mean of each metric over these frames. Empty if the run has no scores.
    nlohmann::json protocol;
};

/// Reads training time and scores of a run. Without valid scores, `mean` is empty.
ScoredRun read_run_scores(const std::string& run_path) {
    const fs::path folder = run_path;
    if (!contains_run(folder))
        fail("{} is not a run folder; expected a folder that `relidar train` has written", run_path);
    ScoredRun run;
    // The path without slashes at its end.
    run.name = run_path.substr(0, run_path.find_last_not_of('/') + 1);
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

/// Returns the scores of the runs that have scores.
std::vector<MetricValues> mean_metrics_of(const std::vector<ScoredRun>& runs) {
    std::vector<MetricValues> rows;
    for (const ScoredRun& run : runs)
        if (!run.mean.empty()) rows.push_back(run.mean);
    return rows;
}

/// Returns the keys of the protocol (how scores were computed), such as "grid, range",
/// whose values differ between runs. Scores of these runs are not comparable.
std::string differing_keys(const std::vector<ScoredRun>& runs) {
    std::set<std::string> keys;
    const ScoredRun* first = nullptr;
    for (const ScoredRun& run : runs) {
        if (run.mean.empty()) continue;
        if (!first) first = &run;
        // A key may be missing in either run.
        for (const auto& [key, value] : run.protocol.items())
            if (!first->protocol.contains(key) || first->protocol[key] != value) keys.insert(key);
        for (const auto& [key, value] : first->protocol.items())
            if (!run.protocol.contains(key)) keys.insert(key);
    }
    return fmt::format("{}", fmt::join(keys, ", "));
}

std::string protocol_warning(const std::vector<ScoredRun>& runs) {
    const std::string keys = differing_keys(runs);
    return keys.empty()
               ? ""
               : fmt::format(
                     "Compare the runs with care, because they were scored with different settings: {}.",
                     keys);
}

/// Returns a table row. A | in a cell, which would end the cell, becomes \|.
std::string markdown_row(const TextCells& cells) {
    std::string line = "|";
    for (std::string cell : cells) {
        for (std::size_t at = 0; (at = cell.find('|', at)) != std::string::npos; at += 2)
            cell.insert(at, "\\");
        line += " " + make_one_line(cell) + " |";
    }
    return line + "\n";
}

/// Makes a table with a column per key metric, a row per run, and a row of means.
std::string markdown_table(const std::vector<ScoredRun>& runs) {
    const std::vector<MetricValues> rows = mean_metrics_of(runs);
    const MetricValues mean_row = mean_metrics(rows);
    std::vector<std::string> metrics;  // key metrics for which at least one run has a value
    for (const ReportKeyMetric& key : key_metrics())
        if (mean_row.contains(key.metric)) metrics.push_back(key.metric);
    const auto append_values = [&](TextCells first_cells, const MetricValues& values) {
        for (const std::string& name : metrics)
            first_cells.push_back(values.contains(name) ? format_number(values.at(name)) : "-");
        return markdown_row(first_cells);
    };
    // Columns of text are aligned to the left, columns of numbers to the right.
    TextCells titles{"run", "log", "held-out frames", "training s"}, alignment{"---", "---", "--:", "--:"};
    titles.insert(titles.end(), metrics.begin(), metrics.end());
    alignment.resize(titles.size(), "--:");
    std::string text = markdown_row(titles) + markdown_row(alignment);
    for (const ScoredRun& run : runs) {
        const bool has_scores = !run.mean.empty();
        text +=
            append_values({run.name, has_scores ? run.log : "no scores",
                           has_scores ? fmt::format("{}", run.n_frames) : "-", format_number(run.training_s)},
                          run.mean);
    }
    if (rows.size() > 1)
        text += append_values({fmt::format("mean of {} runs", rows.size()), "", "", ""}, mean_row);
    const std::string note = protocol_warning(runs);
    return note.empty() ? text : text + "\n" + note + "\n";
}

std::string quote_csv_text(const std::string& text) {
    std::string quoted = "\"";
    for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
    return quoted + "\"";
}

/// Makes a table with a column for each metric and a row for each run, for programs.
std::string csv_table(const std::vector<ScoredRun>& runs) {
    // The columns are all metrics for which at least one run has a value.
    const MetricValues metrics = mean_metrics(mean_metrics_of(runs));
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

/// Writes the scores of all runs side by side as a web page.
void write_html(const fs::path& file, const std::vector<ScoredRun>& runs) {
    const std::vector<MetricValues> rows = mean_metrics_of(runs);
    Report report;
    report.title = fmt::format("relidar: scores of {} runs", runs.size());
    report.summary =
        fmt::format("{} of {} runs have scores. {}", rows.size(), runs.size(), protocol_warning(runs));
    report.key_metrics = key_metrics();
    std::set<std::string> scored_frames;  // log and number of frames of each run
    for (const ScoredRun& run : runs) {
        if (run.mean.empty()) {
            report.facts.emplace_back(run.name, "no scores");
            continue;
        }
        report.facts.emplace_back(run.name, fmt::format("{}, {} held-out frames, {} of training", run.log,
                                                        run.n_frames, format_duration(run.training_s)));
        report.metrics.emplace_back(run.name, run.mean);
        scored_frames.insert(fmt::format("{} {}", run.log, run.n_frames));
    }
    // Scores are comparable only with equal logs, frame counts and protocols.
    report.same_scans = scored_frames.size() < 2 && differing_keys(runs).empty();
    if (rows.size() > 1) report.metrics.emplace_back("mean", mean_metrics(rows));
    write_report(file, report);
}

void check_scores(const std::vector<ScoredRun>& runs) {
    const auto missing =
        std::find_if(runs.begin(), runs.end(), [](const ScoredRun& run) { return run.mean.empty(); });
    if (missing == runs.end()) return;
    fail(
        "{} of {} runs have no scores in their metrics.json, for example {}; `relidar eval {}` computes them",
        runs.size() - mean_metrics_of(runs).size(), runs.size(), missing->name,
        quote_for_shell(missing->name));
}

}  // namespace

void write_tables(const std::vector<std::string>& run_folders, const std::vector<std::string>& output_files) {
    // Checks all names before a file is written.
    for (const fs::path file : output_files)
        if (file.extension() != ".md" && file.extension() != ".csv" && file.extension() != ".html")
            fail<UsageError>("--table: found {}; expected a file name that ends in .md, .csv or .html",
                             file.string());
    std::vector<ScoredRun> scored;
    for (const std::string& run : run_folders) scored.push_back(read_run_scores(run));
    for (const fs::path file : output_files) {
        if (file.extension() == ".html") write_html(file, scored);
        else if (file.extension() == ".md") write_text_file(file, markdown_table(scored));
        else write_text_file(file, csv_table(scored));
    }
    // Fails last, so that a script has the scores of all other runs.
    check_scores(scored);
}

}  // namespace relidar::cli
