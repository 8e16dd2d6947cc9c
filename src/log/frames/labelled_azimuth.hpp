// SPDX-License-Identifier: Apache-2.0
// Log::labelled_azimuth of datasets whose labels end where a camera does, and in files.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include <relidar/log/log.hpp>

namespace relidar {

class JsonField;

nlohmann::ordered_json azimuths_json(const AzimuthInterval& azimuths);
/// @throws DataError unless the field has two angles in ascending order
AzimuthInterval read_azimuths(const JsonField& field);

}  // namespace relidar
