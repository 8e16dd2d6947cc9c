// SPDX-License-Identifier: Apache-2.0
// Parses comma-separated values with a header line that names the columns.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Splits a line at its commas and removes blanks at both ends of each cell. Returns at
/// least one cell.
std::vector<std::string_view> split_csv_cells(std::string_view line);

/// Returns the index of each known column in the header, or -1 if the column is missing.
/// @param location_for_errors file and line of the header, for error messages
/// @throws DataError for an unknown column. Otherwise the values of a misspelt column
/// would be read as 0. The message suggests the most similar name
/// @throws DataError for a duplicate column
std::vector<int> find_column_indices(const std::vector<std::string_view>& header_cells,
                                     const std::vector<std::string>& known_columns,
                                     const std::string& location_for_errors);

}  // namespace relidar
