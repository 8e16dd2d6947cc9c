// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <optional>

#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/score/report.hpp>
#include "base/fail.hpp"
#include "browser.hpp"
#include "command.hpp"
#include "console.hpp"
#include "evaluate/actor_strips.hpp"
#include "evaluate/evaluation.hpp"
#include "evaluate/pictures.hpp"
#include "evaluate/run_report.hpp"
#include "evaluate/score_table.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "ranks.hpp"

namespace relidar::cli {
namespace {

struct EvalOptions {
    std::vector<std::string> targets;  ///< Folders of runs or logs that the user typed.
    std::string target;                ///< Run or log to score.
    std::vector<std::string> tables;
    std::string out;
    LogSelection part;
    std::string baseline;
    std::string pictures;
    std::vector<std::string> sets;
    DeviceCommandOptions device;
    bool no_refine = false;
    bool open = false;
    bool quiet = false;
};

/// Scores need frames that training has not seen.
void check_held_out(const Split& split, const std::string& run_or_log_path) {
    if (split.test.empty())
        fail("cannot evaluate {}: it has no held-out frames; expected at least one", run_or_log_path);
}

/// Files and folders of the results. The first MPI process creates the folders before any
/// process renders, so that a folder that cannot be written is reported early.
struct EvaluationOutputs {
    std::filesystem::path file, pictures;
    std::optional<OutputFolder> of_file;
    std::optional<LockedFolder> of_pictures;

    EvaluationOutputs(const std::filesystem::path& metrics_file, const std::string& picture_folder,
                      const MpiProcessGroup& ranks)
        : file(metrics_file), pictures(picture_folder) {
        if (ranks.is_first() && !file.empty()) of_file.emplace(folder_of(file));
        if (ranks.is_first() && !pictures.empty()) of_pictures.emplace(pictures);
        ranks.barrier();
    }

