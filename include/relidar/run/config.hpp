// SPDX-License-Identifier: Apache-2.0
// Settings of a run, one field per setting. The name of a setting consists of the field
// names below, joined by dots, for example `loss.depth` or `init.voxel_m`. Some fields
// are constants of the preset; `relidar list settings --all` does not list them. A run
// with a changed constant cannot be saved.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/diff/densify_options.hpp>
#include <relidar/diff/loss_options.hpp>
#include <relidar/diff/network.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

struct DatasetConfig {
    std::string path;  ///< Path of the dataset as given on the command line.
    /// Name of the drive to read if the dataset has several drives. Empty = the first
    /// drive.
    std::string sequence;
    std::string lidars;  ///< Comma-separated names of the LiDARs to read. Empty = all.
    int frames_begin = 0;
    /// End of the frame range. The frame with this number is excluded. -1 = the range
    /// includes the last frame.
    int frames_end = -1;
    int test_every = 10;
    /// Indices and ranges of the held-out frames, for example "13,26,40:45". Empty =
    /// test_every selects the frames.
    std::string test_frames;
    /// Text file with poses, in the forms of DatasetOptions::poses_file. Empty = use the
    /// poses of the dataset. kNoPoses = read no poses.
    std::string poses;
    /// TF frame or topic of a ROS bag from which the poses are read. Empty = relidar
    /// selects it.
    std::string poses_from;
    bool skip_broken = false;
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    /// Function that maps Waymo intensities to 0..1: "tanh", or "clamp" at 1. The mapping
    /// is needed because these intensities have no upper bound.
    std::string waymo_intensity = "tanh";
    /// Maximum memory for scans, MiB. Scans beyond this limit are stored in a
    /// memory-mapped file. 0 = half of the machine's memory.
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
    /// Layout of range images for rendering and scores: "native" or "kitti360".
    std::string grid = "native";
    /// Method for computing an image on a grid. "project": simulate the scan of the
    /// sensor and bin its points into cells, like measured points. "cast": cast one ray
    /// through each cell centre.
    std::string grid_method = "project";
    RollingShutter rolling_shutter = RollingShutter::automatic;
    /// Quantities to calibrate for each beam before training: "none", "range",
    /// "intensity" or "range,intensity".
    std::string calibrate = "none";
    /// Number of rays that sample the cross-section of each simulated beam: 1, 5 or 9.
    int sub_rays = 1;
    /// Full divergence angle of a simulated beam, milliradians. 0 = value of the sensor.
    double divergence_mrad = 0.0;
    /// Number of returns per simulated ray, 1 or 2. With 2, a ray gives the strongest and
    /// the last return, and sub_rays must be 5 or 9.
    int returns = 1;
    /// Minimum distance between two returns of a ray, metres. Surfaces that are closer to
    /// each other give one merged return.
    double return_separation_m = 0.5;

    /// Returns true if `calibrate` includes the given quantity.
    /// @param quantity "range" or "intensity"
    bool is_calibration_enabled_for(const char* quantity) const {
        return calibrate.find(quantity) != std::string::npos;
    }
    bool operator==(const SensorConfig&) const = default;
};

struct TrainConfig {
    int iterations = 30000;
    /// Layout of the training frames. "native": rays as the sensor fired them.
    /// "kitti360": range image whose cells contain the nearest points, as in published
    /// results.
    std::string grid = "native";
    int rays_per_iteration = 0;     ///< Number of rays per iteration. 0 = all rays of one frame (paper).
    int sh_degree_start = 0;        ///< Degree of the spherical harmonics (SH) at the first iteration.
    int sh_degree_interval = 1000;  ///< Number of iterations after which the SH degree increases by one.
    /// Initial learning rate of the surfels' mean positions, relative to the extent of
    /// the model.
    double mean_rate = 1.6e-4;
    double mean_rate_final = 1.6e-6;
    double rotation_rate = 1e-3;
    double scale_rate = 5e-3;
    /// Limit on the growth of a surfel: maximum ratio of its standard deviation to the
    /// initial value (paper: unlimited).
    double max_growth = 1000.0;
    double opacity_rate = 0.05;
    double sh_rate = 2.5e-3;
    /// Learning rate of the intensity coefficients, relative to the rate of the drop
    /// logits. 1 = equal rates (paper).
    double intensity_factor = 1.0;
    /// Final value of the learning rates relative to their initial value, after
    /// exponential decay. It applies to all learning rates except the rate of the mean
    /// positions. 1 = constant rates (paper).
    double rate_decay = 1.0;
    bool only_touched = false;   ///< If true, Adam skips surfels without a gradient in the current batch.
    bool deterministic = false;  ///< If true, two runs on one device give bit-equal parameters.
    /// If true, training estimates the probability that the sensor itself drops a ray,
    /// independently of the scene (replaces the paper's U-Net).
    bool sensor_drop = false;
    /// Poses that are optimised together with the scene: "none", "sensor", "actors" or
    /// "sensor,actors".
    std::string refine_poses = "none";
    /// If true, the poses of the scans are estimated from the scans (registration) before
    /// the scene is initialised. Pose optimisation then starts from these poses.
    bool pose_register = true;
    /// If true, the poses of held-out scans are corrected after training: the scans are
    /// registered to the trained scene.
    bool place_held_out = true;
    /// If true, training continues even if many scans could not be registered.
    bool allow_lost_scans = false;
    /// Initial learning rate of the sensor's translations, metres. The learning rates of
    /// its rotations and of the actors' boxes are derived from it.
    double pose_rate_m = 2e-4;
    /// Device memory for storing the rays of training frames, MiB. The rays of frames
    /// that do not fit are uploaded again in each iteration.
    int frame_memory_mib = 2048;
    int log_every = 50;
    /// Number of iterations between checkpoints. 0 = checkpoints depend only on time.
    int checkpoint_every = 0;
    /// Minutes between checkpoints. 0 = checkpoints depend only on iterations.
    double checkpoint_minutes = 10.0;
    std::uint64_t seed = 1;

