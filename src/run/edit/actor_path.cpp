// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {

namespace {

enum ActorPathField {
    kTime,
    kX,
    kY,
    kZ,
    kYaw,
    kPitch,
    kRoll,
    kYawRad,
    kPitchRad,
    kRollRad,
    kLatitude,
    kLongitude,
    kHeight,
    kFieldCount
};
// of a file without a header
constexpr std::size_t kMaxUnnamedColumns = 7;
constexpr std::size_t kMinColumns = 5;
// seconds since 1970 are smaller
constexpr double kMaxNumber = 1e10;
constexpr std::string_view kGroundWord = "ground";
/// [ActorPathField]
const std::vector<std::string> kColumnNames{
    "time_s",   "x",       "y",         "z",        "yaw_deg",      "pitch_deg",
    "roll_deg", "yaw_rad", "pitch_rad", "roll_rad", "latitude_deg", "longitude_deg",
    "height_m"};

/// Column index of each field, or -1 if the file does not have the field.
using FieldColumnIndices = std::vector<int>;

/// Reads the line with the column names and returns the column index of each field. A
/// place has either x, y and z or latitude, longitude and height. Each angle is in
/// degrees or in radians; only yaw is required.
/// @throws DataError for an unknown name, a missing field, or a field in both forms
FieldColumnIndices parse_header(const std::vector<std::string_view>& header, const std::string& where) {
    FieldColumnIndices column_of = find_columns(header, kColumnNames, where);
    const auto has = [&](int field) { return column_of[std::size_t(field)] >= 0; };
    const auto require = [&](int field) {
        if (!has(field)) fail("{}: the column '{}' is missing", where, kColumnNames[std::size_t(field)]);
    };
    require(kTime);

    const std::array local_fields{kX, kY, kZ}, geodetic_fields{kLatitude, kLongitude, kHeight};
    const auto local = std::ranges::find_if(local_fields, has),
               geodetic = std::ranges::find_if(geodetic_fields, has);
    const bool is_geodetic = geodetic != geodetic_fields.end();
    if (is_geodetic && local != local_fields.end())
        fail("{}: found the columns '{}' and '{}', expected only one kind of place", where,
             kColumnNames[*local], kColumnNames[*geodetic]);
    for (const int field : is_geodetic ? geodetic_fields : local_fields) require(field);

    if (!has(kYaw) && !has(kYawRad)) fail("{}: the column 'yaw_deg' or 'yaw_rad' is missing", where);
    for (const auto& [degrees, radians] : {std::pair(kYaw, kYawRad), {kPitch, kPitchRad}, {kRoll, kRollRad}})
        if (has(degrees) && has(radians))
            fail("{}: found both columns '{}' and '{}', expected only one of them", where,
                 kColumnNames[degrees], kColumnNames[radians]);
    return column_of;
}

/// Reads the fields of a line. A field without a column is 0. z is NaN for the word
/// `ground`, which means that the actor stands on the ground.
/// @throws DataError naming the column that is not a number
std::array<double, kFieldCount> parse_row(const std::vector<std::string_view>& cells,
                                          const FieldColumnIndices& column_of,
                                          const std::string& error_location) {
    std::array<double, kFieldCount> row{};
    for (std::size_t field = 0; field < row.size(); ++field) {
        // Pitch and roll may be missing at the end of a line.
        if (column_of[field] < 0 || std::size_t(column_of[field]) >= cells.size()) continue;
        const std::string_view cell = cells[std::size_t(column_of[field])];
        if (field == kZ && cell == kGroundWord) {
            row[field] = std::numeric_limits<double>::quiet_NaN();
            continue;
        }
        const std::optional<double> value = parse_number(cell);
        if (!value || !(std::abs(*value) <= kMaxNumber))
            fail("{}: {}: found \"{}\", expected a finite number of at most {:.0e}", error_location,
                 kColumnNames[field], quote(cell), kMaxNumber);
        row[field] = *value;
    }
    return row;
}

}  // namespace

PoseTrack read_trajectory(const std::filesystem::path& path,
                          const std::optional<Georeference>& georeference) {
    PoseTrack track = read_actor_path(path, georeference);
    if (std::isnan(track.pose.front().translation.z))
        fail("{}: found `ground` in the column z, expected numbers, because the path is not that of an actor",
             path.string());
    return track;
}

PoseTrack read_actor_path(const std::filesystem::path& path,
                          const std::optional<Georeference>& georeference) {
    const std::vector<std::string> lines = split_lines(read_text_file(path));
    PoseTrack track;
    FieldColumnIndices column_of;
    std::optional<GeoConverter> geo_converter;
    // maximum number of cells in a line, and minimum number because of the lines before
    std::size_t max_cells = 0, min_cells = 0;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        if (trim(lines[i]).empty()) continue;
        const std::vector<std::string_view> cells = split_csv_cells(lines[i]);
        const std::string where = fmt::format("{}: line {}", path.string(), i + 1);
        if (column_of.empty() && !parse_number(cells[0])) {
            column_of = parse_header(cells, where);
            max_cells = min_cells = cells.size();
            if (column_of[kLatitude] < 0) continue;
            if (!georeference)
                fail<UsageError>("{}: found latitudes, but the run has no georeference; expected x,y,z",
                                 path.string());
            geo_converter.emplace(*georeference);
            continue;
        }
        if (column_of.empty()) {
            // Without a header, column i contains the field kColumnNames[i].
            column_of.resize(kFieldCount, -1);
            std::iota(column_of.begin(), column_of.begin() + kMaxUnnamedColumns, 0);
            max_cells = kMaxUnnamedColumns;
            min_cells = kMinColumns;
        }
        if (cells.size() < min_cells || cells.size() > max_cells)
            fail(
                "{}: found {} columns, expected {} to {}, in the order "
                "time_s,x,y,z,yaw_deg,pitch_deg,roll_deg or that of a header",
                where, cells.size(), min_cells, max_cells);
        const auto row = parse_row(cells, column_of, where);
        min_cells = cells.size();
        if (!track.time_s.empty() && !(row[kTime] > track.time_s.back()))
            fail("{}: time_s is {} after {} in the previous line, expected increasing times", where,
                 row[kTime], track.time_s.back());
        if (!track.pose.empty() && std::isnan(row[kZ]) != std::isnan(track.pose.front().translation.z))
            fail("{}: the column z has numbers and the word `ground`, expected only one of them", where);
        // Each angle is in degrees or in radians. The other field is 0.
        const double yaw_rad = row[kYaw] * kPi / 180.0 + row[kYawRad];
        const double pitch_rad = row[kPitch] * kPi / 180.0 + row[kPitchRad];
        const double roll_rad = row[kRoll] * kPi / 180.0 + row[kRollRad];
        Pose pose{make_rotation(yaw_rad, pitch_rad, roll_rad), {row[kX], row[kY], row[kZ]}};
        if (geo_converter) {
            if (!(std::abs(row[kLatitude]) <= 90.0 && std::abs(row[kLongitude]) <= 360.0))
                fail("{}: found the latitude {} and the longitude {}, expected degrees", where,
                     row[kLatitude], row[kLongitude]);
            const GeodeticPosition place{row[kLatitude], row[kLongitude], row[kHeight]};
            pose = {geo_converter->dataset_from_enu(place) * pose.rotation, geo_converter->to_dataset(place)};
        }
        track.append(row[kTime], pose);
    }
    if (track.pose.size() < 2)
        fail("{}: found {} poses, expected at least two", path.string(), track.pose.size());
    return track;
}

}  // namespace relidar
