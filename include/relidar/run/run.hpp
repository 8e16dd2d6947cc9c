// SPDX-License-Identifier: Apache-2.0
// A run folder is self-describing: config.toml, model.safetensors,
// drop_network.safetensors (where one was trained), sweeps.safetensors (where heads did
// not turn evenly), coverage.safetensors (where the log has looked),
// intensity_scatter.safetensors (how intensities scatter), scene.json (sensor, frames,
// poses, boxes, split, units, conventions), log.jsonl, report.html. It renders without
// the dataset.
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

/// The file of a run folder that holds its surfels.
inline constexpr const char* kModelFile = "model.safetensors";

/// One edit of a run's history.
struct RunEdit {
    std::string run;   ///< absolute path of the run that was edited
    std::string edit;  ///< as typed: "--move 0:0,3.5,0"
};

/// What a run folder holds. The sequence has frames without scans: index, time, nothing
/// else.
struct Run {
    std::filesystem::path folder;
    Config config;
    Sequence sequence;
    Split split;
    Scene scene;
    std::vector<RunEdit> edits{};  ///< oldest first; empty for a run as it was trained
    DropNetwork drop_network{};    ///< corrects ray-drop; empty: there is none
    Coverage coverage{};           ///< where training scans have looked; empty: not known
    std::vector<IntensityScatter> intensity_scatter{};  ///< [lidars] empty: not known
    /// place_held_out() has been asked: what comes behind training is not done twice
    bool held_out_placed = false;
    /// which poses training has corrected, as train.refine_poses says it; empty: none,
    /// they are the log's
    std::string refined_poses{};

    /// The scene with the tracks of its actors, as edits take it and give it back:
    /// run.replace(remove_track(run.driving(), "0")).
    DrivingScene driving() const { return {scene, sequence}; }
    void replace(DrivingScene driving) {
        scene = std::move(driving.scene);
        sequence = std::move(driving.sequence);
    }
};

/// Writes config.toml, scene.json, model.safetensors, drop_network.safetensors,
/// sweeps.safetensors, coverage.safetensors and intensity_scatter.safetensors. A folder
/// that does not exist yet appears complete or not at all. In an existing folder the
/// files get their names only after all of them are written. Until then an earlier run in
/// the folder stays as it is. Blocks of the scene that lie elsewhere are linked into it
/// (copied where the file system has no links), as blocks/NNN/model.safetensors.
/// @throws DataError where the folder cannot be made or written, or where an option that
/// is no setting is not as the program has it
void save_run(const Run& run);
/// Does the same in place of an earlier run. @param remove_earlier  is called when all
/// files are written, before they get their names
void replace_run(const Run& run, const std::function<void()>& remove_earlier);
/// Does the same in place of the run's folder with everything in it, in one step if the
/// file system can exchange folders.
void replace_folder(const Run& run);

/// @throws DataError naming the file that is missing, truncated or inconsistent
Run load_run(const std::filesystem::path& folder);

/// Saves a scene as safetensors: mean [n,3], rotation [n,4], log_scale [n,2],
/// opacity_logit [n], sh [n,3,16], log_scale_w [n] of 3D Gaussians alone; in the metadata
/// the name of the primitive, models and instances. Files of its blocks, which lie below
/// the same folder, are named in the metadata and not written.
/// @throws DataError where an array is misshapen or not finite, or the file cannot be
/// written
void save_model(const std::filesystem::path& path, const Scene& scene);
/// Reads it back. @throws DataError for missing, misshapen or non-finite arrays, naming
/// array and row
Scene load_model(const std::filesystem::path& path);

/// The background of one block. @throws DataError as load_model(), and for a file that
/// does not hold what the scene says
Surfels read_block(const SceneBlock& block);
/// The scene with some of its blocks read into its background, which gets kd order;
/// without the others.
/// @param blocks  positions in Scene::blocks @throws DataError as read_block()
Scene read_blocks(const Scene& scene, const std::vector<std::size_t>& blocks);
/// The same with all of them: for what works on every surfel.
Scene whole_scene(const Scene& scene);

/// Saves a ray-drop network as safetensors, and reads it back. @throws DataError naming
/// file and array, for numbers that are not finite too
void save_drop_network(const std::filesystem::path& path, const DropNetwork& network);
DropNetwork load_drop_network(const std::filesystem::path& path);

/// Models and instances of a scene as JSON text, and back. @param where name used in
/// messages @throws DataError naming the field that is missing or does not fit the
/// scene's surfels
std::string layout_to_json(const Scene& scene);
void read_layout_json(const std::string& text, const std::string& where, Scene& scene);

/// Whether a path looks like a run folder (has a scene.json or a model).
bool is_run(const std::filesystem::path& path);

/// Fails early, before long work: makes the folder and a probe file in it. @throws
/// DataError where that is impossible
void check_writable(const std::filesystem::path& folder);

}  // namespace relidar
