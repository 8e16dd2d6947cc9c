// SPDX-License-Identifier: Apache-2.0
// Settings of a run. The name of a setting consists of the field names below, joined by
// dots, for example `loss.depth`. Some fields are constants of the preset; a run with a
// changed constant cannot be saved.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/diff/densify_options.hpp>
#include <relidar/diff/loss_options.hpp>
#include <relidar/diff/network.hpp>
#include <relidar/log/conventions.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

struct DatasetConfig {
    std::string path;  ///< Path of the dataset as given on the command line.
    /// Drive of a dataset with several drives. Empty = the first drive.
    std::string sequence;
    std::string lidars;  ///< Comma-separated names of the LiDARs to read. Empty = all.
    int frames_begin = 0;
    /// First frame after the range. -1 = all frames to the end.
    int frames_end = -1;
    int test_every = 10;
    /// Held-out frames, for example "13,26,40:45". Empty = test_every selects the frames.
    std::string test_frames;
    /// DatasetOptions::poses_file. Empty = poses of the dataset. kNoPoses = read no
    /// poses.
    std::string poses;
    /// TF frame or topic of a ROS bag. Empty = relidar selects it.
    std::string poses_from;
    bool skip_broken = false;
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    /// Maps Waymo intensities, which have no upper bound, to 0..1: "tanh", or "clamp" at
    /// 1.
    std::string waymo_intensity = "tanh";
    /// Maximum memory for scans, MiB; the others are in a memory-mapped file. 0 = half of
    /// the machine's memory.
    int memory_mib = 0;
    bool operator==(const DatasetConfig&) const = default;
};

/// Selects the scans that are simulated with a rolling shutter. With a rolling shutter,
/// each ray starts at the sensor's pose at the firing time of the ray. Without it, all
/// rays start at the pose at the time of the scan.
///
///   automatic  scans of sensors that are not in the log, and scans of the log's sensors
///              if the log is not motion-compensated
///   yes        all rendered scans; training and scores are the same as with automatic
///   no         no scan; scans of the log are read without a rolling shutter
enum class RollingShutter { automatic, yes, no };

struct SensorConfig {
    /// Range images for rendering and scores: "native" or "kitti360".
    std::string grid = "native";
    /// "project": simulate the scan of the sensor and bin its points into cells, like
    /// measured points. "cast": cast one ray through each cell centre.
    std::string grid_method = "project";
    RollingShutter rolling_shutter = RollingShutter::automatic;
    /// Per beam before training: "none", "range", "intensity" or "range,intensity".
    std::string calibrate = "none";
    /// Rays that sample the cross-section of each simulated beam: 1, 5 or 9.
    int sub_rays = 1;
    /// Full divergence of a simulated beam, milliradians. 0 = value of the sensor.
    double divergence_mrad = 0.0;
    /// Per simulated ray, 1 or 2: the strongest and the last return. 2 needs sub_rays 5
    /// or 9.
    int returns = 1;
    /// Closer surfaces on a ray give one merged return, metres.
    double return_separation_m = 0.5;

    /// Returns true if `calibrate` includes the given quantity.
    /// @param quantity "range" or "intensity"
    bool calibrates(const char* quantity) const { return calibrate.find(quantity) != std::string::npos; }
    bool operator==(const SensorConfig&) const = default;
};

struct TrainConfig {
    int iterations = 30000;
    /// "native": rays as the sensor fired them. "kitti360": range image whose cells
    /// contain the nearest points, as in published results.
    std::string grid = "native";
    int rays_per_iteration = 0;     ///< Number of rays per iteration. 0 = all rays of one frame (paper).
    int sh_degree_start = 0;        ///< Degree of the spherical harmonics (SH) at the first iteration.
    int sh_degree_interval = 1000;  ///< Number of iterations after which the SH degree increases by one.
    /// Relative to the extent of the model.
    double mean_rate = 1.6e-4;
    double mean_rate_final = 1.6e-6;
    double rotation_rate = 1e-3;
    double scale_rate = 5e-3;
    /// Maximum ratio of a surfel's standard deviation to its initial value (paper:
    /// unlimited).
    double max_growth = 1000.0;
    double opacity_rate = 0.05;
    double sh_rate = 2.5e-3;
    /// Relative to the rate of the drop logits. 1 = equal rates (paper).
    double intensity_factor = 1.0;
    /// Exponential decay of all rates except that of the mean positions: final rate
    /// relative to the initial rate. 1 = constant rates (paper).
    double rate_decay = 1.0;
    bool only_touched = false;   ///< If true, Adam skips surfels without a gradient in the current batch.
    bool deterministic = false;  ///< If true, two runs on one device give bit-equal parameters.
    /// Estimates the probability that the sensor itself drops a ray (replaces the paper's
    /// U-Net).
    bool sensor_drop = false;
    /// Poses optimised with the scene: "none", "sensor", "actors" or "sensor,actors".
    std::string refine_poses = "none";
    /// Estimates the poses of the scans by registration before pose optimisation.
    bool pose_register = true;
    /// Registers held-out scans to the trained scene after training.
    bool place_held_out = true;
    /// Continues even if many scans could not be registered.
    bool allow_lost_scans = false;
    /// Sensor translations, metres. The rates of rotations and of boxes are derived from
    /// it.
    double pose_rate_m = 2e-4;
    /// Device memory for rays of training frames, MiB. Other frames are uploaded
    /// repeatedly.
    int frame_memory_mib = 2048;
    int log_every = 50;
    /// Iterations between checkpoints. 0 = depend only on time.
    int checkpoint_every = 0;
    /// 0 = depend only on iterations.
    double checkpoint_minutes = 10.0;
    std::uint64_t seed = 1;

