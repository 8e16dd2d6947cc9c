// SPDX-License-Identifier: Apache-2.0
// Reads and writes run folders, which contain a trained scene. A run can be rendered
// without its dataset. The comment of Run lists the files of a run folder.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/diff/network.hpp>
#include <relidar/log/classes.hpp>
#include <relidar/log/coverage.hpp>
#include <relidar/log/log.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

inline constexpr const char* kModelFile = "model.safetensors";

struct EditHistoryEntry {
    std::string run;   ///< Absolute path of the run that was edited.
    std::string edit;  ///< Edit as it was typed on the command line, for example "--move 0:0,3.5,0".
};

/// Contents of a run folder. The folder stores the index and the time of each frame, but
/// not its scan. The files are:
///
///   config.toml                    settings
///   model.safetensors              surfels
///   drop_network.safetensors       ray-drop network, if one was trained
///   sweeps.safetensors             head rotation of sweeps with uneven rotation
///   coverage.safetensors           space that the log has observed
///   classes.safetensors            classes of the background; with labelled points only
///   intensity_scatter.safetensors  scatter of measured intensities
///   scene.json                     sensor, frames, poses, boxes, split, units
///   log.jsonl, report.html         training log and report
struct Run {
    std::filesystem::path folder;
    Config config;
    Log log;
    Split split;
    Scene scene;
    std::vector<EditHistoryEntry> edits{};  ///< Edit history, oldest first. Empty for a run without edits.
    /// Network that corrects drop probabilities. Empty if no network was trained.
    RayDropNetwork drop_network{};
    ObservedVoxelSet coverage{};  ///< Space that the training scans have observed. Empty if unknown.
    /// In relidar's world frame. Empty if the log has no labelled points.
    SurfaceClassMap classes{};
    /// [lidars]; empty if unknown
    std::vector<IntensityScatterModel> intensity_scatter{};
    /// Held-out scans were aligned with the trained scene. Resumed training skips this
    /// step.
    bool held_out_placed = false;
    /// In the format of train.refine_poses. Empty if all poses are those of the log.
    std::string refined_poses{};

    /// Returns the scene and its log as one object for edit functions. Example:
    /// run.set_driving_scene(remove_track(run.driving_scene(), "0")).
    SceneWithLog driving_scene() const { return {scene, log}; }
    /// Replaces scene and log. Completes actors whose tracks differ from those of this
    /// run (complete_actors()).
    void set_driving_scene(SceneWithLog driving_scene);
};

/// Writes settings, scene, network and all other files of a run. A new folder appears
/// only when it is complete. In an existing folder, all new files are first written under
/// temporary names and then renamed. Block files in other folders are hard-linked to
/// blocks/NNN/model.safetensors, or copied.
/// @throws DataError if the folder cannot be created or written, or if an option that is
/// not a setting differs from its preset value
void save_run(const Run& run);
/// Writes a run like save_run() into a folder that contains an earlier run.
/// @param remove_earlier_files called after all new files are written under temporary
/// names and before they get their final names
void overwrite_run(const Run& run, const std::function<void()>& remove_earlier_files);
/// Writes a run and deletes everything else in the folder. The operation is atomic if the
/// file system can exchange two folders.
void replace_run(const Run& run);

/// Loads the log that config.dataset describes. Uses a rolling shutter if config.sensor
/// enables it. config.dataset.memory_mib is not used: call
/// limit_scan_memory() before.
/// @param max_scans maximum number of scans, as in DatasetOptions::max_scans
/// @throws errors of load_log()
Log load_log(const Config& config, const Progress& progress = {}, int max_scans = 0);

/// Loads a run folder.
/// @throws DataError naming the file that is missing, truncated or inconsistent
Run load_run(const std::filesystem::path& folder);

/// Saves a scene as safetensors: mean [n,3], rotation [n,4], log_scale [n,2],
/// opacity_logit [n], sh [n,3,16], and for 3D Gaussians log_scale_w [n]. The metadata
/// contain the primitive, the models, the instances and the files of the blocks, which
/// must be in or below the same folder and are not written.
/// @throws DataError if an array has the wrong shape or a value that is not finite, or if
/// the file cannot be written
void save_model(const std::filesystem::path& path, const Scene& scene);
/// Loads a scene from a file of save_model().
/// @throws DataError naming array and row if an array is missing, has the wrong shape, or
/// has a value that is not finite
Scene load_model(const std::filesystem::path& path);

/// Loads the background surfels of a block from its file.
/// @throws DataError if the file is invalid or its number of surfels differs from `block`
Surfels load_block(const SceneBlock& block);
/// Returns the scene with the surfels of the selected blocks in its background, in
/// kd-tree order. Other blocks are left out.
/// @param block_indices indices in Scene::blocks
/// @throws DataError if a block file is invalid
Scene with_blocks(const Scene& scene, const std::vector<std::size_t>& block_indices);
/// Returns the scene with the surfels of all blocks, for functions that need every
/// surfel.
Scene with_all_blocks(const Scene& scene);

/// Saves a ray-drop network as a safetensors file.
void save_drop_network(const std::filesystem::path& path, const RayDropNetwork& network);
/// @throws DataError naming file and array, also for numbers that are not finite
RayDropNetwork load_drop_network(const std::filesystem::path& path);

/// Returns the models and instances of a scene as JSON.
std::string format_layout(const Scene& scene);
/// Reads the models and instances of a scene that already has its surfels.
/// @param where name of the text in error messages
/// @throws DataError naming a field that is missing or does not match the surfels
void parse_layout(const std::string& text, const std::string& where, Scene& scene);

/// Returns true if a path looks like a run folder: it contains a scene.json or a model
/// file.
bool is_run_folder(const std::filesystem::path& path);

/// Creates a folder and a test file in it, to report an unwritable folder before long
/// work.
/// @throws DataError if the folder or the file cannot be created
void prepare_folder(const std::filesystem::path& folder);

}  // namespace relidar
