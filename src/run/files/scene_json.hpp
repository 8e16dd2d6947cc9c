// SPDX-License-Identifier: Apache-2.0
// scene.json: the log behind a run without its scans. Private to run.
#pragma once

#include <string>

#include <relidar/run/run.hpp>

namespace relidar::run_detail {

/// Sequence and split as JSON text. @throws DataError where the sequence is inconsistent
/// or not finite
std::string to_scene_json(const Run& run);

/// What a scene.json says.
struct SceneFile {
    Sequence sequence;  ///< frames without scans
    Split split;
    std::vector<RunEdit> edits;
    bool held_out_placed = false;
    std::string refined_poses;
    std::size_t n_surfels = 0;
};
/// @param file name used in messages @throws DataError naming file and field
SceneFile parse_scene_json(const std::string& text, const std::string& file);

}  // namespace relidar::run_detail
