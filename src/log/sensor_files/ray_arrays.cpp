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
#include "base/files.hpp"

namespace relidar::sensor_files {
namespace {

constexpr double kUnit = 1e-3;  // Maximum difference between the length of a direction and 1.
constexpr double kFarthestOrigin_m = 100.0, kLongestScan_s = 100.0, kMostRange_m = 10'000.0,
                 kWidestBeam_rad = 1.0;

void check_length(const std::vector<double>& values, std::size_t expected_length, const char* description,
                  const std::string& location) {
    if (!values.empty() && values.size() != expected_length)
        throw DataError(fmt::format("{}: {} has {} numbers, expected {}", location, description,
                                    values.size(), expected_length));
}

void check_reach(const std::vector<double>& values, double low, double high, const char* description,
                 const std::string& location) {
    const auto bad = std::find_if(values.begin(), values.end(),
                                  [&](double value) { return !(value >= low && value <= high); });
    if (bad != values.end()) {
        throw DataError(fmt::format("{0}: entry {2} of {1} is {3}, expected a number in [{4}, {5}]", location,
                                    description, bad - values.begin(), *bad, low, high));
    }
}

glm::dvec3 get_vector_at(const std::vector<double>& values, std::size_t index) {
    return values.empty() ? glm::dvec3(0.0)
                          : glm::dvec3(values[3 * index], values[3 * index + 1], values[3 * index + 2]);
}

void check(const RayColumns& columns, const std::string& location) {
    const std::size_t n = columns.direction.size() / 3;
    if (n == 0 || n > kMaxRays || n * 3 != columns.direction.size())
        throw DataError(fmt::format("{}: found {} rays, expected 1 to {}", location, n, kMaxRays));
    if (columns.rows < 1 || columns.columns < 1 ||
        std::size_t(columns.rows) * std::size_t(columns.columns) != n)
        throw DataError(fmt::format("{}: found {} rays, expected {} rows of {} rays", location, n,
                                    columns.rows, columns.columns));
    check_length(columns.origin, 3 * n, "origin", location);
    check_length(columns.time_s, n, "time", location);
    check_length(columns.channel, n, "ring", location);
    if (columns.divergence_rad.size() != 1) check_length(columns.divergence_rad, n, "divergence", location);
    check_reach(columns.origin, -kFarthestOrigin_m, kFarthestOrigin_m, "origin", location);
    check_reach(columns.time_s, -kLongestScan_s, kLongestScan_s, "time", location);
    check_reach(columns.channel, 0.0, 65535.0, "ring", location);
    check_reach(columns.divergence_rad, 0.0, kWidestBeam_rad, "divergence (radians)", location);
    check_reach(
        {columns.limits.min_m, std::isinf(columns.limits.max_m) ? kMostRange_m : columns.limits.max_m}, 0.0,
        kMostRange_m, "range limits", location);
    if (!(columns.limits.min_m < columns.limits.max_m))
        throw DataError(
            fmt::format("{}: found range limits of {} to {} m, expected min_range_m below max_range_m",
                        location, columns.limits.min_m, columns.limits.max_m));
}

/// Sets the beam divergences of rays. If all are equal, stores a single number.
void set_divergence(RayTable& rays, const std::vector<double>& divergence_rad) {
    if (divergence_rad.empty()) return;
    if (std::ranges::adjacent_find(divergence_rad, std::not_equal_to<>()) == divergence_rad.end())
        rays.divergence_rad = static_cast<float>(divergence_rad[0]);
    else rays.ray_divergence_rad.assign(divergence_rad.begin(), divergence_rad.end());
}

}  // namespace

std::vector<double> compute_divergence(std::vector<double> ray_divergence_rad,
                                       std::optional<double> common_divergence_mrad,
                                       const std::string& location) {
    if (!ray_divergence_rad.empty() && common_divergence_mrad)
        throw DataError(
            fmt::format("{}: found both divergence and divergence_mrad, expected one of them", location));
    if (common_divergence_mrad) return {1e-3 * *common_divergence_mrad};
    return ray_divergence_rad;
}

SensorModel make_ray_sensor(const RayColumns& columns, const std::string& name, const std::string& location) {
    check(columns, location);
    const std::size_t n = columns.direction.size() / 3;
    RayTable rays;
    rays.rows = columns.rows;
    rays.columns = columns.columns;
    set_divergence(rays, columns.divergence_rad);
    for (std::size_t i = 0; i < n; ++i) {
        const glm::dvec3 direction = get_vector_at(columns.direction, i);
        const double length = glm::length(direction);
        if (!(std::abs(length - 1.0) <= kUnit))
            throw DataError(
                fmt::format("{}: entry {} of directions has length {}, expected 1", location, i, length));
        const bool is_exact = columns.keeps_floats && std::abs(length - 1.0) < 1e-6 &&
                              glm::dvec3(glm::vec3(direction)) == direction;
        rays.direction.emplace_back(is_exact ? direction : direction / length);
        rays.origin.emplace_back(get_vector_at(columns.origin, i));
        rays.time_offset_s.push_back(columns.time_s.empty() ? 0.0f : static_cast<float>(columns.time_s[i]));
        rays.channel.push_back(columns.channel.empty() ? std::uint16_t(0)
                                                       : static_cast<std::uint16_t>(columns.channel[i]));
    }
    return {name, "", columns.limits, std::move(rays)};
}

SensorModel read_ray_npz(const std::string& path, const std::string& name) {
    const std::vector<NamedArray> arrays = read_npz(path);
    const auto values = [&](const std::string& wanted) {
        const NamedArray* array = find_array(arrays, wanted);
        return array ? array->as_double() : std::vector<double>{};
    };
    const auto one = [&](const std::string& wanted) -> std::optional<double> {
        const std::vector<double> found = values(wanted);
        if (found.size() > 1)
            throw DataError(fmt::format("{}: {} has {} numbers, expected one", path, wanted, found.size()));
        return found.empty() ? std::nullopt : std::optional(found[0]);
    };
    const NamedArray* directions = find_array(arrays, "directions");
    if (!directions)
        throw DataError(
            fmt::format("{}: the array \"directions\" is missing, expected the rays of a sensor", path));
    const std::vector<std::size_t>& shape = directions->shape;
    if ((shape.size() != 2 && shape.size() != 3) || shape.back() != 3 || shape[0] > kMaxRays ||
        shape[1] > kMaxRays) {
        throw DataError(fmt::format("{}: directions has shape [{}], expected [n,3] or [rows,columns,3]", path,
                                    fmt::join(shape, ",")));
    }
    RayColumns c{.direction = values("directions"),
                 .origin = values("origin"),
                 .time_s = values("time"),
                 .channel = values("ring")};
    c.rows = shape.size() == 3 ? static_cast<int>(shape[0]) : 1;
    c.columns = static_cast<int>(shape[shape.size() - 2]);
    c.divergence_rad = compute_divergence(values("divergence"), one("divergence_mrad"), path);
    c.limits = {one("min_range_m").value_or(c.limits.min_m), one("max_range_m").value_or(c.limits.max_m)};
    return make_ray_sensor(c, name, path);
}

}  // namespace relidar::sensor_files
