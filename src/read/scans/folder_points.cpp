// SPDX-License-Identifier: Apache-2.0
#include "read/scans/folder_points.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <tuple>
#include <utility>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "read/files/dropped_ray.hpp"
#include "read/files/scan_npz.hpp"
#include "read/scans/point_meaning.hpp"
#include "read/scans/point_times.hpp"

namespace relidar::read {
namespace {

constexpr float kFarthestCoordinate_m = 1e6f;

/// Returns true if the values of a field are the distances of the points from the sensor,
/// in any unit. A field with the name of a range can also be the distance from a plane.
/// @param is_no_return  points without a return, which are ignored
bool are_distances(const PointFieldView& ranges, const std::vector<glm::vec3>& points,
                   const std::vector<char>& is_no_return) {
    constexpr double kRangeTolerance = 0.05, kMinMatchShare = 0.9;
    std::vector<double> ratios;  // of the field to the distance; all equal if the field is a distance
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double distance_m = glm::length(glm::dvec3(points[i]));
        if (!is_no_return[i] && std::isfinite(distance_m) && distance_m > 0.0)
            ratios.push_back(ranges[i] / distance_m);
    }
    if (ratios.empty()) return false;
    const double unit = compute_median(ratios);
    const auto n_matches = std::ranges::count_if(
        ratios, [unit](double ratio) { return std::abs(ratio - unit) <= kRangeTolerance * unit; });
    return double(n_matches) >= kMinMatchShare * double(ratios.size());
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

/// Points of a table at which a pulse was reflected.
struct SelectedPoints {
    std::vector<std::uint32_t> index;   ///< index in the table
    std::vector<glm::vec3> position_m;  ///< in the axes of the table
};

/// Selects the points of returns. Other points only mark rays without a return.
SelectedPoints select_returns(const PointTable& table, const PointFileUnits& units) {
    const std::vector<glm::vec3> positions_m = read_positions(table);
    const std::vector<char> has_no_range = flag_no_returns(table, positions_m);
    SelectedPoints returns;
    for (std::size_t i = 0; i < table.n; ++i) {
        const bool is_marked =
            positions_m[i] == units.no_return || (!has_no_range.empty() && has_no_range[i]);
        if (is_marked || !is_return_point(positions_m[i])) continue;
        returns.index.push_back(std::uint32_t(i));
        returns.position_m.push_back(positions_m[i]);
    }
    return returns;
}

/// Converts fields of the selected points to arrays.
struct FieldConverter {
    const std::vector<std::uint32_t>& selected;  ///< indices of points in the table
    const std::string& where;

