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
    std::vector<int> at(known.size(), -1);
    for (std::size_t c = 0; c < cells.size(); ++c) {
        const auto f =
            static_cast<std::size_t>(std::find(known.begin(), known.end(), cells[c]) - known.begin());
        if (f == known.size()) {
            fail("{}: column '{}' is unknown{} (known: {})", where, quote(cells[c]),
                 did_you_mean(cells[c], known, "'"), fmt::join(known, ", "));
        }
        if (at[f] >= 0) fail("{}: column '{}' occurs twice, expected it once", where, cells[c]);
        at[f] = static_cast<int>(c);
    }
    return at;
}

}  // namespace relidar
