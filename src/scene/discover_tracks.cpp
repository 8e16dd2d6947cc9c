// SPDX-License-Identifier: Apache-2.0
// Finds tracks of moving objects without labels. Clusters the returns at positions that
// are empty in other frames. Links the clusters from frame to frame, and fits boxes to
// the linked clusters. Keeps a box only if other frames prove that it moved.
#include <relidar/scene/scene.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "base/progress_blocks.hpp"
#include "scene/mover_boxes.hpp"
#include "scene/mover_clusters.hpp"
#include "scene/mover_evidence.hpp"
#include "scene/mover_tracks.hpp"

namespace relidar {
namespace {

// Margins in metres around the boxes of people and of vehicles. A second track inside the
// margin may be a part of the same object.
constexpr double kFragment_m = 0.5, kVehicleFragment_m = 1.0;
// minimum number of points of a moving object per frame, after static points are removed
constexpr std::size_t kFewestPoints = 5;
constexpr double kLongest_m = 20.0, kWidest_m = 3.2, kTallest_m = 4.5;
constexpr double kSlowest_mps = 0.4, kFastest_mps = 50.0;
constexpr double kVehicle_m = 1.2;  // objects that are at least this long are vehicles, not people
// Minimum distance that a moving object must travel, as a multiple of the longer side of
// its box. A static object can seem to move by less, because its visible part changes.
constexpr double kWayOfSize = 0.9;
constexpr double kStraightness = 0.5;  // minimum ratio of net motion to path length
// Maximum turn of a vehicle: radians per metre of its path, plus a constant angle. A
// vehicle cannot turn on the spot.
constexpr double kTurnPer_m = 0.4, kTurn_rad = 0.5;

/// Motion of a box: the distance from the first to the last position, the length of the
/// path, and the total turn.
struct Travel {
    double net_m = 0.0, path_m = 0.0, turned_rad = 0.0;
};
Travel measure_travel(const PoseTrack& track) {
    Travel travel;
    for (std::size_t i = 1; i < track.pose.size(); ++i) {
        travel.path_m += glm::distance(track.pose[i - 1].translation, track.pose[i].translation);
        travel.turned_rad +=
            glm::angle(glm::normalize(glm::inverse(track.pose[i - 1].rotation) * track.pose[i].rotation));
    }
    travel.net_m = glm::distance(track.pose.front().translation, track.pose.back().translation);
    return travel;
}

/// Returns true if the size, the speed and the motion of a box are plausible. The box
/// must move farther than a changing view of a static object can explain.
bool is_plausible(const BoxTrack& box) {
    const std::vector<double> speeds = compute_speeds_mps(box);
    const double fastest = speeds.empty() ? 0.0 : std::ranges::max(speeds),
                 longest = std::max(box.size_m.x, box.size_m.y);
    const Travel travel = measure_travel(box.world_from_box);
    const bool turns_on_the_spot =
        longest > kVehicle_m && travel.turned_rad > kTurn_rad + kTurnPer_m * travel.path_m;
    return box.size_m.x < kLongest_m && box.size_m.y < kWidest_m && box.size_m.z < kTallest_m &&
           fastest > kSlowest_mps && fastest < kFastest_mps && travel.net_m > kWayOfSize * longest &&
           travel.net_m > kStraightness * travel.path_m &&
           // `moves()` rejects a track whose only motion is a jump across a gap in time.
           !turns_on_the_spot && box.is_moving();
}

/// Fits a box to a track if other frames prove that the object moved. First removes the
/// returns at positions that are also occupied in other frames. Returns nothing if there
/// is no proof, or if the motion is implausible.
std::optional<BoxTrack> find_proven_box(const Visibility& visibility, MoverTrack& track) {
    EvidenceSum sum;
    const BoxTrack box = fit_track_box(track);
    for (Observation& o : track.seen) sum += remove_static_returns(visibility, o.cluster, box);
    if (!sum.has_proof_of_motion()) return std::nullopt;
    std::erase_if(track.seen, [](const Observation& observation) {
        return observation.cluster.points_m.size() < kFewestPoints;
    });
    if (!is_moving_track(track)) return std::nullopt;
    BoxTrack result = fit_track_box(track);
    if (!is_plausible(result)) return std::nullopt;
    complete_size(result, track);
    return result;
}

/// Extends a labelled box to the times before and after its labels. Uses only those parts
/// of the track in which other frames prove that the object moved. Returns nothing if
/// there is no such part.
std::optional<BoxTrack> find_proven_track_extension(const Visibility& visibility, MoverTrack& track,
                                                    const BoxTrack& label) {
    const BoxTrack box = make_continued_box(track, label);
    const double first_s = label.world_from_box.time_s.front();
    EvidenceSum before, after;
    const auto is_labelled = [](const Observation& observation) {
        return observation.cluster.label != kNoLabel;
    };
    for (Observation& o : track.seen)
        if (!is_labelled(o))
            (o.frame_time_s < first_s ? before : after) += remove_static_returns(visibility, o.cluster, box);
    std::erase_if(track.seen, [&](const Observation& observation) {
        return !is_labelled(observation) &&
               (observation.cluster.points_m.size() < kFewestPoints ||
                !(observation.frame_time_s < first_s ? before : after).has_proof_of_motion());
    });
    if (std::ranges::all_of(track.seen, is_labelled)) return std::nullopt;
    return make_continued_box(track, label);
}

/// Fixed-size data of a box, for the exchange between processes.
struct BoxHead {
    glm::dvec3 size_m;
    std::uint64_t n_poses, n_before, n_after;
    std::int64_t label;
    std::array<char, 16> size_guess;
};

/// Collects the boxes from all processes of the group. The box of a labelled track gets
/// the id and the class of the label.
std::vector<BoxTrack> collect_proven_boxes(const ProcessGroup& group, const std::vector<MoverTrack>& tracks,
                                           const std::vector<std::optional<BoxTrack>>& found,
                                           std::size_t first, const Sequence& sequence) {
    std::vector<BoxHead> heads;
    std::vector<double> times_s;
    std::vector<Pose> poses;
    for (std::size_t i = 0; i < found.size(); ++i) {
        if (!found[i]) continue;
        const BoxTrack& box = *found[i];
        const PoseTrack& track = box.world_from_box;
        BoxHead& head = heads.emplace_back(
            BoxHead{box.size_m, track.pose.size(), box.n_before, box.n_after, tracks[first + i].label, {}});
        std::strncpy(head.size_guess.data(), box.size_guess.c_str(), head.size_guess.size() - 1);
        times_s.insert(times_s.end(), track.time_s.begin(), track.time_s.end());
        poses.insert(poses.end(), track.pose.begin(), track.pose.end());
    }
    heads = group.gather_all(std::move(heads));
    times_s = group.gather_all(std::move(times_s));
    poses = group.gather_all(std::move(poses));
    std::vector<BoxTrack> boxes;
    std::ptrdiff_t at = 0;
    for (const BoxHead& head : heads) {
        const std::ptrdiff_t end = at + std::ptrdiff_t(head.n_poses);
        const BoxTrack* label = head.label == kNoLabel ? nullptr : &sequence.boxes[std::size_t(head.label)];
        boxes.push_back(
            {label ? label->id : "",
             label ? label->category : kDiscoveredCategory,
             head.size_m,
             {{times_s.begin() + at, times_s.begin() + end}, {poses.begin() + at, poses.begin() + end}},
             head.size_guess.data(),
             head.n_before,
             head.n_after});
        at = end;
    }
    return boxes;
}

/// Returns the boxes of all objects that are proven to have moved. If several processes
/// work together, each process checks a share of the tracks.
std::vector<BoxTrack> find_proven_boxes(Visibility& visibility, std::vector<MoverTrack>& tracks,
                                        const Sequence& sequence, const Progress& progress,
                                        const ProcessGroup& group) {
    const ProcessGroup::Share share = group.share(tracks.size());
    for (std::size_t i = share.begin; i < share.end; ++i)
        for (const Observation& o : tracks[i].seen) visibility.request_images(o.cluster.points_m);
    std::vector<std::optional<BoxTrack>> found(share.end - share.begin);
    for_each_with_progress(found.size(), progress, "paths of movers", [&](std::size_t index) {
        MoverTrack& track = tracks[share.begin + index];
        found[index] =
            track.label == kNoLabel
                ? find_proven_box(visibility, track)
                : find_proven_track_extension(visibility, track, sequence.boxes[std::size_t(track.label)]);
    });
    return collect_proven_boxes(group, tracks, found, share.begin, sequence);
}

/// Returns true if two boxes belong to the same object. This is the case if the centre of
/// `part` is inside `box`, plus a margin, for more than half of the time.
bool is_part_of_box(const BoxTrack& part, const BoxTrack& box) {
    const double margin =
        std::max(box.size_m.x, box.size_m.y) < kVehicle_m ? kFragment_m : kVehicleFragment_m;
    std::size_t inside = 0;
    for (std::size_t i = 0; i < part.world_from_box.time_s.size(); ++i) {
        const double t_s = part.world_from_box.time_s[i];
        inside += box.is_present(t_s) && box.holds(part.world_from_box.pose[i].translation, t_s, margin);
    }
    return 2 * inside > part.world_from_box.time_s.size();
}

bool is_continued_label(const BoxTrack& box) { return !box.id.empty(); }

/// Removes duplicate boxes of an object. Keeps the box with the most observations, or a
/// box that extends a label. Boxes of different labels are never duplicates.
std::vector<BoxTrack> remove_parts(std::vector<BoxTrack> boxes) {
    std::ranges::stable_sort(boxes, [](const BoxTrack& first, const BoxTrack& second) {
        return std::pair(is_continued_label(first), first.world_from_box.time_s.size()) >
               std::pair(is_continued_label(second), second.world_from_box.time_s.size());
    });
    std::vector<BoxTrack> kept;
    for (const BoxTrack& box : boxes)
        if (std::ranges::none_of(kept, [&](const BoxTrack& other) {
                return is_continued_label(box) ? box.id == other.id : is_part_of_box(box, other);
            }))
            kept.push_back(box);
    return kept;
}

/// Returns true if a box should be fitted to a track. The track must be an unlabelled
/// object that moves, or a labelled object that was also observed outside the time of its
/// labels.
bool should_fit_box(const MoverTrack& track, const PoseTrack& world_from_vehicle) {
    if (track.label == kNoLabel)
        return is_moving_track(track) && !is_fixed_to_vehicle(track, world_from_vehicle);
    return !std::ranges::all_of(
        track.seen, [](const Observation& observation) { return observation.cluster.label != kNoLabel; });
}

/// Returns the boxes of the moving objects that one LiDAR observed.
std::vector<BoxTrack> discover_with_lidar(int lidar, const Sequence& sequence, std::vector<int> positions,
                                          const Progress& progress, const ProcessGroup& group) {
    std::erase_if(positions,
                  [&](int position) { return sequence.frames[std::size_t(position)].lidar != lidar; });
    std::vector<double> times;
    for (const int position : positions) times.push_back(sequence.frames[std::size_t(position)].time_s);
    Visibility visibility(sequence, positions);
    std::vector<MoverTrack> tracks =
        link_clusters(find_mover_clusters(sequence, positions, visibility, progress, group), times, sequence);
    std::erase_if(
        tracks, [&](const MoverTrack& track) { return !should_fit_box(track, sequence.world_from_vehicle); });
    join_parts(tracks);
    return remove_parts(find_proven_boxes(visibility, tracks, sequence, progress, group));
}

/// Adds the boxes that another LiDAR found. If both LiDARs found the same object, prefers
/// the box that extends a label. Otherwise keeps the existing box, unless the new box has
/// more than 1.5 times as many observations. In this case the first LiDAR lost the
/// object.
void merge_movers_of_lidars(std::vector<BoxTrack>& boxes, std::vector<BoxTrack> other_boxes) {
    for (BoxTrack& other : other_boxes) {
        const auto is_same = [&](const BoxTrack& b) {
            return is_continued_label(b) && is_continued_label(other)
                       ? b.id == other.id
                       : is_part_of_box(other, b) || is_part_of_box(b, other);
        };
        const auto stays = [&](const BoxTrack& b) {
            if (is_continued_label(b) != is_continued_label(other)) return is_continued_label(b);
            return 2 * other.world_from_box.time_s.size() <= 3 * b.world_from_box.time_s.size();
        };
        if (std::ranges::any_of(boxes, [&](const BoxTrack& b) { return is_same(b) && stays(b); })) continue;
        std::erase_if(boxes, is_same);
        boxes.push_back(std::move(other));
    }
}

}  // namespace

std::vector<BoxTrack> discover_tracks(const Sequence& sequence, const std::vector<int>& train_positions,
                                      const Progress& progress, const ProcessGroup& group) {
    std::vector<BoxTrack> boxes;
    // Processes each LiDAR separately. If two LiDARs scan at the same time, joint
    // processing would add an object twice to one track.
    for (int lidar = 0; lidar < int(sequence.lidars.size()); ++lidar)
        merge_movers_of_lidars(boxes, discover_with_lidar(lidar, sequence, train_positions, progress, group));
    std::stable_partition(boxes.begin(), boxes.end(),
                          [](const BoxTrack& box) { return !is_continued_label(box); });
    int n = 0;
    for (BoxTrack& box : boxes)
        if (!is_continued_label(box)) box.id = fmt::format("mover-{}", n++);
    return boxes;
}

}  // namespace relidar