    void write_pictures(const ScoredFrame& frame, const Config& config) const {
        if (!pictures.empty()) write_comparison(pictures, frame, config.dataset.max_range_m);
    }
};

/// Prints the scores and writes them to the JSON file, if it has a name.
void write_metrics(const EvaluationOutputs& output, const Evaluation& result, const Config& config,
                   const EvaluationProvenance& provenance, bool quiet) {
    end_progress();
    if (!output.file.empty()) write_text_file(output.file, metrics_json(result, config, provenance));
    if (quiet) return;
    print(format_metrics(result, provenance.baseline));
    print(fmt::format("\n{} held-out frames", result.frames.size()));
    if (result.trace_ms > 0.0)
        print(fmt::format(", {:.1f} ms of tracing per frame, {:.3f} Mrays/s, {} of device memory",
                          result.trace_ms, result.mrays_per_s, format_bytes(provenance.peak_device_bytes)));
    if (!output.file.empty()) print("\nmetrics  " + absolute_path(output.file.string()));
    print("\n");
}

void write_page(const std::filesystem::path& page_file, const Report& report, bool quiet) {
    write_report(page_file, report);
    if (!quiet) print("page     " + absolute_path(page_file.string()) + "\n");
    open_in_browser(absolute_path(page_file.string()));
}

/// The other MPI processes score the remaining frames.
void select_local_frames(std::vector<int>& frame_positions, const MpiProcessGroup& ranks) {
    const ProcessGroup::PartRange share = ranks.group().part_range(frame_positions.size());
    frame_positions = {frame_positions.begin() + std::ptrdiff_t(share.begin),
                       frame_positions.begin() + std::ptrdiff_t(share.end)};
}

/// Loads a run with the settings of the command line.
Run load_scored_run(const EvalOptions& options) {
    std::vector<std::string> setting_names = render_settings();
    setting_names.push_back("dataset.");
    check_settings_used(options.sets, setting_names, "eval");
    return load_configured_run(options.target, options.sets, {}, options.no_refine);
}

/// Writes the report of an evaluation next to the JSON file and opens it in a browser.
void open_report(const EvalOptions& options, const EvaluationOutputs& output, Device& device, const Run& run,
                 const Evaluation& result, const std::string& command_line) {
    Report report = evaluation_report(run, result, device, command_line);
    for (ReportFigure& strip : draw_worst_actors(device, run, result))
        report.figures.push_back(std::move(strip));
    write_page(output.file.parent_path() / "evaluation.html", report, options.quiet);
}

/// Scores the held-out frames of a run. Each MPI process renders a part of the frames,
/// and the first process writes all scores.
void eval_run(const EvalOptions& options, const MpiProcessGroup& ranks, const std::string& command_line) {
    // The command writes metrics.json to the run's folder, so no other process may.
    std::optional<FolderLock> lock;
    if (ranks.is_first() && options.out.empty() && is_run_folder(options.target))
        lock.emplace(options.target);
    Run run = load_scored_run(options);
    const EvaluationOutputs output(
        options.out.empty() ? run.folder / "metrics.json" : std::filesystem::path(options.out),
        options.pictures, ranks);
    check_held_out(run.split, run.folder.string());
    const std::vector<int> all_test = run.split.test;
    select_local_frames(run.split.test, ranks);
    Device device(to_device_options(options.device));
    const Log log = load_dataset(run.config, options.quiet);
    copy_scans(run, run.split.test, log);
    // A baseline predicts held-out scans from training scans.
    const bool has_baseline = !options.baseline.empty();
    if (has_baseline) copy_scans(run, run.split.train, log);

    install_handlers();
    const auto start = Clock::now();
    TerminalProgress progress(options.quiet);
    const auto callback = interruptible_progress(progress);
    std::optional<Evaluation> baseline;
    if (has_baseline)
        baseline = gather_evaluation(
            evaluate_baseline(options.baseline, run.config, run.log, run.split, callback), ranks);
    ScanRenderer renderer(device, run);
    const auto process_frame = [&](const ScoredFrame& frame) { output.write_pictures(frame, run.config); };
    Evaluation result = gather_evaluation(
        evaluate_frames(renderer, run.config, run.log, run.split.test, callback, process_frame), ranks);

    // The first process now has all scores and writes the results alone.
    if (!ranks.is_first()) return;
    if (!options.quiet && !run.edits.empty())
        print(
            "note: the run is edited, but the log shows the scene before the edits; the scores of changed "
            "pixels do not measure the quality of the edit\n");
    EvaluationProvenance source = describe_source(run, device, seconds_since(start));
    source.baseline = baseline ? &*baseline : nullptr;
    write_metrics(output, result, run.config, source, options.quiet);
    if (!output.pictures.empty()) {
        // Pictures of actors also need the frames that other processes have rendered.
        run.split.test = all_test;
        if (ranks.size() > 1) copy_scans(run, run.split.test, log);
        write_worst_actors(output.pictures, device, run, result);
    }
    if (options.open) open_report(options, output, device, run, result, command_line);
}

/// Settings that change the real scans or their images. A baseline renders no scene, so
/// all other settings have no effect on it.
const std::vector<std::string> kBaselineSettings = {
    "dataset.sequence",        "dataset.lidars",      "dataset.frames_begin",   "dataset.frames_end",
    "dataset.test_every",      "dataset.poses",       "dataset.test_frames",    "dataset.poses_from",
    "dataset.skip_broken",     "dataset.min_range_m", "dataset.memory_mib",     "dataset.max_range_m",
    "dataset.waymo_intensity", "sensor.grid",         "sensor.rolling_shutter", "conventions."};

/// Scores a baseline, a simple prediction of the held-out scans of a log. Needs neither a
/// trained run nor a GPU.
void eval_baseline(const EvalOptions& options, const MpiProcessGroup& ranks) {
    check_settings_used(options.sets, kBaselineSettings, "eval LOG --baseline");
    Config config = make_preset("default");
    apply_settings(config, options.sets);
    config.dataset.path = absolute_dataset(options.target);
    apply_selection(config, options.part);
    const EvaluationOutputs output(options.out, options.pictures, ranks);
    const Log log = load_dataset(config, options.quiet);
    if (!options.quiet)
        for (const std::string& text : log.notes) print_note(text);
    config = with_max_range(std::move(config), log);
    Split split = split_frames(log, config.dataset.test_every, config.dataset.test_frames);
    check_held_out(split, options.target);
    select_local_frames(split.test, ranks);

    install_handlers();
    const auto start = Clock::now();
    TerminalProgress progress(options.quiet);
    const auto process_frame = [&](const ScoredFrame& frame) { output.write_pictures(frame, config); };
    const Evaluation result =
        gather_evaluation(evaluate_baseline(options.baseline, config, log, split,
                                            interruptible_progress(progress), process_frame),
                          ranks);
    const EvaluationProvenance source{.run = "", .device = "none", .seconds = seconds_since(start)};
    if (ranks.is_first()) write_metrics(output, result, config, source, options.quiet);
}

/// Makes a table of the existing scores of several runs, without rendering.
void write_score_tables(const EvalOptions& options, const MpiProcessGroup& ranks) {
    if (ranks.is_first()) write_tables(options.targets, options.tables);
    if (options.quiet) return;
    for (const std::string& file : options.tables) print("table  " + absolute_path(file) + "\n");
}

/// Rejects options that do not fit to the argument, before anything is loaded, because
/// loading takes a long time.
/// @param is_log_baseline only a baseline of a log is scored, so that no run is needed
void check_eval_options(const EvalOptions& options, bool is_log_baseline, int n_processes) {
    if (options.open && n_processes > 1)
        fail<UsageError>(
            "--open: found {} MPI processes; expected one, because the page shows all frames, but each of "
            "several processes renders only a part of them",
            n_processes);
    // Called only for its error.
    if (!options.baseline.empty()) (void)parse_baseline(options.baseline);
    if (is_log_baseline && options.open)
        throw UsageError(
            "--open: the argument is a log; expected a run, because only the scores of a run are written as "
            "a page");
    if (!is_log_baseline && (!options.part.frames.empty() || !options.part.sequence.empty()))
        fail<UsageError>(
            "{} cannot be used with a run, because a run already has its held-out frames; expected it only "
            "with --baseline and a log",
            options.part.frames.empty() ? "--sequence" : "--frames");
}

/// Runs `relidar eval`: writes a table of existing scores, or scores a run or a baseline.
void run_eval(const EvalOptions& command_options, const std::string& command_line) {
    const MpiProcessGroup ranks;
    EvalOptions options = command_options;
    options.quiet = options.quiet || !ranks.is_first();
    if (!options.tables.empty()) return write_score_tables(options, ranks);
    if (options.targets.size() > 1)
        fail<UsageError>(
            "found {} runs as arguments; expected one run, or --table FILE to write a table of the scores of "
            "several runs",
            options.targets.size());
    options.target = options.targets.front();
    options.device = ranks.select_device(options.device);
    const bool is_log_baseline = !options.baseline.empty() && !is_run_folder(options.target);
    check_eval_options(options, is_log_baseline, ranks.size());
    if (is_log_baseline) eval_baseline(options, ranks);
    else eval_run(options, ranks, command_line);
}

/// Rejects all options except --table and --quiet, because no scan is rendered.
void check_table_options(const CLI::App& command) {
    for (const CLI::Option* option : command.get_options()) {
        const bool was_typed = option->count() > 0;
        const bool is_allowed =
            option->get_positional() || option->check_lname("table") || option->check_lname("quiet");
        if (was_typed && !is_allowed)
            fail<UsageError>(
                "{} cannot be used together with --table, which only reads existing scores; use it in "
                "`relidar eval RUN`",
                option->get_name());
    }
}

constexpr const char* kEvalHelp =
    R"(The log is read from the path that the run was trained from. If the log has moved, use
--set dataset.path=PATH.
The environment variable RELIDAR_LPIPS_WEIGHTS names the file with the weights of LPIPS, which
tools/lpips_weights writes. Without the variable, LPIPS is not computed.
Metrics: peer/* follow published tables, strict/* use pixels that return in both scans,
moving_boxes/* and similar names score a part of the scan. The name of a metric ends with its unit.
An edited run is compared with the log, which does not have the edits.
Examples:
  relidar eval run --open
  relidar eval run --out median.json --set render.range=median
  mpirun -n 8 relidar eval run
  relidar eval run --baseline nearest --pictures pictures
  relidar eval runs/*/ --table scores.md --table scores.html
  relidar eval LOG --baseline nearest --frames 0:50 --set sensor.grid=kitti360)";

}  // namespace