    /// Returns true if training optimises the given poses.
    /// @param pose_kind "sensor" or "actors"
    bool refines(const char* pose_kind) const { return refine_poses.find(pose_kind) != std::string::npos; }
    bool operator==(const TrainConfig&) const = default;
};

/// A block is a section of the trajectory of a long log that is trained separately.
struct BlockConfig {
    /// Metres along the sensor's trajectory. 0 = do not divide the log.
    double length_m = 0.0;
    /// Sweeps within this distance also train the block, metres.
    double halo_m = 40.0;
    /// Repetitions of all frames in the last step, which trains only the actors. 0 = no
    /// such step.
    int actor_epochs = 4;
    bool operator==(const BlockConfig&) const = default;
};

struct RenderConfig {
    /// From hits with weights w and ranges t: "expected" = sum w t (as in the paper),
    /// "normalised" = sum w t / sum w, "median", or "mode" (range of the surface with the
    /// largest weight).
    std::string range = "normalised";
    /// At the time of a recorded sweep, uses the head azimuths measured during this
    /// sweep.
    bool follow_sweeps = false;
    /// Comma-separated optional channels of scans.
    std::string channels;
    /// Range of point clouds. "median": the ray's transmittance falls to 0.5. "range":
    /// range of the range image.
    std::string points = "median";
    /// Cache of background blocks, MiB, without the blocks that the current scan needs.
    int memory_mib = 1024;
    bool operator==(const RenderConfig&) const = default;
};

struct TraceConfig {
    int chunk = 16;
    /// Hits per ray that the forward pass stores for the backward pass. Doubled up to 256
    /// if a ray has more. 0 = the backward pass traces every ray again, as in the paper.
    int keep_hits = 64;
    bool operator==(const TraceConfig&) const = default;
};

struct Config {
    std::string preset = "paper";
    DatasetConfig dataset;
    Conventions conventions;
    SensorConfig sensor;
    InitOptions init;
    ImageModel image;
    LossWeights loss;
    TrainConfig train;
    BlockConfig blocks;
    DensifyOptions densify;
    RayDropNetworkOptions refine;
    RenderConfig render;
    TraceConfig trace;

    /// Then a training step renders windows of adjacent columns instead of small groups
    /// that are spread over all directions.
    bool has_pixel_pair_loss() const { return loss.intensity * loss.intensity_ssim > 0.0f; }
    bool operator==(const Config&) const = default;
};

/// "paper", "released", "default" or "quick".
/// @throws UsageError for any other name, with the most similar name
Config make_preset(const std::string& preset_name);

struct ConfigKey {
    std::string key;
    std::string value;
    std::string help;
    bool expert = false;  ///< True if the setting requires knowledge of the implementation.
};
/// In the order of the TOML file.
std::vector<ConfigKey> list_config_keys(const Config& config);

/// @throws UsageError for an unknown key (with the most similar key), or for a value of
/// the wrong type or out of range
void set_value(Config& config, const std::string& key, const std::string& value);

/// Overwrites the settings that the file contains. A table name is the first part of a
/// key.
/// @throws UsageError for an unknown key or an invalid value
/// @throws DataError if the file is missing or malformed
void apply_file(Config& config, const std::filesystem::path& path);
/// For files of to_toml(), for example config.toml of a run.
/// @throws DataError if the file is malformed, lacks a setting, or has an unknown setting
Config load_settings(const std::filesystem::path& path);

/// With explanations as comments. load_settings() reads the same values.
std::string to_toml(const Config& config);
/// Leaves out expert settings that equal the preset.
std::string to_short_toml(const Config& config);

}  // namespace relidar
