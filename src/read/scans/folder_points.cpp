// SPDX-License-Identifier: Apache-2.0
#include "read/scans/folder_points.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>
#include <utility>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "read/files/scan_npz.hpp"
#include "read/scans/dropped_ray.hpp"
#include "read/scans/point_times.hpp"

namespace relidar::read {
namespace {

constexpr float kFarthestCoordinate_m = 1e6f;
// Two points are returns of one ray if 1 - cos(angle between their directions) is below
// this (1.4 mrad). The limit is not 0, because file coordinates are rounded.
constexpr float kOneRay = 1e-6f;

/// Returns true if the values of a field are the distances of the points from the sensor,
/// in any unit. A field with the name of a range can also be the distance from a plane.
/// @param is_no_return  points without a return, which are ignored
bool are_distances(const PointFieldView& ranges, const std::vector<glm::vec3>& points,
                   const std::vector<char>& is_no_return) {
    constexpr std::size_t kMostCompared = 2000;
    constexpr double kRangeTolerance = 0.05, kMinMatchShare = 0.9;
    std::vector<double> ratios;
    const std::size_t step = std::max<std::size_t>(1, points.size() / kMostCompared);
    for (std::size_t i = 0; i < points.size(); i += step)
        if (const double distance_m = glm::length(glm::dvec3(points[i]));
            !is_no_return[i] && std::isfinite(distance_m) && distance_m > 0.0)
            ratios.push_back(ranges[i] / distance_m);
    if (ratios.empty()) return false;
    const double unit = compute_median(ratios);
    const auto n = std::ranges::count_if(
        ratios, [unit](double ratio) { return std::abs(ratio - unit) <= kRangeTolerance * unit; });
    return double(n) >= kMinMatchShare * double(ratios.size());
}

/// Returns for each point whether its field `range` shows that the ray has no return.
/// Returns an empty array if no field contains ranges.
std::vector<char> flag_no_returns(const PointTable& table, const std::vector<glm::vec3>& points) {
    const PointFieldView* ranges = table.find_field(PointAttribute::range);
    std::vector<char> marked;
    if (!ranges) return marked;
    marked.resize(table.n);
    ranges->for_each(table.n, [&](std::size_t i, double range) { marked[i] = !is_return_range(range); });
    if (!are_distances(*ranges, points, marked)) marked.clear();
    return marked;
}

/// Returns the indices and positions of the points at which a pulse was reflected. Leaves
/// out points that only mark rays without a return.
std::pair<std::vector<std::uint32_t>, std::vector<glm::vec3>> select_returns(const PointTable& table,
                                                                             const PointFileUnits& units) {
    const std::vector<glm::vec3> all = read_positions(table);
    const std::vector<char> marked = flag_no_returns(table, all);
    std::pair<std::vector<std::uint32_t>, std::vector<glm::vec3>> returns;
    returns.first.reserve(table.n);
    for (std::size_t i = 0; i < table.n; ++i)
        if (is_return_point(all[i]) && all[i] != units.no_return && (marked.empty() || !marked[i]))
            returns.first.push_back(std::uint32_t(i));
    for (const std::uint32_t i : returns.first) returns.second.push_back(all[i]);
    return returns;
}

struct FieldConverter {
    std::vector<std::uint32_t> selected_indices;
    const std::string& where;