/// Adds the command `relidar eval` and its options to the parser.
void add_eval(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("eval", "score the held-out frames of a run against its log");
    const auto options = std::make_shared<EvalOptions>();
    command
        ->add_option("RUN", options->targets,
                     "run folder of `relidar train`; with --baseline also a log; with --table several runs")
        ->required();
    add_option(*command, "--out FILE", options->out,
               "JSON file for the scores (default: RUN/metrics.json for a run, no file for a log)");
    add_option(
        *command, "--baseline NAME", options->baseline,
        "also score a simple baseline for comparison: nearest uses the two neighbouring real scans, moved to "
        "the held-out pose; nearest-actors also moves the points in boxes along their tracks");
    add_log_options(*command, options->part);
    add_option(*command, "--pictures DIR", options->pictures,
               "folder for pictures of each held-out frame and of each moving box: real, rendered, error");
    command->add_flag("--open", options->open,
                      "write the scores to a page, evaluation.html in the folder of the JSON file, and open "
                      "it in a browser");
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    add_no_refine_option(*command, options->no_refine);
    add_quiet_option(*command, options->quiet);
    add_list_option(*command, "--table FILE", options->tables,
                    "write a table of the existing scores of the runs, as .md, .csv or .html (chosen by the "
                    "file extension); repeatable");
    command->footer(kEvalHelp);
    command->callback([&call, options, command] {
        if (!options->tables.empty()) check_table_options(*command);
        call.run = [&call, options] { run_eval(*options, call.command_line); };
    });
}

}  // namespace relidar::cli
