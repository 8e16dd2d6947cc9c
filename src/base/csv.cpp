// SPDX-License-Identifier: Apache-2.0
#include "base/csv.hpp"

#include <algorithm>

#include <fmt/ranges.h>

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

std::vector<int> find_columns(const std::vector<std::string_view>& cells,
                              const std::vector<std::string>& known, const std::string& where) {
    std::vector<int> columns(known.size(), -1);
    for (std::size_t column = 0; column < cells.size(); ++column) {
        const std::string_view name = cells[column];
        const auto match = std::find(known.begin(), known.end(), name);
        if (match == known.end())
            fail("{}: column '{}' is unknown{} (known: {})", where, quote(name),
                 did_you_mean(name, known, "'"), fmt::join(known, ", "));
        int& column_of_name = columns[std::size_t(match - known.begin())];
        if (column_of_name >= 0) fail("{}: column '{}' occurs twice, expected it once", where, name);
        column_of_name = static_cast<int>(column);
    }
    return columns;
}

}  // namespace relidar
