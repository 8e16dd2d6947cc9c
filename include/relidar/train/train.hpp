// SPDX-License-Identifier: Apache-2.0
// The training loop: initialise, then sample a frame, render, compare, differentiate,
// step. It can stop and continue.
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

/// One line of the log.
struct TrainProgress {
    int iteration = 0;
    int n_iterations = 0;
    double seconds = 0.0;  ///< since training started
    double iterations_per_second = 0.0;
    double eta_s = 0.0;
    std::array<double, kLossTerms> terms{};  ///< weighted, mean over the iterations since the last line
    double loss = 0.0;
    std::uint32_t n_surfels = 0;
    /// sums over the densifications since the last line; `before` and `after` are of the
    /// last one
    DensifyReport densified;
};

/// Poses as training corrected them (train.refine_poses). prepare_log() has registered
/// them before: it places a held-out scan by its own points on the planes of the training
/// scans; nothing else of training looks at it. What gradients then add at a held-out
/// pose comes from what the neighbouring sweeps see that were fired between, or, without
/// a rolling shutter, from the corrections before and after, interpolated. Where the
/// sensor was registered, all boxes went along; gradients leave them where refine_poses
/// names no actors.
struct RefinedPoses {
    PoseTrack world_from_vehicle;
    std::vector<BoxTrack> boxes;
};

/// What training leaves behind. Log and times count from the first start, whatever the
/// number of interruptions.
struct TrainResult {
    Scene scene;
    std::optional<RefinedPoses> poses;  ///< to render the scene with; nothing where the log's own were kept
    Coverage coverage;                  ///< of its training frames
    std::vector<TrainProgress> log;
    KernelTimes times;  ///< of this session
    double initialise_s = 0.0;
    double train_s = 0.0;
    std::uint64_t peak_device_bytes = 0;
    int iterations = 0;        ///< done
    bool interrupted = false;  ///< before the last one
};

/// Called with every line of the log, a few iterations after the one at which it ends.
/// Returning false stops training after the current iteration; the result holds the scene
/// so far.
using ProgressCallback = std::function<bool(const TrainProgress&)>;

/// How a training that may take days starts and stops.
struct TrainSession {
    /// folder they go to, as train.checkpoint_* say and where training stops early;
    /// empty: none
    std::filesystem::path checkpoints;
    const Checkpoint* start = nullptr;  ///< continue from here; null: from the beginning
    std::function<bool()> stop;         ///< asked after every iteration; true stops training
    /// one line about what the log does not say: a full disk under a checkpoint, boxes
    /// that become no actor
    std::function<void(const std::string&)> note;
    /// of the initialisation, before the first line of the log; what it throws ends
    /// training
    Progress progress = {};
    StageTimes* stages = nullptr;  ///< "initialise", "train", "drops" (the sensor's own), "coverage"
};

/// How a log is prepared.
struct PrepareSession {
    std::function<void(const std::string&)> tell;  ///< one line about each estimate, as soon as it is made
    std::function<bool()> stop;                    ///< asked now and then; true ends it
    Progress progress = {};                        ///< of what takes longer than a moment
    StageTimes* stages = nullptr;                  ///< "register", "calibrate", "movers"
    ProcessGroup group = {};                       ///< processes that prepare the same log
};

/// Estimates what the log does not say and training needs from the start, in this order,
/// as the settings ask: poses of the sensor (train.refine_poses), offsets and responses
/// of its beams (sensor.calibrate), tracks of what moves without a label
/// (init.unlabelled_movers). From training frames alone, but for the poses of held-out
/// ones; the same for the same log and settings, so that a resumed training prepares its
/// log anew, and in all processes of a group, of which the first one alone tells.
/// @throws Error with exit code 130 where stopped; DataError where more than 5 % of the
/// scans do not find their place among the others and train.allow_lost_scans is not set;
/// UsageError where a log without poses is not to be registered
void prepare_log(Sequence& sequence, const Split& split, const Config& config, PrepareSession session = {});

/// The log that config.dataset describes, with rolling shutter where config.sensor wants
/// it. @throws as load_sequence()
/// @param most_scans  DatasetOptions::most_scans
Sequence load_log(const Config& config, const Progress& progress = {}, int most_scans = 0);

/// Trains a scene on the training frames of a log, prepared by prepare_log().
/// @throws UsageError where the session's start does not fit (check_resumable); DataError
/// where there is nothing to train on, where a loss is not finite, naming iteration,
/// frame and term, or a parameter, naming array and row; DeviceError on the device's
/// failures. Checkpoints already written stay
TrainResult train(Device& device, const Sequence& sequence, const Split& split, const Config& config,
                  const ProgressCallback& progress, const TrainSession& session = {});

/// How held-out scans are placed.
struct PlaceSession {
    Progress progress = {};
    std::function<bool()> stop = {};  ///< asked before each scan; true ends it with nothing changed
};

