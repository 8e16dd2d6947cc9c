// SPDX-License-Identifier: Apache-2.0
// The command `relidar train` trains a run on a log, or resumes a training. It checks all
// options before it reads the log, so that the user sees errors early.
#include <memory>
#include <optional>
#include <string_view>
#include <tuple>

#include <CLI/CLI.hpp>

#include <relidar/run/checkpoint.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "evaluate/actor_strips.hpp"
#include "evaluate/evaluation.hpp"
#include "evaluate/run_report.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "train/train_blocks.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

struct TrainOptions {
    std::string dataset;
    std::string out;
    LogSelection part;
    SettingsCommandOptions settings;
    DeviceCommandOptions device;
    std::string seed;
    std::string blocks;         ///< Length of the blocks into which the log is divided, such as "60m".
    std::string resume_folder;  ///< Argument of --resume.
    bool resume = false;
    bool from_preset = false;  ///< --preset or --config is given.
    bool force = false;
    bool no_eval = false;
    bool quiet = false;
};

constexpr const char* kConfigFile = "config.toml";

bool is_file(const fs::path& path) {
    std::error_code failed;
    return fs::is_regular_file(path, failed);
}

/// Completes the paths of the log (`dataset`) and of the run folder (`out`). The path
/// after --resume can be either of them. A resumed run needs no log, because its
/// config.toml names it.
TrainOptions resolve_paths(TrainOptions options) {
    const std::string& resume_path = options.resume_folder;  // empty without --resume
    if (options.out.empty()) {
        options.out = resume_path;  // --resume RUN
    } else if (options.dataset.empty() && resume_path != options.out) {
        options.dataset = resume_path;  // --out RUN --resume LOG
    }
    if (!options.resume && options.dataset.empty())
        throw UsageError("DATASET is required (see `relidar train --help`)");
    if (options.out.empty())
        throw UsageError("--out is required, or --resume with a run folder (see `relidar train --help`)");
    const bool run_names_log = options.resume && is_file(fs::path(options.out) / kConfigFile);
    if (options.dataset.empty() && !run_names_log)
        fail<UsageError>(
            "DATASET is required, because {} has no config.toml that names the log (see `relidar train "
            "--help`)",
            options.out);
    return options;
}

/// Returns the settings of a training. A resumed training uses its saved settings, unless
/// --preset or --config is given.
Config training_config(const TrainOptions& options) {
    if (contains_run(options.dataset))
        fail<UsageError>(
            "cannot train on {}: it is a run, expected a log; `relidar train --resume RUN` continues the "
            "training of a run",
            options.dataset);
    const fs::path config_file = fs::path(options.out) / kConfigFile;
    const bool has_saved = options.resume && is_file(config_file);
    Config config;
    if (has_saved && !options.from_preset) {
        config = load_settings(config_file);
        apply_settings(config, options.settings.sets);
    } else {
        config = make_config(options.settings);
    }
    // 0 means automatic. A resumed training uses the range that was found earlier.
    if (has_saved && config.dataset.max_range_m == 0.0)
        config.dataset.max_range_m = load_settings(config_file).dataset.max_range_m;
    if (!options.dataset.empty()) config.dataset.path = absolute_dataset(options.dataset);
    if (config.dataset.poses != kNoPoses) config.dataset.poses = absolute_path(config.dataset.poses);
    apply_selection(config, options.part);
    std::string block_length = options.blocks;
    if (block_length.ends_with('m')) block_length.pop_back();
    if (!block_length.empty()) set_value(config, "blocks.length_m", block_length);
    if (!options.seed.empty()) set_value(config, "train.seed", options.seed);
    return config;
}

/// Returns true if a run has a scene, a report, and all requested iterations.
bool is_finished(const fs::path& run_folder, const Config& config) {
    return is_file(run_folder / "scene.json") && is_file(run_folder / "report.html") &&
           last_iteration(run_folder) >= config.train.iterations;
}

/// Returns true if all settings whose names begin with a text, for example "refine.", are
/// equal. Both lists have the same settings in the same order.
bool is_group_equal(const Config& first, const Config& second, std::string_view setting_name_prefix) {
    const std::vector<ConfigKey> keys = list_config_keys(first), other_keys = list_config_keys(second);
    for (std::size_t i = 0; i < keys.size(); ++i)
        if (keys[i].key.starts_with(setting_name_prefix) && keys[i].value != other_keys[i].value)
            return false;
    return true;
}

