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
const Pose kShift{glm::dquat(1.0, 0.0, 0.0, 0.0), glm::dvec3(0.0, 2.0, 1.0)};
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

Config make_demo_config(const DemoOptions& options, const fs::path& street_folder) {
    Config config = make_preset_config("quick");
    set_config_value(config, "train.seed", options.seed);
    // The preset is made for 64 beams. Here the gaps between 32 beams need larger
    // surfels.
    config.init.scale_factor = 0.6;
    // The demo takes one to two minutes on two processor cores.
    config.train.iterations = 250;
    parse_and_apply_setting_texts(config, options.sets);
    config.dataset.path = make_dataset_path_absolute("synthetic:" + street_folder.string());
    return config;
}

EvaluationResult evaluate_on_held_out_frames(Device& device, const TrainedRun& run, bool quiet) {
    TerminalProgress progress(quiet);
    ScanRenderer renderer(device, run);
    std::vector<ScoredFrame> with_images;  // Frames whose scans are written to files.
    EvaluationResult evaluation = evaluate_frames(
        renderer, run.config, run.sequence, run.split.test, make_interruptible_progress_callback(progress),
        [&](const ScoredFrame& frame) { with_images.push_back(frame); });
    evaluation.frames = std::move(with_images);
    return evaluation;
}

/// Compares with exact scans of the synthetic street.
EvaluationResult evaluate_with_shifted_sensor(Device& device, const TrainedRun& run,
                                              const SyntheticOptions& exact_street_options, bool quiet) {
    TerminalProgress progress(quiet);
    ScanRenderer renderer(device, run);
    const PoseTrack track = compute_mounted_track(run.sequence.get_world_from_sensor(0), kShift);
    const RayTable rays = make_rays(run.sequence.lidars[0].sensor);
    std::vector<ScoredFrame> frames;
    for (const int position : run.split.test) {
        throw_if_interrupted();
        const LidarFrame& frame = run.sequence.frames[static_cast<std::size_t>(position)];
        LidarFrame exact{frame.index, frame.time_s,
                         cast_rays_into_synthetic_street(exact_street_options, rays, track, frame.time_s)};
        remove_returns_outside_limits(exact.scan, run.sequence.lidars[0].sensor.range_limits());
        frames.push_back(render_and_score_frame(renderer, run.config, run.sequence, exact, kShift));
        progress.show_step_progress("scoring the shifted sensor: frame", frames.size(),
                                    run.split.test.size());
    }
    return summarise_evaluation(std::move(frames), renderer.times());
}

void write_rendered_scans_of_evaluation(const fs::path& folder, const EvaluationResult& evaluation,
                                        const TrainedRun& run, const Pose& sensor_offset) {
    const OutputFolder made(folder);
    ScanOutputOptions format =
        make_default_output_options(run, make_sensor_from_config(run.config, run.sequence));
    format.offset = sensor_offset;
    format.formats = {"npz", "png", "ply", "exr"};
    ScanFolderWriter scans(folder, format);
    for (const ScoredFrame& frame : evaluation.frames) {
        scans.write_scan(frame.frame, frame.rendered);
        write_png(folder / fmt::format("range_{:06}.png", frame.frame),
                  draw_stacked_real_and_rendered_range(frame, run.config.dataset.max_range_m));
    }
    scans.finish_scan_folder();
}

std::string format_demo_metrics_table(const EvaluationResult& held_out_evaluation,
                                      const EvaluationResult& shifted_evaluation) {
    std::vector<std::vector<std::string>> rows{{"metric", "held-out frames", "shifted sensor"}};
    const auto cell = [](const MetricValues& row, const char* name) {
        return row.contains(name) ? format_four_significant_digits(row.at(name)) : std::string("-");
    };
    for (const char* name : kDemoMetrics)
        rows.push_back({name, cell(held_out_evaluation.mean, name), cell(shifted_evaluation.mean, name)});
    return format_table(rows);
}