    /// Returns true if training optimises the given poses (`refine_poses`).
    /// @param pose_kind "sensor" or "actors"
    bool is_pose_refinement_enabled_for(const char* pose_kind) const {
        return refine_poses.find(pose_kind) != std::string::npos;
    }
    bool operator==(const TrainConfig&) const = default;
};

/// Settings for training a long log in blocks. A block is a section of the trajectory
/// that is trained separately.
struct BlockConfig {
    /// Maximum length of a block along the sensor's trajectory, metres. 0 = do not divide
    /// the log.
    double length_m = 0.0;
    /// Distance around a block, metres. Sweeps within this distance are also used to
    /// train the block.
    double halo_m = 40.0;
    /// After the blocks were trained and joined, a last step trains only the actors
    /// (moving objects). This is how often it repeats all frames. 0 = no such step.
    int actor_epochs = 4;
    bool operator==(const BlockConfig&) const = default;
};

struct RenderConfig {
    /// How range images compute the range of a ray from its hits with weights w and
    /// ranges t: "expected" = sum w t (as in the paper), "normalised" = sum w t / sum w,
    /// "median", or "mode" (range of the surface with the largest weight).
    std::string range = "normalised";
    /// If true, a scan at the time of a recorded sweep uses the head azimuths that were
    /// measured during this sweep.
    bool follow_sweeps = false;
    /// Comma-separated names of optional channels that a scan gets in addition to the
    /// basic channels.
    std::string channels;
    /// Range at which the points of point clouds are placed. "median": range at which the
    /// ray's transmittance falls to 0.5. "range": range of the range image.
    std::string points = "median";
    /// Device memory for caching background blocks, MiB. The memory of the blocks that
    /// the current scan needs is not counted.
    int memory_mib = 1024;
    bool operator==(const RenderConfig&) const = default;
};

struct TraceConfig {
    int chunk = 16;
    /// Initial number of hits per ray that the forward pass can store for the backward
    /// pass. If a ray has more hits, later iterations use twice this number, up to 256.
    /// With 0, the backward pass traces every ray again, as in the paper.
    int keep_hits = 64;
    bool operator==(const TraceConfig&) const = default;
};

struct Config {
    std::string preset = "paper";
    DatasetConfig dataset;
    SensorConfig sensor;
    SceneInitialisationOptions init;
    ImageFormationModel image;
    LossWeights loss;
    TrainConfig train;
    BlockConfig blocks;
    DensifyOptions densify;
    RayDropNetworkOptions refine;
    RenderConfig render;
    TraceConfig trace;

    /// Returns true if a loss compares neighbouring pixels. A training step then renders
    /// windows of adjacent columns. Otherwise it renders small groups of columns that are
    /// spread over all directions.
    bool has_loss_between_neighbour_pixels() const { return loss.intensity * loss.intensity_ssim > 0.0f; }
    bool operator==(const Config&) const = default;
};

/// Returns the settings of the preset "paper", "released", "default" or "quick".
/// @throws UsageError for any other name. The message suggests the most similar name.
Config make_preset_config(const std::string& preset_name);

/// Description of a setting: key, current value as text, and explanation.
struct ConfigKey {
    std::string key;
    std::string value;
    std::string help;
    bool expert = false;  ///< True if the setting requires knowledge of the implementation.
};
/// Lists all settings, in the order of the TOML file.
std::vector<ConfigKey> list_config_keys(const Config& config);

/// Sets a setting from text.
/// @throws UsageError for an unknown key (the message suggests the most similar key), or
/// for a value of the wrong type or out of range
void set_config_value(Config& config, const std::string& key, const std::string& value);

/// Reads a TOML file and overwrites the settings that the file contains. A table name is
/// the first part of a key.
/// @throws UsageError for an unknown key or an invalid value
/// @throws DataError if the file is missing or malformed
void apply_config_file(Config& config, const std::filesystem::path& path);
/// Reads a settings file written by to_toml(), for example config.toml of a run.
/// @throws DataError if the file is malformed, lacks a setting, or has an unknown setting
Config load_saved_config(const std::filesystem::path& path);

/// Returns all settings as TOML text, with explanations as comments. load_saved_config()
/// reads the same values from this text.
std::string to_toml(const Config& config);
/// Returns the settings as TOML text. Leaves out expert settings that equal the preset.
std::string to_toml_without_defaults(const Config& config);

}  // namespace relidar