/// Checks that a finished run agrees with the settings of the command line, because
/// nothing is trained. Settings without effect on the result may differ.
/// @throws UsageError that names the first other setting
void check_same_settings(const fs::path& run_folder, const Config& current_config) {
    const Config trained = load_settings(run_folder / kConfigFile);
    std::string key = find_fixed_setting(trained, current_config);
    // find_fixed_setting() allows these, because a training that continues applies them.
    if (key.empty() && trained.dataset.path != current_config.dataset.path) key = "dataset.path";
    if (key.empty() && trained.dataset.sequence != current_config.dataset.sequence) key = "dataset.sequence";
    for (const char* group : {"refine.", "render."})
        if (key.empty() && !is_group_equal(trained, current_config, group)) key = std::string(group) + "*";
    if (!key.empty())
        fail<UsageError>(
            "cannot resume {}: its finished training used another value of the setting {}; expected the same "
            "value; --force trains again from the start, and `relidar refine` trains only the ray-drop "
            "network",
            run_folder.string(), key);
}

/// Returns true if the scene was trained to the end with these settings, but no report
/// was written. Then only the later steps are missing.
bool lacks_report(const fs::path& run_folder, const Config& config) {
    if (!is_file(run_folder / "scene.json") || is_file(run_folder / "report.html") ||
        last_iteration(run_folder) < config.train.iterations)
        return false;
    const Config trained = load_settings(run_folder / kConfigFile);
    const auto log_of = [](const DatasetConfig& d) { return std::tie(d.path, d.sequence, d.poses); };
    return log_of(trained.dataset) == log_of(config.dataset) && find_fixed_setting(trained, config).empty();
}

/// Loads the newest checkpoint of the run to resume. Returns no value if there is none,
/// so that training starts from the beginning.
std::optional<Checkpoint> load_checkpoint(const TrainOptions& options) {
    const fs::path folder = options.out;
    std::optional<Checkpoint> start = load_newest(checkpoint_folder(folder), print_warning);
    if (start) return start;
    if (is_file(folder / "report.html"))
        fail<UsageError>(
            "cannot resume {}: its training has ended without a checkpoint; --force trains again from the "
            "start",
            folder.string());
    print_warning(
        fmt::format("{} has no checkpoint, so training starts from the beginning", folder.string()));
    return std::nullopt;
}

void print_start(const Log& log, const Split& split, const Device& device, const Checkpoint* resumed) {
    print(fmt::format("log     {}: {} frames, {} for training, {} held out\ndevice  {} ({})\n", log.name,
                      log.frames.size(), split.train.size(), split.test.size(), device.info().name,
                      device.backend() == RayTracingBackend::software ? "software traversal" : "ray query"));
    for (const std::string& note : log.notes) print("note    " + note + "\n");
    if (resumed) print(fmt::format("resume  training continues from iteration {}\n", resumed->iteration));
    std::fflush(stdout);
}

/// Trains the scene. If the training fails, throws an error that names the last
/// checkpoint and the command that resumes the training.
TrainResult train_with_hint(Device& device, const Run& run, const TrainOptions& options,
                            const Checkpoint* checkpoint_to_resume, StageTimes& stage_times) {
    const fs::path checkpoints = checkpoint_folder(run.folder);
    try {
        return train_scene(device, run.log, run.split, run.config, run.folder, options.quiet,
                           {.checkpoints = checkpoints,
                            .start = checkpoint_to_resume,
                            .stop = {},
                            .note = {},
                            .stages = &stage_times});
    } catch (const Error& error) {
        const bool has_checkpoint = !list_checkpoints(checkpoints).empty();
        if (!has_checkpoint && error.code() != ExitCode::interrupted) throw;
        const char* advice =
            has_checkpoint ? "the last checkpoint is saved; continue with" : "start again with";
        throw Error(error.code(), fmt::format("{}; {}: {}", error.what(), advice,
                                              resume_command("train", options.out, options.device)));
    }
}

/// For a user who interrupts a step after the scene was saved.
Error resume_error(const char* interrupted_step, const Run& run, const TrainOptions& options) {
    return Error(
        ExitCode::interrupted,
        fmt::format("interrupted while {}; the scene is saved in {}; continue with: {}", interrupted_step,
                    run.folder.string(), resume_command("train", options.out, options.device)));
}

