// SPDX-License-Identifier: Apache-2.0
// Reads and writes two files. coverage.safetensors stores the space that the training
// scans of a run have observed. classes.safetensors stores the classes of the background.
// Private to run.
#pragma once

#include <filesystem>

#include <relidar/log/classes.hpp>
#include <relidar/log/coverage.hpp>

namespace relidar::run_detail {

/// Writes the voxels (cells) that the log has observed. `place` [blocks,3] int32 has the
/// position of each block of 8 x 8 x 8 voxels, in blocks. `cells` [blocks,32] uint16 has
/// one bit per voxel. Writes no file if no voxel is observed.
void save_coverage(const std::filesystem::path& path, const ObservedVoxelSet& coverage);
/// Reads a file that describes which space the log of a run has observed.
/// @throws DataError for missing arrays, wrong shapes, or cells of another size
ObservedVoxelSet load_coverage(const std::filesystem::path& path);

/// Writes a class map to a file. The array `place` [cells,3] i4 is the position of each
/// cell, in units of cells. The array `class` [cells,1] u2 has the classes. Writes no
/// file if the map is empty.
void save_class_map(const std::filesystem::path& path, const SurfaceClassMap& class_map);
/// Reads the class map of a run from a file.
/// @throws DataError for missing arrays, wrong shapes, an unknown class, or cells of
/// another size
SurfaceClassMap load_class_map(const std::filesystem::path& path);

}  // namespace relidar::run_detail
