// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/folder_points.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "log/clouds/scan_npz.hpp"

namespace relidar::folder {
namespace {

constexpr double kFarthestCoordinate_m = 1e6;
// 1 - cosine of 1.4 mrad: what two returns of one ray, rounded, are apart at most
constexpr float kOneRay = 1e-6f;

/// Whether a return type of Nebula (ReturnType: 3 strongest, 6 identical, 9 and 10
/// strongest and first or last) says that nothing of its ray came back stronger.
bool is_strongest(double type) { return type == 3.0 || type == 6.0 || type == 9.0 || type == 10.0; }

void check_coordinate(const glm::dvec3& p, const std::string& where) {
    if (!(std::abs(p.x) <= kFarthestCoordinate_m && std::abs(p.y) <= kFarthestCoordinate_m &&
          std::abs(p.z) <= kFarthestCoordinate_m))
        throw DataError(fmt::format("{}: ({}, {}, {}), expected metres within {}", where, p.x, p.y, p.z,
                                    kFarthestCoordinate_m));
}

template <class T>
void rearrange(std::vector<T>& values, const std::vector<std::size_t>& order) {
    if (values.empty()) return;
    std::vector<T> arranged;
    arranged.reserve(values.size());
    for (const std::size_t i : order) arranged.push_back(values[i]);
    values = std::move(arranged);
}

/// Points of one ring and time whose directions are the same are returns of one ray: the
/// strongest is the first of them.
/// @param type  [n] of the points
void number_returns(Points& points, const std::vector<double>& type) {
    const std::size_t n = points.size();
    std::vector<std::size_t> order(n);
    std::iota(order.begin(), order.end(), std::size_t(0));
    const auto ray = [&](std::size_t i) { return std::pair(points.ring[i], points.time_offset_s[i]); };
    const auto strength = [&](std::size_t i) {
        return std::pair(is_strongest(type[i]), points.intensity[i]);
    };
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
        return ray(a) != ray(b) ? ray(a) < ray(b) : strength(a) > strength(b);
    });
    points.return_number.assign(n, 1);
    for (std::size_t k = 1; k < n; ++k) {
        const std::size_t i = order[k], before = order[k - 1];
        const glm::vec3 a = glm::normalize(points.position_m[i]),
                        b = glm::normalize(points.position_m[before]);
        if (ray(i) == ray(before) && 1.0f - glm::dot(a, b) < kOneRay)
            points.return_number[i] = std::uint8_t(std::min(points.return_number[before] + 1, 8));
    }
    rearrange(points.position_m, order);
    rearrange(points.intensity, order);
    rearrange(points.ring, order);
    rearrange(points.time_offset_s, order);
    rearrange(points.return_number, order);
}

std::uint8_t return_of(double number, const std::string& where) {
    if (!(number >= 0.0 && number < 8.0))
        throw DataError(fmt::format("{}: return {}, expected 0 (the strongest) to 7", where, number));
    return std::uint8_t(number);
}

}  // namespace

Points points_of(const PointTable& table, const PointUnits& units, double time_s, const std::string& where) {
    const std::vector<double>*x = table.find({"x"}), *y = table.find({"y"}), *z = table.find({"z"});
    if (!x || !y || !z)
        throw DataError(fmt::format("{}: no field {}, expected x, y and z", where,
                                    !x   ? "x"
                                    : !y ? "y"
                                         : "z"));
    const std::vector<double>*intensity = table.find({"intensity", "reflectivity"}),
          *ring = table.find({"ring", "channel", "line"}),
          *time = table.find({"time", "t", "timestamp", "time_stamp", "offset_time"}),
          *number = table.find({"return", "return_number"}), *type = table.find({"return_type"});
    const auto is_return = [&](std::size_t i) {
        return !std::isnan((*x)[i]) && ((*x)[i] != 0.0 || (*y)[i] != 0.0 || (*z)[i] != 0.0);
    };
    // some count from 1, as relidar's own point files do: no scan has second returns
    // alone
    const double first_number = number && !number->empty() && std::ranges::min(*number) == 1.0 ? 1.0 : 0.0;
    Points points;
    std::size_t n = 0;
    for (std::size_t i = 0; i < table.n; ++i) n += is_return(i);
    points.position_m.reserve(n);
    std::vector<double> types;
    std::size_t i = 0;
    // named where something is wrong with it alone: a text for each would take longer
    // than all the rest
    const std::string of_point;
    try {
        for (; i < table.n; ++i) {
            if (!is_return(i)) continue;
            const glm::dvec3 p((*x)[i], (*y)[i], (*z)[i]);
            check_coordinate(p, of_point);
            points.position_m.emplace_back(p);
            points.intensity.push_back(intensity ? unit_intensity((*intensity)[i], units, of_point) : 0.0f);
            if (ring) points.ring.push_back(ring_number((*ring)[i], of_point));
            if (time) points.time_offset_s.push_back(time_offset((*time)[i], units, time_s, of_point));
            if (number)
                points.return_number.push_back(
                    std::uint8_t(1 + return_of((*number)[i] - first_number, of_point)));
            if (type) types.push_back((*type)[i]);
        }
    } catch (const DataError& error) {
        throw DataError(fmt::format("{}: point {}{}", where, i, error.what()));
    }
    if (type && ring && time && !number) number_returns(points, types);
    return points;
}

}  // namespace relidar::folder
