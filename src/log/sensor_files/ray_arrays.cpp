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
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar::sensor_files {
namespace {

constexpr double kUnitLengthTolerance = 1e-3;  // Maximum difference between the length of a direction and 1.
constexpr double kFarthestOrigin_m = 100.0, kLongestScan_s = 100.0, kMostRange_m = 10'000.0,
                 kWidestBeam_rad = 1.0;

void check_length(const std::vector<double>& values, std::size_t expected_length, const char* text,
                  const std::string& where) {
    if (!values.empty() && values.size() != expected_length)
        fail("{}: {} has {} numbers, expected {}", where, text, values.size(), expected_length);
}

void check_range(const std::vector<double>& values, double min_value, double max_value, const char* text,
                 const std::string& where) {
    const auto bad = std::find_if(values.begin(), values.end(),
                                  [&](double value) { return !(value >= min_value && value <= max_value); });
    if (bad != values.end())
        fail("{0}: entry {2} of {1} is {3}, expected a number in [{4}, {5}]", where, text,
             bad - values.begin(), *bad, min_value, max_value);
}

glm::dvec3 xyz_at(const std::vector<double>& values, std::size_t index) {
    return values.empty() ? glm::dvec3(0.0)
                          : glm::dvec3(values[3 * index], values[3 * index + 1], values[3 * index + 2]);
}

void check_ray_arrays(const RayFileArrays& ray_arrays, const std::string& where) {
    const std::size_t n = ray_arrays.direction.size() / 3;
    if (n == 0 || n > kMaxRays || n * 3 != ray_arrays.direction.size())
        fail("{}: found {} rays, expected 1 to {}", where, n, kMaxRays);
    if (ray_arrays.rows < 1 || ray_arrays.columns < 1 ||
        std::size_t(ray_arrays.rows) * std::size_t(ray_arrays.columns) != n)
        fail("{}: found {} rays, expected {} rows of {} rays", where, n, ray_arrays.rows, ray_arrays.columns);
    check_length(ray_arrays.origin, 3 * n, "origin", where);
    check_length(ray_arrays.time_s, n, "time", where);
    check_length(ray_arrays.channel, n, "ring", where);
    if (ray_arrays.divergence_rad.size() != 1)
        check_length(ray_arrays.divergence_rad, n, "divergence", where);
    check_range(ray_arrays.origin, -kFarthestOrigin_m, kFarthestOrigin_m, "origin", where);
    check_range(ray_arrays.time_s, -kLongestScan_s, kLongestScan_s, "time", where);
    check_range(ray_arrays.channel, 0.0, 65535.0, "ring", where);
    check_range(ray_arrays.divergence_rad, 0.0, kWidestBeam_rad, "divergence (radians)", where);
    check_range({ray_arrays.limits.min_m,
                 std::isinf(ray_arrays.limits.max_m) ? kMostRange_m : ray_arrays.limits.max_m},
                0.0, kMostRange_m, "range limits", where);
    if (!(ray_arrays.limits.min_m < ray_arrays.limits.max_m))
        fail("{}: found range limits of {} to {} m, expected min_range_m below max_range_m", where,
             ray_arrays.limits.min_m, ray_arrays.limits.max_m);
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
        // Normalising a unit vector again could change its last bit.
        const bool is_exact = arrays.keeps_floats && std::abs(length - 1.0) < 1e-6 &&
                              glm::dvec3(glm::vec3(direction)) == direction;
        rays.direction.emplace_back(is_exact ? direction : direction / length);
        rays.origin.emplace_back(xyz_at(arrays.origin, i));
        rays.time_offset_s.push_back(arrays.time_s.empty() ? 0.0f : float(arrays.time_s[i]));
        rays.channel.push_back(arrays.channel.empty() ? std::uint16_t(0) : std::uint16_t(arrays.channel[i]));
    }
    return {name, "", arrays.limits, std::move(rays)};
}

SensorModel read_ray_npz(const std::string& path, const std::string& name) {
    const std::vector<NamedArray> arrays = read_npz(path);
    const auto values = [&](const std::string& array_name) {
        const NamedArray* array = find_array(arrays, array_name);
        return array ? array->to_doubles() : std::vector<double>{};
    };
    const auto one = [&](const std::string& array_name) -> std::optional<double> {
        const std::vector<double> numbers = values(array_name);
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
    RayFileArrays c{.direction = values("directions"),
                    .origin = values("origin"),
                    .time_s = values("time"),
                    .channel = values("ring")};
    c.rows = shape.size() == 3 ? int(shape[0]) : 1;
    c.columns = int(shape[shape.size() - 2]);
    c.divergence_rad = choose_divergence(values("divergence"), one("divergence_mrad"), path);
    c.limits = {one("min_range_m").value_or(c.limits.min_m), one("max_range_m").value_or(c.limits.max_m)};
    return make_ray_sensor(c, name, path);
}

}  // namespace relidar::sensor_files
