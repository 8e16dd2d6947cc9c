// SPDX-License-Identifier: Apache-2.0
#include <relidar/train/train.hpp>

#include <algorithm>
#include <chrono>
#include <utility>

#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/scene/labels.hpp>

#include "base/fail.hpp"
#include "train/checkpoints/checkpoint_keeper.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Creates the scene with which training starts, from the points of the training frames.
Scene initial_scene(const Log& log, const Split& split, const Config& config, const TrainSession& session) {
    InitOptions options = config.init;
    options.seed = config.train.seed;
    // The ray-drop probability is a softmax of a hit and a drop logit (docs/method.md
    // M6). With `one_logit`, the hit logit is 0. The drop logit then starts at the
    // difference of both, so that the initial probability is the same.
    options.one_logit = config.image.single_drop_logit;
    std::vector<std::string> notes;
    Scene scene = init_scene(log, split.train, options, session.progress, &notes);
    for (const std::string& note : notes)
        if (session.note) session.note(note);
    convert_surfels(scene.surfels, config.image.primitive, config.init.thickness);
    return scene;
}

/// Prints which moving boxes have no surfels. Training ignores the returns in them.
void report_ignored(const Scene& scene, const Log& log, const Config& config, const TrainSession& session) {
    const std::vector<BoxTrack> masked = find_unmodelled(scene, log, config.init);
    if (masked.empty() || !session.note) return;
    session.note(
        fmt::format("points and losses in {} moving boxes are ignored: {}. Only classes in "
                    "init.actor_classes with at least init.actor_min_points points become actors",
                    masked.size(), format_box_list(masked)));
}

/// Prints how many training frames are kept in device memory, unless all are kept.
void report_evicted(const TrainingFrames& frames, const Config& config, const TrainSession& session) {
    if (frames.count_resident() == frames.all().size() || !session.note) return;
    session.note(
        fmt::format("{} of {} training frames fit into the device memory for frames "
                    "(train.frame_memory_mib={}); the others are uploaded whenever a step uses them",
                    frames.count_resident(), frames.all().size(), config.train.frame_memory_mib));
}

/// Turns off the refinement of sensor poses if all training frames belong to one sweep.
/// No other training frame constrains the pose of this sweep, so it would drift away from
/// the poses of held-out sweeps. Also reports if the scene has no actors to refine.
Config with_useful_poses(Config config, const Log& log, const Split& split, const Scene& initial,
                         const TrainSession& session) {
    const auto report = [&](const char* note) {
        if (session.note) session.note(note);
    };
    // Frames of several LiDARs that belong to the same sweep have the same number.
    const auto sweep_of = [&](int position) { return log.frames[std::size_t(position)].index; };
    const bool has_one_sweep = std::ranges::all_of(
        split.train, [&](int position) { return sweep_of(position) == sweep_of(split.train[0]); });
    if (config.train.refines("sensor") && has_one_sweep) {
        config.train.refine_poses = config.train.refines("actors") ? "actors" : "none";
        report(
            "train.refine_poses=sensor has no effect, because training uses only one sweep, whose pose is "
            "fixed");
    }
    const bool has_actors = initial.instances.size() >= 2;  // the first instance is the background
    if (config.train.refine_poses == "actors" && !has_actors)
        report("train.refine_poses=actors has no effect, because the scene has no actors");
    return config;
}

