// SPDX-License-Identifier: Apache-2.0
// Finds tracks of moving objects without labels. Clusters the returns at positions where
// other frames observe empty space. Links the clusters from frame to frame, and fits
// boxes to the linked clusters. Keeps a box only if other frames prove that it moved.

#include <fmt/format.h>

#include "base/progress_blocks.hpp"
#include "scene/movers/mover_tracks.hpp"
#include "scene/visibility.hpp"

namespace relidar {
namespace {

constexpr double kSamePosition_m = 0.2;      // closer returns can be of one static object: poses have errors
constexpr double kTrackedBoxMargin_m = 0.4;  // around the tracked box, because the object may still be there
constexpr double kMinMovedReturnShare = 0.25;  // share of a track's returns that must prove the motion
constexpr double kMinConfirmedShare = 0.85;    // minimum n_moved_returns / n_decided_returns of a track
constexpr double kMinMovedFrameShare = 0.5;    // share of a track's frames that must prove motion

/// Number of frames which show that the object at a position has not moved, or has moved.
struct MotionEvidence {
    /// frames that have a return at the position, although the object is elsewhere
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
    void operator+=(const TrackMotionEvidence& other) {
        frame_evidence += other.frame_evidence;
        n_returns += other.n_returns;
        n_decided_returns += other.n_decided_returns;
        n_moved_returns += other.n_moved_returns;
        n_frames += other.n_frames;
        n_moved_frames += other.n_moved_frames;
    }
    /// Returns true if the counts prove that the object moves. Other frames observe empty
    /// space at nearly all positions of a moving object, and only at the edges of a
    /// static object. The counts prove little if the box hardly moves.
    bool is_moving() const {
        return frame_evidence.is_moving() &&
               double(n_moved_returns) >= kMinMovedReturnShare * double(n_returns) &&
               double(n_moved_returns) >= kMinConfirmedShare * double(n_decided_returns) &&
               double(n_moved_frames) >= kMinMovedFrameShare * double(n_frames);
    }
};

/// Counts the frames that show whether the object at a point (world) moved. Skips frames
/// in which the box of the track contains the point. The box stays at its first pose
/// before the track, and at its last pose after it.
MotionEvidence weigh_point(const VisibilityChecker& checker, const glm::dvec3& point_m, const BoxTrack& box) {
    const std::vector<double>& times = box.world_from_box.time_s;
    MotionEvidence evidence;
    for (const std::uint32_t view : checker.find_views_near(point_m)) {
        const double box_time_s = std::clamp(checker.view_time_s(view), times.front(), times.back());
        if (box.contains_point(point_m, box_time_s, kTrackedBoxMargin_m)) continue;
        if (checker.has_return_at(view, point_m, kSamePosition_m)) ++evidence.n_occupied_frames;
        else if (checker.classify_point(view, point_m) == PointVisibility::empty) ++evidence.n_empty_frames;
    }
    return evidence;
}

/// Removes the returns of a cluster that other frames prove to be static.
/// @return evidence of motion, summed over all returns of the cluster before the removal
TrackMotionEvidence remove_static(const VisibilityChecker& view, MoverCluster& cluster, const BoxTrack& box) {
    TrackMotionEvidence sum;
    std::vector<glm::dvec3> remaining_m;
    for (const glm::dvec3& p : cluster.points_m) {
        const MotionEvidence evidence = weigh_point(view, p, box);
        sum.frame_evidence += evidence;
        if (evidence.is_observed()) ++sum.n_decided_returns;
        if (evidence.is_moving()) ++sum.n_moved_returns;
        if (!evidence.is_static()) remaining_m.push_back(p);
    }
    sum.n_returns = cluster.points_m.size();
    // One cluster is the observation of one frame.
    sum.n_frames = 1;
    sum.n_moved_frames = sum.frame_evidence.is_moving() ? 1 : 0;
    cluster.points_m = std::move(remaining_m);
    cluster.centre_m = glm::dvec3(0.0);
    for (const glm::dvec3& p : cluster.points_m) cluster.centre_m += p / double(cluster.points_m.size());
    return sum;
}

// A track inside this margin around the box of a person or vehicle is a part of it.
constexpr double kPersonMargin_m = 0.5, kVehicleMargin_m = 1.0;
constexpr std::size_t kMinMoverPoints = 5;  // minimum number of points per frame without static points
constexpr double kMaxBoxLength_m = 20.0, kMaxBoxWidth_m = 3.2, kMaxBoxHeight_m = 4.5;
constexpr double kMinSpeed_mps = 0.4, kMaxSpeed_mps = 50.0;
constexpr double kMinVehicleLength_m = 1.2;  // objects that are at least this long are vehicles, not people
// Minimum travel as a multiple of the longer side of the box. A static object can seem to
// travel a shorter distance, because its visible part changes.
constexpr double kMinTravelPerSize = 0.9;
constexpr double kMinBoxStraightness = 0.5;  // minimum ratio of net motion to path length
// Maximum rotation of a vehicle per metre of its path, plus a constant angle.
constexpr double kMaxRotationPer_m = 0.4, kMaxExtraRotation_rad = 0.5;

/// Returns true if the size, the speed and the motion of a box are plausible. Its motion
/// must exceed the apparent motion of a static object whose visible part changes.
bool is_plausible(const BoxTrack& box) {
    const std::vector<double> speeds = speeds_mps(box);
    const double fastest_mps = speeds.empty() ? 0.0 : std::ranges::max(speeds),
                 longest_m = std::max(box.size_m.x, box.size_m.y);
    const std::vector<Pose>& poses = box.world_from_box.pose;
    double path_m = 0.0, rotation_rad = 0.0;
    for (std::size_t i = 1; i < poses.size(); ++i) {
        path_m += glm::distance(poses[i - 1].translation, poses[i].translation);
        rotation_rad += glm::angle(glm::normalize(glm::inverse(poses[i - 1].rotation) * poses[i].rotation));
    }
    const double net_m = glm::distance(poses.front().translation, poses.back().translation);
    const bool turns_on_the_spot =
        longest_m > kMinVehicleLength_m && rotation_rad > kMaxExtraRotation_rad + kMaxRotationPer_m * path_m;
    return box.size_m.x < kMaxBoxLength_m && box.size_m.y < kMaxBoxWidth_m &&
           box.size_m.z < kMaxBoxHeight_m && fastest_mps > kMinSpeed_mps && fastest_mps < kMaxSpeed_mps &&
           net_m > kMinTravelPerSize * longest_m && net_m > kMinBoxStraightness * path_m &&
           !turns_on_the_spot && box.is_moving();
}

/// Fits a box to a track if other frames prove that the object moved. First removes the
/// returns at positions that are also occupied in other frames.
std::optional<BoxTrack> fit_moved_box(const VisibilityChecker& visibility, MoverTrack& track) {
    TrackMotionEvidence sum;
    const BoxTrack box = fit_box(track);
    for (MoverObservation& o : track.observations) sum += remove_static(visibility, o.cluster, box);
    if (!sum.is_moving()) return std::nullopt;
    // Frames in which nearly all points were static do not show the object.
    std::erase_if(track.observations, [](const MoverObservation& observation) {
        return observation.cluster.points_m.size() < kMinMoverPoints;
    });
    if (!is_moving_track(track)) return std::nullopt;
    BoxTrack result = fit_box(track);
    if (!is_plausible(result)) return std::nullopt;
    enlarge_box(result, track);
    return result;
}

/// Extends a labelled box to the times before its first and after its last label. Uses
/// each of the two parts only if other frames prove that the object moved in it.
/// @param track  observations of the object; loses returns and parts without motion
std::optional<BoxTrack> extend_box(const VisibilityChecker& view, MoverTrack& track, const BoxTrack& label) {
    const BoxTrack box = extend_in_time(track, label);
    TrackMotionEvidence before, after;  // sums over the observations before and after the labels
    const auto evidence_of = [&](const MoverObservation& observation) -> TrackMotionEvidence& {
        return observation.frame_time_s < label.world_from_box.time_s.front() ? before : after;
    };
    for (MoverObservation& o : track.observations)  // removes the static returns, too
        if (!is_labelled(o)) evidence_of(o) += remove_static(view, o.cluster, box);
    const auto shows_motion = [&](const MoverObservation& o) {
        return o.cluster.points_m.size() >= kMinMoverPoints && evidence_of(o).is_moving();
    };
    std::erase_if(track.observations,
                  [&](const MoverObservation& o) { return !is_labelled(o) && !shows_motion(o); });
    if (std::ranges::all_of(track.observations, is_labelled)) return std::nullopt;
    return extend_in_time(track, label);  // again, without the removed returns
}

/// Fixed-size data of a box, for the exchange between processes. Poses are separate.
struct BoxRecord {
    glm::dvec3 size_m;
    std::uint64_t n_poses, n_before, n_after;
    std::int64_t label;
    std::array<char, 16> size_guess;
};

/// Collects the boxes of all processes. They exchange flat arrays, so the record of a box
/// has the number of its poses. A labelled track gets the id and class of its label.
/// @param boxes [tracks of this process] no value if the object did not move
std::vector<BoxTrack> gather_boxes(const ProcessGroup& group, std::span<const MoverTrack> tracks,
                                   const std::vector<std::optional<BoxTrack>>& boxes, const Log& log) {
    std::vector<BoxRecord> records;
    std::vector<double> times_s;
    std::vector<Pose> poses;
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        if (!boxes[i]) continue;
        const BoxTrack& box = *boxes[i];
        const PoseTrack& track = box.world_from_box;
        BoxRecord& record = records.emplace_back(
            BoxRecord{box.size_m, track.pose.size(), box.n_before, box.n_after, tracks[i].label, {}});
        // Leaves at least one 0 at the end of the text.
        std::strncpy(record.size_guess.data(), box.size_guess.c_str(), record.size_guess.size() - 1);
        times_s.insert(times_s.end(), track.time_s.begin(), track.time_s.end());
        poses.insert(poses.end(), track.pose.begin(), track.pose.end());
    }
    records = group.gather(std::move(records));
    times_s = group.gather(std::move(times_s));
    poses = group.gather(std::move(poses));
    std::vector<BoxTrack> all;
    std::ptrdiff_t first_pose = 0;  // of the next box in the gathered arrays
    for (const BoxRecord& record : records) {
        const std::ptrdiff_t end_pose = first_pose + std::ptrdiff_t(record.n_poses);
        const BoxTrack* label = record.label == kNoLabel ? nullptr : &log.boxes[std::size_t(record.label)];
        all.push_back({.id = label ? label->id : "",
                       .category = label ? label->category : kDiscoveredCategory,
                       .size_m = record.size_m,
                       .world_from_box = {{times_s.begin() + first_pose, times_s.begin() + end_pose},
                                          {poses.begin() + first_pose, poses.begin() + end_pose}},
                       .size_guess = record.size_guess.data(),
                       .n_before = record.n_before,
                       .n_after = record.n_after});
        first_pose = end_pose;
    }
    return all;
}

/// Returns the boxes of all objects that are proven to have moved: fits boxes to tracks
/// without a label, and extends the boxes of labelled ones. The processes share the work.
std::vector<BoxTrack> fit_moved_boxes(VisibilityChecker& view, MoverTracks& tracks, const Log& log,
                                      const Progress& progress, const ProcessGroup& group) {
    const ProcessGroup::PartRange share = group.part_range(tracks.size());
    const std::span<MoverTrack> local_tracks =
        std::span(tracks).subspan(share.begin, share.end - share.begin);
    for (const MoverTrack& track : local_tracks)  // not in the parallel loop, which only reads the images
        for (const MoverObservation& o : track.observations) view.make_images(o.cluster.points_m);
    std::vector<std::optional<BoxTrack>> boxes(local_tracks.size());
    progress_for(boxes.size(), progress, "computing the paths of moving objects", [&](std::size_t i) {
        MoverTrack& track = local_tracks[i];
        boxes[i] = track.label == kNoLabel ? fit_moved_box(view, track)
                                           : extend_box(view, track, log.boxes[std::size_t(track.label)]);
    });
    return gather_boxes(group, local_tracks, boxes, log);
}

/// Returns true if the centre of box `inner` is inside the enlarged box `outer` at more
/// than half of the times of `inner`.
bool is_same_object(const BoxTrack& inner, const BoxTrack& outer) {
    const double margin_m =
        std::max(outer.size_m.x, outer.size_m.y) < kMinVehicleLength_m ? kPersonMargin_m : kVehicleMargin_m;
    const PoseTrack& track = inner.world_from_box;
    std::size_t n_inside = 0;
    for (std::size_t i = 0; i < track.time_s.size(); ++i)
        if (outer.is_observed(track.time_s[i]) &&
            outer.contains_point(track.pose[i].translation, track.time_s[i], margin_m))
            ++n_inside;
    return 2 * n_inside > track.time_s.size();
}

/// Only boxes of labelled objects have an id until discover_tracks() names the others.
bool has_label(const BoxTrack& box) { return !box.id.empty(); }

/// Keeps one box of each object. Prefers a box with the id of a labelled object, then the
/// box with the most observations. Boxes with different such ids are never duplicates.
std::vector<BoxTrack> unique_boxes_of(std::vector<BoxTrack> boxes) {
    std::ranges::stable_sort(boxes, [](const BoxTrack& first, const BoxTrack& second) {
        return std::pair(has_label(first), first.world_from_box.time_s.size()) >
               std::pair(has_label(second), second.world_from_box.time_s.size());
    });
    std::vector<BoxTrack> unique;
    for (const BoxTrack& box : boxes)
        if (std::ranges::none_of(unique, [&](const BoxTrack& other) {
                return has_label(box) ? box.id == other.id : is_same_object(box, other);
            }))
            unique.push_back(box);
    return unique;
}

/// Returns true if the track belongs to an unlabelled object that moves, or to a labelled
/// object that was also observed outside the time of its labels.
bool should_fit_box(const MoverTrack& track, const PoseTrack& world_from_vehicle) {
    return track.label == kNoLabel ? is_moving_track(track) && !is_ego_part(track, world_from_vehicle)
                                   : !std::ranges::all_of(track.observations, is_labelled);
}

/// Returns the boxes of the moving objects that one LiDAR observed.
std::vector<BoxTrack> discover_in_lidar(int lidar, const Log& log, std::vector<int> frames,
                                        const Progress& progress, const ProcessGroup& group) {
    std::erase_if(frames, [&](int position) { return log.frames[std::size_t(position)].lidar != lidar; });
    std::vector<double> times;
    for (const int position : frames) times.push_back(log.frames[std::size_t(position)].time_s);
    VisibilityChecker visibility(log, frames);
    MoverTracks tracks = link_clusters(find_clusters(log, frames, visibility, progress, group), times, log);
    std::erase_if(tracks,
                  [&](const MoverTrack& track) { return !should_fit_box(track, log.world_from_vehicle); });
    merge_tracks(tracks);
    return unique_boxes_of(fit_moved_boxes(visibility, tracks, log, progress, group));
}

/// Adds the boxes that another LiDAR found. Of two boxes of an object, prefers the one
/// with the id of a labelled object. Otherwise keeps the box in `boxes`, unless the other
/// has more than 1.5 times as many observations.
void merge_boxes(std::vector<BoxTrack>& boxes, std::vector<BoxTrack> others) {
    for (BoxTrack& other : others) {
        const auto is_same = [&](const BoxTrack& box) {
            if (has_label(box) && has_label(other)) return box.id == other.id;
            return is_same_object(other, box) || is_same_object(box, other);
        };
        const auto is_better = [&](const BoxTrack& box) {  // than `other`
            if (has_label(box) != has_label(other)) return has_label(box);
            const std::size_t n = box.world_from_box.time_s.size();
            return 2 * other.world_from_box.time_s.size() <= 3 * n;  // n_other <= 1.5 n
        };
        const auto is_same_and_better = [&](const BoxTrack& box) { return is_same(box) && is_better(box); };
        if (std::ranges::any_of(boxes, is_same_and_better)) continue;
        std::erase_if(boxes, is_same);
        boxes.push_back(std::move(other));
    }
}

}  // namespace

std::vector<BoxTrack> discover_tracks(const Log& log, const std::vector<int>& frames,
                                      const Progress& progress, const ProcessGroup& group) {
    std::vector<BoxTrack> boxes;
    // A joint search would add an object twice if two LiDARs scan it simultaneously.
    for (int lidar = 0; lidar < int(log.lidars.size()); ++lidar)
        merge_boxes(boxes, discover_in_lidar(lidar, log, frames, progress, group));
    // Objects without a label are listed first and get a name.
    std::stable_partition(boxes.begin(), boxes.end(), [](const BoxTrack& box) { return !has_label(box); });
    int n_named = 0;
    for (BoxTrack& box : boxes)
        if (!has_label(box)) box.id = fmt::format("mover-{}", n_named++);
    return boxes;
}

}  // namespace relidar
