// SPDX-License-Identifier: Apache-2.0
// Every choice of a run, one field each, so that each ablation of the paper is one
// `--set`. Keys are the field names below, joined by a dot: `loss.depth`, `init.voxel_m`.
// A field that `relidar list settings --all` does not list is a constant: the preset sets
// it, and a run with another value cannot be saved.
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
    std::string path;  ///< dataset as given on the command line
    /// which drive of a dataset that holds several, by its own name; empty: the only one,
    /// or the first
    std::string sequence;
    std::string lidars;  ///< names of those that are read, separated by commas; empty: all
    int frames_begin = 0;
    int frames_end = -1;  ///< -1: to the last
    int test_every = 10;
    /// numbers of the frames held out, with ranges: "13,26,40:45"; empty: test_every
    /// decides
    std::string test_frames;
    std::string poses;  ///< file with 12 numbers a line; empty = the dataset's own; kNoPoses = none at all
    /// of a ROS bag: the frame, or the topic, that poses are taken from; empty: guessed
    std::string poses_from;
    bool skip_broken = false;
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    /// what becomes of Waymo's, which have no upper end: "tanh", or "clamp" at 1
    std::string waymo_intensity = "tanh";
    /// for scans; what goes beyond lies in a mapped file. 0: half of what the machine has
    int memory_mib = 0;
    bool operator==(const DatasetConfig&) const = default;
};

/// Which scans have a rolling shutter: each ray starts at the sensor's pose at the ray's
/// firing time, not at the scan's time.
///   automatic  scans of other sensors than the log's, and of the log's sensors unless the log is motion-compensated
///   yes        all rendered scans; training and scores do the same as with automatic
///   no         no scan; scans of the log are read without it
enum class RollingShutter { automatic, yes, no };

struct SensorConfig {
    std::string grid = "native";  ///< "native" or "kitti360": the image that is rendered and scored
    /// "project": simulate the native scan and bin its points as the real ones were;
    /// "cast": rays through cell centres
    std::string grid_method = "project";
    RollingShutter rolling_shutter = RollingShutter::automatic;
    /// "none", "range", "intensity", "range,intensity": what is found of each beam before
    /// training, see calibrate_ranges() and calibrate_intensity()
    std::string calibrate = "none";
    /// rays cast for each one that is simulated, over the footprint of its beam: 1, 5 or
    /// 9
    int sub_rays = 1;
    double divergence_mrad = 0.0;  ///< full beam divergence of the simulated sensor; 0: the sensor's own
    /// simulated for each ray, 1 or 2; 2: the strongest and the last, with sub_rays of 5
    /// or 9
    int returns = 1;
    double return_separation_m = 0.5;  ///< surfaces nearer to each other than this are one return

    /// @param what  "range" or "intensity"
    bool calibrates(const char* what) const { return calibrate.find(what) != std::string::npos; }
    bool operator==(const SensorConfig&) const = default;
};

struct TrainConfig {
    int iterations = 30000;
    /// what a frame is: "native", the rays fired, or "kitti360", an image of cells
    /// (published results)
    std::string grid = "native";
    int rays_per_iteration = 0;     ///< 0 = all rays of one frame (paper)
    int sh_degree_start = 0;        ///< active from the first iteration
    int sh_degree_interval = 1000;  ///< +1 degree this often
    double mean_rate = 1.6e-4;      ///< times the extent
    double mean_rate_final = 1.6e-6;
    double rotation_rate = 1e-3;
    double scale_rate = 5e-3;
    /// surfels grow to so many times the standard deviation that they began with (paper:
    /// without end)
    double max_growth = 1000.0;
    double opacity_rate = 0.05;
    double sh_rate = 2.5e-3;
    /// rates of the intensity's coefficients over those of the drop logits (1 = paper)
    double intensity_factor = 1.0;
    /// all rates but the mean's end at this share of their start, exponentially (1 =
    /// paper)
    double rate_decay = 1.0;
    bool only_touched = false;   ///< Adam leaves surfels without a gradient in this batch alone
    bool deterministic = false;  ///< bit-equal parameters from run to run on one device
    /// learn what the sensor itself never sees apart from the scene (stands in for the
    /// paper's U-Net)
    bool sensor_drop = false;
    /// "none", "sensor", "actors", "sensor,actors": poses that are optimised with the
    /// scene
    std::string refine_poses = "none";
    /// refined poses start from a registration of the scans, before the scene is
    /// initialised
    bool pose_register = true;
    bool place_held_out = true;     ///< registered held-out scans are placed once more, on the trained scene
    bool allow_lost_scans = false;  ///< train on, however many scans did not find their place
    /// of the sensor's translations, at the start; its turns and actors' boxes follow it
    double pose_rate_m = 2e-4;
    /// device memory for rays that stay there; those of further frames come when it is
    /// their turn
    int frame_memory_mib = 2048;
    int log_every = 50;
    int checkpoint_every = 0;          ///< iterations between checkpoints; 0 = by time alone
    double checkpoint_minutes = 10.0;  ///< minutes between checkpoints; 0 = by iterations alone
    std::uint64_t seed = 1;

