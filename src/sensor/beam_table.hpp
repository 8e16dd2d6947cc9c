// SPDX-License-Identifier: Apache-2.0
// CSV beam tables: one line a beam from the highest down, columns found by their header name, missing ones 0.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/sensor.hpp>

namespace relidar {

/// A beam table as named on the command line: "path[:columns[xHz]]".
struct BeamTableName {
    std::filesystem::path path;
    int columns = 1800;  ///< 0.2 degrees a step
    double rate_hz = 10.0;
};

/// Splits the suffix off. @throws UsageError for zero columns or a rate that is not positive
BeamTableName parse_beam_table_name(const std::string& name);

/// Reads the table. @throws DataError naming the line and the value that is wrong
SpinningSensor read_beam_table(const BeamTableName& name);

}  // namespace relidar
