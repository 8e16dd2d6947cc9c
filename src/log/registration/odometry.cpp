// SPDX-License-Identifier: Apache-2.0
// Aligns each scan with a map of the earlier scans. The start pose is predicted from the
// given poses and from the velocity of the previous scan. Then Gauss-Newton steps move
// the scan as a rigid body onto planes, first in cells of 2 m, then in smaller cells.
// Each point is placed at its firing time between two poses. The earlier of these poses
// is fixed, and the later pose moves. If there are several predictions, the result with
// the most points on planes is used.
#include "log/registration/odometry.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <span>
#include <thread>
#include <utility>

#include "base/parallel.hpp"
#include "log/registration/level_maps.hpp"
#include "log/registration/pose_equations.hpp"

namespace relidar {
namespace {

constexpr int kMostSteps = 8;
constexpr double kConverged_m = 1e-3;  // stops the iteration if a step is shorter than this
// Weight of the prior that pulls a pose to its prediction, relative to the mean weight of
// the points. It matters only in directions that no point constrains, for example along a
// road without walls.
constexpr double kPrior = 3e-4;
// A scan is lost if a smaller share of its points lies on planes of the map. In streets,
// the share is 0.5 to 0.8.
constexpr double kFewestShare = 0.1;
// Cells of the map are removed if they were not observed on this length of the path. A
// separate step closes loops, so odometry must not match old cells.
constexpr double kMemory_m = 80.0;
// Old cells of the map are removed once per this path length. This is rare, because
// checking all cells takes as long as adding a scan.
constexpr double kForgotten_m = 5.0;
// Two predictions that are closer than this lead to the same pose, so only one is tried.
constexpr double kSame_m = 0.05;
// After this many consecutive scans that do not match the map, the map is cleared.
constexpr int kLostInARow = 5;
constexpr std::size_t kStretch = 200;  // number of poses in a section of the log
// Number of poses that two consecutive sections share, which is enough to build a map.
constexpr std::size_t kOverlap = 20;
// number of scans for estimating the first motion of a section
constexpr int kTrialScans = 4;
// Forward motions from -kBackwards_m to kFastest_m per scan are tested. The maximum is 40
// m/s at 10 Hz.
constexpr double kTrialStep_m = 0.5, kFastest_m = 4.0, kBackwards_m = 1.0;

/// Returns the relative motion between two poses, scaled by a factor.
Pose scale_motion(const Pose& first, const Pose& second, double fraction) {
    return interpolate(Pose{}, inverse(first) * second, fraction);
}

/// Section of a log. Poses within a section are estimated one after the other.
struct Stretch {
    std::size_t begin, end;
};

/// Divides a log into overlapping sections. The last one can be up to twice as long as
/// the others.
std::vector<Stretch> divide_into_stretches(std::size_t n_poses) {
    std::vector<Stretch> stretches{{0, n_poses}};
    for (std::size_t begin = kStretch; begin + kStretch <= n_poses; begin += kStretch) {
        stretches.back().end = begin;
        stretches.push_back({begin - kOverlap, n_poses});
    }
    return stretches;
}

class Follower {
public:
    Follower(const PoseTrack& initial_track, const OdometryOptions& options, std::size_t begin,
             std::optional<Pose> first_motion)
        : given_(initial_track),
          track_(initial_track),
          options_(options),
          begin_(begin),
          first_motion_(first_motion),
          maps_(options.first, options.last) {
        if (begin + 1 < track_.pose.size()) track_.pose[begin + 1] = list_predictions(begin + 1).front();
    }

    /// Estimates a pose and adds its scan to the map. Must be called for each pose in
    /// order.
    void estimate_next_pose(std::size_t pose, const std::vector<ThinPoint>& scan) {
        const std::vector<Pose> starts =
            pose == begin_ ? std::vector<Pose>{track_.pose[pose]} : list_predictions(pose);
        Candidate best{starts.front(), 0.0};
        for (const Pose& start : starts) {
            const Candidate candidate = align_scan(pose, start, scan);
            if (candidate.share > best.share) best = candidate;
        }
        const bool is_lost = !scan.empty() && !maps_.empty() && best.share < kFewestShare;
        set_pose(pose, is_lost ? starts.front() : best.pose);
        if (pose > begin_)
            travelled_m_ += glm::distance(track_.pose[pose].translation, track_.pose[pose - 1].translation);
        if (scan.empty()) return;
        share_ += best.share;
        lost_in_a_row_ = is_lost ? lost_in_a_row_ + 1 : 0;
        if (is_lost && lost_in_a_row_ < kLostInARow) return;
        if (is_lost) maps_.clear();
        add_to_maps(scan);
    }

