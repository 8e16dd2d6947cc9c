// SPDX-License-Identifier: Apache-2.0
// Reads and writes scene.json, which stores the log of a run without its scans. Private
// to run.
#pragma once

#include <string>

#include <relidar/run/run.hpp>

namespace relidar::files {

/// @throws DataError if the sequence is inconsistent or not finite
std::string format_scene_json(const TrainedRun& run);

struct SceneJsonContents {
    LidarSequence sequence;  ///< frames without scans
    TrainTestSplit split;
    std::vector<EditHistoryEntry> edits;
    bool held_out_placed = false;
    std::string refined_poses;
    std::size_t n_surfels = 0;
};
/// @param file_name  name of the file in error messages
/// @throws DataError naming the file and the field
SceneJsonContents parse_scene_json(const std::string& json_text, const std::string& file_name);

}  // namespace relidar::files
