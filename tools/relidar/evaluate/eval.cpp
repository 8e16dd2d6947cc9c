// SPDX-License-Identifier: Apache-2.0
// The command `relidar eval` renders the held-out frames of a run and compares them with
// the log. It can also score a baseline, which needs a log but no run. A third use is a
// table that contains the scores of several runs.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/score/report.hpp>
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
#include "render/recast.hpp"

namespace relidar::cli {
namespace {

struct EvalOptions {
    std::vector<std::string> targets;  ///< Folders of runs or logs that the user typed.
    std::string target;                ///< Run or log to score.
    std::vector<std::string> tables;
    std::string out;
    LogPart part;
    std::string baseline;
    std::string pictures;
    std::vector<std::string> sets;
    DeviceChoice device;
    bool no_refine = false;
    bool open = false;
    bool quiet = false;
};

void apply_options(Config& config, const EvalOptions& options) { apply_setting_texts(config, options.sets); }

void check_held_out(const Split& split, const std::string& location) {
    if (split.test.empty())
        throw DataError(
            fmt::format("cannot evaluate {}: it has no held-out frames; expected at least one", location));
}

/// Output files and folders of the command. The first MPI process checks that they are
/// writable, before any process renders.
struct Output {
    /// Paths of the output files. If a path is empty, that output is not written.
    std::filesystem::path file, pictures;
    std::optional<OutputFolder> of_file;
    std::optional<LockedFolder> of_pictures;

    Output(const std::filesystem::path& metrics, const std::string& picture_folder, const Ranks& ranks)
        : file(metrics), pictures(picture_folder) {
        if (ranks.is_first() && !file.empty())
            of_file.emplace(file.has_parent_path() ? file.parent_path() : ".");
        if (ranks.is_first() && !pictures.empty()) of_pictures.emplace(pictures);
        ranks.wait_for_all();
    }

