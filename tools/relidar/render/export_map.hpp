// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

#include "options.hpp"

namespace relidar::cli {

struct MapOptions {
    std::string run, file;
    double spacing_m = 0.05;
    std::optional<std::string> frames;
    DeviceCommandOptions device;
    bool quiet = false;
};

/// Renders the background at the poses of the log's LiDARs and writes all points as one
/// file: the mean point of each cell of a grid in the dataset's world.
/// @throws UsageError if the file has an unknown ending, or for a wrong spacing
void export_map(const MapOptions& options);

}  // namespace relidar::cli
