// SPDX-License-Identifier: Apache-2.0
// coverage.safetensors: space that the training scans have observed. classes.safetensors:
// classes of the background. Private to run.
#pragma once

#include <filesystem>

#include <relidar/log/classes.hpp>
#include <relidar/log/coverage.hpp>

namespace relidar::files {

/// `place` [blocks,3] int32 is the position of each block of 8 x 8 x 8 voxels, in blocks.
/// `cells` [blocks,32] uint16 has one bit per voxel. Writes no file if no voxel is
/// observed.
void save_coverage(const std::filesystem::path& path, const ObservedVoxelSet& coverage);
/// @throws DataError for missing arrays, wrong shapes, or cells of another size
ObservedVoxelSet load_coverage(const std::filesystem::path& path);

/// `place` [cells,3] i4 is the position in units of cells, `class` [cells,1] u2 the
/// class. Writes no file if the map is empty.
void save_class_map(const std::filesystem::path& path, const SurfaceClassMap& class_map);
/// @throws DataError for missing arrays, wrong shapes, an unknown class, or cells of
/// another size
SurfaceClassMap load_class_map(const std::filesystem::path& path);

}  // namespace relidar::files
