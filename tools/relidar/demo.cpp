// SPDX-License-Identifier: Apache-2.0
// The command `relidar demo` runs all steps on a synthetic street whose geometry is known
// exactly. It writes a log, trains a scene, and scores the held-out frames. It also
// scores scans of a sensor that is shifted by 2 m to the left and 1 m up. A real log
// contains no such scans.
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/scan_files.hpp>
#include "command.hpp"
#include "console.hpp"
#include "evaluate/evaluation.hpp"
#include "evaluate/pictures.hpp"
#include "evaluate/run_report.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "train/training.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

// The second simulated sensor: 2 m to the left and 1 m above.
const Pose kSensorShift{glm::dquat(1.0, 0.0, 0.0, 0.0), glm::dvec3(0.0, 2.0, 1.0)};
constexpr const char* kDemoMetrics[] = {"points/depth_medae_m", "points/depth_rmse_m", "strict/intensity_mae",
                                        "strict/drop_accuracy", "strict/cd_mean_m",    "points/cd_mean_m",
                                        "points/f_22cm",        "peer/depth_psnr_db",  "peer/depth_ssim"};

struct DemoOptions {
    std::string out = "demo";
    std::string seed = "1";
    std::vector<std::string> sets;
    DeviceCommandOptions device;
    bool quiet = false;
};

/// Returns the settings of the training. The user can change them with --set.
Config demo_config(const DemoOptions& options, const fs::path& street_folder) {
    Config config = make_preset("quick");
    set_value(config, "train.seed", options.seed);
    // The preset is made for 64 beams. The gaps between 32 beams need larger surfels.
    config.init.scale_factor = 0.6;
    // Fewer iterations than in the preset, so that the demo takes one to two minutes on
    // two processor cores.
    config.train.iterations = 250;
    apply_settings(config, options.sets);
    config.dataset.path = absolute_dataset("synthetic:" + street_folder.string());
    return config;
}

/// Scores the held-out frames. Keeps their scans, which the demo writes to files.
/// evaluate_frames() keeps only the scan of the middle frame.
Evaluation score_held_out(Device& device, const Run& run, bool quiet) {
    TerminalProgress progress(quiet);
    ScanRenderer renderer(device, run);
    std::vector<ScoredFrame> with_images;
    Evaluation evaluation =
        evaluate_frames(renderer, run.config, run.log, run.split.test, interruptible_progress(progress),
                        [&](const ScoredFrame& frame) { with_images.push_back(frame); });
    evaluation.frames = std::move(with_images);
    return evaluation;
}

/// Renders the held-out frames from a sensor that is shifted from its recorded position.
/// Compares the scans with exact scans of the synthetic street.
Evaluation score_shifted(Device& device, const Run& run, const StreetOptions& street, bool quiet) {
    TerminalProgress progress(quiet);
    ScanRenderer renderer(device, run);
    const PoseTrack track = mount_track(run.log.lidar_track(0), kSensorShift);
    const RayTable rays = make_rays(run.log.lidars[0].sensor);
    std::vector<ScoredFrame> frames;
    for (const int position : run.split.test) {
        check_interrupt();
        const Frame& frame = run.log.frames[static_cast<std::size_t>(position)];
        Frame exact{frame.index, frame.time_s, cast_street_rays(street, rays, track, frame.time_s)};
        limit_ranges(exact.scan, run.log.lidars[0].sensor.range_limits());
        frames.push_back(score_frame(renderer, run.config, run.log, exact, kSensorShift));
        progress.show_step("scoring the shifted sensor: frame", frames.size(), run.split.test.size());
    }
    return summarise(std::move(frames), renderer.times());
}

/// Writes the rendered scans of scored frames, with pictures of real and rendered ranges.
void write_demo_scans(const fs::path& folder, const Evaluation& result, const Run& run, const Pose& offset) {
    const OutputFolder created(folder);
    ScanOutputOptions format = default_options(run, make_sensor(run.config, run.log));
    format.offset = offset;
    format.formats = {"npz", "png", "ply", "exr"};
    ScanFolderWriter scans(folder, format);
    for (const ScoredFrame& frame : result.frames) {
        scans.write_scan(frame.frame, frame.rendered);
        write_png(folder / fmt::format("range_{:06}.png", frame.frame),
                  draw_ranges(frame, run.config.dataset.max_range_m));
    }
    scans.finish();
}

