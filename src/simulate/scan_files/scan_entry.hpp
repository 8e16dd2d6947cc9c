// SPDX-License-Identifier: Apache-2.0
// What scans.json says of one scan, and what is in the way of a new rendering.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/simulate/render.hpp>

namespace relidar::scan_files {

/// @param frame  its number @param files  names in the folder @return a JSON object
std::string entry_json(int frame, const RenderedScan& scan, std::size_t n_points,
                       const std::vector<std::string>& files);

/// Removes an earlier rendering from a folder, and what a killed one left half written.
/// @throws DataError for a file that cannot be removed
void remove_scans(const std::filesystem::path& folder);

}  // namespace relidar::scan_files
