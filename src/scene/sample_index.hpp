// SPDX-License-Identifier: Apache-2.0
// Finds the nearest samples of an actor in one frame, or in one phase of its walk.
// Private to scene.
#pragma once

#include <cmath>

#include <nanoflann.hpp>

#include "scene/point_surfels.hpp"

namespace relidar {

inline std::map<int, SampleIndices> group_samples(const LidarSamples& samples) {
    std::map<int, SampleIndices> groups;
    for (std::size_t i = 0; i < samples.size(); ++i) groups[samples[i].frame].push_back(std::uint32_t(i));
    return groups;
}

/// Adapter that gives nanoflann access to some of the samples.
struct SampleCloud {
    const LidarSamples& samples;
    SampleIndices of;  ///< indices of the samples
    std::size_t kdtree_get_point_count() const { return of.size(); }
    float kdtree_get_pt(std::size_t index, std::size_t axis) const {
        return samples[of[index]].position[int(axis)];
    }
    bool kdtree_get_bbox(auto&) const { return false; }
};
using SampleTree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, SampleCloud>,
                                                       SampleCloud, 3, std::size_t>;

/// Spatial index of a subset of the samples.
struct SampleIndex {
    SampleCloud cloud;
    SampleTree tree;
    SampleIndex(const LidarSamples& samples, SampleIndices indices)
        : cloud{samples, std::move(indices)}, tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(8)) {}

    /// Limited to `max_distance_m`.
    double nearest_m(const glm::vec3& point_m, double max_distance_m) const {
        if (cloud.of.empty()) return max_distance_m;
        std::size_t nearest;
        float distance2;
        tree.knnSearch(&point_m.x, 1, &nearest, &distance2);
        return std::min(max_distance_m, std::sqrt(double(distance2)));
    }
    /// Returns at most `max_count` indices of samples, sorted by distance.
    SampleIndices find_in_radius(const glm::vec3& point_m, double radius_m, std::size_t max_count) const {
        std::vector<std::size_t> tree_indices(max_count);
        std::vector<float> distance2(max_count);
        if (cloud.of.empty()) return {};
        tree_indices.resize(tree.knnSearch(&point_m.x, max_count, tree_indices.data(), distance2.data()));
        SampleIndices numbers;
        for (std::size_t k = 0; k < tree_indices.size() && double(distance2[k]) < radius_m * radius_m; ++k)
            numbers.push_back(cloud.of[tree_indices[k]]);
        return numbers;
    }
};

}  // namespace relidar
