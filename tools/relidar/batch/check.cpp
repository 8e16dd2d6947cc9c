// SPDX-License-Identifier: Apache-2.0
#include "batch/check.hpp"

#include <algorithm>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "batch/state.hpp"
#include "command.hpp"
#include "options.hpp"
#include "usage.hpp"
#include <relidar/dataset.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

/// Whether a path lies in a folder, as both are written.
bool is_within(const fs::path& path, const fs::path& folder) {
    const fs::path below = fs::absolute(path).lexically_normal().lexically_relative(fs::absolute(folder).lexically_normal());
    return !below.empty() && *below.begin() != "..";
}

/// What a command writes lies in the job's own folders: no job touches what is another's, and what is replaced was its own.
void check_outputs(const CLI::App& command, const PlannedJob& job) {
    for (const char* name : {"--out", "--pictures"}) {
        const CLI::Option* option = command.get_option_no_throw(name);
        if (!option || option->empty()) continue;
        const fs::path path = option->results().front();
        if (!is_within(path, job.folder) && !is_within(path, job.run))
            throw UsageError(fmt::format("{}: found {}, expected a place in {{job}} or {{run}}, folders of the job", name, path.string()));
    }
}

/// A command line, read by the parser that will read it when it runs.
void check_command(const JobCommand& command, const PlannedJob& job) {
    CLI::App app("", "relidar");
    Call call;
    add_commands(app, call);
    try {
        app.parse(std::vector<std::string>(command.words.rbegin(), command.words.rend()));   // it takes them from the back
    } catch (const CLI::Success&) {
        throw UsageError(fmt::format("{}: asks for help, expected a command that does something", command.text));
    } catch (const CLI::ParseError& error) {
        throw UsageError(fmt::format("{}: {}", command.text, usage_message(app, error.what())));
    }
    if (&command != &job.commands.front()) check_outputs(*app.get_subcommands().front(), job);
}

void check_settings(const BatchJob& job) {
    if (job.settings.contains("preset")) throw UsageError("settings.preset: expected preset as a key of the job itself");
    Settings settings;
    if (!job.preset.empty()) settings.preset = job.preset;
    settings.file = job.config;
    for (const auto& [key, value] : job.settings) settings.sets.push_back(key + "=" + value);
    (void)resolve(settings);
    if (!job.frames.empty()) (void)parse_frames(job.frames);
}

/// The folder is new, or that of this job with this training.
void check_folder_of(const PlannedJob& job, const JobState& state) {
    std::error_code failed;
    if (state.phase == JobPhase::waiting) {
        for (fs::directory_iterator entry(job.folder, failed), end; !failed && entry != end; entry.increment(failed))
            if (!entry->path().filename().string().starts_with('.'))   // of a process that begins this job now
                throw UsageError(fmt::format("{}: found {} in it, but no job of a batch; expected a new folder", job.folder.string(),
                                             entry->path().filename().string()));
        return;
    }
    const std::string& wanted = job.commands.front().text;
    if (!state.done.empty() && state.done.front() != wanted)
        throw UsageError(fmt::format("its training was done as \"{}\", found \"{}\"; expected the same, or that {} and {} are removed",
                                     state.done.front(), wanted, job.folder.string(), job.run.string()));
}

void check_job(const PlannedJob& job) {
    check_settings(job.job);
    for (const JobCommand& command : job.commands) check_command(command, job);
    const JobState state = load_state(job.folder);
    check_folder_of(job, state);
    if (!job.is_done(state.done)) check_dataset(job.job.log, job.job.sequence);   // where all is done, the log may have gone
}

/// A folder that a job will write.
struct Claim {
    std::string path;   ///< absolute, with a slash at the end
    const PlannedJob* job;
};

/// As a claim has it, through links as far as the folder is there already.
std::string folder_path(const fs::path& folder) { return (fs::weakly_canonical(folder).lexically_normal() / "").string(); }

/// What is wrong with a folder that is another one, or lies in it; empty where nothing is.
std::string conflict(const Claim& outer, const Claim& inner) {
    const BatchJob &first = outer.job->job, &second = inner.job->job;
    if (outer.job == inner.job)
        return outer.path == inner.path ? fmt::format("out: found {}, its own folder, expected another one", inner.path) : "";
    if (first.name == second.name) return fmt::format("the name is that of the job at {} too, expected names that differ", first.where);
    return fmt::format("its folder {} is that of job {} too, or lies in it; expected one for each", inner.path, first.name);
}

/// Folders that are the same for two jobs, or one in the other's. Sorted by path, a folder is followed by all that lie in it.
std::vector<Error> shared_folders(const BatchPlan& plan) {
    std::vector<Claim> claims, around;
    for (const PlannedJob& job : plan.jobs) {
        claims.push_back({folder_path(job.folder), &job});
        if (!job.job.out.empty()) claims.push_back({folder_path(job.run), &job});
    }
    std::stable_sort(claims.begin(), claims.end(), [](const Claim& a, const Claim& b) { return a.path < b.path; });
    std::vector<Error> problems;
    for (const Claim& claim : claims) {
        while (!around.empty() && !claim.path.starts_with(around.back().path)) around.pop_back();
        const std::string wrong = around.empty() ? "" : conflict(around.back(), claim);
        if (!wrong.empty()) problems.push_back(UsageError(fmt::format("{}: {}", claim.job->job.where, wrong)));
        around.push_back(claim);
    }
    return problems;
}

}  // namespace

std::vector<Error> check_plan(const BatchPlan& plan) {
    std::vector<Error> problems = shared_folders(plan);
    for (const PlannedJob& job : plan.jobs) {
        try {
            check_job(job);
        } catch (const Error& error) {
            problems.emplace_back(error.code(), fmt::format("{}: {}", job.job.where, error.what()));
        }
    }
    return problems;
}

}  // namespace relidar::cli
