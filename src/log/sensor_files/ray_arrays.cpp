// SPDX-License-Identifier: Apache-2.0
#include "log/sensor_files/ray_arrays.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar::sensor_files {
namespace {

constexpr double kUnitLengthTolerance = 1e-3;  // Maximum difference between the length of a direction and 1.
constexpr double kFarthestOrigin_m = 100.0, kLongestScan_s = 100.0, kMostRange_m = 10'000.0,
                 kWidestBeam_rad = 1.0;

glm::dvec3 xyz_at(const std::vector<double>& values, std::size_t index) {
    return values.empty() ? glm::dvec3(0.0)
                          : glm::dvec3(values[3 * index], values[3 * index + 1], values[3 * index + 2]);
}

/// What an array of a ray table may contain.
struct ArrayLimits {
    const char* name;  ///< for messages
    std::size_t n_values;
    double min, max;
};

/// Fails if an array has another number of values, or a value outside the limits. An
/// empty array is valid, because arrays are optional.
void check_array_values(const std::vector<double>& values, const ArrayLimits& limits,
                        const std::string& where) {
    if (!values.empty() && values.size() != limits.n_values)
        fail("{}: {} has {} numbers, expected {}", where, limits.name, values.size(), limits.n_values);
    for (std::size_t i = 0; i < values.size(); ++i)
        if (!(values[i] >= limits.min && values[i] <= limits.max))
            fail("{}: entry {} of {} is {}, expected a number in [{}, {}]", where, i, limits.name, values[i],
                 limits.min, limits.max);
}

/// Checks the number of rays, the lengths of the arrays (optional ones may be empty), and
/// the limits of their values.
void check_ray_arrays(const RayFileArrays& ray_arrays, const std::string& where) {
    const std::size_t n = ray_arrays.direction.size() / 3;
    if (n == 0 || n > kMaxRays || n * 3 != ray_arrays.direction.size())
        fail("{}: found {} rays, expected 1 to {}", where, n, kMaxRays);
    if (ray_arrays.rows < 1 || ray_arrays.columns < 1 ||
        std::size_t(ray_arrays.rows) * std::size_t(ray_arrays.columns) != n)
        fail("{}: found {} rays, expected {} rows of {} rays", where, n, ray_arrays.rows, ray_arrays.columns);
    check_array_values(
        ray_arrays.origin,
        {.name = "origin", .n_values = 3 * n, .min = -kFarthestOrigin_m, .max = kFarthestOrigin_m}, where);
    check_array_values(ray_arrays.time_s,
                       {.name = "time", .n_values = n, .min = -kLongestScan_s, .max = kLongestScan_s}, where);
    check_array_values(ray_arrays.channel, {.name = "ring", .n_values = n, .min = 0.0, .max = 65535.0},
                       where);
    // A single divergence applies to all rays.
    const std::size_t n_divergences = ray_arrays.divergence_rad.size() == 1 ? 1 : n;
    check_array_values(
        ray_arrays.divergence_rad,
        {.name = "divergence (radians)", .n_values = n_divergences, .min = 0.0, .max = kWidestBeam_rad},
        where);
    // An infinite maximum is allowed, because it means that the file has none.
    const RangeLimits& limits = ray_arrays.limits;
    const double max_m = std::isinf(limits.max_m) ? kMostRange_m : limits.max_m;
    check_array_values({limits.min_m, max_m},
                       {.name = "range limits", .n_values = 2, .min = 0.0, .max = kMostRange_m}, where);
    if (!(limits.min_m < limits.max_m))
        fail("{}: found range limits of {} to {} m, expected min_range_m below max_range_m", where,
             limits.min_m, limits.max_m);
}

enum RayCsvField {
    kAzimuth,
    kElevation,
    kOriginX,
    kOriginY,
    kOriginZ,
    kTime,
    kChannel,
    kDivergence,
    kMinRange,
    kMaxRange,
    kFieldCount
};
const std::vector<std::string> kColumnNames{"azimuth_deg", "elevation_deg", "origin_x_m", "origin_y_m",
                                            "origin_z_m",  "time_s",        "channel",    "divergence_mrad",
                                            "min_range_m", "max_range_m"};
using RayCsvRow = std::array<double, kFieldCount>;

/// Parses the numbers of one ray. Values of missing columns are 0, except the maximum
/// range, which has its default.
/// @param column_of_field  cell of each RayCsvField; -1: the file has no such column
/// @param n_cells  number of cells of the header
RayCsvRow parse_ray_line(const std::string& line, const std::vector<int>& column_of_field,
                         std::size_t n_cells, const std::string& where) {
    const std::vector<std::string_view> cells = split_csv_cells(line);
    if (cells.size() != n_cells)
        fail("{}: found {} values, expected {} like in the header", where, cells.size(), n_cells);
    RayCsvRow values{};
    values[kMaxRange] = RayFileArrays{}.limits.max_m;
    for (std::size_t field = 0; field < kFieldCount; ++field) {
        if (column_of_field[field] < 0) continue;
        const std::string_view cell = cells[std::size_t(column_of_field[field])];
        const auto number = parse_number(cell);
        if (!number || !std::isfinite(*number))
            fail("{}: {} is '{}', expected a number", where, kColumnNames[field], quote(cell));
        values[field] = *number;
    }
    return values;
}

/// Adds one ray. Converts its angles to a direction (x forward, y left, z up).
void append_ray_row(RayFileArrays& rays, const RayCsvRow& row_values) {
    const double azimuth_rad = row_values[kAzimuth] * kPi / 180.0,
                 elevation_rad = row_values[kElevation] * kPi / 180.0;
    const double horizontal = std::cos(elevation_rad);
    rays.direction.insert(
        rays.direction.end(),
        {horizontal * std::cos(azimuth_rad), horizontal * std::sin(azimuth_rad), std::sin(elevation_rad)});
    rays.origin.insert(rays.origin.end(), {row_values[kOriginX], row_values[kOriginY], row_values[kOriginZ]});
    rays.time_s.push_back(row_values[kTime]);
    rays.channel.push_back(row_values[kChannel]);
    rays.divergence_rad.push_back(row_values[kDivergence] * 1e-3);  // from milliradians
}

}  // namespace

