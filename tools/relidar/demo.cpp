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

// Position of the second simulated sensor: 2 m to the left of the first and 1 m above it.
const Pose kShift{glm::dquat(1.0, 0.0, 0.0, 0.0), glm::dvec3(0.0, 2.0, 1.0)};
constexpr const char* kDemoMetrics[] = {"strict/depth_medae_m", "strict/depth_rmse_m", "strict/intensity_mae",
                                        "strict/drop_accuracy", "strict/cd_mean_m",    "points/cd_mean_m",
                                        "points/f_22cm",        "peer/depth_psnr_db",  "peer/depth_ssim"};

struct DemoOptions {
    std::string out = "demo";
    std::string seed = "1";
    std::vector<std::string> sets;
    DeviceChoice device;
    bool quiet = false;
};

Config make_demo_config(const DemoOptions& options, const fs::path& street) {
    Config config = make_preset("quick");
    set_config_value(config, "train.seed", options.seed);
    // The preset is made for 64 beams. This sensor has 32 beams, so the gaps between its
    // points are wider and need another factor.
    config.init.scale_factor = 0.6;
    // fewer iterations than in preset `quick`, so that the demo takes one to two minutes
    // on two processor cores
    config.train.iterations = 250;
    apply_setting_texts(config, options.sets);
    config.dataset.path = make_dataset_absolute("synthetic:" + street.string());
    return config;
}

Evaluation evaluate_held_out(Device& device, const Run& run, bool quiet) {
    Progress progress(quiet);
    ScanRenderer renderer(device, run);
    std::vector<ScoredFrame> with_images;  // Frames whose scans are written to files.
    Evaluation evaluation =
        evaluate_frames(renderer, run.config, run.sequence, run.split.test, stop_on_interrupt(progress),
                        [&](const ScoredFrame& frame) { with_images.push_back(frame); });
    evaluation.frames = std::move(with_images);
    return evaluation;
}

/// Renders the held-out frames from the shifted sensor. Compares the rendered scans with
/// exact scans of the street from the same position.
Evaluation evaluate_shifted(Device& device, const Run& run, const SyntheticOptions& street, bool quiet) {
    Progress progress(quiet);
    ScanRenderer renderer(device, run);
    const PoseTrack track = mount_on_track(run.sequence.world_from_sensor(0), kShift);
    const RayTable rays = make_rays(run.sequence.lidars[0].sensor);
    std::vector<ScoredFrame> frames;
    for (const int position : run.split.test) {
        stop_if_interrupted();
        const Frame& frame = run.sequence.frames[static_cast<std::size_t>(position)];
        Frame exact{frame.index, frame.time_s, cast_synthetic_street(street, rays, track, frame.time_s)};
        drop_outside_limits(exact.scan, run.sequence.lidars[0].sensor.range_limits());
        frames.push_back(score_frame(renderer, run.config, run.sequence, exact, kShift));
        progress.count("shifted sensor, frame", frames.size(), run.split.test.size());
    }
    return summarise(std::move(frames), renderer.times());
}

void write_scans(const fs::path& folder, const Evaluation& evaluation, const Run& run, const Pose& offset) {
    const OutputFolder made(folder);
    ScanFormat format = make_scan_format(run, make_configured_sensor(run.config, run.sequence));
    format.offset = offset;
    format.formats = {"npz", "png", "ply", "exr"};
    ScanFolder scans(folder, format);
    for (const ScoredFrame& frame : evaluation.frames) {
        scans.write(frame.frame, frame.rendered);
        write_png(folder / fmt::format("range_{:06}.png", frame.frame),
                  draw_range_pair(frame, run.config.dataset.max_range_m));
    }
    scans.finish();
}

std::string make_short_table(const Evaluation& held_out, const Evaluation& shifted) {
    std::vector<std::vector<std::string>> rows{{"metric", "held out", "shifted sensor"}};
    const auto cell = [](const MetricRow& row, const char* name) {
        return row.contains(name) ? format_short_number(row.at(name)) : std::string("-");
    };
    for (const char* name : kDemoMetrics)
        rows.push_back({name, cell(held_out.mean, name), cell(shifted.mean, name)});
    return format_table(rows);
}

