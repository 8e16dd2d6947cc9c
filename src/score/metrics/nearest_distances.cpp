// SPDX-License-Identifier: Apache-2.0
// Computes exact nearest neighbours between two point clouds, for Chamfer distance and
// F-score. Builds a k-d tree of the target points, and processes the query points in
// parallel. Uses double precision, because the points of a log can be far from the
// origin.
#include <relidar/score/metrics.hpp>

#include <cmath>

#include <fmt/format.h>
#include <nanoflann.hpp>

#include <relidar/base/error.hpp>

#include "base/parallel.hpp"

namespace relidar {
namespace {

/// Adapter that gives nanoflann access to a list of points. The names of the members must
/// be those that nanoflann calls.
struct KdTreeTargetCloud {
    const std::vector<glm::dvec3>& points;

    std::size_t kdtree_get_point_count() const { return points.size(); }
    double kdtree_get_pt(std::size_t index, std::size_t axis) const {
        return points[index][glm::length_t(axis)];
    }
    template <class Box>
    bool kdtree_get_bbox(Box&) const {
        return false;
    }
};

using Metric = nanoflann::L2_Simple_Adaptor<double, KdTreeTargetCloud>;
using Tree = nanoflann::KDTreeSingleIndexAdaptor<Metric, KdTreeTargetCloud, 3, std::uint32_t>;

constexpr std::size_t kLeafSize = 16;

void require_finite_points(const std::vector<glm::dvec3>& points, const char* cloud_name) {
    for (std::size_t i = 0; i < points.size(); ++i)
        if (!std::isfinite(points[i].x + points[i].y + points[i].z))
            throw DataError(fmt::format(
                "cannot search nearest points: point {} of the {} points is ({}, {}, {}), expected finite "
                "coordinates in metres",
                i, cloud_name, points[i].x, points[i].y, points[i].z));
}

}  // namespace

std::vector<double> compute_nearest_distances(const std::vector<glm::dvec3>& query_points,
                                              const std::vector<glm::dvec3>& target_points) {
    std::vector<double> distance(query_points.size());
    if (query_points.empty()) return distance;
    if (target_points.empty())
        throw DataError(
            fmt::format("cannot search nearest points: there are {} query points, but no target point",
                        query_points.size()));
    require_finite_points(query_points, "query");
    require_finite_points(target_points, "target");

    const KdTreeTargetCloud cloud{target_points};
    const Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(kLeafSize));
    parallel_for_in_blocks(query_points.size(), [&](std::size_t i) {
        std::uint32_t index = 0;
        double squared = 0.0;
        tree.knnSearch(&query_points[i].x, 1, &index, &squared);
        distance[i] = std::sqrt(squared);
    });
    return distance;
}

}  // namespace relidar
