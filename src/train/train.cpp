// SPDX-License-Identifier: Apache-2.0
// Trains a scene from a log: starts or resumes, runs the iterations of train_loop.cpp,
// prints progress, and saves checkpoints.
#include <relidar/train/train.hpp>

#include <algorithm>
#include <chrono>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>

#include "train/checkpoints/checkpoint_keeper.hpp"
#include "train/checkpoints/resume.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

using Clock = std::chrono::steady_clock;
double measure_seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Returns the options for the initial scene. A surfel can have one drop logit instead of
/// two. The single logit then starts with the difference of the two logits, which gives
/// the same ray-drop probability (docs/method.md M6).
SceneInitialisationOptions make_initialise_options(const Config& config) {
    SceneInitialisationOptions options = config.init;
    options.seed = config.train.seed;
    options.one_logit = config.image.single_drop_logit;
    return options;
}

/// Returns the initial scene of a training.
Scene make_initial_scene(const LidarSequence& sequence, const TrainTestSplit& split, const Config& config,
                         const TrainSession& session) {
    std::vector<std::string> notes;
    Scene scene =
        initialise_scene(sequence, split.train, make_initialise_options(config), session.progress, &notes);
    for (const std::string& note : notes)
        if (session.note) session.note(note);
    convert_to_primitive(scene.surfels, config.image.primitive, config.init.thickness);
    return scene;
}

/// Prints the moving boxes without surfels. Training ignores the returns inside these
/// boxes.
void report_masked_boxes(const Scene& scene, const LidarSequence& sequence, const Config& config,
                         const TrainSession& session) {
    const std::vector<BoxTrack> masked = find_boxes_without_model(scene, sequence, config.init);
    if (masked.empty() || !session.note) return;
    session.note(
        fmt::format("points and losses in {} moving boxes are ignored: {}. Only classes in "
                    "init.actor_classes with at least init.actor_min_points points become actors",
                    masked.size(), format_box_list(masked)));
}

/// Prints how many training frames are kept in device memory. Prints nothing if all are
/// kept.
void report_resident_frames(const TrainingFrames& frames, const Config& config, const TrainSession& session) {
    if (frames.count_resident_frames() == frames.get_all_frames().size() || !session.note) return;
    session.note(fmt::format(
        "{} of {} training frames fit into the device memory for frames "
        "(train.frame_memory_mib={}); the others are uploaded whenever a step uses them",
        frames.count_resident_frames(), frames.get_all_frames().size(), config.train.frame_memory_mib));
}

/// Turns the refinement of sensor poses off if all training frames belong to one sweep.
/// Nothing constrains the pose of a single sweep, so this pose would drift away from the
/// poses of the other sweeps.
Config disable_useless_pose_refinement(Config config, const LidarSequence& sequence,
                                       const TrainTestSplit& split, const Scene& initial,
                                       const TrainSession& session) {
    const auto get_sweep = [&](int frame) { return sequence.frames[std::size_t(frame)].index; };
    const auto is_in_first_sweep = [&](int frame) { return get_sweep(frame) == get_sweep(split.train[0]); };
    const auto report = [&](const char* note) {
        if (session.note) session.note(note);
    };
    if (config.train.should_refine_poses("sensor") && std::ranges::all_of(split.train, is_in_first_sweep)) {
        config.train.refine_poses = config.train.should_refine_poses("actors") ? "actors" : "none";
        report(
            "train.refine_poses=sensor has no effect, because training uses only one sweep, whose "
            "pose is fixed");
    }
    if (config.train.refine_poses == "actors" && initial.instances.size() < 2)
        report("train.refine_poses=actors has no effect, because the scene has no actors");
    return config;
}

bool should_log_at(int step, const TrainConfig& config) {
    return step == 1 || step % std::max(1, config.log_every) == 0 || step == config.iterations;
}

