// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/scatter.hpp>

namespace relidar::files {

/// The decision tree of LiDAR 0 is `0.feature`, `0.child`, `0.first`, `0.count` [nodes]
/// i4 and `0.at` [nodes] f4. The other arrays are `0.values` [returns] f4 and `0.step`
/// [1] f8. A LiDAR without a model has no arrays. If no LiDAR has a model, no file is
/// written.
void save_scatter(const std::filesystem::path& path, const std::vector<IntensityScatterModel>& scatter);
/// @param n_lidars  number of LiDARs of the log
/// @throws DataError for missing arrays, wrong shapes, or nodes that do not form a tree
std::vector<IntensityScatterModel> load_scatter(const std::filesystem::path& path, std::size_t n_lidars);

}  // namespace relidar::files
