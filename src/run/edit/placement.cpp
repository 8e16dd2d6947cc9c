// SPDX-License-Identifier: Apache-2.0
// Checks where an edit has placed actors: above the ground, in the boxes of other
// objects, or in the background.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <cmath>
#include <set>

#include <relidar/run/run.hpp>
#include <relidar/scene/labels.hpp>
#include "base/fail.hpp"
#include "base/sigmoid.hpp"
#include "run/edit/tracks.hpp"

namespace relidar {
namespace {

constexpr double kMaxGap_m = 0.3;
constexpr int kNoLidar = -1;  // for notes that are not about a LiDAR
// Labels are a few centimetres larger or smaller than their objects.
constexpr double kMinOverlap_m = 0.1;
// Lower surfaces below an actor are ground, kerbs and grass.
constexpr double kMinObstacle_m = 0.3;
// Length and width of the columns of a box.
constexpr double kColumn_m = 0.3;
// A single surfel in a column is noise.
constexpr int kMinColumnSurfels = 2;
// More transparent surfels are not a surface.
constexpr double kMinOpacity = 0.5;
// Smaller shares are a branch or noise.
constexpr double kMinBackgroundShare = 0.02;

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

/// Height of the bottom of a box above the ground; no value without observed ground.
using GroundGap = std::optional<double>;

/// Adds a note if an actor floats: if its box is more than kMaxGap_m above the ground in
/// a frame. Frames without observed ground below the box do not count.
/// @param path  poses of the box in all frames
void add_gap_note(Notes& notes, const BoxTrack& box, const PoseTrack& path,
                  const std::vector<GroundGap>& gaps_m) {
    const auto is_floating = [](const GroundGap& gap_m) { return gap_m > kMaxGap_m; };
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

/// Returns the centres of the opaque surfels of the background near a path, sorted by x.
std::vector<glm::dvec3> list_background(const Scene& scene, const PoseTrack& path, double radius_m) {
    glm::dvec3 low_m(INFINITY), high_m(-INFINITY);
    for (const Pose& pose : path.pose) {
        low_m = glm::min(low_m, pose.translation - radius_m);
        high_m = glm::max(high_m, pose.translation + radius_m);
    }
    std::vector<glm::dvec3> points;
    const auto add_surfels = [&](const Surfels& surfels, std::size_t n_surfels) {
        for (std::size_t i = 0; i < n_surfels; ++i) {
            const glm::dvec3 point(surfels.mean[i]);
            if (glm::all(glm::greaterThan(point, low_m)) && glm::all(glm::lessThan(point, high_m)) &&
                sigmoid(double(surfels.opacity_logit[i])) > kMinOpacity)
                points.push_back(point);
        }
    };
    add_surfels(scene.surfels, scene.models.front().count);
    for (const SceneBlock& block : scene.blocks)
        if (glm::all(glm::greaterThan(glm::dvec3(block.high_m), low_m)) &&
            glm::all(glm::lessThan(glm::dvec3(block.low_m), high_m)))
            add_surfels(load_block(block), block.count);
    std::ranges::sort(points, {}, &glm::dvec3::x);
    return points;
}

/// Returns the share of the space in a box above the ground that the background fills. A
/// LiDAR sees only surfaces, so the space from the ground to the highest surface of a
/// column counts as filled. The sides of the box are moved inwards by kMinOverlap_m. The
/// highest surface may be above the box by as much.
/// @param points  list_background()
/// @param gap_m  height of the bottom of the box above the ground
double filled_share(const std::vector<glm::dvec3>& points, const Pose& world_from_box,
                    const glm::dvec3& size_m, double gap_m) {
    const glm::dvec2 half_m = 0.5 * glm::dvec2(size_m) - kMinOverlap_m;
    const double low_m = -0.5 * size_m.z + std::max(0.0, kMinObstacle_m - gap_m),
                 height_m = 0.5 * size_m.z - low_m;
    if (half_m.x <= 0.0 || half_m.y <= 0.0 || height_m <= 0.0) return 0.0;
    const glm::ivec2 n = glm::max(glm::ivec2(1), glm::ivec2(glm::round(2.0 * half_m / kColumn_m)));
    struct Column {
        int n_surfels = 0;
        double filled_m = 0.0;
    };
    std::vector<Column> columns(std::size_t(n.x) * std::size_t(n.y));
    const Pose box_from_world = inverse(world_from_box);
    const double reach_m = 0.5 * glm::length(size_m), centre_m = world_from_box.translation.x;
    for (auto p = std::ranges::lower_bound(points, centre_m - reach_m, {}, &glm::dvec3::x);
         p != points.end() && p->x < centre_m + reach_m; ++p) {
        const glm::dvec3 point = box_from_world * *p;
        const glm::dvec2 place = (glm::dvec2(point) + half_m) / (2.0 * half_m);  // 0 to 1 in the box
        const double filled_m = point.z - low_m;
        if (!glm::all(glm::greaterThan(place, glm::dvec2(0.0))) ||
            !glm::all(glm::lessThan(place, glm::dvec2(1.0))) || filled_m <= 0.0 ||
            filled_m > height_m + kMinOverlap_m)
            continue;
        const glm::ivec2 at(place * glm::dvec2(n));
        Column& column = columns[std::size_t(at.y * n.x + at.x)];
        ++column.n_surfels;
        column.filled_m = std::max(column.filled_m, std::min(filled_m, height_m));
    }
    double sum_m = 0.0;
    for (const Column& column : columns)
        if (column.n_surfels >= kMinColumnSurfels) sum_m += column.filled_m;
    return sum_m / (height_m * double(columns.size()));
}

/// Adds a note if an actor stands in the background in a frame.
/// @param path  poses of the box in all frames
void add_background_note(Notes& notes, const Scene& scene, const BoxTrack& box, const PoseTrack& path,
                         const std::vector<GroundGap>& gaps_m) {
    const std::vector<glm::dvec3> points = list_background(scene, path, 0.5 * glm::length(box.size_m));
    std::vector<double> shares;
    for (std::size_t i = 0; i < path.pose.size(); ++i)
        shares.push_back(filled_share(points, path.pose[i], box.size_m, gaps_m[i].value_or(0.0)));
    const auto n_inside =
        std::ranges::count_if(shares, [](double share) { return share > kMinBackgroundShare; });
    if (n_inside == 0) return;
    const auto largest = std::ranges::max_element(shares);
    notes.emplace_back(
        "background", kNoLidar,
        fmt::format("the background, for example a wall or a parked car, fills {:.0f} % of the "
                    "box of {} above the ground at {:.2f} s, and more than {:.0f} % in {} of "
                    "{} frames",
                    100.0 * *largest, box.id, path.time_s[std::size_t(largest - shares.begin())],
                    100.0 * kMinBackgroundShare, n_inside, shares.size()));
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
    const std::vector<BoxTrack> standing = list_standing(edited.scene, edited.log, {});
    const std::vector<double> times_s = list_sweep_times_s(edited.log);
    std::vector<BoxTrack> boxes = edited.log.boxes;
    for (BoxTrack& box : boxes)
        if (const auto match = std::ranges::find(standing, box.id, &BoxTrack::id); match != standing.end())
            box.world_from_box = {times_s, std::vector(times_s.size(), match->world_from_box.pose.front())};
    std::set<std::string> checked;  // ids; a pair of placed actors is checked with the first of them
    for (const std::string& track : tracks) {
        const BoxTrack* box = find_box(edited.log, track);
        if (!box) continue;
        PoseTrack path;
        for (const double time_s : times_s)
            if (box->is_observed(time_s)) path.append(time_s, box->world_from_box.pose_at(time_s));
        // heights_above_ground() expects poses in the world frame of the dataset.
        const std::vector<GroundGap> gaps_m =
            heights_above_ground(edited, shift_track(path, edited.log.world_offset_m), box->size_m);
        add_gap_note(notes, *box, path, gaps_m);
        add_background_note(notes, edited.scene, *box, path, gaps_m);
        checked.insert(track);
        for (const BoxTrack& other : boxes)
            if (!checked.contains(other.id)) add_overlap_note(notes, edited.log, *box, other);
    }
    return notes;
}

}  // namespace relidar