/// Aligns the held-out scans to the trained scene, and learns the noise of intensities.
void finish_scene(Device& device, Run& run, const TrainOptions& options, StageTimes& stage_times) {
    if (align_and_fit_noise(device, run, options.quiet, stage_times) == TrainingEndReason::stopped)
        throw resume_error("held-out scans were being aligned or intensity noise was being learned", run,
                           options);
}

/// Scores the held-out frames and writes metrics.json. Returns an empty evaluation if
/// there are no held-out frames, or if the user wants no scores.
Evaluation score_run(Device& device, const Run& run, const TrainOptions& options) {
    if (run.split.test.empty() || options.no_eval) return {};
    ScanRenderer renderer(device, run);
    TerminalProgress progress(options.quiet);
    const auto start = Clock::now();
    Evaluation evaluation =
        evaluate_frames(renderer, run.config, run.log, run.split.test, interruptible_progress(progress));
    write_text_file(run.folder / "metrics.json",
                    metrics_json(evaluation, run.config, describe_source(run, device, seconds_since(start))));
    return evaluation;
}

/// Scores the run and adds the scores and pictures of actors to its report.
Evaluation add_scores(Report& report, Device& device, const Run& run, const TrainOptions& options,
                      StageTimes& stage_times) {
    try {
        stage_times.start_stage("evaluate");
        Evaluation evaluation = score_run(device, run, options);
        stage_times.start_stage("report");
        add_evaluation(report, evaluation, run, {"held out", "real"});
        for (ReportFigure& strip : draw_worst_actors(device, run, evaluation))
            report.figures.push_back(std::move(strip));
        if (std::optional<ReportFigure> strip = draw_walker(device, run))
            report.figures.push_back(std::move(*strip));
        return evaluation;
    } catch (const Error& error) {
        if (error.code() != ExitCode::interrupted) throw;
        throw resume_error("held-out frames were scored or drawn", run, options);
    }
}

/// Writes the report. After a complete training, also computes and writes the scores.
void write_train_report(Device& device, const Run& run, const TrainResult& result,
                        const TrainOptions& options, const std::string& command_line,
                        StageTimes& stage_times) {
    stage_times.start_stage("report");
    Report report = training_report(run, result, device, command_line);
    if (result.interrupted) {
        write_report(run.folder / "report.html", report);
        throw Error(
            ExitCode::interrupted,
            fmt::format(
                "interrupted after iteration {} of {}; the current scene is saved in {}; continue with: {}",
                result.iterations, run.config.train.iterations, run.folder.string(),
                resume_command("train", options.out, options.device)));
    }
    const Evaluation evaluation = add_scores(report, device, run, options, stage_times);
    report.facts.emplace_back("Stages", stage_times_text(stage_times));
    write_report(run.folder / "report.html", report);
    stage_times.end_stage();
    append_stage_times(run.folder, stage_times);
    if (options.quiet) return;
    if (!evaluation.frames.empty())
        print(fmt::format("\n{}all scores: {}\n\n", format_scores(evaluation),
                          absolute_path((run.folder / "metrics.json").string())));
    print(fmt::format("{} surfels in {} of training, {} of device memory\nstages  {}\nreport  {}\n",
                      count_surfels(run.scene), format_duration(result.train_s),
                      format_bytes(result.peak_device_bytes), stage_times_text(stage_times),
                      absolute_path((run.folder / "report.html").string())));
}

/// Loads the checkpoint from which the training of the ray-drop network resumes. If it
/// belongs to another scene or other settings, prints a note and returns no value.
std::optional<Checkpoint> load_network_state(const Run& run) {
    try {
        std::optional<Checkpoint> start = load_newest(network_checkpoint_folder(run.folder), print_warning);
        if (start) check_drop_resume(*start, run);
        return start;
    } catch (const Error& error) {
        print_warning(fmt::format(
            "{}; therefore the training of the ray-drop network starts from the beginning", error.what()));
        return std::nullopt;
    }
}

