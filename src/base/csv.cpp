// SPDX-License-Identifier: Apache-2.0
#include "base/csv.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {

std::vector<std::string_view> split_csv_cells(std::string_view line) {
    std::vector<std::string_view> cells;
    for (std::size_t begin = 0; begin <= line.size();) {
        const std::size_t end = std::min(line.find(',', begin), line.size());
        cells.push_back(trim(line.substr(begin, end - begin)));
        begin = end + 1;
    }
    return cells;
}

std::vector<int> find_columns(const std::vector<std::string_view>& header_cells,
                              const std::vector<std::string>& known_columns,
                              const std::string& location_for_errors) {
    std::vector<int> at(known_columns.size(), -1);
    for (std::size_t c = 0; c < header_cells.size(); ++c) {
        const auto f = static_cast<std::size_t>(
            std::find(known_columns.begin(), known_columns.end(), header_cells[c]) - known_columns.begin());
        if (f == known_columns.size()) {
            fail("{}: column '{}' is unknown{} (known: {})", location_for_errors, quote(header_cells[c]),
                 did_you_mean(header_cells[c], known_columns, "'"), fmt::join(known_columns, ", "));
        }
        if (at[f] >= 0)
            fail("{}: column '{}' occurs twice, expected it once", location_for_errors, header_cells[c]);
        at[f] = static_cast<int>(c);
    }
    return at;
}

}  // namespace relidar
