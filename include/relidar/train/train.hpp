// SPDX-License-Identifier: Apache-2.0
// Training: initialises a scene, then repeats these steps: sample a frame, render it,
// compare it with the measured scan, compute gradients, update the parameters. Training
// can be stopped and resumed.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/diff/densify_options.hpp>
#include <relidar/diff/loss_options.hpp>
#include <relidar/diff/network.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/coverage.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

struct Checkpoint;
struct Run;

/// Entry of the training log.
struct TrainProgress {
    int iteration = 0;
    int n_iterations = 0;
    double seconds = 0.0;  ///< Seconds since training started.
    double iterations_per_second = 0.0;
    double eta_s = 0.0;
    /// Weighted loss terms, averaged over the iterations since the previous entry.
    std::array<double, kLossTerms> terms{};
    double loss = 0.0;
    std::uint32_t n_surfels = 0;
    /// Sums over the densifications since the previous entry. `before` and `after` refer
    /// to the last densification.
    DensifyReport densified;
};

/// Poses that training has corrected (train.refine_poses), for both training and held-out
/// scans.
///
/// prepare_log() registers the poses before training. It places a held-out scan by
/// matching its points with the planes of the training scans. Training uses held-out
/// scans for nothing else. Gradients correct a held-out pose only indirectly. With a
/// rolling shutter, they come from rays of neighbouring sweeps fired between the poses.
/// Without one, the corrections before and after are interpolated. Registration of the
/// sensor also moves all boxes. Gradients change boxes only if refine_poses includes
/// actors.
struct RefinedPoses {
    PoseTrack world_from_vehicle;
    std::vector<BoxTrack> boxes;
};

/// Result of a training. Log and times count from the first start, across all
/// interruptions.
struct TrainResult {
    Scene scene;
    /// Corrected poses, to render the scene with; nullopt if training kept the poses of
    /// the log.
    std::optional<RefinedPoses> poses;
    Coverage coverage;  ///< Coverage of the training frames.
    std::vector<TrainProgress> log;
    KernelTimes times;  ///< Kernel times of this session.
    double initialise_s = 0.0;
    double train_s = 0.0;
    std::uint64_t peak_device_bytes = 0;
    int iterations = 0;        ///< Number of completed iterations.
    bool interrupted = false;  ///< True if training stopped before the last iteration.
};

/// Callback for each entry of the training log, called a few iterations after the entry's
/// last iteration. If it returns false, training stops after the current iteration and
/// returns the current scene.
using ProgressCallback = std::function<bool(const TrainProgress&)>;

/// Checkpoints, callbacks and stop condition of a training that may take days.
struct TrainSession {
    /// Folder for checkpoints; empty = no checkpoints. They are written as
    /// train.checkpoint_* specifies, and when training stops early.
    std::filesystem::path checkpoints;
    const Checkpoint* start = nullptr;  ///< Checkpoint to resume from; null = start from the beginning.
    std::function<bool()> stop;         ///< Polled after every iteration; training stops if it returns true.
    /// Callback for one-line notes that are not in the training log, such as a full disk
    /// or a box that does not become an actor.
    std::function<void(const std::string&)> note;
    /// Progress of the initialisation, before the first log entry. An exception from this
    /// callback ends training.
    Progress progress = {};
    /// Times of the stages "initialise", "train", "drops" (drop probabilities of the
    /// sensor) and "coverage".
    StageTimes* stages = nullptr;
};

/// Callbacks and process group for the preparation of a log.
struct PrepareSession {
    /// Callback for one line about each estimate, as soon as it is available.
    std::function<void(const std::string&)> tell;
    std::function<bool()> stop;    ///< Polled from time to time; preparation stops if it returns true.
    Progress progress = {};        ///< Progress of long-running steps.
    StageTimes* stages = nullptr;  ///< Times of the stages "register", "calibrate" and "movers".
    ProcessGroup group = {};       ///< Processes that prepare the same log together.
};

