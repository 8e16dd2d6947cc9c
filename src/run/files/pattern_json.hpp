// SPDX-License-Identifier: Apache-2.0
// Scan patterns of LiDARs that do not spin, as stored in scene.json. Private to run.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include <relidar/log/sensor.hpp>

namespace relidar {
class JsonField;
}

namespace relidar::run_detail {

nlohmann::ordered_json pattern_json(const FixedPattern& pattern);
/// Reads a scan pattern.
/// @throws DataError naming the field that is wrong
FixedPattern read_pattern(const JsonField& field);

}  // namespace relidar::run_detail