std::vector<double> choose_divergence(std::vector<double> ray_divergence_rad,
                                      std::optional<double> common_divergence_mrad,
                                      const std::string& where) {
    if (!ray_divergence_rad.empty() && common_divergence_mrad)
        fail("{}: found both divergence and divergence_mrad, expected one of them", where);
    if (common_divergence_mrad) return {1e-3 * *common_divergence_mrad};
    return ray_divergence_rad;
}

SensorModel make_ray_sensor(const RayFileArrays& arrays, const std::string& name, const std::string& where) {
    check_ray_arrays(arrays, where);
    const std::size_t n = arrays.direction.size() / 3;
    RayTable rays;
    rays.rows = arrays.rows;
    rays.columns = arrays.columns;
    const std::vector<double>& divergence_rad = arrays.divergence_rad;
    // Stores one value if all rays have the same divergence.
    if (std::ranges::adjacent_find(divergence_rad, std::not_equal_to<>()) != divergence_rad.end())
        rays.ray_divergence_rad.assign(divergence_rad.begin(), divergence_rad.end());
    else if (!divergence_rad.empty()) rays.divergence_rad = float(divergence_rad[0]);
    for (std::size_t i = 0; i < n; ++i) {
        const glm::dvec3 direction = xyz_at(arrays.direction, i);
        const double length = glm::length(direction);
        if (!(std::abs(length - 1.0) <= kUnitLengthTolerance))
            fail("{}: entry {} of directions has length {}, expected 1", where, i, length);
        // A file that relidar has written contains unit vectors of floats. Normalising
        // them again could change their last bit.
        const bool has_only_floats = glm::dvec3(glm::vec3(direction)) == direction;
        const bool keeps_bits = arrays.keeps_floats && std::abs(length - 1.0) < 1e-6 && has_only_floats;
        rays.direction.emplace_back(keeps_bits ? direction : direction / length);
        rays.origin.emplace_back(xyz_at(arrays.origin, i));
        rays.time_offset_s.push_back(arrays.time_s.empty() ? 0.0f : float(arrays.time_s[i]));
        rays.channel.push_back(arrays.channel.empty() ? std::uint16_t(0) : std::uint16_t(arrays.channel[i]));
    }
    return {.name = name, .limits = arrays.limits, .pattern = std::move(rays)};
}