/// Trains and saves the network that corrects which rays of a scene drop. Only prints a
/// note if the log has no suitable training data, or the device cannot run the network.
void train_drop(Device& device, Run& run, const TrainOptions& options, StageTimes& stage_times) {
    const std::optional<Checkpoint> start = load_network_state(run);
    if (!start) remove_network_state(run.folder);
    else if (!options.quiet)
        print(fmt::format("resume  training of the ray-drop network continues from step {}\n",
                          start->iteration));
    const auto continue_without = [](const Error& error) {
        end_progress();
        print_warning(error.what());
    };
    try {
        const RayDropTrainingSession session{.checkpoints = network_checkpoint_folder(run.folder),
                                             .start = start ? &*start : nullptr,
                                             .stages = &stage_times};
        if (train_network_with_bar(device, run, options.quiet, session) == TrainingEndReason::stopped)
            throw resume_error("the ray-drop network was trained", run, options);
    } catch (const DataError& error) {
        // A training that continues from the checkpoints would fail with the same error.
        remove_network_state(run.folder);
        return continue_without(error);
    } catch (const DeviceError& error) {
        return continue_without(error);
    }
    save_run(run);
    remove_network_state(run.folder);
}

/// Returns what the log of a training says about its result.
TrainResult read_result(const fs::path& run_folder) {
    TrainResult result;
    result.log = read_log(run_folder);
    if (!result.log.empty()) {
        result.iterations = result.log.back().iteration;
        result.train_s = result.log.back().seconds;
    }
    return result;
}

/// Resumes a run whose scene is already trained. Runs only the missing steps: held-out
/// poses, ray-drop network, scores.
void finish_run(const TrainOptions& options, const Config& config, const std::string& command_line) {
    const RunOutputFolder folder(options.out, ExistingRunPolicy::keep);
    Run run = load_run(options.out);
    // A network that was trained with other settings is trained again.
    const bool has_network = !run.drop_network.empty() && is_group_equal(run.config, config, "refine.");
    run.config = config;
    Device device(to_device_options(options.device));
    StageTimes stages;
    stages.start_stage("read");
    const Log log = load_dataset(config, options.quiet);
    copy_scans(run, run.split.train, log);
    copy_scans(run, run.split.test, log);
    if (!options.quiet) {
        print_start(run.log, run.split, device, nullptr);
        print("resume  all iterations are done; continuing with the steps after them\n");
    }
    install_handlers();
    if (!run.held_out_placed) finish_scene(device, run, options, stages);
    // A process that was killed may have left checkpoints of a network that is complete.
    if (has_network) remove_network_state(run.folder);
    else if (config.refine.enabled) train_drop(device, run, options, stages);
    TrainResult result = read_result(run.folder);
    result.peak_device_bytes = device.peak_bytes();
    write_train_report(device, run, result, options, command_line, stages);
}

/// Removes the results of an earlier training, and saves the settings.
void prepare_run_folder(const fs::path& run_folder, const Config& config, bool keep_blocks,
                        bool keep_checkpoints) {
    remove_results(run_folder);
    remove_network_state(run_folder);
    if (!keep_checkpoints) remove_checkpoints(checkpoint_folder(run_folder));
    if (!keep_blocks) remove_blocks(run_folder);
    // If the process is killed, the training can be resumed with them.
    write_text_file(run_folder / kConfigFile, to_toml(config));
}

/// Returns what happens to an existing run in the output folder.
ExistingRunPolicy existing_run_policy(const TrainOptions& options) {
    if (options.force) return ExistingRunPolicy::replace;
    return options.resume ? ExistingRunPolicy::keep : ExistingRunPolicy::refuse;
}

/// Trains a log from the beginning or from a checkpoint, and writes the run. With
/// --blocks, the MPI processes share the training, and the first one writes the run.
void train_run(const TrainOptions& options, Config config, const MpiProcessGroup& ranks,
               const std::string& command_line) {
    const bool resume = options.resume && !options.force;
    const bool in_blocks = config.blocks.length_m > 0.0;
    if (ranks.size() > 1 && !in_blocks)
        fail<UsageError>(
            "training with {} MPI processes needs --blocks, because the processes share the blocks of a log",
            ranks.size());
    std::optional<RunOutputFolder> folder;
    if (ranks.is_first()) folder.emplace(options.out, existing_run_policy(options));
    if (resume && in_blocks) check_blocks(options.out, config);
    std::optional<Checkpoint> start = resume && !in_blocks ? load_checkpoint(options) : std::nullopt;
    Device device(to_device_options(options.device));

    // Reads and prepares the log.
    StageTimes stages;
    stages.start_stage("read");
    Log log = load_dataset(config, options.quiet);
    config = with_max_range(std::move(config), log);
    const Split split = split_frames(log, config.dataset.test_every, config.dataset.test_frames);
    if (!options.quiet) print_start(log, split, device, start ? &*start : nullptr);
    install_handlers();
    prepare_log(log, split, config, options.quiet, ranks.group(), &stages);
    if (start) check_resume(*start, log, split, config);
    if (folder) prepare_run_folder(folder->path(), config, resume && in_blocks, start.has_value());
    // The other processes must not write blocks before the folder is prepared.
    ranks.barrier();

    // Trains the scene.
    Run run{options.out, config, std::move(log), split, {}, {}};
    if (in_blocks) stages.start_stage("train");
    TrainResult result =
        in_blocks ? train_blocks(device, run,
                                 {ranks, options.quiet, resume_command("train", options.out, options.device)})
                  : train_with_hint(device, run, options, start ? &*start : nullptr, stages);
    if (!ranks.is_first()) return;
    end_progress();
    start.reset();  // frees its memory

    // Saves the scene, then runs the steps that need it.
    if (!in_blocks) move_result(run, result);
    stages.start_stage("save");
    save_run(run);
    if (!result.interrupted) finish_scene(device, run, options, stages);
    if (config.refine.enabled && !result.interrupted) train_drop(device, run, options, stages);
    write_train_report(device, run, result, options, command_line, stages);
}

