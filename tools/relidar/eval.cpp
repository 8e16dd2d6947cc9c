// SPDX-License-Identifier: Apache-2.0
// relidar eval: the held-out frames of a run rendered again and scored against the log it was trained on.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "command.hpp"
#include "console.hpp"
#include "evaluation.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include <relidar/export.hpp>
#include <relidar/run.hpp>

namespace relidar::cli {
namespace {

constexpr double kSameTime_s = 1e-3;

struct Options {
    std::string run;
    std::string out;
    std::vector<std::string> sets;
    DeviceChoice device;
    bool quiet = false;
};

/// Gives the run's held-out frames the scans of the log. Poses stay those of the run.
void attach_scans(Run& run, Sequence log) {
    for (const int position : run.split.test) {
        Frame& frame = run.sequence.frames[static_cast<std::size_t>(position)];
        const auto it = std::find_if(log.frames.begin(), log.frames.end(), [&](const Frame& f) { return f.index == frame.index; });
        if (it == log.frames.end()) throw DataError(fmt::format("{}: frame {} is not there, expected it as when {} was trained", run.config.dataset.path, frame.index, run.folder.string()));
        if (std::abs(it->time_s - frame.time_s) > kSameTime_s) {
            throw DataError(fmt::format("{}: frame {} is of time {} s, expected {} s as when {} was trained", run.config.dataset.path, frame.index, it->time_s, frame.time_s, run.folder.string()));
        }
        frame.scan = std::move(it->scan);
    }
}

void run_eval(const Options& options) {
    Run run = load_run(options.run);
    apply_sets(run.config, options.sets);
    const std::filesystem::path out = options.out.empty() ? run.folder / "metrics.json" : std::filesystem::path(options.out);
    const OutputFolder folder(out.has_parent_path() ? out.parent_path() : ".");
    if (run.split.test.empty()) throw DataError(fmt::format("{}: no frame was held out, expected at least one to evaluate", run.folder.string()));
    Device device(device_options(options.device));
    attach_scans(run, load_dataset(run.config));

    catch_interrupts();
    const auto start = std::chrono::steady_clock::now();
    ScanRenderer renderer(device, run.scene, run.config, run.sequence);
    Progress progress(options.quiet);
    const Evaluation evaluation = evaluate_frames(renderer, run.config, run.sequence, run.split.test, progress);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    end_progress_line();
    write_text(out, metrics_json(evaluation, run.config, {absolute_path(run.folder.string()), device.info().name, device.peak_bytes(), seconds}));
    if (options.quiet) return;
    print(metric_table(evaluation));
    print(fmt::format("\n{} held-out frames, {:.1f} ms of tracing a frame, {} of device memory\nmetrics  {}\n", evaluation.frames.size(), evaluation.trace_ms, byte_size(device.peak_bytes()),
                      absolute_path(out.string())));
}

}  // namespace

void add_eval(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("eval", "score the held-out frames of a run against its log");
    const auto options = std::make_shared<Options>();
    command->add_option("RUN", options->run, "run folder of `relidar train`")->required();
    command->add_option("--out", options->out, "JSON file for the numbers (default: RUN/metrics.json)")->type_name("FILE");
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer("The log is read from where it was when the run was trained; --set dataset.path=... names another place.\n"
                    "Metrics: peer/* as published tables do it, strict/* over pixels returned in both; units in the names.\n"
                    "Examples:\n"
                    "  relidar eval run\n"
                    "  relidar eval run --out median.json --set render.range=median");
    command->callback([&call, options] { call.run = [options] { run_eval(*options); }; });
}

}  // namespace relidar::cli