    void draw(const ScoredFrame& frame, const Config& config) const {
        if (!pictures.empty()) write_strips(pictures, frame, config.dataset.max_range_m);
    }
};

void write_results(const Output& output, const Evaluation& evaluation, const Config& config,
                   const MetricsOrigin& origin, bool quiet) {
    end_progress_line();
    if (!output.file.empty()) write_text(output.file, make_metrics_json(evaluation, config, origin));
    if (quiet) return;
    print(format_metric_table(evaluation, origin.baseline));
    print(fmt::format("\n{} held-out frames", evaluation.frames.size()));
    if (evaluation.trace_ms > 0.0)
        print(fmt::format(", {:.1f} ms of tracing per frame, {:.3f} Mrays/s, {} of device memory",
                          evaluation.trace_ms, evaluation.mrays_per_s,
                          format_byte_size(origin.peak_device_bytes)));
    if (!output.file.empty()) print("\nmetrics  " + make_absolute_path(output.file.string()));
    print("\n");
}

double measure_seconds_since(std::chrono::steady_clock::time_point start) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// Writes the scores as a web page and opens this page in a browser.
void open_page(const std::filesystem::path& page, const Report& report, bool quiet) {
    write_report(page, report);
    if (!quiet) print("page     " + make_absolute_path(page.string()) + "\n");
    open_in_browser(make_absolute_path(page.string()));
}

/// Returns a note that explains what the scores of an edited run mean.
std::string describe_edits(const Run& run) {
    if (run.edits.empty()) return "";
    if (can_recast_scans(run))
        return "note: the synthetic street was rendered again with the run's edits and without noise; "
               "the scores edited/* use only the pixels that the edits change\n";
    return "note: the run is edited, but the log shows the scene before the edits; the scores of changed "
           "pixels do not measure the quality of the edit\n";
}

/// Adds scores of only those pixels that an edit has changed.
/// @param original_scan exact scan of the street without the edit
void add_edited_scores(ScoredFrame& frame, const Config& config, const Scan& original_scan) {
    frame.metrics.merge(
        evaluate_regions(frame.rendered.image, frame.real,
                         {find_edited_region(frame.real, make_real_image(config, original_scan))}));
}

/// Keeps only the frames that this process scores. The other MPI processes score the
/// remaining frames.
void select_rank_positions(std::vector<int>& positions, const Ranks& ranks) {
    const ProcessGroup::Share share = ranks.group().share(positions.size());
    positions = {positions.begin() + std::ptrdiff_t(share.begin),
                 positions.begin() + std::ptrdiff_t(share.end)};
}

/// Loads the scans of the held-out frames. For an edited synthetic street, computes the
/// scans exactly.
/// @return exact scans of the street before the edits; empty for other logs
std::vector<Scan> attach_test_scans(Run& run, const Sequence& log) {
    if (can_recast_scans(run)) return attach_exact_scans(run);
    attach_scans(run, run.split.test, log);
    return {};
}

void score_run(const EvalOptions& options, const Ranks& ranks, const std::string& command_line) {
    // Lock of the run's folder, because the command writes metrics.json there. No other
    // process may write to the folder.
    std::optional<FolderLock> lock;
    if (ranks.is_first() && options.out.empty() && is_run(options.target)) lock.emplace(options.target);
    std::vector<std::string> used = list_rendering_settings();
    used.insert(used.end(), {"dataset."});
    check_setting_names(options.sets, used, "eval");
    Run run = load_run(options.target);
    apply_options(run.config, options);
    run.config = use_farthest_return(std::move(run.config), run.sequence);
    if (options.no_refine) run.config.refine.enabled = false;
    const Output output(
        options.out.empty() ? run.folder / "metrics.json" : std::filesystem::path(options.out),
        options.pictures, ranks);
    check_held_out(run.split, run.folder.string());
    const std::vector<int> all_test = run.split.test;
    select_rank_positions(run.split.test, ranks);
    Device device(make_device_options(options.device));
    const Sequence log = load_dataset(run.config, options.quiet);
    const std::vector<Scan> before = attach_test_scans(run, log);
    if (!options.baseline.empty()) attach_scans(run, run.split.train, log);

    catch_interrupts();
    const auto start = std::chrono::steady_clock::now();
    Progress progress(options.quiet);
    std::optional<Evaluation> baseline;
    if (!options.baseline.empty())
        baseline = gather_evaluation(evaluate_baseline(options.baseline, run.config, run.sequence, run.split,
                                                       stop_on_interrupt(progress)),
                                     ranks);
    ScanRenderer renderer(device, run);
    std::size_t n_seen = 0;
    const auto see = [&](ScoredFrame& frame) {
        if (!before.empty()) add_edited_scores(frame, run.config, before[n_seen++]);
        output.draw(frame, run.config);
    };
    Evaluation evaluation = gather_evaluation(
        evaluate_frames(renderer, run.config, run.sequence, run.split.test, stop_on_interrupt(progress), see),
        ranks);
    if (!ranks.is_first()) return;
    if (!options.quiet) print(describe_edits(run));
    write_results(output, evaluation, run.config,
                  {make_absolute_path(run.folder.string()), device.info().name, device.peak_bytes(),
                   measure_seconds_since(start), baseline ? &*baseline : nullptr},
                  options.quiet);
    if (!output.pictures.empty()) {
        run.split.test = all_test;
        if (ranks.size() > 1) (void)attach_test_scans(run, log);
        write_actor_strips(output.pictures, device, run, evaluation);
    }
    if (!options.open) return;
    Report report = make_evaluation_report(run, evaluation, device, command_line);
    for (ReportFigure& strip : draw_worst_actor_strips(device, run, evaluation))
        report.figures.push_back(std::move(strip));
    open_page(output.file.parent_path() / "evaluation.html", report, options.quiet);
}

/// Settings that affect the scores of a baseline.
const std::vector<std::string> kBaselineSettings = {
    "dataset.sequence",        "dataset.lidars",      "dataset.frames_begin",  "dataset.frames_end",
    "dataset.test_every",      "dataset.poses",       "dataset.test_frames",   "dataset.poses_from",
    "dataset.skip_broken",     "dataset.min_range_m", "dataset.memory_mib",    "dataset.max_range_m",
    "dataset.waymo_intensity", "sensor.grid",         "sensor.rolling_shutter"};

/// Scores a baseline on a log. A baseline needs neither a trained run nor a GPU.
void score_log(const EvalOptions& options, const Ranks& ranks) {
    check_setting_names(options.sets, kBaselineSettings, "eval LOG --baseline");
    Config config = make_preset("default");
    apply_options(config, options);
    config.dataset.path = make_dataset_absolute(options.target);
    apply_log_part(config, options.part);
    const Output output(options.out, options.pictures, ranks);
    const Sequence log = load_dataset(config, options.quiet);
    if (!options.quiet)
        for (const std::string& text : log.notes) note(text);
    config = use_farthest_return(std::move(config), log);
    Split split = split_frames(log, config.dataset.test_every, config.dataset.test_frames);
    check_held_out(split, options.target);
    select_rank_positions(split.test, ranks);

    catch_interrupts();
    const auto start = std::chrono::steady_clock::now();
    Progress progress(options.quiet);
    const auto see = [&](const ScoredFrame& frame) { output.draw(frame, config); };
    const Evaluation evaluation = gather_evaluation(
        evaluate_baseline(options.baseline, config, log, split, stop_on_interrupt(progress), see), ranks);
    if (ranks.is_first())
        write_results(output, evaluation, config, {"", "none", 0, measure_seconds_since(start)},
                      options.quiet);
}

void run_eval(const EvalOptions& typed_options, const std::string& command_line) {
    const Ranks ranks;
    EvalOptions options = typed_options;
    options.quiet = options.quiet || !ranks.is_first();
    if (!options.tables.empty()) {
        if (ranks.is_first()) write_score_tables(options.targets, options.tables);
        if (!options.quiet)
            for (const std::string& file : options.tables) print("table  " + make_absolute_path(file) + "\n");
        return;
    }
    if (options.targets.size() > 1)
        throw UsageError(fmt::format(
            "found {} runs as arguments; expected one run, or --table FILE to write a table of the "
            "scores of several runs",
            options.targets.size()));
    options.target = options.targets.front();
    options.device = ranks.device(options.device);
    if (options.open && ranks.size() > 1)
        throw UsageError(
            fmt::format("--open: found {} MPI processes; expected one, because the page has pictures of all "
                        "frames",
                        ranks.size()));
    // Throws an error if the baseline is unknown. This is checked before the log is
    // loaded, because loading takes a long time.
    if (!options.baseline.empty()) (void)find_baseline(options.baseline);
    if (!options.baseline.empty() && !is_run(options.target)) {
        if (options.open)
            throw UsageError(
                "--open: the argument is a log; expected a run, because --baseline on a log writes no "
                "page");
        return score_log(options, ranks);
    }
    if (!options.part.frames.empty() || !options.part.sequence.empty())
        throw UsageError(fmt::format(
            "{} cannot be used with a run, because a run already has its held-out frames; expected "
            "it only with --baseline and a log",
            options.part.frames.empty() ? "--sequence" : "--frames"));
    score_run(options, ranks, command_line);
}

/// Checks the options that the user has combined with --table.
/// @throws UsageError if one of them is an option for scoring
void check_table_options(const CLI::App& command) {
    for (const CLI::Option* option : command.get_options()) {
        if (option->count() == 0 || option->get_positional() || option->check_lname("table") ||
            option->check_lname("quiet"))
            continue;
        throw UsageError(fmt::format(
            "{} cannot be used together with --table, which only reads existing scores; use it in "
            "`relidar eval RUN`",
            option->get_name()));
    }
}

constexpr const char* kEvalHelp =
    R"(The log is read from the path that the run was trained from. If the log has moved, use
--set dataset.path=PATH.
RELIDAR_LPIPS_WEIGHTS is the file with the weights of LPIPS, made by tools/lpips_weights. LPIPS is
left out if the variable is not set.
Metrics: peer/* follow published tables, strict/* use pixels that return in both scans,
moving_boxes/* and others are of a region. Each name ends with its unit.
An edited run of a synthetic street is compared with the street rendered with the same edits
(edited/*: pixels that the edits change). An edited run of a real log is compared with the log,
which does not have the edits.
Examples:
  relidar eval run --open
  relidar eval run --out median.json --set render.range=median
  mpirun -n 8 relidar eval run
  relidar eval run --baseline nearest --pictures pictures
  relidar eval runs/*/ --table scores.md --table scores.html
  relidar eval LOG --baseline nearest --frames 0:50 --set sensor.grid=kitti360)";

}  // namespace