    /// @param poses  "sensor" or "actors"
    bool refines(const char* poses) const { return refine_poses.find(poses) != std::string::npos; }
    bool operator==(const TrainConfig&) const = default;
};

/// A long log is trained in blocks, each a stretch of the trajectory with the sweeps that
/// see it.
struct BlockConfig {
    /// of the trajectory of the sensor, a block, at most; 0 = the log is trained in one
    /// piece
    double length_m = 0.0;
    double halo_m = 40.0;  ///< sweeps that were taken so near to a block are trained on with it
    /// so often every training frame teaches the actors before the joined background; 0 =
    /// not
    int actor_epochs = 4;
    bool operator==(const BlockConfig&) const = default;
};

struct RenderConfig {
    /// "expected" (D, paper), "normalised" (D / W), "median" or "mode": of range images
    std::string range = "normalised";
    /// the log's LiDAR, at the time of one of its sweeps, points where its head did
    bool follow_sweeps = false;
    /// that scans have beside the basic ones: names of optional_channels(), separated by
    /// commas
    std::string channels;
    /// range of the points of point clouds: "median", the dominant surface, or "range",
    /// as above
    std::string points = "median";
    int memory_mib = 1024;  ///< device memory for blocks of a long scene beyond those that a scan needs
    bool operator==(const RenderConfig&) const = default;
};

struct TraceConfig {
    int chunk = 16;
    /// hits a ray that the forward pass keeps for the backward pass, at first: doubled up
    /// to 256 while any ray has more; 0 = cast every ray again (paper)
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

    /// Whether a loss compares neighbouring pixels: steps then see windows of columns in
    /// the place of groups of columns from all around.
    bool needs_images() const { return loss.intensity * loss.intensity_ssim > 0.0f; }
    bool operator==(const Config&) const = default;
};

/// The named preset: "paper", "released", "default" or "quick". @throws UsageError for
/// another name, naming the nearest
Config make_preset(const std::string& name);

/// A key with its present value as text and what it means.
struct ConfigKey {
    std::string key;
    std::string value;
    std::string help;
    bool expert = false;  ///< nobody needs it who does not know how the program works inside
};
/// All settings, in the order of the TOML file.
std::vector<ConfigKey> config_keys(const Config& config);

/// Sets one field from text.
/// @throws UsageError for an unknown key (the message names the nearest known one), or
/// for a value of the wrong kind or out of range
void set_key(Config& config, const std::string& key, const std::string& value);

/// Reads a TOML file over `config`: tables are the first part of a key.
/// @throws UsageError as set_key, DataError for a malformed or missing file
void load_config(Config& config, const std::filesystem::path& path);
/// Reads a file that to_toml() wrote, as config.toml of a run.
/// @throws DataError if the file is malformed, lacks a setting, or names an unknown one
Config load_saved_config(const std::filesystem::path& path);

/// Every value used, as TOML with its help as comments; load_saved_config() reads it back
/// to the same values.
std::string to_toml(const Config& config);
/// The same without those expert settings that are as the preset has them.
std::string to_short_toml(const Config& config);

}  // namespace relidar
