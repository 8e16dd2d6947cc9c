// SPDX-License-Identifier: Apache-2.0
#include "batch/summary.hpp"

#include <algorithm>
#include <chrono>
#include <fstream>
#include <memory>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"
#include "output_folder.hpp"
#include <relidar/error.hpp>
#include <relidar/export.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using Metrics = std::map<std::string, double>;

constexpr const char* kTotals[] = {"done", "failed", "preempted", "lost", "running", "waiting"};  // in the order of totals
constexpr const char* kShownMetrics[] = {"strict/depth_medae_m", "strict/depth_rmse_m", "strict/intensity_mae", "strict/drop_accuracy",
                                         "points/cd_mean_m"};
constexpr std::chrono::milliseconds kLookAgain{20};
constexpr int kMostLooks = 500;   // 10 s: then somebody holds the lock who does not write

std::size_t count(const std::vector<JobReport>& reports, const std::string& phase) {
    return static_cast<std::size_t>(std::count_if(reports.begin(), reports.end(), [&](const JobReport& r) { return r.phase == phase; }));
}

double total_seconds(const std::vector<JobReport>& reports) {
    double seconds = 0.0;
    for (const JobReport& report : reports) seconds += report.state.seconds;
    return seconds;
}

/// A mean over jobs, and over how many: not every log has every metric.
struct Mean {
    double sum = 0.0;
    int n = 0;
};

std::map<std::string, Mean> means(const std::vector<JobReport>& reports) {
    std::map<std::string, Mean> result;
    for (const JobReport& report : reports) {
        for (const auto& [name, value] : report.state.metrics) {
            result[name].sum += value;
            ++result[name].n;
        }
    }
    return result;
}

Json job_json(const JobReport& report) {
    const auto& [job, state, phase] = report;
    return {{"name", job->job.name},
            {"state", phase},
            {"log", job->job.log},
            {"folder", job->folder.string()},
            {"run", job->run.string()},
            {"commands_done", job->n_done(state.done)},
            {"commands", job->commands.size()},
            {"attempts", state.attempts},
            {"seconds", state.seconds},
            {"exit_code", state.exit_code},
            {"message", state.message},
            {"host", state.host},
            {"metrics", state.metrics}};
}

std::string summary_json(const BatchPlan& plan, const std::vector<JobReport>& reports) {
    Json totals = {{"jobs", reports.size()}};
    for (const char* phase : kTotals) totals[phase] = count(reports, phase);
    totals["seconds"] = total_seconds(reports);
    Json metrics = Json::object(), jobs = Json::array();
    for (const auto& [name, mean] : means(reports)) metrics[name] = {{"mean", mean.sum / mean.n}, {"jobs", mean.n}};
    for (const JobReport& report : reports) jobs.push_back(job_json(report));
    const Json json = {{"format", "relidar batch"},
                       {"version", 1},
                       {"relidar", RELIDAR_VERSION},
                       {"manifest", plan.manifest.string()},
                       {"written", utc_now()},
                       {"totals", totals},
                       {"metrics", metrics},
                       {"jobs", jobs}};
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string metrics_text(const std::vector<JobReport>& reports) {
    const std::map<std::string, Mean> all = means(reports);
    std::vector<std::vector<std::string>> rows{{"metric", "mean", "jobs"}};
    for (const char* name : kShownMetrics)
        if (const auto found = all.find(name); found != all.end())
            rows.push_back({name, number(found->second.sum / found->second.n), fmt::format("{}", found->second.n)});
    return rows.size() > 1 ? "\n" + table(rows) : "";
}

/// Of failures that differ, the code of the one that another attempt helps most likely: a device or a crash before a bug, before what is
/// wrong with a log or a setting.
ExitCode code_of_failures(const std::vector<JobReport>& failed) {
    for (const ExitCode code : {ExitCode::device, ExitCode::bug, ExitCode::data}) {
        for (const JobReport& report : failed) {
            const int found = report.state.exit_code;
            const bool crashed = found > static_cast<int>(ExitCode::device);   // 127, 128 + signal
            if (found == static_cast<int>(code) || (crashed && code == ExitCode::device)) return code;
        }
    }
    return ExitCode::usage;
}

}  // namespace

std::vector<JobReport> report_jobs(const BatchPlan& plan) {
    std::vector<JobReport> reports;
    for (const PlannedJob& job : plan.jobs) {
        JobReport report{&job, load_state(job.folder), ""};
        if (report.state.phase == JobPhase::running && !FolderLock::is_held(job.folder)) {
            report.state = load_state(job.folder);   // it may have ended between the two looks
            if (report.state.phase == JobPhase::running) report.phase = "lost";
        }
        if (report.state.phase == JobPhase::done && !job.is_done(report.state.done)) report.phase = phase_name(JobPhase::waiting);
        if (report.phase.empty()) report.phase = phase_name(report.state.phase);
        reports.push_back(std::move(report));
    }
    return reports;
}

std::string status_text(const std::vector<JobReport>& reports) {
    std::vector<std::vector<std::string>> rows{{"job", "state", "commands", "attempts", "time"}};
    std::string failed, totals;
    for (const auto& [job, state, phase] : reports) {
        rows.push_back({job->job.name, phase, fmt::format("{}/{}", job->n_done(state.done), job->commands.size()),
                        fmt::format("{}", state.attempts), duration(state.seconds)});
        if (phase == "failed")
            failed += one_line(fmt::format("failed  {}: exit code {}: {}", job->job.name, state.exit_code, state.message)) + "\n";
    }
    for (const char* phase : kTotals)
        if (const std::size_t n = count(reports, phase); n > 0) totals += fmt::format(", {} {}", n, phase);
    const std::string jobs = fmt::format("\n{} job{}", reports.size(), reports.size() == 1 ? "" : "s");
    return table(rows) + (failed.empty() ? "" : "\n" + failed) + jobs + totals +
           fmt::format(", {} of work\n", duration(total_seconds(reports))) + metrics_text(reports);
}

void raise_ends(const std::vector<JobReport>& reports) {
    std::vector<JobReport> failed;
    const std::size_t n_jobs = reports.size();
    std::size_t n_done = 0;
    for (const JobReport& report : reports) {
        n_done += report.phase == "done";
        if (report.phase == "failed") failed.push_back(report);
    }
    if (n_done + failed.size() < n_jobs)
        throw Error(ExitCode::interrupted,
                    fmt::format("interrupted: {} of {} jobs are done, {} failed; the same command goes on", n_done, n_jobs, failed.size()));
    if (!failed.empty())
        throw Error(code_of_failures(failed),
                    fmt::format("{} of {} jobs failed, {} {}: {}; --retry-failed tries again", failed.size(), n_jobs,
                                failed.size() == 1 ? "job" : "the first, job", failed.front().job->job.name, failed.front().state.message));
}

void write_summary(const BatchPlan& plan) {
    std::unique_ptr<FolderLock> lock;
    for (int look = 0; look < kMostLooks && !(lock = FolderLock::take_if_free(plan.out)); ++look) std::this_thread::sleep_for(kLookAgain);
    write_text(plan.out / "batch.json", summary_json(plan, report_jobs(plan)));
}

std::map<std::string, double> mean_metrics(const fs::path& run) {
    std::ifstream file(run / "metrics.json", std::ios::binary);
    const Json json = Json::parse(file, nullptr, false);
    Metrics metrics;
    if (!json.is_object() || !json.contains("mean")) return metrics;
    for (const auto& [name, value] : json["mean"].items())
        if (value.is_number()) metrics[name] = value.get<double>();
    return metrics;
}

}  // namespace relidar::cli