void add_eval(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("eval", "score the held-out frames of a run against its log");
    const auto options = std::make_shared<EvalOptions>();
    command
        ->add_option("RUN", options->targets,
                     "run folder of `relidar train`; with --baseline also a log; with --table several runs")
        ->required();
    command
        ->add_option("--out", options->out,
                     "JSON file for the scores (default: RUN/metrics.json for a run, no file for a log)")
        ->type_name("FILE");
    command
        ->add_option("--baseline", options->baseline,
                     "also score a prediction that is made only of the two neighbouring real scans, moved to "
                     "the held-out pose: nearest, or nearest-actors, which also moves the points in boxes "
                     "along their tracks")
        ->type_name("NAME");
    add_log_part_options(*command, options->part);
    command
        ->add_option("--pictures", options->pictures,
                     "folder for pictures of each held-out frame and of each moving box: real, rendered, "
                     "error")
        ->type_name("DIR");
    command->add_flag("--open", options->open,
                      "write the scores to a page, evaluation.html in the folder of the JSON file, and open "
                      "it in a browser");
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    command->add_flag("--no-refine", options->no_refine,
                      "use the ray-drop of the surfels, without the run's network");
    command->add_flag("--quiet", options->quiet, "print errors only");
    command
        ->add_option("--table", options->tables,
                     "write a table of the existing scores of the runs, as .md, .csv or .html (chosen by the "
                     "file extension); repeatable")
        ->type_name("FILE")
        ->type_size(1)
        ->allow_extra_args(false);
    command->footer(kEvalHelp);
    command->callback([&call, options, command] {
        if (!options->tables.empty()) check_table_options(*command);
        call.run = [&call, options] { run_eval(*options, call.command_line); };
    });
}

}  // namespace relidar::cli
