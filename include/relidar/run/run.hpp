// SPDX-License-Identifier: Apache-2.0
// Reads and writes run folders. A run can be rendered without its dataset. Its folder
// contains:
//
//   config.toml                    settings
//   model.safetensors              surfels
//   drop_network.safetensors       ray-drop network, if one was trained
//   sweeps.safetensors             head rotation of sweeps with uneven rotation
//   coverage.safetensors           space that the log has observed
//   intensity_scatter.safetensors  scatter of measured intensities
//   scene.json                     sensor, frames, poses, boxes, split, units, conventions
//   log.jsonl, report.html         training log and report
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <relidar/diff/network.hpp>
#include <relidar/log/coverage.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// File of a run folder that contains the surfels.
inline constexpr const char* kModelFile = "model.safetensors";

/// Entry in the edit history of a run.
struct RunEdit {
    std::string run;   ///< Absolute path of the run that was edited.
    std::string edit;  ///< Edit as typed on the command line: "--move 0:0,3.5,0".
};

/// Contents of a run folder. Frames of the sequence have an index and a time, but no
/// scan.
struct Run {
    std::filesystem::path folder;
    Config config;
    Sequence sequence;
    Split split;
    Scene scene;
    std::vector<RunEdit> edits{};  ///< Edit history, oldest first; empty for a run that was not edited.
    DropNetwork drop_network{};    ///< Network that corrects drop probabilities; empty if none was trained.
    Coverage coverage{};           ///< Space that the training scans have observed; empty if unknown.
    /// Intensity scatter of each LiDAR, [lidars]; empty if unknown.
    std::vector<IntensityScatter> intensity_scatter{};
    /// True if place_held_out() has run, so that a resumed training does not repeat it.
    bool held_out_placed = false;
    /// Poses that training has corrected, in the format of train.refine_poses. Empty if
    /// all poses are those of the log.
    std::string refined_poses{};

    /// Returns the scene with the tracks of its actors. Edits use this type:
    /// run.replace(remove_track(run.driving(), "0")).
    DrivingScene driving() const { return {scene, sequence}; }
    void replace(DrivingScene driving) {
        scene = std::move(driving.scene);
        sequence = std::move(driving.sequence);
    }
};

/// Writes config.toml, scene.json, model.safetensors, drop_network.safetensors,
/// sweeps.safetensors, coverage.safetensors and intensity_scatter.safetensors. A new
/// folder appears only when it is complete. In an existing folder, all files are written
/// first and then renamed, so that an earlier run stays valid until then. Block files in
/// other folders are hard-linked to blocks/NNN/model.safetensors, or copied if the file
/// system has no links.
/// @throws DataError if the folder cannot be created or written, or if an option that is
/// not a setting differs from its preset value
void save_run(const Run& run);
/// Writes a run as save_run() does, in place of an earlier run.
/// @param remove_earlier called after all files are written and before they are renamed
void replace_run(const Run& run, const std::function<void()>& remove_earlier);
/// Writes a run as save_run() does, and replaces the existing folder with all its
/// contents. The replacement is atomic if the file system can exchange folders.
void replace_folder(const Run& run);

/// Loads a run folder.
/// @throws DataError naming the file that is missing, truncated or inconsistent
Run load_run(const std::filesystem::path& folder);

/// Saves a scene as safetensors: mean [n,3], rotation [n,4], log_scale [n,2],
/// opacity_logit [n], sh [n,3,16], and for 3D Gaussians log_scale_w [n]. The metadata
/// contain the name of the primitive, the models and the instances. They also list the
/// files of the scene's blocks, which must be in or below the same folder and are not
/// written.
/// @throws DataError if an array has the wrong shape or a value that is not finite, or if
/// the file cannot be written
void save_model(const std::filesystem::path& path, const Scene& scene);
/// Loads a scene that save_model() wrote.
/// @throws DataError naming array and row if an array is missing, has the wrong shape, or
/// has a value that is not finite
Scene load_model(const std::filesystem::path& path);

/// Loads the background surfels of a block.
/// @throws DataError as load_model(), or if the number of surfels differs from `block`
Surfels read_block(const SceneBlock& block);
/// Returns a copy of the scene with the selected blocks loaded into its background, which
/// is sorted in kd order. The copy does not refer to the other blocks.
/// @param blocks indices in Scene::blocks
/// @throws DataError as read_block()
Scene read_blocks(const Scene& scene, const std::vector<std::size_t>& blocks);
/// Returns a copy of the scene with all blocks loaded, for functions that need every
/// surfel.
Scene whole_scene(const Scene& scene);

/// Saves a ray-drop network as safetensors, and loads it.
/// @throws DataError naming file and array, also for numbers that are not finite
void save_drop_network(const std::filesystem::path& path, const DropNetwork& network);
DropNetwork load_drop_network(const std::filesystem::path& path);

/// Converts models and instances of a scene to JSON text, and reads them back.
/// @param where name of the source in messages
/// @throws DataError naming the field that is missing or does not match the surfels of
/// the scene
std::string layout_to_json(const Scene& scene);
void read_layout_json(const std::string& text, const std::string& where, Scene& scene);

/// Returns true if a path looks like a run folder (it has a scene.json or a model).
bool is_run(const std::filesystem::path& path);

/// Creates the folder and a test file in it, so that an unwritable folder is reported
/// before long work starts.
/// @throws DataError if the folder or the file cannot be created
void check_writable(const std::filesystem::path& folder);

}  // namespace relidar