std::string format_demo_table(const Evaluation& held_out_evaluation, const Evaluation& shifted_evaluation) {
    TableRows rows{{"metric", "held-out frames", "shifted sensor"}};
    const auto cell = [](const MetricValues& row, const char* name) {
        return row.contains(name) ? format_number(row.at(name)) : std::string("-");
    };
    for (const char* name : kDemoMetrics)
        rows.push_back({name, cell(held_out_evaluation.mean, name), cell(shifted_evaluation.mean, name)});
    return format_table(rows);
}

/// Scores the log's sensor and a shifted sensor. Writes scores, scans and a report.
void write_demo_report(Device& device, const Run& run, const StreetOptions& exact_street_options,
                       Report report, const fs::path& output_folder, bool quiet) {
    const Evaluation held_out = score_held_out(device, run, quiet);
    const Evaluation shifted = score_shifted(device, run, exact_street_options, quiet);
    write_text_file(run.folder / "metrics.json",
                    metrics_json(held_out, run.config, describe_source(run, device)));
    write_demo_scans(output_folder / "held_out", held_out, run, {});
    write_demo_scans(output_folder / "shifted", shifted, run, kSensorShift);
    report.title = "relidar demo: a synthetic street";
    report.same_scans = false;
    add_evaluation(report, held_out, run, {"held out", "real"});
    report.summary +=
        " The shifted sensor is 2 m to the left of the real one and 1 m higher. Its exact scan is made by "
        "casting rays into the street, without noise. Moving cars are actors: each has its own surfels, "
        "placed by its tracked box.";
    add_evaluation(report, shifted, run, {"shifted sensor", "exact"});
    write_report(run.folder / "report.html", report);
    write_report(output_folder / "report.html", report);
    if (!quiet)
        print(format_demo_table(held_out, shifted) +
              fmt::format("\nreport  {}\n", absolute_path((output_folder / "report.html").string())));
}

/// Runs the complete pipeline on a synthetic street: writes a log, trains a scene,
/// renders scans, scores them and writes a report.
void run_demo(const DemoOptions& options, const std::string& command_line) {
    const fs::path out = options.out;
    const Config config = demo_config(options, out / "street");
    check_lpips_weights();
    const LockedFolder folder(out);
    const RunOutputFolder run_folder(out / "run", ExistingRunPolicy::replace);
    Device device(to_device_options(options.device));

    // Writes the log of the street and reads it like a recorded log.
    StreetOptions street;
    street.seed = config.train.seed;
    save_street(street, out / "street");
    Log log = load_dataset(config, options.quiet);
    const Split split = split_frames(log, config.dataset.test_every, config.dataset.test_frames);
    if (!options.quiet) {
        print(fmt::format("{}: {} frames of {} x {} rays, {} held out; training {} iterations on {}\n",
                          log.name, log.frames.size(), street.rows, street.columns, split.test.size(),
                          config.train.iterations, device.info().name));
        std::fflush(stdout);
    }

    // Trains the scene.
    install_handlers();
    remove_results(run_folder.path());
    remove_blocks(run_folder.path());
    prepare_log(log, split, config, options.quiet);
    TrainResult result = train_scene(device, log, split, config, run_folder.path(), options.quiet);
    end_progress();
    Run run{run_folder.path(), with_max_range(config, log), std::move(log), split, {}, {}};
    move_result(run, result);
    save_run(run);
    check_interrupt();

    // Completes the run: poses of held-out scans, noise of intensities, ray-drop network.
    StageTimes stages;  // not shown
    align_and_fit_noise(device, run, options.quiet, stages);
    check_interrupt();
    if (config.refine.enabled &&
        train_network_with_bar(device, run, options.quiet) == TrainingEndReason::finished)
        save_run(run);
    check_interrupt();

    write_demo_report(device, run, street, training_report(run, result, device, command_line), out,
                      options.quiet);
}

constexpr const char* kDemoHelp =
    R"(DIR receives report.html, street/ (the log), run/ (the scene), held_out/ and shifted/ (scans as
npz, png, ply and exr). Training has 250 iterations; --set train.iterations=N changes the number.
Example: relidar demo --out demo)";

}  // namespace

/// Adds the command `relidar demo` and its options to the parser.
void add_demo(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("demo", "train, render, score and report on a synthetic street");
    const auto options = std::make_shared<DemoOptions>();
    add_option(*command, "--out DIR", options->out, "folder for all results (default: demo)");
    add_option(*command, "--seed S", options->seed,
               "seed of the synthetic street and of training (default: 1)");
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->quiet);
    command->footer(kDemoHelp);
    command->callback(
        [&call, options] { call.run = [&call, options] { run_demo(*options, call.command_line); }; });
}

}  // namespace relidar::cli
