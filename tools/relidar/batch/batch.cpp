// SPDX-License-Identifier: Apache-2.0
// relidar batch: many logs, each trained and then rendered, scored, edited as a manifest says; on one machine, or on many that share a
// folder. docs/fleet.md has the manifest, the exit codes and files for Slurm and Kubernetes.
#include <algorithm>
#include <memory>
#include <optional>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "batch/check.hpp"
#include "batch/manifest.hpp"
#include "batch/plan.hpp"
#include "batch/share.hpp"
#include "batch/summary.hpp"
#include "batch/work.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

struct BatchOptions {
    std::string manifest;
    std::string out;
    std::optional<int> task, tasks;
    DeviceChoice device;
    bool retry_failed = false;
    bool status = false;
    bool quiet = false;
};

/// One line where one thing is wrong; else each is told, and the error says how many.
void raise_problems(const std::vector<Error>& problems, const std::string& manifest) {
    if (problems.empty()) return;
    if (problems.size() == 1) throw problems.front();
    for (const Error& problem : problems) note(problem.what());
    const bool usage = std::any_of(problems.begin(), problems.end(), [](const Error& p) { return p.code() == ExitCode::usage; });
    throw Error(usage ? ExitCode::usage : problems.front().code(),
                fmt::format("{}: {} faults, see above; no job was begun", manifest, problems.size()));
}

std::vector<JobReport> report_share(const BatchPlan& plan, const Share& share) {
    const std::vector<JobReport> all = report_jobs(plan);
    std::vector<JobReport> reports;
    for (std::size_t j = 0; j < all.size(); ++j)
        if (share.has(j)) reports.push_back(all[j]);
    return reports;
}

void run_batch(const BatchOptions& options) {
    catch_interrupts();   // at once: the first process of a container gets no signal that it does not catch
    const BatchManifest manifest = load_manifest(options.manifest);
    const BatchPlan plan = plan_batch(manifest, fs::absolute(options.out).lexically_normal(), options.device);
    if (options.status) return print(status_text(report_jobs(plan)));

    const Share share = find_share(options.task, options.tasks);
    fs::current_path(manifest.folder());   // what its paths are relative to, for the checks and for every command
    raise_problems(check_plan(plan), options.manifest);
    const OutputFolder folder(plan.out);
    if (share.tasks > 1 && !options.quiet) print(fmt::format("task {} of 0 to {}\n", share.task, share.tasks - 1));
    work(plan, {share, options.retry_failed, options.quiet});
    write_summary(plan);
    const std::vector<JobReport> reports = report_share(plan, share);
    if (!options.quiet) print("\n" + status_text(reports));
    raise_ends(reports);
}

void add_share_options(CLI::App& command, BatchOptions& options) {
    command
        .add_option("--task", options.task,
                    "do the share of one of --tasks, counted from 0 (default: SLURM_ARRAY_TASK_ID of an array, JOB_COMPLETION_INDEX)")
        ->type_name("I");
    command.add_option("--tasks", options.tasks, "how many share the jobs (default: that of the array; else 1)")->type_name("N");
}

}  // namespace

void add_batch(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("batch", "train, render and score many logs, resumably, on one machine or many");
    const auto options = std::make_shared<BatchOptions>();
    command->add_option("MANIFEST", options->manifest, "TOML file with [defaults] and a [[job]] for each log or list of logs")->required();
    command->add_option("--out", options->out, "folder for all jobs")->required()->type_name("DIR");
    add_share_options(*command, *options);
    command->add_flag("--retry-failed", options->retry_failed, "try again what failed before");
    command->add_flag("--status", options->status, "say how far every job is, and do nothing");
    add_device_options(*command, options->device);
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer(
        "[[job]]: log or logs (paths, kind:path, patterns), name, frames, sequence or sequences, preset, config, settings, out, steps;\n"
        "[defaults]: what jobs have in common. Paths are relative to the manifest. Steps are command lines after training: refine, render, "
        "eval, edit,\n"
        "export, import, info; {run} is the job's run, {job} its folder, {name} its name.\n"
        "DIR/NAME/ gets job.json (how far it is), batch.log (what its commands printed), run/; DIR/batch.json all jobs at a glance.\n"
        "The same command again goes on: what is done is left, what was interrupted is resumed, what failed waits for --retry-failed.\n"
        "Exit codes: 0 all done, 130 interrupted (the same command goes on), else that of a failed job; docs/fleet.md.\n"
        "Examples:\n"
        "  relidar batch fleet.toml --out fleet\n"
        "  relidar batch fleet.toml --out fleet --status\n"
        "  relidar batch fleet.toml --out fleet --task 3 --tasks 16");
    command->callback([&call, options] { call.run = [options] { run_batch(*options); }; });
}

}  // namespace relidar::cli