    /// Sets the values of the selected points. Does nothing if the field does not exist.
    /// @param convert  function of a value; begins its errors with ": "
    /// @throws DataError from `convert`, with the number of the point
    template <class T, class OfValue>
    void convert_field(std::vector<T>& values, const PointFieldView* field, const OfValue& convert) const {
        if (!field) return;
        values.resize(selected.size());
        field->with_reader([&](const auto& value_at) {
            std::size_t k = 0;
            try {
                for (; k < values.size(); ++k) values[k] = convert(double(value_at(selected[k])));
            } catch (const DataError& error) {
                fail("{}: point {}{}", where, selected[k], error.what());
            }
        });
    }
};

/// Sets the times of the points, in seconds relative to the time of the frame. First
/// repairs counters that overflow in the scan, and offsets without their signs.
/// @throws DataError if a time is wrong. With units.skip_wrong_times, only MostTimesWrong
/// if most times are wrong. Otherwise, a wrong time becomes kMaxTimeOffset_s, which is
/// so long that read_scans() removes the point.
void convert_times(LidarPoints& points, const FieldConverter& convert, PointTable table,
                   const PointFileUnits& units, double frame_time_s) {
    unwrap_times(table, !units.absolute_times);
    if (!units.absolute_times) restore_signs(table);
    const PointFieldView* times = table.find_field(PointAttribute::time);
    const auto offset_of = [&](double time) { return frame_offset_s(time, units, frame_time_s, ""); };
    if (!units.skip_wrong_times) {
        convert.convert_field(points.time_offset_s, times, offset_of);
        return;
    }
    std::size_t n_wrong = 0;
    std::string first_error;  // begins with ": "
    convert.convert_field(points.time_offset_s, times, [&](double time) {
        try {
            return offset_of(time);
        } catch (const DataError& error) {
            if (n_wrong == 0) first_error = error.what();
            ++n_wrong;
            return kMaxTimeOffset_s;
        }
    });
    if (2 * n_wrong > points.time_offset_s.size())
        throw MostTimesWrong(fmt::format("{}: {} of {} points have wrong times{}", convert.where, n_wrong,
                                         points.time_offset_s.size(), first_error));
}

/// Sets the return number of each point and sorts the points by ray. Points with the same
/// ring, time and direction are returns of one ray; the strongest becomes the first
/// return.
/// @param return_types  [points] values of the field return_type
void set_return_numbers(LidarPoints& points, const std::vector<double>& return_types) {
    const std::size_t n = points.size();
    const auto ring_time = [&](std::size_t i) { return std::pair(points.ring[i], points.time_offset_s[i]); };
    const auto strength = [&](std::size_t i) {
        // Return types of the ROS package Nebula that include the strongest return: 3
        // (strongest), 6 (identical), 9 and 10 (strongest, and also first or last).
        const double type = return_types[i];
        const bool is_strongest = type == 3.0 || type == 6.0 || type == 9.0 || type == 10.0;
        return std::pair(is_strongest, points.intensity[i]);
    };
    std::vector<std::size_t> order(n);
    std::iota(order.begin(), order.end(), std::size_t(0));
    std::stable_sort(order.begin(), order.end(), [&](std::size_t first, std::size_t second) {
        if (ring_time(first) != ring_time(second)) return ring_time(first) < ring_time(second);
        return strength(first) > strength(second);
    });
    points.return_number.assign(n, 1);
    for (std::size_t k = 1; k < n; ++k) {
        const std::size_t point = order[k], before = order[k - 1];
        const glm::vec3 direction = glm::normalize(points.position_m[point]);
        const glm::vec3 direction_before = glm::normalize(points.position_m[before]);
        const bool is_on_same_ray = glm::distance(direction, direction_before) < float(kOneRay_rad);
        if (ring_time(point) == ring_time(before) && is_on_same_ray)
            points.return_number[point] =
                std::uint8_t(std::min(points.return_number[before] + 1, int(kMostReturns)));
    }
    select_points(points, order);
}

/// Checks that a table has positions, and that all selected positions are plausible.
/// @throws DataError with the field or the number of the point
void check_positions(const PointTable& table, const SelectedPoints& selected, const std::string& where) {
    const auto* x = table.find_field(PointAttribute::x);
    const auto* y = table.find_field(PointAttribute::y);
    const auto* z = table.find_field(PointAttribute::z);
    for (const auto& [field, name] : {std::pair(x, "x"), std::pair(y, "y"), std::pair(z, "z")})
        if (!field) fail("{}: the field {} is missing, expected x, y and z", where, name);
    for (std::size_t k = 0; k < selected.index.size(); ++k) {
        const glm::vec3 p = glm::abs(selected.position_m[k]);
        if (std::max({p.x, p.y, p.z}) <= kFarthestCoordinate_m) continue;
        const std::size_t i = selected.index[k];
        fail("{}: point {} is ({}, {}, {}), expected coordinates of at most {} m", where, i, (*x)[i], (*y)[i],
             (*z)[i], kFarthestCoordinate_m);
    }
}

/// Sets the intensity of each point, or 0 if the table has none or it is not finite.
void convert_intensities(LidarPoints& points, const FieldConverter& convert, const PointTable& table,
                         const PointFileUnits& units) {
    const auto* intensity = table.find_field(units.intensity_field);
    if (!intensity) intensity = table.find_field(PointAttribute::intensity);
    if (!intensity) points.intensity.assign(points.size(), 0.0f);
    convert.convert_field(points.intensity, intensity, [&](double value) {
        return std::isfinite(value) ? scale_intensity(value, units, "") : 0.0f;
    });
}

/// Converts return numbers of a file, which begin with 0 or 1, to numbers from 1. The
/// smallest number shows where they begin, because every file has first returns.
void convert_numbers(LidarPoints& points, const FieldConverter& convert, const PointFieldView& numbers,
                     std::size_t n_points) {
    double least = numbers[0];
    numbers.for_each(n_points, [&](std::size_t, double value) { least = std::min(least, value); });
    const double first_number = least == 1.0 ? 1.0 : 0.0;
    convert.convert_field(points.return_number, &numbers, [&](double value) {
        const double number_from_0 = value - first_number;
        if (!(number_from_0 >= 0.0 && number_from_0 < double(kMostReturns)))
            fail(": the return number is {}, expected {} (the strongest return) to {}", value, first_number,
                 first_number + double(kMostReturns - 1));
        return std::uint8_t(1 + int(number_from_0));
    });
}

/// Sets return numbers from the field return_number. Without this field, computes them
/// from return_type (for example "strongest"), ring and time, if the table has all three.
void convert_returns(LidarPoints& points, const FieldConverter& convert, const PointTable& table) {
    const auto* numbers = table.find_field(PointAttribute::return_number);
    const auto* types = table.find_field(PointAttribute::return_type);
    if (numbers) {
        convert_numbers(points, convert, *numbers, table.n);
    } else if (types && !points.ring.empty() && !points.time_offset_s.empty()) {
        std::vector<double> type_of_point;
        convert.convert_field(type_of_point, types, std::identity());
        set_return_numbers(points, type_of_point);
    }
}

}  // namespace

LidarPoints convert_table(const PointTable& table, const PointFileUnits& units, double frame_time_s,
                          const std::string& where) {
    SelectedPoints selected = select_returns(table, units);
    LidarPoints points;
    if (units.returns.exist)  // Two returns of a ray have no numbers. Sorts `selected` by ray.
        points.return_number =
            number_returns(table, units.returns, units.intensity_field, selected.index, selected.position_m);
    check_positions(table, selected, where);
    points.position_m = std::move(selected.position_m);

    const FieldConverter convert{.selected = selected.index, .where = where};
    convert_intensities(points, convert, table, units);
    const auto ring_of = [](double value) { return convert_ring(value, /*where=*/""); };  // `convert` adds it
    convert.convert_field(points.ring, table.find_field(PointAttribute::ring), ring_of);
    if (!units.ignore_times) convert_times(points, convert, table, units, frame_time_s);
    convert_returns(points, convert, table);
    return points;
}

}  // namespace relidar::read
