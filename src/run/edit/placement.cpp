// SPDX-License-Identifier: Apache-2.0
// Checks where an edit has placed actors: above the ground, or inside other objects.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <cmath>
#include <set>

#include <relidar/scene/labels.hpp>
#include "base/fail.hpp"
#include "run/edit/tracks.hpp"

namespace relidar {
namespace {

constexpr double kMaxGap_m = 0.3;
constexpr int kNoLidar = -1;  // for notes that are not about a LiDAR
// Labels are a few centimetres larger or smaller than their objects.
constexpr double kMinOverlap_m = 0.1;

/// Returns the depth by which two boxes overlap, in metres: the smallest overlap of their
/// projections onto the six axes of both boxes (separating axes). Negative if the boxes
/// are apart along one of these axes.
double overlap_m(const Pose& first, const glm::dvec3& first_size_m, const Pose& second,
                 const glm::dvec3& second_size_m) {
    const glm::dmat3 a = glm::mat3_cast(first.rotation), b = glm::mat3_cast(second.rotation);
    double least_m = INFINITY;
    for (const glm::dvec3& axis : {a[0], a[1], a[2], b[0], b[1], b[2]}) {
        // axis * a is the axis in the frame of the first box.
        const double half_lengths_m =
            0.5 * (glm::dot(first_size_m, glm::abs(axis * a)) + glm::dot(second_size_m, glm::abs(axis * b)));
        const double distance_m = std::abs(glm::dot(axis, second.translation - first.translation));
        least_m = std::min(least_m, half_lengths_m - distance_m);
    }
    return least_m;
}

/// Adds a note if an actor floats: if its box is more than kMaxGap_m above the ground in
/// a frame. Frames without observed ground below the box do not count.
void add_gap_note(Notes& notes, const SceneWithLogView& edited, const BoxTrack& box) {
    PoseTrack path;
    for (const double time_s : list_sweep_times_s(edited.sequence))
        if (box.is_observed(time_s)) path.append(time_s, box.world_from_box.pose_at(time_s));
    // heights_above_ground() expects poses in the world frame of the dataset.
    const std::vector<std::optional<double>> gaps_m =
        heights_above_ground(edited, shift_track(path, edited.sequence.world_offset_m), box.size_m);
    const auto is_floating = [](const std::optional<double>& gap_m) { return gap_m > kMaxGap_m; };
    const auto n_floating = std::ranges::count_if(gaps_m, is_floating);
    if (n_floating == 0) return;
    // A missing height (nothing) compares below every number, so `largest` has a value.
    const auto largest = std::ranges::max_element(gaps_m);
    const double largest_gap_m = largest->value(),
                 time_s = path.time_s[std::size_t(largest - gaps_m.begin())];
    notes.emplace_back("floating", kNoLidar,
                       fmt::format("actor {} is {:.2f} m above the ground at {:.2f} s, and more than {} m in "
                                   "{} of {} frames",
                                   box.id, largest_gap_m, time_s, kMaxGap_m, n_floating, gaps_m.size()));
}

/// Adds a note if the boxes of two actors overlap by more than kMinOverlap_m in a frame.
void add_overlap_note(Notes& notes, const Log& log, const BoxTrack& box, const BoxTrack& other) {
    std::optional<double> first_s, last_s;
    double largest_m = 0.0;
    for (const double time_s : list_sweep_times_s(log)) {
        if (!box.is_observed(time_s) || !other.is_observed(time_s)) continue;
        const double depth_m = overlap_m(box.world_from_box.pose_at(time_s), box.size_m,
                                         other.world_from_box.pose_at(time_s), other.size_m);
        if (depth_m <= kMinOverlap_m) continue;
        if (!first_s) first_s = time_s;
        last_s = time_s;
        largest_m = std::max(largest_m, depth_m);
    }
    if (first_s)
        notes.emplace_back(
            "overlap", kNoLidar,
            fmt::format("the boxes of {} and {} overlap by up to {:.2f} m between {:.2f} and {:.2f} s",
                        box.id, other.id, largest_m, *first_s, *last_s));
}

}  // namespace

Notes check_placement(const SceneWithLogView& edited, const std::vector<std::string>& tracks) {
    Notes notes;
    // A standing object is present in all frames, not only in those with labels.
    const std::vector<BoxTrack> standing = list_standing(edited.scene, edited.sequence, {});
    const std::vector<double> times_s = list_sweep_times_s(edited.sequence);
    std::vector<BoxTrack> boxes = edited.sequence.boxes;
    for (BoxTrack& box : boxes)
        if (const auto match = std::ranges::find(standing, box.id, &BoxTrack::id); match != standing.end())
            box.world_from_box = {times_s, std::vector(times_s.size(), match->world_from_box.pose.front())};
    std::set<std::string> checked;  // ids; a pair of placed actors is checked with the first of them
    for (const std::string& track : tracks) {
        const BoxTrack* box = find_box(edited.sequence, track);
        if (!box) continue;
        add_gap_note(notes, edited, *box);
        checked.insert(track);
        for (const BoxTrack& other : boxes)
            if (!checked.contains(other.id)) add_overlap_note(notes, edited.sequence, *box, other);
    }
    return notes;
}

}  // namespace relidar
