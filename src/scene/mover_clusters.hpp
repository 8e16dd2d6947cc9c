// SPDX-License-Identifier: Apache-2.0
// Finds clusters of moved returns in each frame. A return has moved if other frames
// observe an empty space at its position. Private to scene.
#pragma once

#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/visibility.hpp"

namespace relidar {

inline constexpr int kNoLabel = -1;

/// Cluster of returns in one frame. It holds either moved returns without a label, or all
/// returns inside a moving labelled box. The same type is used for both, so that a track
/// can continue beyond the labels of an object.
struct MoverCluster {
    double time_s = 0.0;               ///< mean firing time of its returns
    glm::dvec3 centre_m{0.0};          ///< mean position of its returns, world
    std::vector<glm::dvec3> points_m;  ///< positions of its returns, world
    /// index of the labelled box in Sequence::boxes; kNoLabel if there is no label
    int label = kNoLabel;

    /// Adds the returns of another cluster of the same frame.
    void merge(const MoverCluster& other);
};

/// Finds the clusters of moved returns in all given frames. Splits a long log into
/// sections, which are shared among the processes of a group.
/// @param positions indices of the frames, ascending
/// @param visibility visibility in these frames
/// @return [positions] clusters of each frame, identical in all processes
std::vector<std::vector<MoverCluster>> find_mover_clusters(const Sequence& sequence,
                                                           const std::vector<int>& positions,
                                                           Visibility& visibility, const Progress& progress,
                                                           const ProcessGroup& group);

}  // namespace relidar
