// SPDX-License-Identifier: Apache-2.0
// Training of a scene, which can be stopped and resumed.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/diff/densify_options.hpp>
#include <relidar/diff/loss_options.hpp>
#include <relidar/diff/network.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/classes.hpp>
#include <relidar/log/coverage.hpp>
#include <relidar/log/log.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

class Loss;
struct Checkpoint;
struct Run;
namespace shared {
struct DeviceRay;
struct DeviceTarget;
}  // namespace shared

/// Summarises the iterations since the previous line.
struct TrainProgress {
    int iteration = 0;
    int n_iterations = 0;
    double seconds = 0.0;  ///< Seconds since training started.
    double iterations_per_second = 0.0;
    double eta_s = 0.0;
    /// Weighted loss terms, averaged over these iterations.
    std::array<double, kLossTerms> terms{};
    double loss = 0.0;
    std::uint32_t n_surfels = 0;
    /// Numbers of surfels added and removed. `before` and `after` are those of the last
    /// densification.
    DensifyReport densified;
};

/// Poses of training and held-out scans that training has corrected (train.refine_poses).
/// prepare_log() registers a held-out scan by matching its points with the
/// planes of the training scans. Training does not use held-out scans in any other way.
/// Gradients then correct a held-out pose only indirectly: with a rolling shutter by rays
/// of neighbouring sweeps fired between it and the next pose, otherwise by interpolation
/// of neighbouring corrections. Registration of the sensor also moves all boxes.
/// Gradients change boxes only if refine_poses includes actors.
struct RefinedPoses {
    PoseTrack world_from_vehicle;
    std::vector<BoxTrack> boxes;
};

/// The log and the times of a resumed training cover all sessions since the start.
struct TrainResult {
    Scene scene;
    /// Render scans with these poses, not with those of the log. nullopt if training used
    /// the log's poses unchanged.
    std::optional<RefinedPoses> poses;
    ObservedVoxelSet coverage;  ///< Space that the training frames have observed.
    SurfaceClassMap classes;    ///< Classes of the background. Empty if the log has no labelled points.
    std::vector<TrainProgress> log;
    KernelTimes times;  ///< Kernel times of this session only.
    double initialise_s = 0.0;
    double train_s = 0.0;
    std::uint64_t peak_device_bytes = 0;
    int iterations = 0;        ///< Number of completed iterations.
    bool interrupted = false;  ///< True if training stopped before the last iteration.
};

/// Called for each line of the log, a few iterations after the last iteration that it
/// describes. To stop the training, it returns false.
using TrainProgressCallback = std::function<bool(const TrainProgress&)>;

struct TrainSession {
    /// Empty = no checkpoints. Written at the intervals train.checkpoint_*, and when
    /// training stops early.
    std::filesystem::path checkpoints = {};
    /// Null = start from the beginning.
    const Checkpoint* start = nullptr;
    /// Called after every iteration. Returns true to stop the training.
    std::function<bool()> stop = {};
    /// Receives one-line messages that are not in the training log, for example about a
    /// full disk.
    std::function<void(const std::string&)> note = {};
    /// Of the initialisation. An exception from the callback ends training.
    Progress progress = {};
    /// Times of "initialise", "train", "drops" (of the sensor) and "coverage".
    StageTimes* stages = nullptr;
    /// Losses of the program, in addition to those of the settings. They must use the
    /// same device and exist until train() returns. The log sums their values in the term
    /// `custom`. An exception from a loss ends training. A checkpoint does not contain
    /// the losses: pass equal losses to a resumed training. train_actors() and other
    /// processes do not use them.
    std::vector<Loss*> losses = {};
};

struct LogPreparationCallbacks {
    /// One line about each estimate, as soon as it is available.
    std::function<void(const std::string&)> report_line;
    /// Polled. Returns true to stop the preparation.
    std::function<bool()> stop;
    Progress progress = {};        ///< Function that receives the progress of slow steps.
    StageTimes* stages = nullptr;  ///< Output: times of the stages "register", "calibrate" and "movers".
    ProcessGroup group = {};       ///< Group of processes that prepare the same log together.
};

/// Estimates data that training needs from the start but that the log does not contain.
/// The settings select the steps, in this order:
/// - train.refine_poses: poses of the sensor
/// - sensor.calibrate: range offsets and intensity responses of the sensor's beams
/// - init.unlabelled_movers: tracks of moving objects without a label
///
/// Uses only training frames, except for the poses of held-out frames. The result is
/// deterministic, so a resumed training prepares the log again. All processes of a group
/// get the same result, but only the first process calls `report_line`.
/// @throws Error with exit code 130 if stopped
/// @throws DataError if the log has no poses, more than 5 % of the scans cannot be
/// registered, and train.allow_lost_scans is not set
/// @throws UsageError if the log has no poses and the settings do not register it
void prepare_log(Log& log, const Split& split, const Config& config, LogPreparationCallbacks callbacks = {});

/// Trains a scene on the training frames of a prepared log. Existing checkpoints are kept
/// if an error occurs.
/// @throws UsageError if the session's checkpoint does not match the settings
/// @throws DataError if there is no training frame, if a loss is not finite (naming
/// iteration, frame and term), or if a parameter is not finite (naming array and row)
/// @throws DeviceError if the device fails
TrainResult train(Device& device, const Log& log, const Split& split, const Config& config,
                  const TrainProgressCallback& progress = {}, const TrainSession& session = {});

