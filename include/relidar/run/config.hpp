// SPDX-License-Identifier: Apache-2.0
// Settings of a run, one field per setting, so that each ablation of the paper is a
// single `--set`. A key consists of the field names below, joined by dots: `loss.depth`,
// `init.voxel_m`. A field that `relidar list settings --all` does not list is a constant
// of the preset. A run with another value of a constant cannot be saved.
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
    /// Name of the drive to read from a dataset with several drives. Empty: the only
    /// drive, or the first.
    std::string sequence;
    std::string lidars;  ///< Comma-separated names of the LiDARs to read; empty = all.
    int frames_begin = 0;
    int frames_end = -1;  ///< End of the frame range (exclusive); -1 = up to the last frame.
    int test_every = 10;
    /// Numbers and ranges of the held-out frames: "13,26,40:45". Empty: test_every
    /// selects them.
    std::string test_frames;
    /// File with 12 numbers per line, one pose per frame. Empty = poses of the dataset;
    /// kNoPoses = no poses.
    std::string poses;
    /// Frame or topic of a ROS bag that provides the poses; empty = chosen automatically.
    std::string poses_from;
    bool skip_broken = false;
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    /// Mapping of Waymo intensities, which have no upper bound: "tanh", or "clamp" at 1.
    std::string waymo_intensity = "tanh";
    /// Memory for scans in MiB; further scans are stored in a memory-mapped file. 0 =
    /// half of the machine's memory.
    int memory_mib = 0;
    bool operator==(const DatasetConfig&) const = default;
};

/// Selects the scans with a rolling shutter. Each ray of such a scan starts at the
/// sensor's pose at its firing time, instead of the pose at the time of the scan.
///
///   automatic  scans of sensors that are not in the log; scans of the log's sensors
///              unless the log is motion-compensated
///   yes        all rendered scans; training and scores are as with automatic
///   no         no scan; scans of the log are read without a rolling shutter
enum class RollingShutter { automatic, yes, no };

struct SensorConfig {
    std::string grid = "native";  ///< Range image that is rendered and scored: "native" or "kitti360".
    /// Method for grid images. "project": simulate the native scan and bin its points
    /// like the real points. "cast": cast rays through the cell centres.
    std::string grid_method = "project";
    RollingShutter rolling_shutter = RollingShutter::automatic;
    /// Per-beam calibration before training: "none", "range", "intensity" or
    /// "range,intensity". See calibrate_ranges() and calibrate_intensity().
    std::string calibrate = "none";
    /// Number of rays that are cast over the footprint of each simulated beam: 1, 5 or 9.
    int sub_rays = 1;
    /// Full beam divergence of the simulated sensor, milliradians; 0 = value of the
    /// sensor.
    double divergence_mrad = 0.0;
    /// Number of returns per simulated ray, 1 or 2. With 2 returns, these are the
    /// strongest and the last; sub_rays must be 5 or 9.
    int returns = 1;
    /// Surfaces closer to each other than this are merged to one return, metres.
    double return_separation_m = 0.5;

    /// Returns true if `calibrate` includes the given part.
    /// @param what "range" or "intensity"
    bool calibrates(const char* what) const { return calibrate.find(what) != std::string::npos; }
    bool operator==(const SensorConfig&) const = default;
};

struct TrainConfig {
    int iterations = 30000;
    /// Form of the training frames: "native" (the rays as fired) or "kitti360" (an image
    /// of cells, as in published results).
    std::string grid = "native";
    int rays_per_iteration = 0;     ///< Rays per iteration; 0 = all rays of one frame (paper).
    int sh_degree_start = 0;        ///< SH degree at the first iteration.
    int sh_degree_interval = 1000;  ///< Number of iterations after which the SH degree increases by one.
    double mean_rate = 1.6e-4;      ///< Learning rate of the means, multiplied by the extent.
    double mean_rate_final = 1.6e-6;
    double rotation_rate = 1e-3;
    double scale_rate = 5e-3;
    /// Maximum growth of a surfel's standard deviation, relative to its initial value
    /// (paper: unlimited).
    double max_growth = 1000.0;
    double opacity_rate = 0.05;
    double sh_rate = 2.5e-3;
    /// Learning rate of the intensity coefficients, relative to the rate of the drop
    /// logits (1 = paper).
    double intensity_factor = 1.0;
    /// Final value of all learning rates except that of the means, relative to their
    /// initial value. The decay is exponential (1 = paper).
    double rate_decay = 1.0;
    bool only_touched = false;   ///< If true, Adam skips surfels without a gradient in the current batch.
    bool deterministic = false;  ///< If true, two runs on one device produce bit-equal parameters.
    /// If true, learns which rays the sensor never returns separately from the scene
    /// (replaces the paper's U-Net).
    bool sensor_drop = false;
    /// Poses that are optimised with the scene: "none", "sensor", "actors" or
    /// "sensor,actors".
    std::string refine_poses = "none";
    /// If true, the scans are registered before the scene is initialised, and refinement
    /// starts from these poses.
    bool pose_register = true;
    /// If true, registered held-out scans are placed again on the trained scene.
    bool place_held_out = true;
    bool allow_lost_scans = false;  ///< If true, trains even if many scans could not be registered.
    /// Initial learning rate of the sensor's translations, metres. The rates of its
    /// rotations and of actors' boxes are derived from it.
    double pose_rate_m = 2e-4;
    /// Device memory for rays of training frames, MiB. Frames that do not fit are
    /// uploaded again for each use.
    int frame_memory_mib = 2048;
    int log_every = 50;
    int checkpoint_every = 0;          ///< Iterations between checkpoints; 0 = only by time.
    double checkpoint_minutes = 10.0;  ///< Minutes between checkpoints; 0 = only by iterations.
    std::uint64_t seed = 1;

