// SPDX-License-Identifier: Apache-2.0
// Decides whether returns belong to a moving or to a static object. Compares the returns
// with frames in which the tracked object is elsewhere. Private to scene.
#pragma once

#include "scene/movers/mover_clusters.hpp"
#include "scene/visibility.hpp"

namespace relidar {

/// Number of frames which show that the object at a position has not moved, or has moved.
struct MotionEvidence {
    /// Frames that have a return at the position although the tracked object is
    /// elsewhere.
    std::size_t n_occupied_frames = 0;
    std::size_t n_empty_frames = 0;  ///< frames that observe an empty space at the position
    void operator+=(const MotionEvidence& other) {
        n_occupied_frames += other.n_occupied_frames;
        n_empty_frames += other.n_empty_frames;
    }
    bool is_observed() const { return n_occupied_frames + n_empty_frames > 0; }
    bool is_static() const { return n_occupied_frames > 0 && n_occupied_frames >= n_empty_frames; }
    bool is_moving() const { return n_empty_frames > kMuchMore * n_occupied_frames; }
    /// Other objects that pass behind or near a moving object occupy its positions.
    static constexpr std::size_t kMuchMore = 3;
};

struct TrackMotionEvidence {
    MotionEvidence frame_evidence;
    std::size_t n_returns = 0;
    std::size_t n_decided_returns = 0;  ///< returns whose position other frames observe
    std::size_t n_moved_returns = 0;    ///< returns that other frames prove to have moved
    /// Frames in which the object was observed, and those of them that prove its motion.
    std::size_t n_frames = 0, n_moved_frames = 0;
    void operator+=(const TrackMotionEvidence& other);
    /// Returns true if the counts prove that the object moves. Other frames observe empty
    /// space at nearly all positions of a moving object, and only at the edges of a
    /// static object. The counts prove little if the box hardly moves.
    bool is_moving() const;
};

/// Counts the frames that show whether the object at a point (world) moved. Skips frames
/// in which the box of the track contains the point. The box stays at its first pose
/// before the track, and at its last pose after it.
MotionEvidence weigh_point(const VisibilityChecker& view, const glm::dvec3& point_m, const BoxTrack& box);

/// Removes the returns of a cluster that other frames prove to be static.
/// @return evidence of motion, summed over all returns of the cluster before the removal
TrackMotionEvidence remove_static(const VisibilityChecker& view, MoverCluster& cluster, const BoxTrack& box);

}  // namespace relidar