/// Estimates data that a log lacks and that training needs from the start. The settings
/// select the steps, in this order: poses of the sensor (train.refine_poses), offsets and
/// responses of its beams (sensor.calibrate), tracks of moving objects without a label
/// (init.unlabelled_movers).
///
/// Uses only training frames, except for the poses of held-out frames. The result is
/// deterministic, so that a resumed training prepares the log again. All processes of a
/// group get the same result, but only the first process calls `tell`.
/// @throws Error with exit code 130 if stopped
/// @throws DataError if more than 5 % of the scans cannot be registered and
/// train.allow_lost_scans is not set
/// @throws UsageError if the log has no poses and the settings do not register it
void prepare_log(Sequence& sequence, const Split& split, const Config& config, PrepareSession session = {});

/// Loads the log that config.dataset describes, with a rolling shutter if config.sensor
/// enables it.
/// @param most_scans see DatasetOptions::most_scans
/// @throws errors of load_sequence()
Sequence load_log(const Config& config, const Progress& progress = {}, int most_scans = 0);

/// Trains a scene on the training frames of a log that prepare_log() has prepared. If an
/// error occurs, checkpoints already written are kept.
/// @throws UsageError if the session's start does not match the settings (see
/// check_resumable())
/// @throws DataError if there is no training frame
/// @throws DataError if a loss is not finite; the message names iteration, frame and term
/// @throws DataError if a parameter is not finite; the message names array and row
/// @throws DeviceError if the device fails
TrainResult train(Device& device, const Sequence& sequence, const Split& split, const Config& config,
                  const ProgressCallback& progress, const TrainSession& session = {});

/// Callbacks of place_held_out().
struct PlaceSession {
    Progress progress = {};
    /// Polled before each scan; if it returns true, placement ends and no pose changes.
    std::function<bool()> stop = {};
};

/// Result of place_held_out(): number of held-out scans, number of placed scans, and how
/// far they moved.
struct HeldOutPlacement {
    std::size_t scans = 0, placed = 0;
    double median_m = 0.0, largest_m = 0.0;
};

/// Places each held-out scan of a run on the trained scene (place_scan() in
/// relidar/log/registration.hpp). The run's sequence must contain the scans. This is
/// needed because training corrected the neighbouring poses but not those of held-out
/// scans. It changes only the pose of the held-out frame; the scene stays unchanged.
/// LiDARs that sweep together are placed together.
///
/// Does nothing if the settings do not register the sensor (train.refine_poses), or for
/// 3D Gaussians, which have no normals. Sets Run::held_out_placed unless it was stopped.
/// If stopped, no scan is placed.
HeldOutPlacement place_held_out(Device& device, Run& run, const PlaceSession& session = {});

/// Checkpoints, callbacks and stop condition for the training of a ray-drop network.
struct RefineSession {
    Progress progress = {};                                ///< Progress of rendering the training frames.
    std::function<void(const RefineProgress&)> step = {};  ///< Callback after each training step.
    /// Polled after each frame and each step; training stops if it returns true.
    std::function<bool()> stop = {};
    /// Folder for checkpoints of the network; empty = no checkpoints. They are written
    /// after each epoch, as train.checkpoint_minutes specifies, and when training stops
    /// early. The caller removes them after it has saved the network.
    std::filesystem::path checkpoints = {};
    const Checkpoint* start = nullptr;  ///< Checkpoint to resume from; null = start from the beginning.
    /// Callback for one-line notes about checkpoints that could not be written.
    std::function<void(const std::string&)> note = {};
    StageTimes* stages = nullptr;  ///< Times of the stages "network's images" and "network".
};

/// Subfolder for checkpoints of the ray-drop network, inside the checkpoint folder of the
/// scene.
inline constexpr const char* kRefineCheckpoints = "drop_network";

