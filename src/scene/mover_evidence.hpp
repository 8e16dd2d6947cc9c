// SPDX-License-Identifier: Apache-2.0
// Decides whether returns belong to a moving or to a static object. Compares the returns
// with frames in which the tracked object is elsewhere. Private to scene.
#pragma once

#include <relidar/log/sequence.hpp>

#include "scene/mover_clusters.hpp"
#include "scene/visibility.hpp"

namespace relidar {

/// Number of frames which show that the object at a position has moved, and number of
/// frames which show that it stayed.
struct Evidence {
    /// Number of frames with a return at the position although the tracked object is
    /// elsewhere. Something else occupies the position.
    std::size_t stayed = 0;
    std::size_t left = 0;  ///< frames that observe an empty space at the position
    void operator+=(const Evidence& other) { stayed += other.stayed, left += other.left; }
    bool has_observations() const { return stayed + left > 0; }
    bool has_proof_of_rest() const { return stayed > 0 && stayed >= left; }
    bool has_proof_of_motion() const { return left > kMuchMore * stayed; }
    /// Motion is proven if `left` is more than this factor times `stayed`. `stayed` can
    /// be above zero for a moving object, because other objects pass behind or near it.
    static constexpr std::size_t kMuchMore = 3;
};

/// Evidence of motion, summed over all returns of a track or of a part of the track.
struct EvidenceSum {
    Evidence looks;
    std::size_t returns = 0;
    std::size_t told = 0;   ///< number of returns for which `left` or `stayed` is above zero
    std::size_t moved = 0;  ///< number of returns that other frames prove to have moved
    /// Number of frames in which the object was observed, and number of those frames that
    /// prove its motion.
    std::size_t frames = 0, frames_moved = 0;
    void operator+=(const EvidenceSum& other);
    /// Returns true if the frame counts prove that the object moves. At nearly all
    /// positions of a moving object, other frames observe empty space. For a static
    /// object, they observe empty space only at its edges. The counts prove little for a
    /// box that hardly moves.
    bool has_proof_of_motion() const;
};

/// Counts the frames that show whether the object at a point moved. Skips frames in which
/// the box of the track covers the point. Before the track begins, uses the first pose of
/// the box. After the track ends, uses the last pose.
/// @param point_m [3] world
/// @param box box of the track to which the return at this point belongs
Evidence collect_evidence(const Visibility& visibility, const glm::dvec3& point_m, const BoxTrack& box);

/// Removes the returns of a cluster that other frames prove to be static.
/// @return counts for all returns of the cluster, including the removed returns
EvidenceSum remove_static_returns(const Visibility& visibility, MoverCluster& cluster, const BoxTrack& box);

}  // namespace relidar
