// SPDX-License-Identifier: Apache-2.0
// A camera in JSON: in files of the user, scene.json and scans.json.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include <relidar/log/camera.hpp>

namespace relidar {

class JsonField;

/// Returns the object that read_camera() reads, with a quaternion.
nlohmann::ordered_json camera_json(const Camera& camera);
/// Reads the object of parse_camera().
Camera read_camera(const JsonField& root);

}  // namespace relidar
