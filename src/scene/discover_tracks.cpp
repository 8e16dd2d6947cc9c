// SPDX-License-Identifier: Apache-2.0
// Tracks of what moves without a label: groups of returns that other frames see through,
// linked from frame to frame, placed by their near ends along their motion, boxed, and
// proven by what other frames see where they were.
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

// around a box, where another track may be a part of the same thing
constexpr double kFragment_m = 0.5, kVehicleFragment_m = 1.0;
constexpr std::size_t kFewestPoints = 5;  // of a frame, once those that stayed are out
constexpr double kLongest_m = 20.0, kWidest_m = 3.2, kTallest_m = 4.5;
constexpr double kSlowest_mps = 0.4, kFastest_mps = 50.0;
constexpr double kVehicle_m = 1.2;  // what is as large is no person
// of its longer side: what is seen of a thing that stands wanders within it
constexpr double kWayOfSize = 0.9;
constexpr double kStraightness = 0.5;                // of its path
constexpr double kTurnPer_m = 0.4, kTurn_rad = 0.5;  // a vehicle does not turn on the spot

/// How far a box comes, from end to end and along its path, and how much it turns.
struct Travel {
    double net_m = 0.0, path_m = 0.0, turned_rad = 0.0;
};
Travel travel_of(const PoseTrack& track) {
    Travel travel;
    for (std::size_t i = 1; i < track.pose.size(); ++i) {
        travel.path_m += glm::distance(track.pose[i - 1].translation, track.pose[i].translation);
        travel.turned_rad +=
            glm::angle(glm::normalize(glm::inverse(track.pose[i - 1].rotation) * track.pose[i].rotation));
    }
    travel.net_m = glm::distance(track.pose.front().translation, track.pose.back().translation);
    return travel;
}

/// Whether something may have this size and speed, and has come so far that its sides, as
/// they appear, cannot be all that moves.
bool is_plausible(const BoxTrack& box) {
    const std::vector<double> speeds = speeds_mps(box);
    const double fastest = speeds.empty() ? 0.0 : std::ranges::max(speeds),
                 longest = std::max(box.size_m.x, box.size_m.y);
    const Travel travel = travel_of(box.world_from_box);
    const bool turns_on_the_spot =
        longest > kVehicle_m && travel.turned_rad > kTurn_rad + kTurnPer_m * travel.path_m;
    return box.size_m.x < kLongest_m && box.size_m.y < kWidest_m && box.size_m.z < kTallest_m &&
           fastest > kSlowest_mps && fastest < kFastest_mps && travel.net_m > kWayOfSize * longest &&
           travel.net_m > kStraightness * travel.path_m &&
           // as a label would be: what is joined around a gap may have jumped in it and
           // nowhere else
           !turns_on_the_spot && box.moves();
}

/// The box of a track of which other frames say that it moved, without what they say
/// stayed; nothing where they do not say so.
std::optional<BoxTrack> proven_box(const Visibility& visibility, MoverTrack& track) {
    Testimony sum;
    const BoxTrack box = box_of(track);
    for (Observation& o : track.seen) sum += sift(visibility, o.cluster, box);
    if (!sum.says_moved()) return std::nullopt;
    std::erase_if(track.seen, [](const Observation& o) { return o.cluster.points_m.size() < kFewestPoints; });
    if (!comes_far(track)) return std::nullopt;
    BoxTrack result = box_of(track);
    if (!is_plausible(result)) return std::nullopt;
    complete_size(result, track);
    return result;
}

/// A labelled box with what of its track other frames say moved before or after its
/// labels; nothing where they do not say so.
std::optional<BoxTrack> proven_continuation(const Visibility& visibility, MoverTrack& track,
                                            const BoxTrack& label) {
    const BoxTrack box = continued_box(track, label);
    const double first_s = label.world_from_box.time_s.front();
    Testimony before, after;
    const auto is_labelled = [](const Observation& o) { return o.cluster.label != kNoLabel; };
    for (Observation& o : track.seen)
        if (!is_labelled(o)) (o.frame_time_s < first_s ? before : after) += sift(visibility, o.cluster, box);
    std::erase_if(track.seen, [&](const Observation& o) {
        return !is_labelled(o) && (o.cluster.points_m.size() < kFewestPoints ||
                                   !(o.frame_time_s < first_s ? before : after).says_moved());
    });
    if (std::ranges::all_of(track.seen, is_labelled)) return std::nullopt;
    return continued_box(track, label);
}

/// What processes send each other of a box.
struct BoxHead {
    glm::dvec3 size_m;
    std::uint64_t n_poses, n_before, n_after;
    std::int64_t label;
    std::array<char, 16> size_guess;
};

