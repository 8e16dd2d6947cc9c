// SPDX-License-Identifier: Apache-2.0
// Lines of numbers parted by commas, under a header that names their columns.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Cells of a line, without blanks at their ends; at least one.
std::vector<std::string_view> csv_cells(std::string_view line);

/// Where the header has each known column, -1 where it is missing. @param where  of the
/// header: file and line
/// @throws DataError for a column that is not known, naming the nearest, since a misspelt
/// one would be 0; or there twice
std::vector<int> find_columns(const std::vector<std::string_view>& header,
                              const std::vector<std::string>& known, const std::string& where);

}  // namespace relidar
