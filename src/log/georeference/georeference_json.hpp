// SPDX-License-Identifier: Apache-2.0
// Georeference of a log in scene.json and sequence.json.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include <relidar/log/georeference.hpp>

namespace relidar {

class JsonField;

nlohmann::ordered_json georeference_json(const Georeference& georeference);
Georeference read_georeference(const JsonField& field);

}  // namespace relidar
