// SPDX-License-Identifier: Apache-2.0
#include "read/scans/point_meaning.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "read/scans/dropped_ray.hpp"

namespace relidar::read {
namespace {

// Minimum share of the points that occur exactly twice. In other clouds, positions repeat
// only if coordinates are rounded.
constexpr double kLeastRepeated = 0.1;
// Share of the repeated points that must follow the same rule.
constexpr double kMinRegularShare = 0.95;
// If a driver removes repeated points, only true second returns share ring and time with
// another point. At least this number, and this share of them, must be on the same ray.
constexpr std::size_t kFewestPairs = 16;
constexpr double kLeastOnRay = 0.5, kMostLargeGroups = 0.01;
// Two points are on the same ray if the angle between them is below kOneRay_rad, plus the
// parallax of a beam that starts kLargestOffset_m beside the centre.
constexpr double kOneRay_rad = 1.4e-3, kLargestOffset_m = 0.1;
// Columns of no sensor are this close. Such pairs are returns, even if they are frequent.
constexpr double kSameRay_rad = 2e-4;
// Number of points of equal ring and time that are compared. It limits the search in
// clouds with coarse times.
constexpr std::size_t kMostNeighbours = 64;

constexpr std::size_t kNoPoint = SIZE_MAX;

using IndexPair = std::array<std::size_t, 2>;
using RayKey = std::pair<double, double>;  // ring and time

/// Returns ring and time of each point, or nothing if a field is missing.
std::vector<RayKey> read_ray_keys(const PointTable& table) {
    const PointFieldView* ring = table.find_field(PointAttribute::ring);
    const PointFieldView* time = table.find_field(PointAttribute::time);
    std::vector<RayKey> keys(ring && time ? table.n : 0);
    if (keys.empty()) return keys;
    ring->for_each(table.n, [&](std::size_t i, double value) { keys[i].first = value; });
    time->for_each(table.n, [&](std::size_t i, double value) {
        keys[i].second = std::isnan(value) ? INFINITY : value;  // NaN cannot be sorted
    });
    return keys;
}

/// Returns true if two points can be returns of one ray: their directions, seen from the
/// centre of the sensor, differ by less than `limit_rad` and the parallax of the beam.
bool are_on_same_ray(const glm::vec3& first, const glm::vec3& second, double limit_rad) {
    const glm::dvec3 a(first), b(second);
    const double parallax_rad = kLargestOffset_m * std::abs(1.0 / glm::length(a) - 1.0 / glm::length(b));
    const double angle_rad = std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
    return angle_rad < limit_rad + parallax_rad;
}

/// Returns the pairs of indices of points that occur exactly twice. In a pair, the
/// smaller index is first.
std::vector<IndexPair> find_repeated(const std::vector<glm::vec3>& points, std::vector<std::size_t> indices) {
    const auto position = [&](std::size_t i) { return std::array{points[i].x, points[i].y, points[i].z}; };
    std::ranges::stable_sort(indices, {}, position);
    std::vector<IndexPair> pairs;
    for (std::size_t begin = 0, end = 0; begin < indices.size(); begin = end) {
        while (end < indices.size() && points[indices[end]] == points[indices[begin]]) ++end;
        if (end - begin == 2) pairs.push_back({indices[begin], indices[begin + 1]});
    }
    return pairs;
}

/// Counts groups of points with equal ring and time, over some clouds.
struct PairCounts {
    std::size_t n_groups = 0;
    std::size_t n_pairs = 0;   ///< groups of two points
    std::size_t n_large = 0;   ///< groups of more points
    std::size_t n_on_ray = 0;  ///< pairs whose directions differ by less than kOneRay_rad
    std::size_t n_exact = 0;   ///< pairs whose directions differ by less than kSameRay_rad

