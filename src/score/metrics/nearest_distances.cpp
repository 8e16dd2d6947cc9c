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

std::vector<double> nearest_distances_m(const std::vector<glm::dvec3>& query_points,
                                        const std::vector<glm::dvec3>& target_points) {
    std::vector<double> distance(query_points.size());
    if (query_points.empty()) return distance;
    if (target_points.empty())
        fail("cannot search nearest points: there are {} query points, but no target point",
             query_points.size());
    check_finite_points(query_points, "query");
    check_finite_points(target_points, "target");

    const NearestPointFinder<double> targets(target_points);
    parallel_blocks(query_points.size(), [&](std::size_t i) {
        distance[i] = std::sqrt(targets.nearest_distance_sq(query_points[i]));
    });
    return distance;
}

}  // namespace relidar
