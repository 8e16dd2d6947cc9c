// SPDX-License-Identifier: Apache-2.0
// Files of a run folder except the settings, the model and the ray-drop network. No
// function writes a file that would be empty; it removes the file of an earlier save
// instead. Private to run.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/run/run.hpp>

namespace relidar::files {

struct SceneJsonContents {
    Log log;  ///< frames without scans
    Split split;
    std::vector<EditHistoryEntry> edits;
    bool held_out_placed = false;
    std::string refined_poses;
    std::size_t n_surfels = 0;
};
/// Returns the text of scene.json: the log of a run without scans, its split and edits.
/// @throws DataError if the log is inconsistent or not finite
std::string format_scene(const Run& run);
/// Reads the text of scene.json. All sections except the basic ones are optional.
/// @throws DataError naming the file and the field
SceneJsonContents parse_scene(const std::string& json_text, const std::string& file_name);

// The functions that load the following files throw a DataError for missing arrays, wrong
// shapes and values that are not possible.

/// sweeps.safetensors has Frame::azimuth_shift_rad: an array [columns] f4 for each frame
/// with shifts, named by the index of the frame in scene.json.
void save_azimuths(const std::filesystem::path& path, const Log& log);
void load_azimuths(const std::filesystem::path& path, Log& log);

/// own_body.safetensors has Lidar::own_body: `0.range_m` and `0.intensity` [cells] f4 for
/// LiDAR 0, empty without a body.
void save_bodies(const std::filesystem::path& path, const std::vector<Lidar>& lidars);
void load_bodies(const std::filesystem::path& path, std::vector<Lidar>& lidars);

/// Writes coverage.safetensors, unless the coverage is empty. `place` [blocks,3] i4 is
/// the position of each block of 8 x 8 x 8 voxels, in blocks. `cells` [blocks,32] u2 has
/// one bit per voxel.
void save_coverage(const std::filesystem::path& path, const ObservedVoxelSet& coverage);
ObservedVoxelSet load_coverage(const std::filesystem::path& path);

/// Writes classes.safetensors, unless the map is empty. `place` [cells,3] i4 is the
/// position in units of cells, `class` [cells,1] u2 the class.
void save_class_map(const std::filesystem::path& path, const SurfaceClassMap& class_map);
SurfaceClassMap load_class_map(const std::filesystem::path& path);

/// The decision tree of LiDAR 0 is `0.feature`, `0.child`, `0.first`, `0.count` [nodes]
/// i4 and `0.at` [nodes] f4. The other arrays are `0.values` [returns] f4 and `0.step`
/// [1] f8. A LiDAR without a model has no arrays.
void save_scatter(const std::filesystem::path& path, const std::vector<IntensityScatterModel>& scatter);
std::vector<IntensityScatterModel> load_scatter(const std::filesystem::path& path, std::size_t n_lidars);

}  // namespace relidar::files