/// What placing them has changed: scans that found their place, and by how much they
/// moved.
struct HeldOutPlacement {
    std::size_t scans = 0, placed = 0;
    double median_m = 0.0, largest_m = 0.0;
};

/// Places each held-out scan of a run, whose sequence has its scans, on the trained
/// scene, which stays (place_scan() in relidar/log/registration.hpp): training has moved
/// the poses around it, and it did not go along. Nothing but the pose of its frame is
/// found from its returns. LiDARs that sweep together are placed together. Nothing
/// happens if the settings do not register the sensor (train.refine_poses), or for 3D
/// Gaussians, which have no normals. Sets Run::held_out_placed, unless it was stopped:
/// then nothing is placed.
HeldOutPlacement place_held_out(Device& device, Run& run, const PlaceSession& session = {});

/// How a ray-drop network is trained.
struct RefineSession {
    Progress progress = {};                                ///< of the rendering of the training frames
    std::function<void(const RefineProgress&)> step = {};  ///< called after each step
    std::function<bool()> stop = {};                       ///< asked after each frame and step; true ends it
    /// folder that checkpoints of the network go to: after each epoch, as
    /// train.checkpoint_minutes says and where training stops early; empty: none. Whoever
    /// has saved the network removes them
    std::filesystem::path checkpoints = {};
    const Checkpoint* start = nullptr;  ///< continue from here; null: from the beginning
    /// one line about a checkpoint that could not be written
    std::function<void(const std::string&)> note = {};
    StageTimes* stages = nullptr;  ///< "network's images", "network"
};

/// Folder of a network's checkpoints below that of its scene's.
inline constexpr const char* kRefineCheckpoints = "drop_network";

/// Trains config.refine's network on the training frames of a run whose sequence has its
/// scans, rendered once with the sensor's nominal rays; those of a scan would tell what
/// returned. A training that continues renders them again, and ends with the network it
/// would have had without the stop, to the last bit on one device. @return nothing where
/// stopped
/// @throws DataError where no training frame has an image, or none has a dropped ray; as
/// check_refine_resumable() for the session's start
DropNetwork refine_drops(Device& device, const Run& run, const RefineSession& session = {});

/// Whether the training of a network may continue with this run, whose sequence has the
/// scans of its training frames: scene, log and the settings that images and network
/// depend on (refine.*, image.*, sensor.*, init.*, render.range, train.seed) must be the
/// checkpoint's.
/// @throws UsageError naming the setting, DataError naming the part of log or scene that
/// differs
void check_refine_resumable(const Checkpoint& checkpoint, const Run& run);
/// Gives a config those settings as a network's checkpoint has them. @throws UsageError
/// for one that this version does not know
void take_refine_settings(const Checkpoint& checkpoint, Config& config);

/// How it is learnt how intensities scatter.
struct ScatterSession {
    Progress progress = {};
    std::function<bool()> stop = {};  ///< asked before each frame; true ends it
};

/// How the intensities of each LiDAR scatter about those that the scene of a run, whose
/// sequence has its scans, renders for some of its training frames. @return [lidars] an
/// empty one where a LiDAR has too few returns; none where stopped
std::vector<IntensityScatter> learn_scatter(Device& device, const Run& run,
                                            const ScatterSession& session = {});

/// How actors are trained on.
struct ActorSession {
    std::function<void(int step, int n_steps)> step = {};  ///< called after each step
    std::function<bool()> stop = {};                       ///< asked after each step; true ends it
};

/// Trains the actors of a run whose scene is in blocks and whose sequence has its scans,
/// blocks.actor_epochs times on each training frame that sees one. A block's training
/// knows nothing of what lies behind its actors beyond its own sweeps' surroundings: here
/// they learn before the background of all blocks, which stays as it is. Rays are those
/// that come near an actor's box; of the background takes part what lies along them. The
/// number of surfels stays.
/// @return whether it came to its end @throws DataError as read_blocks(), and where a
/// loss is not finite
bool train_actors(Device& device, Run& run, const ActorSession& session = {});

/// Gives a run what training has made of its log: the scene, where the log has looked,
/// and the poses where training has corrected them. They are moved out of the result.
void take_result(Run& run, TrainResult& result);

/// Whether a training may continue with this log and these settings. train.iterations may
/// be raised: the learning rates continue where the longer schedule stands at that
/// iteration. train.log_every, train.checkpoint_*, refine.*, render.*, eval.* and
/// trace.chunk are free.
/// @throws UsageError naming the setting, DataError naming the part of the log that
/// differs
void check_resumable(const Checkpoint& checkpoint, const Sequence& sequence, const Split& split,
                     const Config& config);
/// A setting of two configs that differs and is not free in that sense; empty: none.
std::string differing_setting(const Config& config, const Config& other);
/// The log up to a checkpoint. @throws DataError where the checkpoint is not one of
/// training
std::vector<TrainProgress> resumed_log(const Checkpoint& checkpoint, const Config& config);

}  // namespace relidar