SensorModel read_ray_npz(const std::string& path, const std::string& name) {
    const std::vector<NamedArray> arrays = read_npz(path);
    const auto read_values = [&](const std::string& array_name) {
        const NamedArray* array = find_array(arrays, array_name);
        return array ? array->to_doubles() : std::vector<double>{};
    };
    // Returns nothing if the file has no such array.
    const auto read_number = [&](const std::string& array_name) -> std::optional<double> {
        const std::vector<double> numbers = read_values(array_name);
        if (numbers.size() > 1)
            fail("{}: the array \"{}\" has {} numbers, expected one number", path, array_name,
                 numbers.size());
        return numbers.empty() ? std::nullopt : std::optional(numbers[0]);
    };
    const NamedArray* directions = find_array(arrays, "directions");
    if (!directions) fail("{}: the array \"directions\" is missing, expected the rays of a sensor", path);
    const std::vector<std::size_t>& shape = directions->shape;
    if ((shape.size() != 2 && shape.size() != 3) || shape.back() != 3 || shape[0] > kMaxRays ||
        shape[1] > kMaxRays) {
        fail("{}: directions has shape [{}], expected [n,3] or [rows,columns,3]", path,
             fmt::join(shape, ","));
    }
    RayFileArrays rays{.direction = read_values("directions"),
                       .origin = read_values("origin"),
                       .time_s = read_values("time"),
                       .channel = read_values("ring")};
    // The last dimension is x, y, z. Without an image, all rays form one row.
    rays.rows = shape.size() == 3 ? int(shape[0]) : 1;
    rays.columns = int(shape[shape.size() - 2]);
    rays.divergence_rad = choose_divergence(read_values("divergence"), read_number("divergence_mrad"), path);
    rays.limits = {read_number("min_range_m").value_or(rays.limits.min_m),
                   read_number("max_range_m").value_or(rays.limits.max_m)};
    return make_ray_sensor(rays, name, path);
}

/// Parses a table of rays: a header line, then one line per ray in firing order. An
/// unknown column is an error.
/// @param where  path of the file, for messages
SensorModel parse_ray_csv(const std::string& csv_text, const std::string& name, const std::string& where) {
    const std::vector<std::string> lines = split_lines(csv_text);
    std::vector<std::string_view> header;
    if (!lines.empty()) header = split_csv_cells(lines[0]);
    const std::vector<int> column_of_field = find_columns(header, kColumnNames, where + " line 1");
    if (column_of_field[kAzimuth] < 0 || column_of_field[kElevation] < 0)
        fail("{} line 1: the column azimuth_deg or elevation_deg is missing, expected both in a ray table",
             where);
    RayFileArrays rays;
    RayCsvRow first_row{};
    for (std::size_t l = 1; l < lines.size(); ++l) {
        if (trim(lines[l]).empty()) continue;
        const std::string line = fmt::format("{} line {}", where, l + 1);
        const RayCsvRow row = parse_ray_line(lines[l], column_of_field, header.size(), line);
        if (rays.time_s.empty()) first_row = row;
        // The sensor has one pair of limits.
        for (const RayCsvField field : {kMinRange, kMaxRange})
            if (row[field] != first_row[field])
                fail(
                    "{}: {} is {}, expected {} like in the first line; this column needs one value for all "
                    "rays",
                    line, kColumnNames[field], row[field], first_row[field]);
        append_ray_row(rays, row);
    }
    // A single row. make_ray_sensor() reports more than kMaxRays rays.
    rays.columns = int(std::min(rays.time_s.size(), kMaxRays + 1));
    rays.limits = {first_row[kMinRange], first_row[kMaxRange]};
    return make_ray_sensor(rays, name, where);
}

}  // namespace relidar::sensor_files
