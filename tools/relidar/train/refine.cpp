// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/run/stage_options.hpp>
#include "command.hpp"
#include "console.hpp"
#include "evaluate/evaluation.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

struct RefineCommandOptions {
    std::string run;
    std::vector<std::string> sets;
    DeviceCommandOptions device;
    bool resume = false;
    bool no_eval = false;
    bool quiet = false;
};

/// Loads the checkpoint that --resume continues. No value: starts from the beginning.
std::optional<Checkpoint> load_checkpoint(const RefineCommandOptions& options) {
    const std::filesystem::path folder = network_checkpoint_folder(options.run);
    if (!options.resume) {
        if (!list_checkpoints(folder).empty())
            print_warning(
                fmt::format("{} contains a checkpoint of an unfinished network training, which is discarded; "
                            "use --resume to continue such a training",
                            options.run));
        return std::nullopt;
    }
    std::optional<Checkpoint> start = load_newest(folder, print_warning);
    if (!start)
        print_warning(fmt::format(
            "{} has no checkpoint of its network training, which therefore starts from the beginning",
            options.run));
    return start;
}

/// Trains the ray-drop network and saves it. If the user interrupts, throws an error with
/// the command that resumes the training.
void train_network(Device& device, Run& run, const RefineCommandOptions& options, const Checkpoint* from) {
    if (from && !options.quiet)
        print(fmt::format("resume  training of the network continues from step {}\n", from->iteration));
    const std::filesystem::path checkpoints = network_checkpoint_folder(run.folder);
    install_handlers();
    if (train_network_with_bar(device, run, options.quiet, {.checkpoints = checkpoints, .start = from}) ==
        TrainingEndReason::stopped) {
        std::string message =
            fmt::format("interrupted: the ray-drop network of run {} is unchanged", run.folder.string());
        if (!list_checkpoints(checkpoints).empty())
            message += "; continue with: " + resume_command("refine", options.run, options.device);
        throw Error(ExitCode::interrupted, message);
    }
    save_run(run);
}

Evaluation score_held_out(Device& device, Run run, bool use_drop_network, bool quiet) {
    run.config.refine.enabled = use_drop_network;
    ScanRenderer renderer(device, run);
    TerminalProgress progress(quiet);
    return evaluate_frames(renderer, run.config, run.log, run.split.test, interruptible_progress(progress));
}

/// Scores the run without and with the ray-drop network and prints both. Writes the
/// scores with the network to metrics.json.
void compare_scores(Device& device, const Run& run, const RefineCommandOptions& options) {
    const Evaluation before = score_held_out(device, run, false, options.quiet),
                     after = score_held_out(device, run, true, options.quiet);
    end_progress();
    write_text_file(run.folder / "metrics.json",
                    metrics_json(after, run.config, describe_source(run, device)));
    if (!options.quiet)
        print(format_metrics(after, &before) +
              "\nThe column \"baseline\" has the scores without the ray-drop network.\n");
}

/// Returns the settings for refining a run: those of the run or of the checkpoint from
/// which the training resumes, changed by --set.
Config refine_config(const Run& run, const std::optional<Checkpoint>& start,
                     const std::vector<std::string>& sets) {
    std::vector<std::string> used = render_settings();
    used.insert(used.end(), {"dataset.", "refine.", "train.seed", "train.checkpoint_minutes"});
    check_settings_used(sets, used, "refine");
    Config config = run.config;
    if (start) read_drop_settings(*start, config);
    apply_settings(config, sets);
    config.refine.enabled = true;
    return with_max_range(std::move(config), run.log);
}

/// Trains the ray-drop network of an existing run again, and scores the result.
void run_refine(const RefineCommandOptions& options) {
    std::optional<FolderLock> lock;
    if (is_run_folder(options.run)) lock.emplace(options.run);  // otherwise load_run() fails
    Run run = load_run(options.run);
    const std::optional<Checkpoint> start = load_checkpoint(options);
    run.config = refine_config(run, start, options.sets);
    prepare_folder(run.folder);  // Fails before the training if the results cannot be written.
    Device device(to_device_options(options.device));
    const Log log = load_dataset(run.config, options.quiet);
    copy_scans(run, run.split.train, log);
    if (!options.no_eval) copy_scans(run, run.split.test, log);
    if (start) check_drop_resume(*start, run);
    else remove_network_state(run.folder);

    train_network(device, run, options, start ? &*start : nullptr);
    if (!options.no_eval && !run.split.test.empty()) compare_scores(device, run, options);

    // Removes the checkpoints last. Until then, --resume can use them.
    remove_network_state(run.folder);
}

constexpr const char* kRefineHelp =
    R"(RUN/ receives drop_network.safetensors, which render and eval use from then on. The settings are
refine.*. Each epoch saves a checkpoint (RUN/checkpoints/drop_network), and so does Ctrl-C. With
--resume the network ends exactly the same as without an interruption.
The log is read from the path that the run was trained from. If the log has moved, use --set
dataset.path=PATH.
Examples:
  relidar refine run
  relidar refine run --set refine.network=paper --set refine.epochs=100
  relidar refine --resume run)";

}  // namespace

/// Adds the command `relidar refine` and its options to the parser.
void add_refine(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("refine", "train the network that corrects the ray-drop of a run");
    const auto options = std::make_shared<RefineCommandOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train`")->required();
    command->add_flag("--resume", options->resume,
                      "continue an interrupted training, with its settings, from its newest checkpoint");
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    command->add_flag("--no-eval", options->no_eval, "do not score the held-out frames after the training");
    add_quiet_option(*command, options->quiet);
    command->footer(kRefineHelp);
    run_after_parsing(*command, call, options, run_refine);
}

}  // namespace relidar::cli
