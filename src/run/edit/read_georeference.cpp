// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/georeference/georeference_json.hpp"

namespace relidar {
namespace {

/// Fits the path of the vehicle to the positions of a CSV file. Ignores other columns.
GeoreferenceFit fit_fixes(const std::string& file, const Log& log) {
    constexpr std::array kNames{"time_s", "latitude_deg", "longitude_deg", "height_m"};
    constexpr std::array kLimits{1e10, 90.0, 360.0, 1e5};  // larger values are wrong units or columns
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    std::vector<std::size_t> column_of;  // [kNames]
    std::vector<glm::dvec3> antenna_m;
    std::vector<GeodeticPosition> positions;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        if (trim(lines[i]).empty()) continue;
        const std::vector<std::string_view> cells = split_csv_cells(lines[i]);
        const std::string where = fmt::format("{}: line {}", file, i + 1);
        if (column_of.empty()) {
            for (const char* name : kNames) {
                column_of.push_back(std::size_t(std::ranges::find(cells, name) - cells.begin()));
                if (column_of.back() == cells.size()) fail("{}: the column '{}' is missing", where, name);
            }
            continue;
        }
        std::array<double, kNames.size()> row{};
        for (std::size_t k = 0; k < row.size(); ++k) {
            const std::string_view cell = column_of[k] < cells.size() ? cells[column_of[k]] : "";
            row[k] = parse_number(cell).value_or(INFINITY);
            if (!(std::abs(row[k]) <= kLimits[k]))
                fail("{}: {}: found \"{}\", expected a number from {} to {}", where, kNames[k], quote(cell),
                     -kLimits[k], kLimits[k]);
        }
        if (!log.world_from_vehicle.contains_time(row[0])) continue;
        antenna_m.push_back(log.world_from_vehicle.pose_at(row[0]).translation + log.world_offset_m);
        positions.push_back({row[1], row[2], row[3]});
    }
    return fit_georeference(antenna_m, positions);
}

}  // namespace

GeoreferenceFit read_georeference(const std::filesystem::path& path, const Log& log) {
    const std::string file = path.string();
    if (path.extension() == ".csv") return fit_fixes(file, log);
    const nlohmann::json json = parse_json(read_text_file(path), file);
    const JsonField root(json, file, "");
    const Georeference place =
        read_georeference(root.has_member("georeference") ? root.at("georeference") : root);
    return {place, has_proj() ? GeoConverter(place).scale_note() : ""};
}

}  // namespace relidar
