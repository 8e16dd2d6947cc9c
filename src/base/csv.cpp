// SPDX-License-Identifier: Apache-2.0
#include "base/csv.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include "base/files.hpp"

namespace relidar {

std::vector<std::string_view> split_csv_cells(std::string_view line) {
    std::vector<std::string_view> cells;
    for (std::size_t begin = 0; begin <= line.size();) {
        const std::size_t end = std::min(line.find(',', begin), line.size());
        cells.push_back(trim_spaces(line.substr(begin, end - begin)));
        begin = end + 1;
    }
    return cells;
}

std::vector<int> find_columns(const std::vector<std::string_view>& header,
                              const std::vector<std::string>& known_names, const std::string& location) {
    std::vector<int> at(known_names.size(), -1);
    for (std::size_t c = 0; c < header.size(); ++c) {
        const auto f = static_cast<std::size_t>(std::find(known_names.begin(), known_names.end(), header[c]) -
                                                known_names.begin());
        if (f == known_names.size()) {
            throw DataError(fmt::format("{}: column '{}' is unknown{} (known: {})", location,
                                        make_excerpt(header[c]), suggest_name(header[c], known_names, "'"),
                                        fmt::join(known_names, ", ")));
        }
        if (at[f] >= 0)
            throw DataError(
                fmt::format("{}: column '{}' occurs twice, expected it once", location, header[c]));
        at[f] = static_cast<int>(c);
    }
    return at;
}

}  // namespace relidar
