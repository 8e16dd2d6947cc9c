// SPDX-License-Identifier: Apache-2.0
#include "read/scans/point_meaning.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "read/files/dropped_ray.hpp"

namespace relidar::read {
namespace {

// Minimum share of the points that occur exactly twice. In other clouds, positions repeat
// only if coordinates are rounded.
constexpr double kLeastRepeated = 0.1;
// Share of the repeated points that must follow the same rule.
constexpr double kMinRegularShare = 0.95;
// If a driver removes repeated points, as Nebula does for a Velodyne, only true second
// returns share ring and time with another point. At least this number, and this share of
// them, must be on the same ray.
constexpr std::size_t kFewestPairs = 16;
constexpr double kLeastOnRay = 0.5, kMostLargeGroups = 0.01;
// Two points are on the same ray if the angle between them is below kOneRay_rad, plus the
// parallax of a beam that starts kLargestOffset_m beside the centre.
constexpr double kLargestOffset_m = 0.1;
// Columns of no sensor are this close. Such pairs are returns, even if they are frequent.
constexpr double kExactRay_rad = 2e-4;
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

/// Returns pairs of indices of points that occur exactly twice, the smaller index first.
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

/// Numbers of groups of points with equal ring and time in some clouds.
struct PairCounts {
    std::size_t n_groups = 0;
    std::size_t n_pairs = 0;   ///< groups of two points
    std::size_t n_large = 0;   ///< groups of more points
    std::size_t n_on_ray = 0;  ///< pairs that can be returns of one ray, within kOneRay_rad
    std::size_t n_exact = 0;   ///< pairs with equal directions, within kExactRay_rad

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

/// Counts the groups of points with equal ring and time in a cloud. A group of two is a
/// pair: returns of one ray, or points of two columns that share a time. Counts pairs on
/// nearly the same ray, and exact ones, which are closer than columns of any sensor.
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
        ++counts.n_pairs;
        const glm::vec3 &first = points[indices[begin]], &second = points[indices[begin + 1]];
        if (are_on_same_ray(first, second, kOneRay_rad)) ++counts.n_on_ray;
        if (are_on_same_ray(first, second, kExactRay_rad)) ++counts.n_exact;
    }
}

/// Returns true if a point is in a block of first returns, which alternate with second.
bool is_first_return(std::size_t point, std::size_t block_size) { return point / block_size % 2 == 0; }

/// Returns the size of the blocks in which a cloud stores its first and second returns,
/// or 0. The returns of a ray have the same place in their blocks. So the size is the
/// difference of the indices of nearly all pairs.
std::size_t find_block_size(const std::vector<IndexPair>& pairs, std::size_t n_points) {
    std::map<std::size_t, std::size_t> n_pairs_of_size;
    for (const auto& [first, second] : pairs)
        if (is_first_return(first, second - first)) ++n_pairs_of_size[second - first];
    for (const auto& [size, n_pairs] : n_pairs_of_size)
        if (double(n_pairs) >= kMinRegularShare * double(pairs.size()) && n_points % (2 * size) == 0)
            return size;
    return 0;
}

/// Finds where a cloud stores the second return of a ray: in the block after the block of
/// the first return, or at any place, with equal ring and time. If a ray has only one
/// return, the sensor stores it twice, so pairs of equal points show the layout.
/// @param repeated  pairs of equal points
/// @param keys  [points] ring and time; may be empty
/// @return `exist` is false if the pairs follow neither rule, so that they are accidental
UnnumberedReturns find_layout(const std::vector<IndexPair>& repeated, const std::vector<RayKey>& keys,
                              std::size_t n_points) {
    const std::size_t block_size = find_block_size(repeated, n_points);
    const auto n_equal_keys = std::ranges::count_if(
        repeated, [&](const IndexPair& pair) { return !keys.empty() && keys[pair[0]] == keys[pair[1]]; });
    const bool share_keys = double(n_equal_keys) >= kMinRegularShare * double(repeated.size());
    return {.exist = block_size > 0 || share_keys,
            .block_size = block_size,
            .are_halves = 2 * block_size == n_points};
}

/// Pairs each selected first return with the point at the same place in the next block.
/// Blocks of first and second returns alternate, and each first one has a second one.
/// @param selected  indices of points
/// @return [selected] position of the other return in `selected`, or kNoPoint
std::vector<std::size_t> pair_by_block(const std::vector<std::uint32_t>& selected, std::size_t n_points,
                                       std::size_t block_size) {
    std::vector<std::size_t> position_of_point(n_points, kNoPoint);
    for (std::size_t k = 0; k < selected.size(); ++k) position_of_point[selected[k]] = k;
    std::vector<std::size_t> partner(selected.size(), kNoPoint);
    for (std::size_t k = 0; k < selected.size(); ++k) {
        const std::size_t point = selected[k];
        if (is_first_return(point, block_size)) partner[k] = position_of_point[point + block_size];
    }
    return partner;
}

/// Pairs points of equal ring and time that are on the same ray. A time alone is not
/// enough, because rounded times join several columns.
/// @param order  all points, sorted by key
std::vector<std::size_t> pair_by_key(const std::vector<RayKey>& keys, const std::vector<glm::vec3>& points,
                                     const std::vector<std::size_t>& order) {
    const std::size_t n = keys.size();
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

/// The other return of each ray.
struct ReturnPairs {
    std::vector<std::size_t> order;    ///< points, the returns of a ray close together
    std::vector<std::size_t> partner;  ///< [points] the other return, or kNoPoint; each pair occurs once
};

/// Pairs the two returns of each ray: by their places in the table if it stores blocks of
/// first and second returns, or else by ring, time and direction.
/// @param selected  indices in the table; the result contains positions in this array
/// @param points  [selected] positions
ReturnPairs pair_returns(const PointTable& table, const UnnumberedReturns& layout,
                         const std::vector<std::uint32_t>& selected, const std::vector<glm::vec3>& points) {
    ReturnPairs pairs{.order = std::vector<std::size_t>(selected.size()),
                      .partner = std::vector<std::size_t>(selected.size(), kNoPoint)};
    std::iota(pairs.order.begin(), pairs.order.end(), std::size_t(0));
    // The size of half a cloud differs from cloud to cloud.
    const std::size_t block_size = layout.are_halves ? table.n / 2 : layout.block_size;
    const bool has_full_blocks = block_size > 0 && table.n % (2 * block_size) == 0;
    if (has_full_blocks) {
        pairs.partner = pair_by_block(selected, table.n, block_size);
    } else if (const std::vector<RayKey> key_of_point = read_ray_keys(table); !key_of_point.empty()) {
        std::vector<RayKey> keys;
        for (const std::uint32_t point : selected) keys.push_back(key_of_point[point]);
        std::ranges::stable_sort(pairs.order, {}, [&](std::size_t k) { return keys[k]; });
        pairs.partner = pair_by_key(keys, points, pairs.order);
    }
    return pairs;
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
    PairCounts counts;  // of clouds without copies
    for (const PointTable& cloud : clouds) {
        if (cloud.find_field(PointAttribute::return_number) || cloud.find_field(PointAttribute::return_type))
            continue;
        const std::vector<glm::vec3> points = read_positions(cloud);
        std::vector<std::size_t> valid;
        for (std::size_t i = 0; i < cloud.n; ++i)
            if (is_return_point(points[i])) valid.push_back(i);
        const std::vector<RayKey> keys = read_ray_keys(cloud);
        const std::vector<IndexPair> repeated = find_repeated(points, valid);
        const double n_points_in_pairs = 2.0 * double(repeated.size());
        const bool has_copies =
            !repeated.empty() && n_points_in_pairs >= kLeastRepeated * double(valid.size());
        if (has_copies) {
            const UnnumberedReturns returns = find_layout(repeated, keys, cloud.n);
            if (returns.exist) return returns;
        } else if (!keys.empty()) {
            count_pairs(counts, points, keys, std::move(valid));
        }
    }
    return {.exist = counts.are_returns()};
}

std::vector<std::uint8_t> number_returns(const PointTable& table, const UnnumberedReturns& layout,
                                         const std::string& intensity_field,
                                         std::vector<std::uint32_t>& selected,
                                         std::vector<glm::vec3>& points) {
    // All indices below are positions in `selected` and `points`.
    const auto [order, partner] = pair_returns(table, layout, selected, points);
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
