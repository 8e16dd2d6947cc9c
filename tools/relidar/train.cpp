// SPDX-License-Identifier: Apache-2.0
// relidar train: a log becomes a run. What can fail early does: settings, output folder, device, then the log.
#include <memory>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "command.hpp"
#include "console.hpp"
#include "evaluation.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "run_report.hpp"
#include "training.hpp"
#include <relidar/run.hpp>

namespace relidar::cli {
namespace {

struct Options {
    std::string dataset;
    std::string out;
    std::string frames;
    Settings settings;
    DeviceChoice device;
    std::string seed;
    bool force = false;
    bool no_eval = false;
    bool quiet = false;
};

Config config_of(const Options& options) {
    Config config = resolve(options.settings);
    config.dataset.path = absolute_dataset(options.dataset);
    config.dataset.poses = absolute_path(config.dataset.poses);
    if (!options.frames.empty()) {
        const FrameRange range = parse_frames(options.frames);
        config.dataset.frames_begin = range.begin;
        config.dataset.frames_end = range.end;
    }
    if (!options.seed.empty()) {
        set_key(config, "init.seed", options.seed);
        set_key(config, "train.seed", options.seed);
    }
    return config;
}

void announce(const Sequence& sequence, const Split& split, const Device& device) {
    print(fmt::format("log     {}: {} frames, {} for training, {} held out\ndevice  {} ({})\n", sequence.name, sequence.frames.size(), split.train.size(), split.test.size(),
                      device.info().name, device.traversal() == Traversal::software ? "software traversal" : "ray query"));
    std::fflush(stdout);
}

/// Scores the held-out frames and writes metrics.json. @return nothing scored where no frame is held out
Evaluation score(Device& device, const Run& run, const Options& options) {
    if (run.split.test.empty() || options.no_eval) return {};
    ScanRenderer renderer(device, run.scene, run.config, run.sequence);
    Progress progress(options.quiet);
    const auto start = std::chrono::steady_clock::now();
    Evaluation evaluation = evaluate_frames(renderer, run.config, run.sequence, run.split.test, progress);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    write_text(run.folder / "metrics.json", metrics_json(evaluation, run.config, {absolute_path(run.folder.string()), device.info().name, device.peak_bytes(), seconds}));
    return evaluation;
}

void run_train(const Options& options, const std::string& command_line) {
    const Config config = config_of(options);
    check_empty(options.out, options.force);
    const OutputFolder folder(options.out);
    Device device(device_options(options.device));
    Sequence sequence = load_dataset(config);
    const Split split = split_frames(sequence, config.dataset.test_every);
    if (!options.quiet) announce(sequence, split, device);

    catch_interrupts();
    remove_run_files(folder.path());
    TrainResult result = train_logged(device, sequence, split, config, folder.path(), options.quiet);
    end_progress_line();
    const Run run{folder.path(), config, std::move(sequence), split, std::move(result.scene), {}};
    save_run(run);
    Report report = make_report(run, result, device, command_line);
    if (result.interrupted) {
        write_report(run.folder / "report.html", report);
        throw Error(ExitCode::interrupted, fmt::format("interrupted after iteration {} of {}; {} holds the scene so far", result.log.back().iteration, config.train.iterations, run.folder.string()));
    }
    const Evaluation evaluation = score(device, run, options);
    add_evaluation(report, evaluation, run, {"held out", "real"});
    write_report(run.folder / "report.html", report);
    if (options.quiet) return;
    if (!evaluation.frames.empty()) print("\n" + metric_table(evaluation) + "\n");
    print(fmt::format("{} surfels in {} of training, {} of device memory\nreport  {}\n", run.scene.surfels.size(), duration(result.train_s), byte_size(result.peak_device_bytes),
                      absolute_path((run.folder / "report.html").string())));
}

}  // namespace

void add_train(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("train", "train a scene on a log");
    const auto options = std::make_shared<Options>();
    command->add_option("DATASET", options->dataset, "log: a path (format recognised), or kind:path with kind kitti_raw or synthetic")->required();
    command->add_option("--out", options->out, "run folder to make")->required()->type_name("RUN");
    command->add_option("--frames", options->frames, "frames to use, first:end, by the dataset's own numbers (default: all)")->type_name("A:B");
    add_settings_options(*command, options->settings);
    command->add_option("--seed", options->seed, "seed of initialisation and training (default: 1)")->type_name("S");
    add_device_options(*command, options->device);
    command->add_flag("--force", options->force, "overwrite the run in RUN");
    command->add_flag("--no-eval", options->no_eval, "do not score the held-out frames at the end");
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer("RUN/ gets config.toml, scene.json, model.safetensors, log.jsonl, metrics.json and report.html. Ctrl-C stops training and saves.\n"
                    "Settings: preset, then --config, then --set, then the flags; the later one wins. `relidar config` lists them.\n"
                    "Examples:\n"
                    "  relidar train data/street --out run --preset quick\n"
                    "  relidar train data/2011_09_26_drive_0005_sync --out run --frames 0:50 --set sensor.grid=kitti360 --set dataset.poses=poses.txt");
    command->callback([&call, options] { call.run = [&call, options] { run_train(*options, call.command_line); }; });
}

}  // namespace relidar::cli
