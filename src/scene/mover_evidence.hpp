// SPDX-License-Identifier: Apache-2.0
// Decides whether returns belong to a moving or to a static object. Compares them with
// frames in which the tracked object is elsewhere. Private to scene.
#pragma once

#include <relidar/log/sequence.hpp>

#include "scene/mover_clusters.hpp"
#include "scene/visibility.hpp"

namespace relidar {

/// Counts the frames that support or contradict the motion of the returns at a position.
struct Evidence {
    /// frames that have a return at the position, although the tracked object is
    /// elsewhere
    std::size_t stayed = 0;
    std::size_t left = 0;  ///< frames that observe an empty space at the position
    void operator+=(const Evidence& other) { stayed += other.stayed, left += other.left; }
    bool is_any() const { return stayed + left > 0; }
    bool proves_rest() const { return stayed > 0 && stayed >= left; }
    bool proves_motion() const { return left > kMuchMore * stayed; }
    /// Motion is proven only if `left` is more than this factor times `stayed`. Objects
    /// that pass behind or near a moving object also cause returns at the position.
    static constexpr std::size_t kMuchMore = 3;
};

/// Sums of the frame counts for all returns of a track, or for a part of the track.
struct EvidenceSum {
    Evidence looks;
    std::size_t returns = 0;
    std::size_t told = 0;   ///< number of returns about which at least one frame says something
    std::size_t moved = 0;  ///< number of returns that other frames prove to have moved
    /// Number of frames with observations of the object, and number of frames whose
    /// returns are proven to have moved.
    std::size_t frames = 0, frames_moved = 0;
    void operator+=(const EvidenceSum& other);
    /// Returns true if the counts prove motion. For a moving object, other frames find
    /// nearly all of its positions empty. For a static object, other frames find only its
    /// edges empty. If a box hardly moves, other frames say little about its returns.
    bool proves_motion() const;
};

/// Counts the frames that prove or disprove that the object at a point moved. Skips
/// frames in which the track's box covers the point. Before and after the track, the
/// first and the last pose of the box are used.
/// @param point_m [3] world
/// @param box box of the track to which a return at this point belongs
Evidence collect_evidence(const Visibility& visibility, const glm::dvec3& point_m, const BoxTrack& box);

/// Removes the returns of a cluster that other frames prove to be static.
/// @return counts for all returns of the cluster, including the removed returns
EvidenceSum sift(const Visibility& visibility, MoverCluster& cluster, const BoxTrack& box);

}  // namespace relidar