/// Runs the remaining iterations, unless the user stops the training. Adds lines to the
/// training log, and writes checkpoints.
void run_iterations(TrainLoop& loop, CheckpointKeeper& checkpoints, const Config& config,
                    const TrainProgressCallback& progress, const TrainSession& session, TrainResult& result) {
    const int n_iterations = config.train.iterations, log_every = std::max(1, config.train.log_every);
    const Clock::time_point start = Clock::now();
    const double trained_before_s = result.train_s;
    const auto trained_s = [&] { return trained_before_s + seconds_since(start); };
    bool stop = false;
    const auto collect_lines = [&] {
        for (const TrainLogLine& line : loop.take_log_lines()) {
            append_log_line(result.log, line, config, trained_s());
            stop = (progress && !progress(result.log.back())) || stop;
        }
    };
    while (result.iterations < n_iterations && !stop) {
        const int step = ++result.iterations;
        loop.run_iteration(step, step == 1 || step % log_every == 0 || step == n_iterations);
        collect_lines();
        stop = stop || (session.stop && session.stop());
        if (!stop && !checkpoints.is_due(step)) continue;
        loop.finish_steps();
        collect_lines();  // A checkpoint includes the log lines.
        checkpoints.save_state([&](Checkpoint& state) { loop.save_to(state); }, result, trained_s());
    }
    loop.finish();
    collect_lines();
    result.train_s = trained_s();
}

/// Downloads the trained scene and its poses. Then estimates the drops of the sensor, the
/// observed space, and the classes of the background, with the refined poses.
void fill_result(TrainLoop& loop, Device& device, const Log& log, const Split& split, const Config& config,
                 const TrainSession& session, TrainResult& result) {
    result.interrupted = result.iterations < config.train.iterations;
    result.scene = loop.download_scene();
    fade_far_swings(result.scene, config.image.alpha_min);
    result.poses = loop.refined_poses();
    begin_stage(session.stages, "drops");
    if (config.train.sensor_drop && !result.interrupted)
        result.scene.sensor_drop = loop.sensor_drop_rates(device, log);
    begin_stage(session.stages, "coverage");
    const PoseTrack& poses = result.poses ? result.poses->world_from_vehicle : log.world_from_vehicle;
    result.coverage =
        observe_coverage(log, poses, split.train, with_max_range(config, log).dataset.max_range_m);
    const std::vector<BoxTrack>& boxes = result.poses ? result.poses->boxes : log.boxes;
    result.classes = map_classes(log, poses, boxes, split.train);
}

}  // namespace

TrainResult train(Device& device, const Log& log, const Split& split, const Config& config,
                  const TrainProgressCallback& progress, const TrainSession& session) {
    if (split.train.empty())
        fail("cannot train on {}: it has no training frames; expected at least one", log.name);
    if (session.start) check_resume(*session.start, log, split, config);
    TrainResult result;
    const Clock::time_point begin = Clock::now();
    begin_stage(session.stages, "initialise");
    const Scene initial =
        session.start ? read_scene(*session.start) : initial_scene(log, split, config, session);
    result.initialise_s = seconds_since(begin);
    report_ignored(initial, log, config, session);

    begin_stage(session.stages, "train");
    // must outlive the training loop, which stores a reference to these settings
    const Config training_config = with_useful_poses(config, log, split, initial, session);
    if (session.progress) session.progress("allocating memory and loading kernels", 0.0);
    TrainLoop loop(device, log, split, initial, training_config);
    loop.add_losses(session.losses);
    if (session.progress) session.progress("allocating memory and loading kernels", 1.0);
    report_evicted(loop.training_frames(), config, session);
    if (session.start) {
        loop.restore_from(*session.start);
        read_log(*session.start, config, result);
    }
    CheckpointKeeper checkpoints(log, split, config, session);
    run_iterations(loop, checkpoints, config, progress, session, result);
    const Clock::time_point trained = Clock::now();
    fill_result(loop, device, log, split, config, session, result);
    result.train_s += seconds_since(trained);
    result.times = loop.training_times();
    result.peak_device_bytes = device.peak_bytes();
    return result;
}

void move_result(Run& run, TrainResult& result) {
    run.scene = std::move(result.scene);
    run.coverage = std::move(result.coverage);
    run.classes = std::move(result.classes);
    if (!result.poses) return;
    run.log.world_from_vehicle = std::move(result.poses->world_from_vehicle);
    run.log.boxes = std::move(result.poses->boxes);
    run.refined_poses = run.config.train.refine_poses;
}

}  // namespace relidar