/// Boxes of all processes' tracks; those of labelled ones have the id and the class of
/// their label.
std::vector<BoxTrack> joined(const ProcessGroup& group, const std::vector<MoverTrack>& tracks,
                             const std::vector<std::optional<BoxTrack>>& found, std::size_t first,
                             const Sequence& sequence) {
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
    heads = group.all_gathered(std::move(heads));
    times_s = group.all_gathered(std::move(times_s));
    poses = group.all_gathered(std::move(poses));
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

/// Those of all tracks, of which each process of a process group looks at its share.
std::vector<BoxTrack> proven_boxes(Visibility& visibility, std::vector<MoverTrack>& tracks,
                                   const Sequence& sequence, const Progress& progress,
                                   const ProcessGroup& group) {
    const ProcessGroup::Share share = group.share(tracks.size());
    for (std::size_t i = share.begin; i < share.end; ++i)
        for (const Observation& o : tracks[i].seen) visibility.announce(o.cluster.points_m);
    std::vector<std::optional<BoxTrack>> found(share.end - share.begin);
    for_each_told(found.size(), progress, "paths of movers", [&](std::size_t i) {
        MoverTrack& track = tracks[share.begin + i];
        found[i] = track.label == kNoLabel
                       ? proven_box(visibility, track)
                       : proven_continuation(visibility, track, sequence.boxes[std::size_t(track.label)]);
    });
    return joined(group, tracks, found, share.begin, sequence);
}

/// Whether a track is mostly inside another's box: a part of it that was a group of its
/// own for a while.
bool is_part_of(const BoxTrack& part, const BoxTrack& whole) {
    const double margin =
        std::max(whole.size_m.x, whole.size_m.y) < kVehicle_m ? kFragment_m : kVehicleFragment_m;
    std::size_t inside = 0;
    for (std::size_t i = 0; i < part.world_from_box.time_s.size(); ++i) {
        const double t_s = part.world_from_box.time_s[i];
        inside += whole.present(t_s) && whole.holds(part.world_from_box.pose[i].translation, t_s, margin);
    }
    return 2 * inside > part.world_from_box.time_s.size();
}

bool is_continued(const BoxTrack& box) { return !box.id.empty(); }

/// Of several boxes of one thing the one that was seen most; what continues a label stays
/// beside what discovers it again.
std::vector<BoxTrack> without_parts(std::vector<BoxTrack> boxes) {
    std::ranges::stable_sort(boxes, [](const BoxTrack& a, const BoxTrack& b) {
        return std::pair(is_continued(a), a.world_from_box.time_s.size()) >
               std::pair(is_continued(b), b.world_from_box.time_s.size());
    });
    std::vector<BoxTrack> kept;
    for (const BoxTrack& box : boxes)
        if (std::ranges::none_of(kept, [&](const BoxTrack& other) {
                return is_continued(box) ? box.id == other.id : is_part_of(box, other);
            }))
            kept.push_back(box);
    return kept;
}

/// Whether there is anything to box: a mover on a path of its own, or a label's track
/// that goes on without it.
bool is_worth_boxing(const MoverTrack& track, const PoseTrack& world_from_vehicle) {
    if (track.label == kNoLabel) return comes_far(track) && !rides_along(track, world_from_vehicle);
    return !std::ranges::all_of(track.seen, [](const Observation& o) { return o.cluster.label != kNoLabel; });
}

/// What one LiDAR has seen move.
std::vector<BoxTrack> discovered_by(int lidar, const Sequence& sequence, std::vector<int> positions,
                                    const Progress& progress, const ProcessGroup& group) {
    std::erase_if(positions,
                  [&](int position) { return sequence.frames[std::size_t(position)].lidar != lidar; });
    std::vector<double> times;
    for (const int position : positions) times.push_back(sequence.frames[std::size_t(position)].time_s);
    Visibility visibility(sequence, positions);
    std::vector<MoverTrack> tracks =
        link_clusters(find_mover_clusters(sequence, positions, visibility, progress, group), times, sequence);
    std::erase_if(tracks, [&](const MoverTrack& track) {
        return !is_worth_boxing(track, sequence.world_from_vehicle);
    });
    join_parts(tracks);
    return without_parts(proven_boxes(visibility, tracks, sequence, progress, group));
}

/// Adds what another LiDAR has seen move. Of a mover that is there already the box stays,
/// unless the other saw it half as long again: the longer of two paths of about the same
/// length need not be the better one, but the end of a shorter one is where it is lost.
void add_movers(std::vector<BoxTrack>& boxes, std::vector<BoxTrack> others) {
    for (BoxTrack& other : others) {
        const auto is_same = [&](const BoxTrack& b) {
            return is_continued(b) && is_continued(other) ? b.id == other.id
                                                          : is_part_of(other, b) || is_part_of(b, other);
        };
        const auto stays = [&](const BoxTrack& b) {
            if (is_continued(b) != is_continued(other)) return is_continued(b);
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
    // two sweeps at one time would see a mover twice in a track
    for (int lidar = 0; lidar < int(sequence.lidars.size()); ++lidar)
        add_movers(boxes, discovered_by(lidar, sequence, train_positions, progress, group));
    std::stable_partition(boxes.begin(), boxes.end(), [](const BoxTrack& box) { return !is_continued(box); });
    int n = 0;
    for (BoxTrack& box : boxes)
        if (!is_continued(box)) box.id = fmt::format("mover-{}", n++);
    return boxes;
}

}  // namespace relidar