    const PoseTrack& track() const { return track_; }
    /// sum over all scans of the share of points that lie on planes of the map
    double share() const { return share_; }

private:
    struct Candidate {
        Pose pose;
        double share = 0.0;  // share of the points that lie on planes
    };
    const PoseTrack& given_;
    PoseTrack track_;
    const OdometryOptions& options_;
    std::size_t begin_;
    std::optional<Pose> first_motion_;
    LevelMaps maps_;
    double travelled_m_ = 0.0, forgotten_m_ = 0.0, share_ = 0.0;
    int lost_in_a_row_ = 0;

    void add_to_maps(const std::vector<ThinPoint>& scan) {
        std::vector<glm::dvec3> points_m(scan.size());
        for_each_block(scan.size(), [&](std::size_t index) {
            points_m[index] = place_point_in_world(track_, scan[index]).point_m;
        });
        maps_.add(points_m, travelled_m_);
        if (travelled_m_ - kMemory_m < forgotten_m_ + kForgotten_m) return;
        forgotten_m_ = travelled_m_ - kMemory_m;
        maps_.remove_old_cells(forgotten_m_);
    }

    /// Predicts the motion from pose index - 1 to pose `index` by constant velocity, from
    /// the two previous poses.
    Pose predict_constant_motion(std::size_t index) const {
        if (index < begin_ + 2) return first_motion_.value_or(Pose{});
        const std::vector<double>& t = track_.time_s;
        return scale_motion(track_.pose[index - 2], track_.pose[index - 1],
                            (t[index] - t[index - 1]) / (t[index - 1] - t[index - 2]));
    }

    Pose predict_pose_file_motion(std::size_t index) const {
        return inverse(given_.pose[index - 1]) * given_.pose[index];
    }

    /// Returns the predictions of pose `index` that are tried, the most likely one first.
    std::vector<Pose> list_predictions(std::size_t index) const {
        const Pose kept = track_.pose[index - 1] * predict_constant_motion(index);
        if (!options_.use_pose_motion) return {kept};
        const Pose given = track_.pose[index - 1] * predict_pose_file_motion(index);
        if (index < begin_ + 2 || glm::distance(given.translation, kept.translation) < kSame_m)
            return {given};
        return {given, kept};
    }

    /// Sets pose `index`, and pose index + 1 to its prediction.
    void set_pose(std::size_t index, const Pose& pose) {
        track_.pose[index] = pose;
        if (index + 1 < track_.pose.size())
            track_.pose[index + 1] = pose * (options_.use_pose_motion ? predict_pose_file_motion(index + 1)
                                                                      : predict_constant_motion(index + 1));
    }

    /// Aligns a scan with the maps, from coarse to fine.
    /// @return the aligned pose, and the share of the scan's points that lie on planes
    Candidate align_scan(std::size_t index, const Pose& start, const std::vector<ThinPoint>& scan) {
        set_pose(index, start);
        if (maps_.empty() || scan.empty()) return {start, 0.0};
        double share = 0.0;
        for (int level = 0; level < LevelMaps::kLevels; ++level) {
            const double scale_m = maps_.round(level).scale_m;
            for (int i = 0;
                 i < kMostSteps && align_scan_step(index, start, scan, level, scale_m, share) > kConverged_m;
                 ++i) {}
        }
        return {track_.pose[index], share};
    }

