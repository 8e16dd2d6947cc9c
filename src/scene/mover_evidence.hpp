// SPDX-License-Identifier: Apache-2.0
// Whether returns belong to something that moved along a track, or to something that
// stood: asked of the frames at which the track is elsewhere. Private to scene.
#pragma once

#include <relidar/log/sequence.hpp>

#include "scene/mover_clusters.hpp"
#include "scene/visibility.hpp"

namespace relidar {

/// What other frames say of the places where returns were.
struct Evidence {
    std::size_t stayed = 0;  ///< frames that have a return there, though the track is elsewhere
    std::size_t left = 0;    ///< frames that see through
    void operator+=(const Evidence& other) { stayed += other.stayed, left += other.left; }
    bool is_any() const { return stayed + left > 0; }
    bool says_stayed() const { return stayed > 0 && stayed >= left; }
    bool says_moved() const { return left > kMuchMore * stayed; }
    /// what passes behind a mover, or near by, has returns at its places too
    static constexpr std::size_t kMuchMore = 3;
};

/// What they say of all returns of a track, or of a part of it.
struct Testimony {
    Evidence looks;
    std::size_t returns = 0;
    std::size_t told = 0;   ///< returns of which any frame says something
    std::size_t moved = 0;  ///< of these, those of which it says that they moved
    /// in which the thing was seen, and those of whose returns others say that they moved
    std::size_t frames = 0, frames_moved = 0;
    void operator+=(const Testimony& other);
    /// Of what moved, others see nearly all places free before or after, where they see
    /// them: of what stands, parts are seen through at their edges, and others stay. A
    /// box that hardly leaves its place has few that tell.
    bool says_moved() const;
};

/// Asks the frames near a place, those left out in which the track's box, or where it
/// came from or ended up, covers it.
/// @param point_m [3] world @param box  of the track that a return there belongs to
Evidence look_back(const Visibility& visibility, const glm::dvec3& point_m, const BoxTrack& box);

/// Takes the returns out of a group that other frames say stayed. @return of all returns
/// that it had
Testimony sift(const Visibility& visibility, MoverCluster& cluster, const BoxTrack& box);

}  // namespace relidar
