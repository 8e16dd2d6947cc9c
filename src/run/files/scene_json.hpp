// SPDX-License-Identifier: Apache-2.0
// Reads and writes scene.json, which stores the log of a run without its scans. Private
// to run.
#pragma once

#include <string>

#include <relidar/run/run.hpp>

namespace relidar::run_detail {

/// Converts the log of a run and its split into training and test frames to JSON text.
/// @throws DataError if the sequence is inconsistent or not finite
std::string format_scene_json(const TrainedRun& run);

/// Contents of scene.json.
struct SceneJsonContents {
    LidarSequence sequence;  ///< frames without scans
    TrainTestSplit split;
    std::vector<EditHistoryEntry> edits;
    bool held_out_placed = false;
    std::string refined_poses;
    std::size_t n_surfels = 0;
};
/// Parses the text of scene.json.
/// @param file_name  name of the file in error messages
/// @throws DataError if the text is invalid; the message names the file and the field
SceneJsonContents parse_scene_json(const std::string& json_text, const std::string& file_name);

}  // namespace relidar::run_detail