/// Trains the network of config.refine on the training frames of a run. The run's
/// sequence must contain the scans. The frames are rendered once with the nominal rays of
/// the sensor, because the measured rays of a scan reveal which rays returned. A resumed
/// training renders the frames again. Its result is bit-identical to an uninterrupted
/// training on the same device.
/// @return empty network if stopped
/// @throws DataError if no training frame has an image, or if no training frame has a
/// dropped ray
/// @throws errors of check_refine_resumable() if the session resumes from a checkpoint
DropNetwork refine_drops(Device& device, const Run& run, const RefineSession& session = {});

/// Checks that the training of a ray-drop network can resume with this run. The run's
/// sequence must contain the scans of its training frames. Scene, log and the relevant
/// settings (refine.*, image.*, sensor.*, init.*, render.range, train.seed) must match
/// the checkpoint.
/// @throws UsageError if a setting differs; the message names the setting
/// @throws DataError if the log or scene differs; the message names the differing part
void check_refine_resumable(const Checkpoint& checkpoint, const Run& run);
/// Copies the relevant settings from the checkpoint of a ray-drop network into a config.
/// @throws UsageError for a setting that this version does not know
void take_refine_settings(const Checkpoint& checkpoint, Config& config);

/// Callbacks of learn_scatter().
struct ScatterSession {
    Progress progress = {};
    std::function<bool()> stop = {};  ///< Polled before each frame; learning stops if it returns true.
};

/// Learns how the measured intensities of each LiDAR scatter around the rendered
/// intensities. Renders the scene of the run for some training frames. The run's sequence
/// must contain the scans.
/// @return [lidars], with an empty entry for a LiDAR that has too few returns; empty
/// vector if stopped
std::vector<IntensityScatter> learn_scatter(Device& device, const Run& run,
                                            const ScatterSession& session = {});

/// Callbacks of train_actors().
struct ActorSession {
    std::function<void(int step, int n_steps)> step = {};  ///< Callback after each training step.
    std::function<bool()> stop = {};  ///< Polled after each step; training stops if it returns true.
};

/// Trains the actors of a run whose scene is divided into blocks. The run's sequence must
/// contain the scans. Uses each training frame that sees an actor blocks.actor_epochs
/// times.
///
/// This is needed because the training of one block knows nothing beyond the surroundings
/// of its own sweeps. Here the actors are trained in front of the combined background of
/// all blocks, which stays unchanged. Only rays near an actor's box are used, with the
/// background surfels along these rays. The number of surfels stays constant.
/// @return true if training finished, false if it was stopped
/// @throws DataError as read_blocks(), or if a loss is not finite
bool train_actors(Device& device, Run& run, const ActorSession& session = {});

/// Moves the results of a training into a run: the scene, the coverage and, if training
/// corrected them, the poses.
void take_result(Run& run, TrainResult& result);

/// Checks that a training can resume with this log and these settings. train.iterations
/// may be increased; the learning rates then continue on the longer schedule at the
/// current iteration. These settings may differ: dataset.path, dataset.sequence,
/// dataset.poses, dataset.memory_mib, train.frame_memory_mib, train.log_every,
/// train.checkpoint_minutes, sensor.grid, sensor.grid_method, refine.*, render.* and
/// trace.chunk.
/// @throws UsageError if a setting differs; the message names the setting
/// @throws DataError if the log differs; the message names the differing part
void check_resumable(const Checkpoint& checkpoint, const Sequence& sequence, const Split& split,
                     const Config& config);
/// Returns the first setting that differs between two configs and that check_resumable()
/// does not allow to differ. Returns an empty string if there is none.
std::string differing_setting(const Config& config, const Config& other);
/// Returns the training log up to a checkpoint.
/// @throws DataError if the checkpoint is not a training checkpoint
std::vector<TrainProgress> resumed_log(const Checkpoint& checkpoint, const Config& config);

}  // namespace relidar
