// SPDX-License-Identifier: Apache-2.0
// Parses comma-separated values with a header line that names the columns.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace relidar {

std::vector<std::string_view> split_csv_cells(std::string_view line);

/// Returns the index of each known column in a header line, or -1 for a missing column.
/// @param cells  names in the header line of the file
/// @param where  file and line, for messages
/// @throws DataError for an unknown column, because the values of a misspelt column would
/// otherwise be read as 0, and for a column that occurs twice
std::vector<int> find_columns(const std::vector<std::string_view>& cells,
                              const std::vector<std::string>& known, const std::string& where);

}  // namespace relidar