    /// Returns true if the pairs are the two returns of one ray. If most groups are
    /// pairs, they could also be two columns that share a time, so their directions must
    /// be equal.
    bool are_returns() const {
        const bool are_exact = double(n_exact) >= kMinRegularShare * double(n_pairs);
        const bool are_rare = 2 * n_pairs <= n_groups;
        return n_pairs >= kFewestPairs && (are_rare || are_exact) &&
               double(n_large) <= kMostLargeGroups * double(n_groups) &&
               double(n_on_ray) >= kLeastOnRay * double(n_pairs);
    }
};

/// Counts the groups of points with equal ring and time in a cloud, and how many of them
/// are pairs on one ray.
/// @param keys  [points] ring and time
/// @param indices  points that are compared
void count_pairs(PairCounts& counts, const std::vector<glm::vec3>& points, const std::vector<RayKey>& keys,
                 std::vector<std::size_t> indices) {
    std::ranges::stable_sort(indices, {}, [&](std::size_t i) { return keys[i]; });
    for (std::size_t begin = 0, end = 0; begin < indices.size(); begin = end) {
        while (end < indices.size() && keys[indices[end]] == keys[indices[begin]]) ++end;
        const std::size_t group_size = end - begin;
        ++counts.n_groups;
        if (group_size > 2) ++counts.n_large;
        if (group_size != 2) continue;
        const glm::vec3 &first = points[indices[begin]], &second = points[indices[begin + 1]];
        ++counts.n_pairs;
        if (are_on_same_ray(first, second, kOneRay_rad)) ++counts.n_on_ray;
        if (are_on_same_ray(first, second, kSameRay_rad)) ++counts.n_exact;
    }
}

/// Returns the difference d between the indices of nearly all pairs, or 0 if it varies. A
/// file then has blocks of d first returns and d second returns in turn. So d = 1 if both
/// returns of a ray are neighbours, and d = n_points / 2 if all second returns follow.
std::size_t find_pair_distance(const std::vector<IndexPair>& pairs, std::size_t n_points) {
    std::map<std::size_t, std::size_t> n_pairs_of_distance;
    for (const auto& [first, second] : pairs) {
        const std::size_t distance = second - first;
        const bool is_in_first_block = first / distance % 2 == 0;
        if (is_in_first_block) ++n_pairs_of_distance[distance];
    }
    std::size_t usual_distance = 0;
    for (const auto& [distance, n_pairs] : n_pairs_of_distance)
        if (double(n_pairs) >= kMinRegularShare * double(pairs.size()) && n_points % (2 * distance) == 0)
            usual_distance = distance;
    return usual_distance;
}

/// Finds out how a cloud stores second returns, from the points that occur twice. A
/// sensor repeats the only return of a ray, so both points of such a pair are stored like
/// a first and a second return: in blocks, or with equal ring and time. If few points
/// occur twice, only adds the pairs of equal ring and time to `counts`.
UnnumberedReturns find_in_cloud(const PointTable& cloud, PairCounts& counts) {
    if (cloud.find_field(PointAttribute::return_number) || cloud.find_field(PointAttribute::return_type))
        return {};
    const std::vector<glm::vec3> points = read_positions(cloud);
    std::vector<std::size_t> valid;
    for (std::size_t i = 0; i < cloud.n; ++i)
        if (is_return_point(points[i])) valid.push_back(i);
    const std::vector<IndexPair> repeated = find_repeated(points, valid);
    const std::vector<RayKey> keys = read_ray_keys(cloud);
    UnnumberedReturns returns{.note =
                                  "the points have two returns of each ray without numbers; equal returns "
                                  "are read as one return, and of two other returns the stronger is first"};
    const double n_points_in_pairs = 2.0 * double(repeated.size());
    if (repeated.empty() || n_points_in_pairs < kLeastRepeated * double(valid.size())) {
        if (!keys.empty()) count_pairs(counts, points, keys, valid);
        return returns;
    }
    returns.distance = find_pair_distance(repeated, cloud.n);
    returns.are_halves = 2 * returns.distance == cloud.n;
    const auto have_equal_keys = [&](const IndexPair& pair) {
        return !keys.empty() && keys[pair[0]] == keys[pair[1]];
    };
    const auto n_equal_keys = std::ranges::count_if(repeated, have_equal_keys);
    const bool are_in_blocks = returns.distance > 0;
    const bool share_keys = double(n_equal_keys) >= kMinRegularShare * double(repeated.size());
    returns.exist = are_in_blocks || share_keys;
    return returns;
}

/// Pairs each selected point of a block of first returns with the point `distance` later
/// in the table. Returns positions in `selected`, or kNoPoint.
std::vector<std::size_t> pair_by_distance(const std::vector<std::uint32_t>& selected, std::size_t n_points,
                                          std::size_t distance) {
    std::vector<std::size_t> position_of_point(n_points, kNoPoint);
    for (std::size_t k = 0; k < selected.size(); ++k) position_of_point[selected[k]] = k;
    std::vector<std::size_t> partner(selected.size(), kNoPoint);
    for (std::size_t k = 0; k < selected.size(); ++k) {
        const bool is_in_first_block = selected[k] / distance % 2 == 0;
        if (is_in_first_block) partner[k] = position_of_point[selected[k] + distance];
    }
    return partner;
}

/// Pairs points of equal ring and time that are on the same ray. A time alone is not
/// enough, because rounded times join several columns.
/// @param keys  [selected] ring and time
/// @param order  becomes the positions in `selected`, sorted by key
std::vector<std::size_t> pair_by_key(const std::vector<RayKey>& keys, const std::vector<glm::vec3>& points,
                                     std::vector<std::size_t>& order) {
    const std::size_t n = keys.size();
    std::ranges::stable_sort(order, {}, [&](std::size_t k) { return keys[k]; });
    std::vector<std::size_t> partner(n, kNoPoint);
    std::vector<bool> is_second(n, false);
    for (std::size_t place = 0; place < n; ++place) {
        const std::size_t first = order[place];
        if (is_second[first]) continue;
        const std::size_t end = std::min(n, place + kMostNeighbours);
        for (std::size_t next = place + 1; next < end && keys[order[next]] == keys[first]; ++next) {
            const std::size_t second = order[next];
            if (is_second[second] || !are_on_same_ray(points[first], points[second], kOneRay_rad)) continue;
            partner[first] = second;
            is_second[second] = true;
            break;
        }
    }
    return partner;
}

/// Returns for each selected point the other return of its ray, or kNoPoint. Each pair
/// occurs once.
/// @param order  positions in `selected`; sorted so that the returns of a ray are close
/// together
std::vector<std::size_t> find_partners(const PointTable& table, const UnnumberedReturns& layout,
                                       const std::vector<std::uint32_t>& selected,
                                       const std::vector<glm::vec3>& points,
                                       std::vector<std::size_t>& order) {
    const std::size_t distance = layout.are_halves ? table.n / 2 : layout.distance;
    const bool has_whole_blocks = distance > 0 && table.n % (2 * distance) == 0;
    if (has_whole_blocks) return pair_by_distance(selected, table.n, distance);

    const std::vector<RayKey> keys_of_table = read_ray_keys(table);
    if (keys_of_table.empty()) return std::vector<std::size_t>(selected.size(), kNoPoint);
    std::vector<RayKey> keys;
    for (const std::uint32_t point : selected) keys.push_back(keys_of_table[point]);
    return pair_by_key(keys, points, order);
}

}  // namespace

std::vector<glm::vec3> read_positions(const PointTable& table) {
    std::vector<glm::vec3> points(table.n, glm::vec3(0.0f));
    constexpr std::array kAxisAttributes = {PointAttribute::x, PointAttribute::y, PointAttribute::z};
    for (int axis = 0; axis < 3; ++axis)
        if (const PointFieldView* field = table.find_field(kAxisAttributes[std::size_t(axis)]))
            field->for_each(table.n, [&](std::size_t i, double value) { points[i][axis] = float(value); });
    return points;
}

UnnumberedReturns find_unnumbered(const std::vector<PointTable>& clouds) {
    UnnumberedReturns returns;
    PairCounts counts;
    for (const PointTable& cloud : clouds)  // in some clouds, all rays can have one return
        if (!returns.exist) returns = find_in_cloud(cloud, counts);
    returns.exist = returns.exist || counts.are_returns();
    return returns;
}

std::vector<std::uint8_t> number_returns(const PointTable& table, const UnnumberedReturns& layout,
                                         const std::string& intensity_field,
                                         std::vector<std::uint32_t>& selected,
                                         std::vector<glm::vec3>& points) {
    // All indices below are positions in `selected` and `points`.
    std::vector<std::size_t> order(selected.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    const std::vector<std::size_t> partner = find_partners(table, layout, selected, points, order);
    const PointFieldView* intensity = table.find_field(intensity_field);
    std::vector<std::uint8_t> numbers;
    std::vector<std::uint32_t> sorted;
    std::vector<glm::vec3> sorted_points;
    std::vector<bool> is_done(selected.size(), false);
    const auto add = [&](std::size_t k, std::uint8_t number) {
        numbers.push_back(number);
        sorted.push_back(selected[k]);
        sorted_points.push_back(points[k]);
        is_done[k] = true;
    };
    for (const std::size_t k : order) {
        if (is_done[k]) continue;
        const std::size_t other = partner[k];
        const bool has_other = other != kNoPoint;
        const bool is_copy = has_other && points[other] == points[k];
        if (!has_other || is_copy) {
            // A sensor repeats the only return of a ray. The copy is left out.
            add(k, 1);
            if (is_copy) is_done[other] = true;
            continue;
        }
        const bool is_other_stronger = intensity && (*intensity)[selected[other]] > (*intensity)[selected[k]];
        add(is_other_stronger ? other : k, 1);
        add(is_other_stronger ? k : other, 2);
    }
    selected = std::move(sorted);
    points = std::move(sorted_points);
    return numbers;
}

}  // namespace relidar::read
