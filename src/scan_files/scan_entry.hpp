// SPDX-License-Identifier: Apache-2.0
// What scans.json says of one scan.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/render.hpp>

namespace relidar::scan_files {

/// @param frame  its number @param files  names in the folder @return a JSON object
std::string entry_json(int frame, const RenderedScan& scan, std::size_t n_points, const std::vector<std::string>& files);

}  // namespace relidar::scan_files
