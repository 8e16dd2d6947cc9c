// SPDX-License-Identifier: Apache-2.0
// Registers moving boxes. Optimises all poses of a box together, in the frame of the box.
// Poses of frames without points are interpolated.
#include <relidar/registration/registration.hpp>

#include <algorithm>
#include <cmath>

#include <Eigen/QR>

#include "base/median.hpp"
#include "base/parallel.hpp"
#include "registration/plane_adjustment.hpp"

namespace relidar {
namespace {

constexpr double kMinObjectSize_m = 1.2;  // most shorter boxes are pedestrians, whose shape changes
constexpr double kAboveGround_m = 0.25;   // lower points of a box can belong to the ground
// Minimum number of points of an actor, of points of a pose, and of poses with points.
constexpr std::size_t kFewestActorPoints = 200, kFewestPosePoints = 10, kFewestPoses = 4;
constexpr FitRound kFirstActorRound{0.8, 0.2}, kLastActorRound{0.4, 0.05};
constexpr double kWeightGain = 0.02;  // increase of the mean weight of points that half proves a better fit
constexpr double kLargestCorrection_m = 0.6, kLargestCorrection_rad = 0.1;  // of a pose; more is an error
// A box stands if the points fit a fixed box with this share of their mean weight.
constexpr double kStandingShare = 0.8;
constexpr double kMaxStandingMotion_m = 3.0;  // a box that moves farther than this is not standing
constexpr int kPosesPerSide = 3;       // number of poses on each side that are used to interpolate a pose
constexpr double kLongestGap_s = 1.0;  // maximum time to the poses from which a pose is interpolated

/// Points of an object, in the frame of its labelled box.
struct BoxFramePoints {
    std::vector<SubsampledPoint> points;  ///< points; `pose` is the index of the nearest pose in the track
    std::vector<std::size_t> n_of_pose;   ///< [poses] number of points
};

/// Returns a point of a box, between the poses of the box before and after it.
SubsampledPoint make_box_point(const BoxTrack& box, const glm::dvec3& local_m, double time_s) {
    const TrackInterpolation at = box.world_from_box.find_segment(time_s);
    const std::size_t nearest_pose = at.s < 0.5 ? at.left : at.left + 1;
    return {.point_m = glm::vec3(local_m),
            .s = static_cast<float>(at.s),
            .left = static_cast<std::uint32_t>(at.left),
            .pose = static_cast<std::uint32_t>(nearest_pose)};
}

/// Returns the points of a frame in each box, without those near the ground: [boxes].
std::vector<std::vector<SubsampledPoint>> find_box_points(const Log& log, const Frame& frame,
                                                          const std::vector<BoxTrack*>& boxes) {
    std::vector<std::vector<SubsampledPoint>> points(boxes.size());
    std::vector<std::size_t> visible_boxes;
    for (std::size_t b = 0; b < boxes.size(); ++b)
        if (boxes[b]->is_observed(frame.time_s)) visible_boxes.push_back(b);
    if (visible_boxes.empty()) return points;
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        if (!(frame.scan.range_m[ray] > 0.0f)) continue;
        const WorldReturn measured = locate_return(log, frame, ray);
        for (const std::size_t b : visible_boxes) {
            const BoxTrack& box = *boxes[b];
            if (!box.contains_point(measured.point_m, measured.time_s, kMoverMargin_m)) continue;
            const glm::dvec3 local_m =
                inverse(box.world_from_box.pose_at(measured.time_s)) * measured.point_m;
            if (local_m.z < -0.5 * box.size_m.z + kAboveGround_m) continue;
            points[b].push_back(make_box_point(box, local_m, measured.time_s));
        }
    }
    return points;
}

/// Collects the training returns inside each labelled box.
/// @return [boxes] points sorted by pose of the box, then by frame and ray
std::vector<BoxFramePoints> collect_in_boxes(const Log& log, const std::vector<int>& train_frames,
                                             const std::vector<BoxTrack*>& actor_boxes) {
    std::vector<std::vector<std::vector<SubsampledPoint>>> points_of_frames(train_frames.size());
    parallel_for(static_cast<int>(train_frames.size()), [&](int index) {
        const Frame& frame = log.frames[std::size_t(train_frames[std::size_t(index)])];
        points_of_frames[std::size_t(index)] = find_box_points(log, frame, actor_boxes);
    });
    std::vector<BoxFramePoints> actors(actor_boxes.size());
    for (std::size_t b = 0; b < actor_boxes.size(); ++b) {
        BoxFramePoints& actor = actors[b];
        for (const auto& frame : points_of_frames)
            actor.points.insert(actor.points.end(), frame[b].begin(), frame[b].end());
        std::ranges::stable_sort(actor.points, {}, &SubsampledPoint::pose);
        actor.n_of_pose.assign(actor_boxes[b]->world_from_box.pose.size(), 0);
        for (const SubsampledPoint& point : actor.points) ++actor.n_of_pose[point.pose];
    }
    return actors;
}

/// Returns up to kPosesPerSide poses with points before a pose and as many after it, at
/// most kLongestGap_s away. Returns an empty list if one side has no such pose.
std::vector<std::size_t> find_near_poses(const PoseTrack& track, const std::vector<bool>& pose_has_points,
                                         std::size_t pose_index) {
    std::vector<std::size_t> near;
    for (const int step : {-1, 1}) {
        int n_on_side = 0;
        for (auto k = std::ptrdiff_t(pose_index) + step; k >= 0 && k < std::ssize(track.pose); k += step) {
            const auto pose = std::size_t(k);
            if (std::abs(track.time_s[pose] - track.time_s[pose_index]) > kLongestGap_s) break;
            if (!pose_has_points[pose]) continue;
            near.push_back(pose);
            if (++n_on_side == kPosesPerSide) break;
        }
        if (n_on_side == 0) return {};
    }
    return near;
}

/// Fits a parabola over time to the poses near `pose_index`. Returns the pose on the
/// parabola at the time of `pose_index`, or nothing if one side has no poses with points.
std::optional<Pose> fit_parabola(const PoseTrack& track, const std::vector<bool>& pose_has_points,
                                 std::size_t pose_index) {
    const std::vector<std::size_t> near = find_near_poses(track, pose_has_points, pose_index);
    if (near.empty()) return std::nullopt;
    // A parabola through three poses would follow their noise, so they get a line.
    const int n_terms = near.size() >= 4 ? 3 : 2;
    const auto n_poses = Eigen::Index(near.size());
    const Pose& reference = track.pose[near.front()];
    // Least squares for the coefficients of each of the six values of a twist.
    Eigen::MatrixXd time_powers(n_poses, n_terms), twists(n_poses, 6);
    for (Eigen::Index i = 0; i < n_poses; ++i) {
        const std::size_t pose = near[std::size_t(i)];
        const double t = track.time_s[pose] - track.time_s[pose_index];
        for (int power = 0; power < n_terms; ++power) time_powers(i, power) = std::pow(t, power);
        twists.row(i) = to_vector(compute_twist(reference, track.pose[pose])).transpose();
    }
    const Eigen::MatrixXd coefficients = time_powers.colPivHouseholderQr().solve(twists);
    // The constant term is the value at t = 0, the time of `pose_index`.
    return apply_twist(reference, to_twist(coefficients.row(0).transpose()));
}

/// Prepares the optimisation of the poses of a labelled box, in the frame of the box. A
/// prior keeps the corrections small and smooth.
PoseAdjustment make_adjustment(const BoxTrack& box, std::vector<SubsampledPoint> points,
                               const std::vector<bool>& pose_has_points) {
    const std::vector<double>& time_s = box.world_from_box.time_s;
    const PoseTrack identity{time_s, std::vector<Pose>(time_s.size())};
    // Labels have errors of 0.15 m and 2 degrees (0.035), which change by 0.05 m and 1
    // degree in 0.1 s.
    const PoseCorrectionPrior prior(0.15, 0.035, 0.05, 0.017);
    return {identity, identity, identity, prior, std::move(points), pose_has_points};
}

/// Returns true if the points of an actor fit a fixed box about as well as a moving box.
/// @param moving_box_weight  mean weight of the points on planes of the moving box
bool is_stationary(const BoxTrack& box, const BoxFramePoints& actor_points,
                   const std::vector<bool>& pose_has_points, double moving_box_weight) {
    // discover_tracks() has already proven that these boxes move.
    if (box.category == kDiscoveredCategory) return false;
    const PoseTrack& track = box.world_from_box;
    const Pose middle = track.pose[track.pose.size() / 2];
    for (const Pose& pose : track.pose)
        if (glm::distance(pose.translation, middle.translation) > kMaxStandingMotion_m) return false;
    // The points in the frame of a fixed box, at the middle pose of the track.
    std::vector<SubsampledPoint> in_fixed_box = actor_points.points;
    for (SubsampledPoint& point : in_fixed_box)
        point.point_m = glm::vec3(inverse(middle) * point_to_world(track, point).point_m);
    const PoseAdjustment adjustment = make_adjustment(box, std::move(in_fixed_box), pose_has_points);
    return adjustment.mean_weight(kLastActorRound) >= kStandingShare * moving_box_weight;
}

/// Returns how much of the corrections is applied, from 0 to 1. It is less than 1 if the
/// corrected track hardly fits better, or if a correction is implausible.
/// @param corrections  [poses] corrections of the poses
/// @param weight_gain  increase of the mean weight of the points on planes
double weigh_corrections(const std::vector<Twist>& corrections, double weight_gain) {
    double largest = 0.0;  // as a share of the maximum correction
    for (const Twist& c : corrections)
        largest = std::max({largest, glm::length(glm::dvec3(c[0], c[1], c[2])) / kLargestCorrection_m,
                            glm::length(glm::dvec3(c[3], c[4], c[5])) / kLargestCorrection_rad});
    // A single implausible correction means that the optimisation has failed.
    return smooth_step(weight_gain, 0.0, 2.0 * kWeightGain) * (1.0 - smooth_step(largest, 0.5, 1.0));
}

/// Corrects the track of a box, so that its points from all frames lie on common planes.
/// Keeps the labelled track if the corrected track does not fit the points better.
/// Counts the box in `result`, and appends the median correction if it was registered.
void refine_track(BoxTrack& box, const BoxFramePoints& actor_points, ActorRegistrationResult& result,
                  std::vector<double>& moved_distances_m) {
    std::vector<bool> has_points(actor_points.n_of_pose.size());
    for (std::size_t k = 0; k < has_points.size(); ++k)
        has_points[k] = actor_points.n_of_pose[k] >= kFewestPosePoints;
    if (actor_points.points.size() < kFewestActorPoints ||
        std::ranges::count(has_points, true) < std::ptrdiff_t(kFewestPoses))
        return;
    PoseAdjustment adjustment = make_adjustment(box, actor_points.points, has_points);
    const double labelled_weight = adjustment.mean_weight(kLastActorRound);
    adjustment.converge_poses(kFirstActorRound, kLastActorRound);
    const double registered_weight = adjustment.mean_weight(kLastActorRound);
    PoseTrack& track = box.world_from_box;
    if (is_stationary(box, actor_points, has_points, std::max(labelled_weight, registered_weight))) {
        std::fill(track.pose.begin(), track.pose.end(), Pose(track.pose[track.pose.size() / 2]));
        ++result.n_standing;
        return;
    }
    std::vector<Twist> corrections;
    for (const Pose& pose : adjustment.track().pose) corrections.push_back(compute_twist(Pose{}, pose));
    const double applied_share = weigh_corrections(corrections, registered_weight - labelled_weight);
    if (applied_share == 0.0) return;
    std::vector<double> lengths_m;
    // The adjustment moved the points in the box. The box moves by the inverse instead.
    for (std::size_t k = 0; k < track.pose.size(); ++k) {
        const Pose applied = apply_twist(Pose{}, to_twist(applied_share * to_vector(corrections[k])));
        track.pose[k] = track.pose[k] * inverse(applied);
        track.pose[k].rotation = glm::normalize(track.pose[k].rotation);
        if (has_points[k]) lengths_m.push_back(glm::length(applied.translation));
    }
    // Poses without points were not registered. They follow their registered neighbours.
    const PoseTrack registered = track;
    for (std::size_t k = 0; k < track.pose.size(); ++k)
        if (!has_points[k]) track.pose[k] = fit_parabola(registered, has_points, k).value_or(track.pose[k]);
    ++result.n_registered;
    moved_distances_m.push_back(compute_median(lengths_m));
}

}  // namespace

ActorRegistrationResult register_actors(Log& log, const std::vector<int>& frames, const Progress& progress) {
    ActorRegistrationResult result;
    std::vector<double> moved_m;  // [registered boxes] median correction of the poses
    std::vector<BoxTrack*> boxes;
    for (BoxTrack& box : log.boxes)
        if (box.is_moving() && std::max(box.size_m.x, box.size_m.y) >= kMinObjectSize_m)
            boxes.push_back(&box);
    const std::vector<BoxFramePoints> actors = collect_in_boxes(log, frames, boxes);
    result.n_actors = boxes.size();
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        if (progress) progress("registering actors", double(i) / double(boxes.size()));
        refine_track(*boxes[i], actors[i], result, moved_m);  // also counts the box in `result`
    }
    result.moved_m = moved_m.empty() ? 0.0 : compute_median(std::move(moved_m));
    return result;
}

}  // namespace relidar
