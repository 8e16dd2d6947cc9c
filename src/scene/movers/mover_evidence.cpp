// SPDX-License-Identifier: Apache-2.0
// Counts the frames that show that an object moved, and the frames that show that it did
// not move. A static object has returns at its position whenever the position is visible.
// A moving object leaves the position empty. One empty observation is not enough, because
// beams also pass through glass, between leaves and past edges.
#include "scene/movers/mover_evidence.hpp"

namespace relidar {
namespace {

// Closer returns can belong to the same static object, because poses have errors.
constexpr double kSamePosition_m = 0.2;
// Margin around the tracked box, because the tracked object may still be there.
constexpr double kTrackedBoxMargin_m = 0.4;
// At least this share of the returns of a track must be proven to lie on a moving object.
constexpr double kMinMovedReturnShare = 0.25;
// Minimum n_moved_returns / n_decided_returns of a track.
constexpr double kMinConfirmedShare = 0.85;
constexpr double kMinMovedFrameShare =
    0.5;  // motion must be proven in at least this share of a track's frames

}  // namespace

MotionEvidence weigh_point(const VisibilityChecker& checker, const glm::dvec3& point_m, const BoxTrack& box) {
    const std::vector<double>& times = box.world_from_box.time_s;
    MotionEvidence evidence;
    for (const std::uint32_t view : checker.find_views_near(point_m)) {
        if (box.contains_point(point_m, std::clamp(checker.view_time_s(view), times.front(), times.back()),
                               kTrackedBoxMargin_m))
            continue;
        if (checker.has_return_at(view, point_m, kSamePosition_m)) ++evidence.n_occupied_frames;
        else if (checker.classify_point(view, point_m) == PointVisibility::empty) ++evidence.n_empty_frames;
    }
    return evidence;
}

void TrackMotionEvidence::operator+=(const TrackMotionEvidence& other) {
    frame_evidence += other.frame_evidence;
    n_returns += other.n_returns;
    n_decided_returns += other.n_decided_returns;
    n_moved_returns += other.n_moved_returns;
    n_frames += other.n_frames;
    n_moved_frames += other.n_moved_frames;
}

bool TrackMotionEvidence::is_moving() const {
    return frame_evidence.is_moving() &&
           double(n_moved_returns) >= kMinMovedReturnShare * double(n_returns) &&
           double(n_moved_returns) >= kMinConfirmedShare * double(n_decided_returns) &&
           double(n_moved_frames) >= kMinMovedFrameShare * double(n_frames);
}

TrackMotionEvidence remove_static(const VisibilityChecker& view, MoverCluster& cluster, const BoxTrack& box) {
    TrackMotionEvidence sum;
    std::vector<glm::dvec3> remaining_m;
    for (const glm::dvec3& p : cluster.points_m) {
        const MotionEvidence evidence = weigh_point(view, p, box);
        sum.frame_evidence += evidence;
        sum.n_decided_returns += evidence.is_observed();
        sum.n_moved_returns += evidence.is_moving();
        if (!evidence.is_static()) remaining_m.push_back(p);
    }
    sum.n_returns = cluster.points_m.size();
    // One cluster is the observation of one frame.
    sum.n_frames = 1;
    sum.n_moved_frames = sum.frame_evidence.is_moving();
    cluster.points_m = std::move(remaining_m);
    cluster.centre_m = glm::dvec3(0.0);
    for (const glm::dvec3& p : cluster.points_m) cluster.centre_m += p / double(cluster.points_m.size());
    return sum;
}

}  // namespace relidar
