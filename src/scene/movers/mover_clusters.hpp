// SPDX-License-Identifier: Apache-2.0
// Finds clusters of moved returns in each frame. A return counts as moved if other frames
// observe empty space at its position. Private to scene.
#pragma once

#include <relidar/scene/scene.hpp>

#include "scene/visibility.hpp"

namespace relidar {

inline constexpr int kNoLabel = -1;

/// Points of one moving object in one frame. If the object has a label, these are the
/// points inside its labelled box.
struct MoverCluster {
    double time_s = 0.0;               ///< mean firing time of its returns
    glm::dvec3 centre_m{0.0};          ///< mean position of its returns, world
    std::vector<glm::dvec3> points_m;  ///< positions of its returns, world
    int label = kNoLabel;              ///< index in Log::boxes, or kNoLabel

    void merge_cluster(const MoverCluster& other);
};
using ClustersByFrame = std::vector<std::vector<MoverCluster>>;  ///< [frames]

/// Finds the clusters of points on moving objects in the given frames (ascending). The
/// processes of the group share a long log.
/// @return [frames] clusters of each frame, identical in all processes
ClustersByFrame find_clusters(const Log& log, const std::vector<int>& frames, VisibilityChecker& view,
                              const Progress& progress, const ProcessGroup& group);

}  // namespace relidar
