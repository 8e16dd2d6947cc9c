// SPDX-License-Identifier: Apache-2.0
// Finds the nearest of several points.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include <glm/glm.hpp>
#include <nanoflann.hpp>

namespace relidar {

/// k-d tree. Thread-safe.
/// @tparam Scalar type of coordinates and distances
template <class Scalar>
class NearestPointFinder {
public:
    using Point = glm::vec<3, Scalar>;

    explicit NearestPointFinder(std::vector<Point> points)
        : points_{std::move(points)}, tree_(3, points_, nanoflann::KDTreeSingleIndexAdaptorParams(8)) {}
    NearestPointFinder(const NearestPointFinder&) =
        delete;  // Not copyable, because the tree refers to `points_`.
    NearestPointFinder& operator=(const NearestPointFinder&) = delete;

    std::pair<std::size_t, Scalar> nearest(const Point& query_point) const {
        std::pair<std::size_t, Scalar> index_and_squared_distance{0, Scalar(0)};
        tree_.knnSearch(&query_point.x, 1, &index_and_squared_distance.first,
                        &index_and_squared_distance.second);
        return index_and_squared_distance;
    }
    std::size_t nearest_index(const Point& query_point) const { return nearest(query_point).first; }
    Scalar nearest_distance_sq(const Point& query_point) const { return nearest(query_point).second; }

private:
    struct KdTreePoints {
        std::vector<Point> all;
        std::size_t kdtree_get_point_count() const { return all.size(); }
        Scalar kdtree_get_pt(std::size_t index, std::size_t axis) const {
            return all[index][static_cast<int>(axis)];
        }
        template <class Box>
        bool kdtree_get_bbox(Box&) const {
            return false;
        }
    };

    KdTreePoints points_;
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<Scalar, KdTreePoints>, KdTreePoints, 3,
                                        std::size_t>
        tree_;
};

}  // namespace relidar