/// Runs `relidar train`. A resumed run that is complete stays as it is. If only its
/// scores or its report are missing, computes only these.
void run_train(const TrainOptions& command_options, const std::string& command_line) {
    const MpiProcessGroup ranks;
    TrainOptions options = resolve_paths(command_options);
    options.quiet = options.quiet || !ranks.is_first();
    options.device = ranks.select_device(options.device);
    const Config config = training_config(options);
    const bool resume = options.resume && !options.force;
    if (resume && is_finished(options.out, config)) {
        check_same_settings(options.out, config);
        if (!options.quiet)
            print(
                fmt::format("{} has already finished all {} iterations, so nothing is trained; increase "
                            "train.iterations to continue\n",
                            options.out, config.train.iterations));
        return;
    }
    if (!options.no_eval) check_lpips_weights();
    if (resume && lacks_report(options.out, config)) {
        if (ranks.is_first()) finish_run(options, config, command_line);
        return;
    }
    train_run(options, config, ranks, command_line);
}

constexpr const char* kTrainHelp =
    R"(RUN/ receives config.toml, scene.json, model.safetensors, log.jsonl, metrics.json, report.html,
and checkpoints/ if training takes long.
Ctrl-C stops training and saves the current scene and a checkpoint. --resume continues as if there
had been no interruption, including the ray-drop network. Settings refine.* and render.* may be
changed when resuming; changed refine.* settings train the network from the beginning.
Later settings replace earlier ones in this order: preset, --config, --set, other options.
`relidar list settings` lists the settings.
Examples:
  relidar train data/street --out run --preset quick
  relidar train --resume run
  relidar train data/2011_09_26_drive_0005_sync --out run --frames 0:50 --set sensor.grid=kitti360)";

}  // namespace

/// Adds the command `relidar train` and its options to the parser.
void add_train(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("train", "train a scene on a log");
    const auto options = std::make_shared<TrainOptions>();
    command->add_option("DATASET", options->dataset, "log: a path, whose format is recognised, or KIND:PATH");
    add_option(*command, "--out RUN", options->out, "run folder to create");
    add_log_options(*command, options->part);
    add_settings_options(*command, options->settings);
    add_option(*command, "--seed S", options->seed, "seed of initialisation and training (default: 1)");
    add_option(*command, "--blocks LENGTH", options->blocks,
               "train a long log in blocks of at most this length of its trajectory, for example 60m, so "
               "that memory does not grow with the log (blocks.length_m)");
    add_device_options(*command, options->device);
    add_option(*command, "--resume [RUN]", options->resume_folder,
               "continue the training of the run in --out, or in RUN, from its newest checkpoint; log and "
               "settings are those of the run, unless the command line replaces them")
        ->expected(0, 1);
    command->add_flag("--force", options->force, "overwrite the run in RUN");
    command->add_flag("--no-eval", options->no_eval, "do not score the held-out frames at the end");
    add_quiet_option(*command, options->quiet);
    command->footer(kTrainHelp);
    command->callback([&call, options, command] {
        options->resume = command->count("--resume") > 0;
        options->from_preset = command->count("--preset") + command->count("--config") > 0;
        call.run = [&call, options] { run_train(*options, call.command_line); };
    });
}

}  // namespace relidar::cli
