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
constexpr std::size_t kMostNeighbours = 64;  // number of points of equal ring and time that are compared

constexpr std::size_t kNoPoint = SIZE_MAX;  // no point

using RayKey = std::pair<double, double>;  // ring and time

/// Returns ring and time of each point, or nothing if a field is missing.
std::vector<RayKey> read_ray_keys(const PointTable& table) {
    const PointFieldView *ring = table.find_field(PointAttribute::ring),
                         *time = table.find_field(PointAttribute::time);
    std::vector<RayKey> keys(ring && time ? table.n : 0);
    if (keys.empty()) return keys;
    ring->for_each(table.n, [&](std::size_t i, double value) { keys[i].first = value; });
    time->for_each(table.n, [&](std::size_t i, double value) {
        keys[i].second = std::isnan(value) ? INFINITY : value;  // NaN cannot be sorted
    });
    return keys;
}

bool are_on_same_ray(const glm::vec3& first, const glm::vec3& second, double limit_rad = kOneRay_rad) {
    const glm::dvec3 a(first), b(second);
    const double near_m = glm::length(a), far_m = glm::length(b);
    const double angle_rad = std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
    return angle_rad < limit_rad + kLargestOffset_m * std::abs(1.0 / near_m - 1.0 / far_m);
}

/// Returns the pairs of indices of points that occur exactly twice.
std::vector<std::array<std::size_t, 2>> find_repeated(const std::vector<glm::vec3>& points,
                                                      std::vector<std::size_t> indices) {
    const auto position = [&](std::size_t i) { return std::array{points[i].x, points[i].y, points[i].z}; };
    std::ranges::stable_sort(indices, {}, position);
    std::vector<std::array<std::size_t, 2>> pairs;
    for (std::size_t k = 0, next = 0; k < indices.size(); k = next) {
        while (next < indices.size() && points[indices[next]] == points[indices[k]]) ++next;
        if (next == k + 2) pairs.push_back({indices[k], indices[k + 1]});
    }
    return pairs;
}

/// Counts groups of points with equal ring and time.
struct PairCounts {
    std::size_t n_groups = 0, n_pairs = 0, n_large = 0, n_on_ray = 0, n_exact = 0;

    /// Returns true if some points share ring and time with another point, and if these
    /// pairs are on the same ray. If most points are pairs, they must be on exactly one
    /// ray.
    bool are_returns() const {
        const bool are_exact = double(n_exact) >= kMinRegularShare * double(n_pairs);
        return n_pairs >= kFewestPairs && (2 * n_pairs <= n_groups || are_exact) &&
               double(n_large) <= kMostLargeGroups * double(n_groups) &&
               double(n_on_ray) >= kLeastOnRay * double(n_pairs);
    }
};

/// Adds the points of a cloud to the counts. Sorts them so that points with the same ring
/// and time are neighbours.
void add_pairs(PairCounts& counts, const std::vector<glm::vec3>& points, const std::vector<RayKey>& keys,
               std::vector<std::size_t> indices) {
    auto& [n_groups, n_pairs, n_large, n_on_ray, n_exact] = counts;
    std::ranges::stable_sort(indices, {}, [&](std::size_t i) { return keys[i]; });
    for (std::size_t k = 0, next = 0; k < indices.size(); k = next, ++n_groups) {
        while (next < indices.size() && keys[indices[next]] == keys[indices[k]]) ++next;
        n_large += next > k + 2;
        if (next != k + 2) continue;
        ++n_pairs;
        n_on_ray += are_on_same_ray(points[indices[k]], points[indices[k + 1]]);
        n_exact += are_on_same_ray(points[indices[k]], points[indices[k + 1]], kSameRay_rad);
    }
}

