// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <relidar/run/run.hpp>

namespace relidar::files {

/// @throws DataError if the sequence is inconsistent or not finite
std::string format_scene(const Run& run);

struct SceneJsonContents {
    Log sequence;  ///< frames without scans
    Split split;
    std::vector<EditHistoryEntry> edits;
    bool held_out_placed = false;
    std::string refined_poses;
    std::size_t n_surfels = 0;
};
/// @param name  name of the file in error messages
/// @throws DataError naming the file and the field
SceneJsonContents parse_scene(const std::string& json_text, const std::string& name);

}  // namespace relidar::files