    /// Returns true if `refine_poses` includes the given poses.
    /// @param poses "sensor" or "actors"
    bool refines(const char* poses) const { return refine_poses.find(poses) != std::string::npos; }
    bool operator==(const TrainConfig&) const = default;
};

/// Settings for training a long log in blocks. A block is a section of the trajectory
/// with the sweeps that see it.
struct BlockConfig {
    /// Maximum length of a block along the sensor's trajectory, metres; 0 = train the log
    /// as one unit.
    double length_m = 0.0;
    /// Sweeps recorded within this distance of a block are also used to train it, metres.
    double halo_m = 40.0;
    /// Number of times that each training frame is used to train the actors in front of
    /// the joined background; 0 = off.
    int actor_epochs = 4;
    bool operator==(const BlockConfig&) const = default;
};

struct RenderConfig {
    /// Range in range images: "expected" (D, paper), "normalised" (D / W), "median" or
    /// "mode".
    std::string range = "normalised";
    /// If true, a scan of the log's LiDAR at the time of one of its sweeps uses the
    /// measured orientation of its head.
    bool follow_sweeps = false;
    /// Comma-separated names from optional_channels(), for channels of a scan in addition
    /// to the basic ones.
    std::string channels;
    /// Range of the points in point clouds: "median" (the dominant surface) or "range"
    /// (the value of `range` above).
    std::string points = "median";
    /// Device memory for cached blocks of a long scene, in addition to the blocks that a
    /// scan needs, MiB.
    int memory_mib = 1024;
    bool operator==(const RenderConfig&) const = default;
};

struct TraceConfig {
    int chunk = 16;
    /// Initial number of hits per ray that the forward pass keeps for the backward pass.
    /// Doubled up to 256 while any ray has more hits. 0 = cast every ray again (paper).
    int keep_hits = 64;
    bool operator==(const TraceConfig&) const = default;
};

struct Config {
    std::string preset = "paper";
    DatasetConfig dataset;
    SensorConfig sensor;
    InitialiseOptions init;
    ImageModel image;
    LossWeights loss;
    TrainConfig train;
    BlockConfig blocks;
    DensifyOptions densify;
    RefineOptions refine;
    RenderConfig render;
    TraceConfig trace;

    /// Returns true if a loss compares neighbouring pixels. A training step then uses
    /// windows of adjacent columns instead of groups of columns from all around the
    /// sensor.
    bool needs_images() const { return loss.intensity * loss.intensity_ssim > 0.0f; }
    bool operator==(const Config&) const = default;
};

/// Returns the preset "paper", "released", "default" or "quick".
/// @throws UsageError for any other name; the message suggests the most similar name
Config make_preset(const std::string& name);

/// Setting: key, current value as text, and explanation.
struct ConfigKey {
    std::string key;
    std::string value;
    std::string help;
    bool expert = false;  ///< True if the setting requires knowledge of the implementation.
};
/// Lists all settings, in the order of the TOML file.
std::vector<ConfigKey> config_keys(const Config& config);

/// Sets a field from text.
/// @throws UsageError for an unknown key (the message suggests the most similar key), or
/// for a value of the wrong type or out of range
void set_key(Config& config, const std::string& key, const std::string& value);

/// Reads a TOML file and overwrites the settings that it contains. A table name is the
/// first part of a key.
/// @throws UsageError as set_key()
/// @throws DataError if the file is missing or malformed
void load_config(Config& config, const std::filesystem::path& path);
/// Reads a file that to_toml() wrote, such as config.toml of a run.
/// @throws DataError if the file is malformed, lacks a setting, or has an unknown setting
Config load_saved_config(const std::filesystem::path& path);

/// Returns all settings as TOML, with explanations as comments. load_saved_config()
/// restores the same values.
std::string to_toml(const Config& config);
/// Returns the settings as TOML without the expert settings that equal the preset.
std::string to_short_toml(const Config& config);

}  // namespace relidar
