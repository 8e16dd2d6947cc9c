// SPDX-License-Identifier: Apache-2.0
// Decides whether returns belong to a moving object or to a static one. Uses frames at
// whose time the tracked object is elsewhere. Private to scene.
#pragma once

#include <relidar/log/sequence.hpp>

#include "scene/mover_clusters.hpp"
#include "scene/visibility.hpp"

namespace relidar {

/// Number of frames that support or contradict motion at the positions of returns.
struct Evidence {
    /// frames with a return at the position, although the tracked object is elsewhere
    std::size_t stayed = 0;
    std::size_t left = 0;  ///< frames that see through the position
    void operator+=(const Evidence& other) { stayed += other.stayed, left += other.left; }
    bool is_any() const { return stayed + left > 0; }
    bool says_stayed() const { return stayed > 0 && stayed >= left; }
    bool says_moved() const { return left > kMuchMore * stayed; }
    /// Factor by which `left` must exceed `stayed`. Objects that pass behind or near a
    /// moving object also have returns at its positions.
    static constexpr std::size_t kMuchMore = 3;
};

/// Summed evidence for all returns of a track, or for a part of the track.
struct Testimony {
    Evidence looks;
    std::size_t returns = 0;
    std::size_t told = 0;   ///< returns with any evidence
    std::size_t moved = 0;  ///< returns with evidence that they moved
    /// Number of frames with observations of the object, and number of frames whose
    /// returns are proven to have moved.
    std::size_t frames = 0, frames_moved = 0;
    void operator+=(const Testimony& other);
    /// Returns true if the evidence proves motion. Other frames see nearly all positions
    /// of a moving object free at other times. For a static object, they see through
    /// edges only, and the remainder stays. A box that hardly moves has few returns with
    /// evidence.
    bool says_moved() const;
};

/// Collects the evidence of the frames near a point. Skips frames at whose time the
/// track's box covers the point. The first and last pose of the box hold before and after
/// its track.
/// @param point_m [3] world
/// @param box box of the track to which a return at this point belongs
Evidence look_back(const Visibility& visibility, const glm::dvec3& point_m, const BoxTrack& box);

/// Removes the returns of a cluster that other frames prove to be static.
/// @return evidence of all returns that the cluster had
Testimony sift(const Visibility& visibility, MoverCluster& cluster, const BoxTrack& box);

}  // namespace relidar
