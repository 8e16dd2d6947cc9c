// SPDX-License-Identifier: Apache-2.0
// Beam tables that come with the library (src/sensor/tables, embedded by cmake/SensorTables.cmake).
#pragma once

#include <map>
#include <string>

namespace relidar {

/// Text of each table by the name of its sensor. Its first line begins with # and says where the figures are from.
const std::map<std::string, std::string>& sensor_tables();

}  // namespace relidar