/// Rays of a frame in the scene's frame, and their measurements, [n].
struct TrainingRays {
    std::vector<shared::DeviceRay> rays;
    /// Without range offsets and intensity responses of the beams. The weight is 0 for
    /// rays that training ignores, for example on moving boxes without a model.
    std::vector<shared::DeviceTarget> targets;
};
/// Computes what train() uses of a scan, with the poses, beams and actors of a run.
/// @param frame  a frame of Run::log, with its scan
TrainingRays make_training_rays(const Run& run, const Frame& frame);

struct ScanCallbacks {
    Progress progress = {};
    /// Called before each scan. Returns true to stop.
    std::function<bool()> stop = {};
};

/// Corrected scans, and the distances by which they moved.
struct HeldOutPoseReport {
    std::size_t scans = 0, placed = 0;
    double median_m = 0.0, largest_m = 0.0;
};

/// Registers the points of each held-out scan to the trained scene, because training has
/// corrected the neighbouring poses only. LiDARs that sweep at the same time are
/// registered together. The run's log must contain the scans.
/// Does nothing if the settings do not register the sensor (train.refine_poses), or for
/// 3D Gaussians, which have no normals. Sets Run::held_out_placed. If it was
/// stopped, no pose changes.
HeldOutPoseReport register_held_out(Device& device, Run& run, const ScanCallbacks& session = {});

struct RayDropTrainingSession {
    Progress progress = {};  ///< Function that receives the progress of rendering the training frames.
    /// Called after each training step.
    std::function<void(const RayDropTrainProgress&)> step = {};
    /// Called after each frame and each step. Returns true to stop the training.
    std::function<bool()> stop = {};
    /// Empty = no checkpoints. Written after each epoch, at the interval
    /// train.checkpoint_minutes, and when training stops early. The caller removes them
    /// after saving the network.
    std::filesystem::path checkpoints = {};
    /// Null = start from the beginning.
    const Checkpoint* start = nullptr;
    /// One line about each checkpoint that could not be written.
    std::function<void(const std::string&)> note = {};
    StageTimes* stages = nullptr;  ///< Output: times of the stages "network's images" and "network".
};

/// Relative to the checkpoint folder of the scene.
inline constexpr const char* kRefineCheckpoints = "drop_network";

/// Trains a ray-drop network with the options config.refine on the training frames of a
/// run, whose log must contain the scans. The frames are rendered with the nominal
/// rays of the sensor, because the measured rays of a scan reveal which rays returned. A
/// resumed training gives the same network, bit by bit, on the same device.
/// @return empty network if stopped
/// @throws DataError if no training frame has an image or a dropped ray
/// @throws errors of check_drop_resume() if the session resumes from
/// a checkpoint
RayDropNetwork train_drops(Device& device, const Run& run, const RayDropTrainingSession& session = {});

/// Checks that the training of a ray-drop network can resume with this run, whose
/// log must contain the scans of its training frames. Scene, log and the relevant
/// settings (refine.*, image.*, sensor.*, init.*, render.range, train.seed) must match
/// the checkpoint.
/// @throws UsageError naming a setting that differs
/// @throws DataError naming the part of the log or scene that differs
void check_drop_resume(const Checkpoint& checkpoint, const Run& run);
/// Reads the settings that affect a ray-drop network from its checkpoint.
/// @throws UsageError for a setting that this version does not know
void read_drop_settings(const Checkpoint& checkpoint, Config& config);

/// Models the measured intensities, given the rendered intensities of some training
/// frames. Run::log must contain the measured scans of these frames.
/// @return [lidars] models. A model is empty if its LiDAR has too few returns. The vector
/// is empty if ScanCallbacks::stop has stopped the fit
std::vector<IntensityScatterModel> learn_scatter(Device& device, const Run& run,
                                                 const ScanCallbacks& session = {});

/// `stopped`: by a callback
enum class TrainingEndReason { finished, stopped };

struct ActorTrainingCallbacks {
    /// Called after each training step.
    std::function<void(int step, int n_steps)> step = {};
    /// Called after each training step. Returns true to stop the training.
    std::function<bool()> stop = {};
};

/// Trains the actors of a run in blocks in front of the joined background, which stays
/// unchanged, because the training of a block uses only the surroundings of its own
/// sweeps. Each training frame that shows an actor is used blocks.actor_epochs times,
/// with the rays near its box and the background surfels along these rays. The run's
/// log must contain the scans. The run is unchanged if the training was stopped.
/// @throws DataError if a block cannot be read or a loss is not finite
TrainingEndReason train_actors(Device& device, Run& run, const ActorTrainingCallbacks& session = {});

/// Moves the scene, the coverage and the corrected poses (if any) into a run.
void move_result(Run& run, TrainResult& result);

/// Checks that a training can resume with this log and these settings. train.iterations
/// may be increased; the learning rates then follow the longer schedule. These settings
/// may also differ: dataset.path, dataset.sequence, dataset.poses, dataset.memory_mib,
/// train.frame_memory_mib, train.log_every, train.checkpoint_minutes, sensor.grid,
/// sensor.grid_method, refine.*, render.* and trace.chunk.
/// @throws UsageError naming another setting that differs
/// @throws DataError naming the part of the log that differs
void check_resume(const Checkpoint& checkpoint, const Log& log, const Split& split, const Config& config);
/// Returns the first setting whose difference prevents resuming. Returns an empty string
/// if none does.
std::string find_fixed_setting(const Config& config, const Config& other_config);
/// Returns the training log that is stored in a checkpoint.
/// @throws DataError if the checkpoint is not a training checkpoint
std::vector<TrainProgress> read_training_log(const Checkpoint& checkpoint, const Config& config);

}  // namespace relidar