void finish_demo_report(Device& device, const Run& run, const SyntheticOptions& street, Report report,
                        const fs::path& out, bool quiet) {
    const Evaluation held_out = evaluate_held_out(device, run, quiet);
    const Evaluation shifted = evaluate_shifted(device, run, street, quiet);
    write_text(run.folder / "metrics.json",
               make_metrics_json(
                   held_out, run.config,
                   {make_absolute_path(run.folder.string()), device.info().name, device.peak_bytes(), 0.0}));
    write_scans(out / "held_out", held_out, run, {});
    write_scans(out / "shifted", shifted, run, kShift);
    report.title = "relidar demo: a synthetic street";
    report.same_scans = false;
    add_evaluation(report, held_out, run, {"held out", "real"});
    report.summary +=
        " The shifted sensor is 2 m to the left of the real one and 1 m higher. Its exact scan is made by "
        "casting rays into the street, without noise. Moving cars are actors: each has its own surfels, "
        "placed by its tracked box.";
    add_evaluation(report, shifted, run, {"shifted sensor", "exact"});
    write_report(run.folder / "report.html", report);
    write_report(out / "report.html", report);
    if (!quiet)
        print(make_short_table(held_out, shifted) +
              fmt::format("\nreport  {}\n", make_absolute_path((out / "report.html").string())));
}

void run_demo(const DemoOptions& options, const std::string& command_line) {
    const fs::path out = options.out;
    const Config config = make_demo_config(options, out / "street");
    check_lpips_weights();
    const LockedFolder folder(out);
    const RunFolder run_folder(out / "run", Existing::replace);
    Device device(make_device_options(options.device));
    SyntheticOptions street;
    street.seed = config.train.seed;
    save_synthetic(street, out / "street");
    Sequence sequence = load_dataset(config, options.quiet);
    const Split split = split_frames(sequence, config.dataset.test_every, config.dataset.test_frames);
    if (!options.quiet) {
        print(fmt::format("{}: {} frames of {} x {} rays, {} held out; training {} iterations on {}\n",
                          sequence.name, sequence.frames.size(), street.rows, street.columns,
                          split.test.size(), config.train.iterations, device.info().name));
        std::fflush(stdout);
    }

    catch_interrupts();
    remove_run_files(run_folder.path());
    remove_blocks(run_folder.path());
    prepare_log_with_progress(sequence, split, config, options.quiet);
    TrainResult result = train_with_log(device, sequence, split, config, run_folder.path(), options.quiet);
    end_progress_line();
    Run run{run_folder.path(), use_farthest_return(config, sequence), std::move(sequence), split, {}, {}};
    move_result_into_run(run, result);
    save_run(run);
    stop_if_interrupted();
    StageTimes stages;
    complete_scene_with_progress(device, run, options.quiet, stages);
    stop_if_interrupted();
    if (config.refine.enabled && refine_with_progress(device, run, options.quiet) == TrainingEnd::finished)
        save_run(run);
    stop_if_interrupted();
    finish_demo_report(device, run, street, make_report(run, result, device, command_line), out,
                       options.quiet);
}

constexpr const char* kDemoHelp =
    R"(DIR receives report.html, street/ (the log), run/ (the scene), held_out/ and shifted/ (scans as
npz, png, ply and exr). Training has 250 iterations; --set train.iterations=N changes the number.
Example: relidar demo --out demo)";

}  // namespace

void add_demo(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("demo", "train, render, score and report on a synthetic street");
    const auto options = std::make_shared<DemoOptions>();
    command->add_option("--out", options->out, "folder for all results (default: demo)")->type_name("DIR");
    command->add_option("--seed", options->seed, "seed of the street and of training (default: 1)")
        ->type_name("S");
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer(kDemoHelp);
    command->callback(
        [&call, options] { call.run = [&call, options] { run_demo(*options, call.command_line); }; });
}

}  // namespace relidar::cli
