// SPDX-License-Identifier: Apache-2.0
// Groups of returns, frame by frame, that lie where other frames see through: what moved.
// Private to scene.
#pragma once

#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/visibility.hpp"

namespace relidar {

inline constexpr int kNoLabel = -1;

/// One group in one frame: of what moved without a label, or all that lies in a labelled
/// box that moves, so that both are seen as one thing where the label ends.
struct MoverCluster {
    double time_s = 0.0;               ///< mean time at which its returns were seen
    glm::dvec3 centre_m{0.0};          ///< world, mean of its returns
    std::vector<glm::dvec3> points_m;  ///< world
    int label = kNoLabel;              ///< position in Sequence::boxes of the box it lies in

    /// Adds the returns of a group of the same frame.
    void take_in(const MoverCluster& other);
};

/// Looks at a long log in stretches, of which each process of a process group does its
/// share.
/// @param positions  frames that are looked at, ascending @param visibility  of these
/// frames
/// @return [positions] clusters of each, in all processes
std::vector<std::vector<MoverCluster>> find_mover_clusters(const Sequence& sequence,
                                                           const std::vector<int>& positions,
                                                           Visibility& visibility, const Progress& progress,
                                                           const ProcessGroup& group);

}  // namespace relidar