/// Downloads the trained scene and its poses. Estimates the ray-drop of the sensor, the
/// coverage, and the classes of the background.
void download_trained_scene(TrainLoop& loop, Device& device, const LidarSequence& sequence,
                            const TrainTestSplit& split, const Config& config, const TrainSession& session,
                            TrainResult& result) {
    result.interrupted = result.iterations < config.train.iterations;
    result.scene = loop.download();
    result.poses = loop.get_refined_poses();
    begin_stage(session.stages, "drops");
    if (config.train.sensor_drop && !result.interrupted)
        result.scene.sensor_drop = loop.estimate_sensor_drop_rates(device, sequence);
    begin_stage(session.stages, "coverage");
    const PoseTrack& poses = result.poses ? result.poses->world_from_vehicle : sequence.world_from_vehicle;
    result.coverage = compute_observed_coverage(sequence, poses, split.train,
                                                resolve_max_range(config, sequence).dataset.max_range_m);
    result.classes = compute_class_map(sequence, poses, split.train);
}

}  // namespace

TrainResult train(Device& device, const LidarSequence& sequence, const TrainTestSplit& split,
                  const Config& config, const TrainProgressCallback& progress, const TrainSession& session) {
    if (split.train.empty())
        throw DataError(fmt::format("cannot train on {}: it has no training frames; expected at least one",
                                    sequence.name));
    if (session.start) check_training_resumable(*session.start, sequence, split, config);
    TrainResult result;
    const Clock::time_point begin = Clock::now();
    begin_stage(session.stages, "initialise");
    const Scene initial = session.start ? read_checkpoint_scene(*session.start)
                                        : make_initial_scene(sequence, split, config, session);
    result.initialise_s = measure_seconds_since(begin);
    report_masked_boxes(initial, sequence, config, session);

    begin_stage(session.stages, "train");
    // must outlive the training loop, which stores a reference to these settings
    const Config training_config = disable_useless_pose_refinement(config, sequence, split, initial, session);
    if (session.progress) session.progress("allocating memory and loading kernels", 0.0);
    TrainLoop loop(device, sequence, split, initial, training_config);
    if (session.progress) session.progress("allocating memory and loading kernels", 1.0);
    report_resident_frames(loop.get_training_frames(), config, session);
    if (session.start) {
        loop.restore_state(*session.start);
        read_training_result(*session.start, config, result);
    }
    CheckpointKeeper checkpoints(sequence, split, config, session);
    const Clock::time_point start = Clock::now();
    const double trained_before_s = result.train_s;
    const auto trained_s = [&] { return trained_before_s + measure_seconds_since(start); };
    bool stop = false;
    const auto collect_lines = [&] {
        for (const TrainLogLine& line : loop.take_log_lines()) {
            append_log_line(result.log, line, config, trained_s());
            stop = !progress(result.log.back()) || stop;
        }
    };
    while (result.iterations < config.train.iterations && !stop) {
        const int step = ++result.iterations;
        loop.run_iteration(step, should_log_at(step, config.train));
        collect_lines();
        stop = stop || (session.stop && session.stop());
        if (!stop && !checkpoints.should_save_checkpoint(step)) continue;
        loop.wait_for_iterations();
        collect_lines();  // A checkpoint includes the log lines.
        checkpoints.save_training_state(loop, result, trained_s());
    }
    loop.complete_training();
    collect_lines();
    download_trained_scene(loop, device, sequence, split, config, session, result);
    result.train_s = trained_s();
    result.times = loop.times();
    result.peak_device_bytes = device.peak_allocated_bytes();
    return result;
}

void move_result_into_run(TrainedRun& run, TrainResult& result) {
    run.scene = std::move(result.scene);
    run.coverage = std::move(result.coverage);
    run.classes = std::move(result.classes);
    if (!result.poses) return;
    run.sequence.world_from_vehicle = std::move(result.poses->world_from_vehicle);
    run.sequence.boxes = std::move(result.poses->boxes);
    run.refined_poses = run.config.train.refine_poses;
}

}  // namespace relidar
