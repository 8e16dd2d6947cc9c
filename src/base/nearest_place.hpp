// SPDX-License-Identifier: Apache-2.0
// Finds the nearest of several points, for example the sensor position nearest to a
// point.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include <glm/glm.hpp>
#include <nanoflann.hpp>

namespace relidar {

/// k-d tree that finds the nearest of its points. Thread-safe.
/// @tparam Scalar type of coordinates and distances
template <class Scalar>
class NearestPlace {
public:
    using Point = glm::vec<3, Scalar>;

    /// Builds the tree from at least one point.
    explicit NearestPlace(std::vector<Point> places)
        : places_{std::move(places)}, tree_(3, places_, nanoflann::KDTreeSingleIndexAdaptorParams(8)) {}
    NearestPlace(const NearestPlace&) = delete;  // Not copyable, because the tree refers to `places_`.
    NearestPlace& operator=(const NearestPlace&) = delete;

    /// Returns the index of the nearest point, and the squared distance to it.
    std::pair<std::size_t, Scalar> find(const Point& point) const {
        std::pair<std::size_t, Scalar> found{0, Scalar(0)};
        tree_.knnSearch(&point.x, 1, &found.first, &found.second);
        return found;
    }
    std::size_t of(const Point& point) const { return find(point).first; }
    Scalar squared_distance(const Point& point) const { return find(point).second; }

private:
    /// Container of points with the member functions that nanoflann requires.
    struct Places {
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

    Places places_;
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<Scalar, Places>, Places, 3, std::size_t>
        tree_;
};

}  // namespace relidar