    /// Sets the values of the selected points. Does nothing if the field does not exist.
    /// @throws DataError from `convert`, with the number of the point
    template <class T, class OfValue>
    void convert_field(std::vector<T>& values, const PointFieldView* field, const OfValue& convert) const {
        if (!field) return;
        values.resize(selected_indices.size());
        field->with_reader([&](const auto& value_at) {
            std::size_t k = 0;
            try {
                for (; k < values.size(); ++k) values[k] = convert(double(value_at(selected_indices[k])));
            } catch (const DataError& error) {
                fail("{}: point {}{}", where, selected_indices[k], error.what());
            }
        });
    }
};

/// With units.skip_wrong_times, a wrong time becomes the longest offset, so that
/// read_scans() removes its point.
/// @throws DataError otherwise, and MostTimesWrong if most times are wrong
void convert_times(LidarPoints& points, const FieldConverter& convert, PointTable table,
                   const PointFileUnits& units, double frame_time_s) {
    unwrap_times(table, !units.absolute_times);
    if (!units.absolute_times) restore_signs(table);
    std::size_t n_wrong = 0;
    std::string first_error;
    const std::string of_point;
    convert.convert_field(points.time_offset_s, table.find_field(PointAttribute::time), [&](double value) {
        try {
            return frame_offset_s(value, units, frame_time_s, of_point);
        } catch (const DataError& error) {
            if (!units.skip_wrong_times) throw;
            if (n_wrong++ == 0) first_error = error.what();
            return kMaxTimeOffset_s;
        }
    });
    if (2 * n_wrong > convert.selected_indices.size())
        throw MostTimesWrong(fmt::format("{}: {} of {} points have wrong times{}", convert.where, n_wrong,
                                         convert.selected_indices.size(), first_error));
}

/// Returns 1 if the file counts from 1, otherwise 0. Every file has first returns, so
/// this is the smallest number.
double first_return_number(const PointFieldView& return_numbers, std::size_t n_points) {
    double least = return_numbers[0];
    return_numbers.for_each(n_points, [&](std::size_t, double value) {
        if (value < least) least = value;
    });
    return least == 1.0 ? 1.0 : 0.0;
}

/// Sets the return number of each point and sorts the points by ray. Points with the same
/// ring, time and direction are returns of one ray; the strongest becomes the first
/// return.
/// @param return_types  [points] values of the field return_type
void set_return_numbers(LidarPoints& points, const std::vector<double>& return_types) {
    const std::size_t n = points.size();
    std::vector<std::size_t> order(n);
    std::iota(order.begin(), order.end(), std::size_t(0));
    const auto ray = [&](std::size_t index) {
        return std::pair(points.ring[index], points.time_offset_s[index]);
    };
    const auto strength = [&](std::size_t index) {
        // Return types of the ROS package Nebula that include the strongest return: 3
        // (strongest), 6 (identical), 9 and 10 (strongest, and also first or last).
        const double type = return_types[index];
        const bool is_strongest = type == 3.0 || type == 6.0 || type == 9.0 || type == 10.0;
        return std::pair(is_strongest, points.intensity[index]);
    };
    std::stable_sort(order.begin(), order.end(), [&](std::size_t first, std::size_t second) {
        return ray(first) != ray(second) ? ray(first) < ray(second) : strength(first) > strength(second);
    });
    points.return_number.assign(n, 1);
    for (std::size_t k = 1; k < n; ++k) {
        const std::size_t i = order[k], before = order[k - 1];
        const glm::vec3 a = glm::normalize(points.position_m[i]),
                        b = glm::normalize(points.position_m[before]);
        if (ray(i) == ray(before) && 1.0f - glm::dot(a, b) < kOneRay)
            points.return_number[i] = std::uint8_t(std::min(points.return_number[before] + 1, 8));
    }
    select_points(points, order);
}

}  // namespace

LidarPoints convert_table(const PointTable& table, const PointFileUnits& units, double frame_time_s,
                          const std::string& where) {
    const auto *x = table.find_field(PointAttribute::x), *y = table.find_field(PointAttribute::y),
               *z = table.find_field(PointAttribute::z);
    for (const auto& [field, name] : {std::pair(x, "x"), std::pair(y, "y"), std::pair(z, "z")})
        if (!field) fail("{}: the field {} is missing, expected x, y and z", where, name);
    LidarPoints points;
    FieldConverter convert{{}, where};
    std::tie(convert.selected_indices, points.position_m) = select_returns(table, units);
    if (units.returns.exist)
        points.return_number = number_returns(table, units.returns, units.intensity_field,
                                              convert.selected_indices, points.position_m);
    for (std::size_t k = 0; k < convert.selected_indices.size(); ++k) {
        const glm::vec3 p = glm::abs(points.position_m[k]);
        if (std::max({p.x, p.y, p.z}) <= kFarthestCoordinate_m) continue;
        const std::size_t i = convert.selected_indices[k];
        fail("{}: point {} is ({}, {}, {}), expected coordinates of at most {} m", where, i, (*x)[i], (*y)[i],
             (*z)[i], kFarthestCoordinate_m);
    }
    const std::string of_point;  // Conversion adds the point's number
    const auto* intensity = table.find_field(units.intensity_field);
    if (!intensity) intensity = table.find_field(PointAttribute::intensity);
    if (!intensity) points.intensity.assign(convert.selected_indices.size(), 0.0f);
    convert.convert_field(points.intensity, intensity,
                          [&](double value) { return scale_intensity(value, units, of_point); });
    convert.convert_field(points.ring, table.find_field(PointAttribute::ring),
                          [&](double value) { return convert_ring(value, of_point); });
    if (!units.ignore_times) convert_times(points, convert, table, units, frame_time_s);
    const auto *number = table.find_field(PointAttribute::return_number),
               *type = table.find_field(PointAttribute::return_type);
    if (number) {
        const double first = first_return_number(*number, table.n);
        convert.convert_field(points.return_number, number, [&](double value) {
            const double return_number = value - first;
            if (!(return_number >= 0.0 && return_number < 8.0))
                fail("{}: the return number is {}, expected 0 (the strongest return) to 7", of_point,
                     return_number);
            return std::uint8_t(1 + int(return_number));
        });
    } else if (type && !points.ring.empty() && !points.time_offset_s.empty()) {
        std::vector<double> types;
        convert.convert_field(types, type, [](double value) { return value; });
        set_return_numbers(points, types);
    }
    return points;
}

}  // namespace relidar::read