void evaluate_run_and_write_demo_report(Device& device, const TrainedRun& run,
                                        const SyntheticOptions& exact_street_options, Report report,
                                        const fs::path& output_folder, bool quiet) {
    const EvaluationResult held_out = evaluate_on_held_out_frames(device, run, quiet);
    const EvaluationResult shifted = evaluate_with_shifted_sensor(device, run, exact_street_options, quiet);
    write_text_file(run.folder / "metrics.json",
                    make_metrics_json(held_out, run.config,
                                      {make_absolute_path(run.folder.string()), device.info().name,
                                       device.peak_allocated_bytes(), 0.0}));
    write_rendered_scans_of_evaluation(output_folder / "held_out", held_out, run, {});
    write_rendered_scans_of_evaluation(output_folder / "shifted", shifted, run, kShift);
    report.title = "relidar demo: a synthetic street";
    report.same_scans = false;
    add_evaluation_to_report(report, held_out, run, {"held out", "real"});
    report.summary +=
        " The shifted sensor is 2 m to the left of the real one and 1 m higher. Its exact scan is made by "
        "casting rays into the street, without noise. Moving cars are actors: each has its own surfels, "
        "placed by its tracked box.";
    add_evaluation_to_report(report, shifted, run, {"shifted sensor", "exact"});
    write_report(run.folder / "report.html", report);
    write_report(output_folder / "report.html", report);
    if (!quiet)
        print(format_demo_metrics_table(held_out, shifted) +
              fmt::format("\nreport  {}\n", make_absolute_path((output_folder / "report.html").string())));
}

void run_demo_command(const DemoOptions& options, const std::string& command_line) {
    const fs::path out = options.out;
    const Config config = make_demo_config(options, out / "street");
    require_readable_lpips_weights();
    const LockedFolder folder(out);
    const RunOutputFolder run_folder(out / "run", ExistingRunPolicy::replace);
    Device device(convert_to_device_options(options.device));
    SyntheticOptions street;
    street.seed = config.train.seed;
    save_synthetic_options(street, out / "street");
    LidarSequence sequence = load_dataset(config, options.quiet);
    const TrainTestSplit split =
        split_frames_into_train_and_test(sequence, config.dataset.test_every, config.dataset.test_frames);
    if (!options.quiet) {
        print(fmt::format("{}: {} frames of {} x {} rays, {} held out; training {} iterations on {}\n",
                          sequence.name, sequence.frames.size(), street.rows, street.columns,
                          split.test.size(), config.train.iterations, device.info().name));
        std::fflush(stdout);
    }

    install_interrupt_handlers();
    remove_run_result_files(run_folder.path());
    remove_block_folders(run_folder.path());
    prepare_log_for_training_with_progress(sequence, split, config, options.quiet);
    TrainResult result =
        train_scene_with_progress(device, sequence, split, config, run_folder.path(), options.quiet);
    end_progress_line();
    TrainedRun run{
        run_folder.path(), replace_automatic_max_range(config, sequence), std::move(sequence), split, {}, {}};
    move_result_into_run(run, result);
    save_run(run);
    throw_if_interrupted();
    StageTimes stages;
    align_held_out_scans_and_fit_intensity_noise(device, run, options.quiet, stages);
    throw_if_interrupted();
    if (config.refine.enabled &&
        train_drop_network_with_progress(device, run, options.quiet) == TrainingEndReason::finished)
        save_run(run);
    throw_if_interrupted();
    evaluate_run_and_write_demo_report(
        device, run, street, make_training_report(run, result, device, command_line), out, options.quiet);
}

constexpr const char* kDemoHelp =
    R"(DIR receives report.html, street/ (the log), run/ (the scene), held_out/ and shifted/ (scans as
npz, png, ply and exr). Training has 250 iterations; --set train.iterations=N changes the number.
Example: relidar demo --out demo)";

}  // namespace

void add_demo_command(CLI::App& app, ParsedCommand& selected_command) {
    CLI::App* command = app.add_subcommand("demo", "train, render, score and report on a synthetic street");
    const auto options = std::make_shared<DemoOptions>();
    command->add_option("--out", options->out, "folder for all results (default: demo)")->type_name("DIR");
    command->add_option("--seed", options->seed, "seed of the synthetic street and of training (default: 1)")
        ->type_name("S");
    add_setting_override_option(*command, options->sets);
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->quiet);
    command->footer(kDemoHelp);
    command->callback([&selected_command, options] {
        selected_command.run = [&selected_command, options] {
            run_demo_command(*options, selected_command.command_line);
        };
    });
}

}  // namespace relidar::cli
