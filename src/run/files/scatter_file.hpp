// SPDX-License-Identifier: Apache-2.0
// intensity_scatter.safetensors: how the intensities of a run's LiDARs scatter. Private
// to run.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/scatter.hpp>

namespace relidar::run_detail {

/// For each LiDAR, by its number in Sequence::lidars: arrays `0.feature`, `0.child`,
/// `0.first`, `0.count` [nodes] i4 and `0.at` [nodes] f4, its tree; `0.values` [returns]
/// f4; `0.step` [1] f8. One of which nothing is known has none. Nothing known of any: no
/// file.
void save_scatter(const std::filesystem::path& path, const std::vector<IntensityScatter>& scatter);
/// @param n_lidars  of the log @throws DataError for arrays that are missing or
/// misshapen, and for what is no tree
std::vector<IntensityScatter> load_scatter(const std::filesystem::path& path, std::size_t n_lidars);

}  // namespace relidar::run_detail