    /// Moves pose `index` by one Gauss-Newton step.
    /// @return length of the step
    double align_scan_step(std::size_t index, const Pose& start, const std::vector<ThinPoint>& scan,
                           int level, double scale_m, double& share) {
        const RigidEquations equations =
            parallel_reduce(scan.size(), kPointsOfPart, [&](std::size_t begin, std::size_t end) {
                RigidEquations part;
                for (const ThinPoint& point : std::span(scan).subspan(begin, end - begin)) {
                    const PlacedPoint at = place_point_in_world(track_, point);
                    const double moves_along = point.left + 1 == index ? double(point.s) : 1.0;
                    if (const Plane* plane = maps_.find_finest_plane(at.point_m, level))
                        part.add(make_plane_residual_row(at, *plane, scale_m), moves_along);
                }
                return part;
            });
        share = double(equations.count_points_on_planes()) / double(scan.size());
        if (equations.empty()) return 0.0;
        const Twist x = equations.solve(kPrior, compute_twist(start, track_.pose[index]));
        set_pose(index, apply_twist(track_.pose[index], x));
        return compute_length_m(x);
    }
};

/// Estimates the motion between the first two poses of a section, for logs without given
/// poses. Tries several forward speeds and returns the one for which the first scans
/// match best.
Pose find_first_motion(const PoseTrack& initial_track, const std::vector<std::vector<ThinPoint>>& scans,
                       const OdometryOptions& options, const Stretch& stretch) {
    Pose best;
    double best_share = -1.0;
    for (double step_m = -kBackwards_m; step_m <= kFastest_m; step_m += kTrialStep_m) {
        const Pose motion{{1.0, 0.0, 0.0, 0.0}, {step_m, 0.0, 0.0}};
        Follower follower(initial_track, options, stretch.begin, motion);
        int n = 0;
        for (std::size_t k = stretch.begin; k < stretch.end && n < kTrialScans; n += !scans[k++].empty())
            follower.estimate_next_pose(k, scans[k]);
        if (follower.share() <= best_share) continue;
        best_share = follower.share();
        best = motion;
    }
    return best;
}

/// Estimates the poses of a section. The first pose stays unchanged.
/// @param proceed called before each scan
/// @return poses of the section; empty if proceed() returned false
std::vector<Pose> estimate_stretch_poses(const PoseTrack& initial_track,
                                         const std::vector<std::vector<ThinPoint>>& scans,
                                         const OdometryOptions& options, const Stretch& stretch,
                                         const std::function<bool()>& proceed) {
    Follower follower(initial_track, options, stretch.begin,
                      options.use_pose_motion
                          ? std::nullopt
                          : std::optional(find_first_motion(initial_track, scans, options, stretch)));
    for (std::size_t k = stretch.begin; k < stretch.end; ++k) {
        if (!proceed()) return {};
        follower.estimate_next_pose(k, scans[k]);
    }
    const auto first = follower.track().pose.begin();
    return {first + std::ptrdiff_t(stretch.begin), first + std::ptrdiff_t(stretch.end)};
}

/// Joins the sections to one track. Moves each section so that it agrees with the
/// previous section at the last scan that both contain.
std::vector<Pose> join_stretches(const std::vector<Stretch>& stretches, const std::vector<Pose>& poses,
                                 const std::vector<std::vector<ThinPoint>>& scans) {
    auto own = poses.begin();  // first pose of the current section in `poses`
    std::vector<Pose> track(own, own + std::ptrdiff_t(stretches.front().end));
    for (std::size_t i = 1; i < stretches.size(); ++i) {
        own += std::ptrdiff_t(stretches[i - 1].end - stretches[i - 1].begin);
        const auto [begin, end] = stretches[i];
        std::size_t last = track.size() - 1;
        while (last > begin && scans[last].empty()) --last;
        const Pose place = track[last] * inverse(own[std::ptrdiff_t(last - begin)]);
        track.resize(last + 1);
        for (std::size_t k = last + 1; k < end; ++k) {
            track.push_back(place * own[std::ptrdiff_t(k - begin)]);
            track.back().rotation = glm::normalize(track.back().rotation);
        }
    }
    return track;
}

}  // namespace

PoseTrack estimate_poses(const PoseTrack& initial_track, const std::vector<std::vector<ThinPoint>>& scans,
                         const OdometryOptions& options) {
    const std::vector<Stretch> stretches = divide_into_stretches(scans.size());
    const ProcessGroup::Share share = options.group.share(stretches.size());
    std::size_t n = 0;
    for (std::size_t i = share.begin; i < share.end; ++i) n += stretches[i].end - stretches[i].begin;
    const std::thread::id caller = std::this_thread::get_id();
    std::atomic<std::size_t> done = 0;
    std::atomic<bool> ended = false;
    const auto proceed = [&] {
        const std::size_t before = done++;
        if (std::this_thread::get_id() == caller && !options.proceed(double(before) / double(n)))
            ended = true;
        return !ended;
    };
    std::vector<std::vector<Pose>> parts(share.end - share.begin);
    parallel_for(static_cast<int>(parts.size()), [&](int index) {
        parts[std::size_t(index)] = estimate_stretch_poses(
            initial_track, scans, options, stretches[share.begin + std::size_t(index)], proceed);
    });
    if (ended) return initial_track;
    std::vector<Pose> own;
    for (const std::vector<Pose>& part : parts) own.insert(own.end(), part.begin(), part.end());
    return {initial_track.time_s, join_stretches(stretches, options.group.gather_all(std::move(own)), scans)};
}

}  // namespace relidar