/// Returns for each selected point the other return of its ray, or kNoPoint. Each pair
/// occurs once. Sorts `order` so that the returns of a ray are close together.
std::vector<std::size_t> find_partners(const PointTable& table, const UnnumberedReturns& layout,
                                       const std::vector<std::uint32_t>& selected,
                                       const std::vector<glm::vec3>& points,
                                       std::vector<std::size_t>& order) {
    const std::size_t n = selected.size();
    std::vector<std::size_t> partner(n, kNoPoint);
    // Some drivers store second returns at a constant distance after the first returns,
    // for example in the second half. Otherwise, compares points with equal ring and
    // time.
    const std::size_t distance = layout.are_halves ? table.n / 2 : layout.distance;
    if (distance > 0 && table.n % (2 * distance) == 0) {
        std::vector<std::size_t> rank(table.n, kNoPoint);
        for (std::size_t k = 0; k < n; ++k) rank[selected[k]] = k;
        for (std::size_t k = 0; k < n; ++k)
            if (selected[k] / distance % 2 == 0) partner[k] = rank[selected[k] + distance];
    } else if (const std::vector<RayKey> keys = read_ray_keys(table); !keys.empty()) {
        const auto key = [&](std::size_t k) { return keys[selected[k]]; };
        std::ranges::stable_sort(order, {}, key);
        std::vector<bool> is_second(n, false);
        for (std::size_t a = 0; a < n; ++a) {
            const std::size_t k = order[a];
            for (std::size_t b = a + 1; !is_second[k] && b < std::min(n, a + kMostNeighbours); ++b) {
                if (key(order[b]) != key(k)) break;
                if (is_second[order[b]] || !are_on_same_ray(points[k], points[order[b]])) continue;
                partner[k] = order[b];
                is_second[order[b]] = true;
                break;
            }
        }
    }
    return partner;
}

/// Finds returns from the repeated points of a cloud. Otherwise counts its pairs.
UnnumberedReturns find_in_cloud(const PointTable& cloud, PairCounts& counts) {
    if (cloud.find_field(PointAttribute::return_number) || cloud.find_field(PointAttribute::return_type))
        return {};
    const std::vector<glm::vec3> points = read_positions(cloud);
    std::vector<std::size_t> valid;
    for (std::size_t i = 0; i < cloud.n; ++i)
        if (is_return_point(points[i])) valid.push_back(i);
    const auto repeated = find_repeated(points, valid);
    const std::vector<RayKey> keys = read_ray_keys(cloud);
    UnnumberedReturns returns{.about =
                                  "the points have two returns of each ray without numbers; equal returns "
                                  "are read as one return, and of two other returns the stronger is first"};
    if (2.0 * double(repeated.size()) < kLeastRepeated * double(valid.size())) {
        if (!keys.empty()) add_pairs(counts, points, keys, valid);
        return returns;
    }
    std::map<std::size_t, std::size_t> n_of_distance;
    std::size_t n_of_ray = 0;
    for (const auto& [first, second] : repeated) {
        if (first / (second - first) % 2 == 0) ++n_of_distance[second - first];
        n_of_ray += !keys.empty() && keys[first] == keys[second];
    }
    const double least = kMinRegularShare * double(repeated.size());
    for (const auto& [distance, n] : n_of_distance)
        if (double(n) >= least && cloud.n % (2 * distance) == 0) returns.distance = distance;
    returns.are_halves = 2 * returns.distance == cloud.n;
    returns.exist = returns.distance > 0 || double(n_of_ray) >= least;
    return returns;
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
    const std::size_t n = selected.size();
    std::vector<std::size_t> order(n), partner;
    std::iota(order.begin(), order.end(), std::size_t(0));
    partner = find_partners(table, layout, selected, points, order);
    const PointFieldView* intensity = table.find_field(intensity_field);
    std::vector<std::uint8_t> numbers;
    std::vector<std::uint32_t> sorted;
    std::vector<glm::vec3> sorted_points;
    std::vector<bool> is_done(n, false);
    const auto add = [&](std::size_t k, std::uint8_t number) {
        numbers.push_back(number);
        sorted.push_back(selected[k]);
        sorted_points.push_back(points[k]);
        is_done[k] = true;
    };
    for (std::size_t k : order) {
        if (is_done[k]) continue;
        std::size_t other = partner[k];
        // Both returns have the same position, so one of them is removed.
        if (other != kNoPoint && points[other] == points[k]) is_done[std::exchange(other, kNoPoint)] = true;
        // The stronger return is number 1.
        if (other != kNoPoint && intensity && (*intensity)[selected[other]] > (*intensity)[selected[k]])
            std::swap(k, other);
        add(k, 1);
        if (other != kNoPoint) add(other, 2);
    }
    selected = std::move(sorted);
    points = std::move(sorted_points);
    return numbers;
}

}  // namespace relidar::read
