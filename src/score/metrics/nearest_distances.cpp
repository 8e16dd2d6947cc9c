// SPDX-License-Identifier: Apache-2.0
// Computes exact nearest neighbours between two point clouds, for Chamfer distance and
// F-score. Builds a k-d tree of the target points, and processes the query points in
// parallel. Uses double precision, because the points of a log can be far from the
// origin.
#include <relidar/score/metrics.hpp>

#include <cmath>

#include "base/fail.hpp"
#include "base/geometry/nearest_place.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

void check_finite_points(const std::vector<glm::dvec3>& points, const char* cloud_name) {
    for (std::size_t i = 0; i < points.size(); ++i)
        if (!std::isfinite(points[i].x + points[i].y + points[i].z))
            fail(
                "cannot search nearest points: point {} of the {} points is ({}, {}, {}), expected finite "
                "coordinates in metres",
                i, cloud_name, points[i].x, points[i].y, points[i].z);
}

}  // namespace

std::vector<double> nearest_distances_m(const std::vector<glm::dvec3>& from,
                                        const std::vector<glm::dvec3>& to) {
    std::vector<double> distance(from.size());
    if (from.empty()) return distance;
    if (to.empty())
        fail("cannot search nearest points: there are {} query points, but no target point", from.size());
    check_finite_points(from, "query");
    check_finite_points(to, "target");

    const NearestPointFinder<double> targets(to);
    parallel_blocks(from.size(),
                    [&](std::size_t i) { distance[i] = std::sqrt(targets.nearest_distance_sq(from[i])); });
    return distance;
}

}  // namespace relidar
