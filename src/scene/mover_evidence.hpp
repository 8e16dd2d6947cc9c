// SPDX-License-Identifier: Apache-2.0
// Decides whether returns belong to a moving or to a static object. Compares the returns
// with frames in which the tracked object is elsewhere. Private to scene.
#pragma once

#include <relidar/log/sequence.hpp>

#include "scene/mover_clusters.hpp"
#include "scene/visibility.hpp"

namespace relidar {

/// Number of frames which show that the object at a position has moved, and number of
/// frames which show that it has not moved.
struct MotionEvidence {
    /// Number of frames that have a return at the position although the tracked object is
    /// elsewhere. The return then comes from something else.
    std::size_t n_occupied_frames = 0;
    std::size_t n_empty_frames = 0;  ///< frames that observe an empty space at the position
    void operator+=(const MotionEvidence& other) {
        n_occupied_frames += other.n_occupied_frames;
        n_empty_frames += other.n_empty_frames;
    }
    bool has_observations() const { return n_occupied_frames + n_empty_frames > 0; }
    bool is_proven_static() const { return n_occupied_frames > 0 && n_occupied_frames >= n_empty_frames; }
    bool is_proven_moving() const { return n_empty_frames > kMuchMore * n_occupied_frames; }
    /// Motion is proven if `n_empty_frames` is more than this factor times
    /// `n_occupied_frames`. For a moving object, `n_occupied_frames` can be above zero,
    /// because other objects pass behind or near it.
    static constexpr std::size_t kMuchMore = 3;
};

/// Evidence of motion, summed over all returns of a track or of a part of the track.
struct TrackMotionEvidence {
    MotionEvidence frame_evidence;
    std::size_t n_returns = 0;
    std::size_t n_decided_returns =
        0;  ///< number of returns for which `n_empty_frames` or `n_occupied_frames` is above zero
    std::size_t n_moved_returns = 0;  ///< number of returns that other frames prove to have moved
    /// Number of frames in which the object was observed, and number of those frames that
    /// prove its motion.
    std::size_t n_frames = 0, n_moved_frames = 0;
    void operator+=(const TrackMotionEvidence& other);
    /// Returns true if the frame counts prove that the object moves. At nearly all
    /// positions of a moving object, other frames observe empty space. At a static
    /// object, other frames observe empty space only at its edges. The counts prove
    /// little if the box hardly moves.
    bool is_proven_moving() const;
};

/// Counts the frames that show whether the object at a point moved. Skips frames in which
/// the box of the track contains the point. Before the track begins, uses the first pose
/// of the box. After the track ends, uses the last pose.
/// @param point_m [3] world
/// @param box box of the track to which the return at this point belongs
MotionEvidence count_occupied_and_empty_frames_at_point(const VisibilityChecker& visibility,
                                                        const glm::dvec3& point_m, const BoxTrack& box);

/// Removes the returns of a cluster that other frames prove to be static.
/// @return evidence of motion, summed over all returns of the cluster before the removal
TrackMotionEvidence remove_static_returns_and_measure_motion(const VisibilityChecker& visibility,
                                                             MoverCluster& cluster, const BoxTrack& box);

}  // namespace relidar
