// SPDX-License-Identifier: Apache-2.0
// Finds clusters of moved returns in each frame: returns at places that other frames see
// through. Private to scene.
#pragma once

#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/visibility.hpp"

namespace relidar {

inline constexpr int kNoLabel = -1;

/// Cluster of returns in one frame. It holds either moved returns without a label, or all
/// returns inside a moving labelled box. Using one type for both makes it possible to
/// follow an object beyond its labels.
struct MoverCluster {
    double time_s = 0.0;               ///< mean firing time of its returns
    glm::dvec3 centre_m{0.0};          ///< mean position of its returns, world
    std::vector<glm::dvec3> points_m;  ///< positions of its returns, world
    int label = kNoLabel;              ///< index in Sequence::boxes of the labelled box, or kNoLabel

    /// Adds the returns of another cluster of the same frame.
    void take_in(const MoverCluster& other);
};

/// Finds the clusters of moved returns in all given frames. Processes a long log in
/// sections, and each process of a process group handles its share.
/// @param positions indices of the frames, ascending
/// @param visibility visibility in these frames
/// @return [positions] clusters of each frame, identical in all processes
std::vector<std::vector<MoverCluster>> find_mover_clusters(const Sequence& sequence,
                                                           const std::vector<int>& positions,
                                                           Visibility& visibility, const Progress& progress,
                                                           const ProcessGroup& group);

}  // namespace relidar
