// SPDX-License-Identifier: Apache-2.0
// Aligns each scan with a map of the earlier scans. The start pose is predicted from the
// given poses and from the velocity of the previous scan. Then Gauss-Newton steps move
// the scan as a rigid body onto planes, first in cells of 2 m, then in smaller cells. A
// point is interpolated between two poses at its firing time. The earlier pose is fixed,
// and the later pose moves. If there are several predictions, the result with the most
// points on planes is used.
#include "registration/odometry.hpp"

#include <algorithm>
#include <atomic>
#include <thread>
#include <utility>

#include "base/joined.hpp"
#include "base/parallel.hpp"
#include "registration/plane_maps.hpp"
#include "registration/pose_equations.hpp"

namespace relidar {
namespace {

constexpr int kMaxSteps = 8;
constexpr double kMinStep_m = 1e-3;       // stops the iteration if a step is shorter than this
constexpr double kMinAlignedShare = 0.1;  // with fewer points on planes of the map, the alignment has failed
// Map cells that got no new points while the vehicle drove this distance are removed.
// Else odometry could match an earlier pass over the road, which close_loops() aligns.
constexpr double kMaxCellAge_m = 80.0;
// The vehicle drives this distance between two removals of old map cells. Removals are
// rare, because checking all cells takes as long as adding a scan.
constexpr double kCleanupInterval_m = 5.0;
constexpr double kSamePrediction_m = 0.05;  // of two predictions that are this close, only one is tried
// A less likely prediction is used only if so many more of the points then lie on planes.
constexpr double kMinPredictionGain = 0.03;
constexpr int kMaxLostScans = 5;  // after so many consecutive scans that do not match, the map is cleared
constexpr std::size_t kPosesPerSection = 200;  // number of poses in a section of the log
// Consecutive sections of a log share this number of poses, so that each section has a
// map before its first new scan.
constexpr std::size_t kSectionOverlap = 20;
constexpr int kTrialScans = 4;      // scans on which several initial speeds are tried, without given poses
constexpr int kSettlingScans = 12;  // scans after which the speed is known
// Forward motions per scan that are tried: from -kMaxTrialReverse_m to kMaxTrialMotion_m,
// which is 40 m/s at 10 Hz.
constexpr double kTrialStep_m = 0.5, kMaxTrialMotion_m = 4.0, kMaxTrialReverse_m = 1.0;

/// Section of a log. Poses within a section are estimated one after the other.
using LogSection = ProcessGroup::PartRange;

/// Estimates the poses of one section of a log, one after the other. Aligns each scan
/// with a map of the earlier scans of the section.
class SectionOdometry {
public:
    SectionOdometry(const PoseTrack& initial_track, const OdometryOptions& options, std::size_t begin,
                    std::optional<Pose> first_motion)
        : initial_track_(initial_track),
          track_(initial_track),
          options_(options),
          begin_(begin),
          first_motion_(first_motion),
          maps_(options.first, options.last) {
        // The first pose is given. Points fired after it are interpolated to the second
        // pose, so this pose needs a prediction.
        if (begin + 1 < track_.pose.size()) track_.pose[begin + 1] = predict_poses(begin + 1).front();
    }

    /// Estimates a pose from its scan, and adds the scan to the map. A scan that does not
    /// match keeps its predicted pose and is not added. Call for each pose in order.
    void add_pose(std::size_t pose_index, const std::vector<SubsampledPoint>& scan) {
        const std::vector<Pose> starts =
            pose_index == begin_ ? std::vector<Pose>{track_.pose[pose_index]} : predict_poses(pose_index);
        PoseCandidate best{starts.front(), 0.0};
        for (const Pose& start : starts) {
            const PoseCandidate candidate = align_scan(pose_index, start, scan);
            const bool is_first = &start == &starts.front();
            if (candidate.share > best.share + (is_first ? 0.0 : kMinPredictionGain)) best = candidate;
        }
        const bool is_lost = !scan.empty() && !maps_.empty() && best.share < kMinAlignedShare;
        set_pose(pose_index, is_lost ? starts.front() : best.pose);
        n_added_ = pose_index + 1 - begin_;
        if (pose_index > begin_)
            travelled_m_ +=
                glm::distance(track_.pose[pose_index].translation, track_.pose[pose_index - 1].translation);
        if (scan.empty()) return;
        share_ += best.share;
        lost_in_a_row_ = is_lost ? lost_in_a_row_ + 1 : 0;
        // After several lost scans, the map probably shows another place.
        if (is_lost && lost_in_a_row_ < kMaxLostScans) return;
        if (is_lost) maps_.clear();
        extend_map(scan);
    }

    const PoseTrack& track() const { return track_; }
    /// sum over all scans of the share of points that lie on planes of the map
    double total_share() const { return share_; }
    /// Returns the motion between the first two poses, if the vehicle moved like between
    /// the last two added poses.
    Pose last_motion() const {
        const std::vector<double>& t = track_.time_s;
        const std::size_t last = begin_ + n_added_ - 1;
        if (n_added_ < 2) return first_motion_.value_or(Pose{});
        return interpolate(Pose{}, inverse(track_.pose[last - 1]) * track_.pose[last],
                           (t[begin_ + 1] - t[begin_]) / (t[last] - t[last - 1]));
    }

private:
    struct PoseCandidate {
        Pose pose;
        double share = 0.0;  // share of the points that lie on planes
    };
    const PoseTrack& initial_track_;
    PoseTrack track_;
    const OdometryOptions& options_;
    std::size_t begin_;
    std::optional<Pose> first_motion_;
    PlaneMaps maps_;
    double travelled_m_ = 0.0, forgotten_m_ = 0.0, share_ = 0.0;
    int lost_in_a_row_ = 0;
    std::size_t n_added_ = 0;  // number of poses

    /// Adds a scan to the map at its estimated pose, and removes old map cells.
    void extend_map(const std::vector<SubsampledPoint>& scan) {
        std::vector<glm::dvec3> points_m(scan.size());
        parallel_blocks(scan.size(), [&](std::size_t index) {
            points_m[index] = point_to_world(track_, scan[index]).point_m;
        });
        maps_.add_points(points_m, travelled_m_);
        if (travelled_m_ - kMaxCellAge_m < forgotten_m_ + kCleanupInterval_m) return;
        forgotten_m_ = travelled_m_ - kMaxCellAge_m;
        maps_.forget_before(forgotten_m_);
    }

    /// Predicts the motion to a pose from the velocity before the previous pose.
    Pose predict_motion(std::size_t pose_index) const {
        if (pose_index < begin_ + 2) return first_motion_.value_or(Pose{});
        const std::vector<double>& t = track_.time_s;
        const Pose previous_motion = inverse(track_.pose[pose_index - 2]) * track_.pose[pose_index - 1];
        return interpolate(Pose{}, previous_motion,
                           (t[pose_index] - t[pose_index - 1]) / (t[pose_index - 1] - t[pose_index - 2]));
    }

    Pose initial_motion(std::size_t pose_index) const {
        return inverse(initial_track_.pose[pose_index - 1]) * initial_track_.pose[pose_index];
    }

    /// Returns start poses for the alignment of a scan, the most likely one first.
    std::vector<Pose> predict_poses(std::size_t pose_index) const {
        const Pose constant_motion_pose = track_.pose[pose_index - 1] * predict_motion(pose_index);
        if (!options_.use_pose_motion) return {constant_motion_pose};
        const Pose pose_file_prediction = track_.pose[pose_index - 1] * initial_motion(pose_index);
        // The velocity is unknown at the first two poses. If both predictions agree,
        // aligning the scan twice gives the same result.
        if (pose_index < begin_ + 2 || glm::distance(pose_file_prediction.translation,
                                                     constant_motion_pose.translation) < kSamePrediction_m)
            return {pose_file_prediction};
        return {pose_file_prediction, constant_motion_pose};
    }

    /// Sets a pose, and sets the next pose to its prediction. The next pose is needed
    /// because points that are fired after the pose are interpolated between both.
    void set_pose(std::size_t pose_index, const Pose& pose) {
        track_.pose[pose_index] = pose;
        if (pose_index + 1 < track_.pose.size())
            track_.pose[pose_index + 1] = pose * (options_.use_pose_motion ? initial_motion(pose_index + 1)
                                                                           : predict_motion(pose_index + 1));
    }

    /// Aligns a scan with the map of the earlier scans, from large to small map cells.
    /// @return the aligned pose, and the share of the scan's points on planes of the map
    PoseCandidate align_scan(std::size_t pose, const Pose& start, const std::vector<SubsampledPoint>& scan) {
        set_pose(pose, start);
        if (maps_.empty() || scan.empty()) return {start, 0.0};
        double share = 0.0;
        for (int level = 0; level < PlaneMaps::kLevels; ++level) {
            const double scale_m = maps_.settings_of_level(level).scale_m;
            for (int i = 0;
                 i < kMaxSteps && gauss_newton_step(pose, start, scan, level, scale_m, share) > kMinStep_m;
                 ++i) {}
        }
        return {track_.pose[pose], share};
    }

    /// Moves pose `pose_index` by one Gauss-Newton step, so that the points of its scan
    /// come closer to planes of the map.
    /// @param kernel_scale_m distance from a plane at which a point has a quarter of its
    /// weight
    /// @param fraction_on_planes output: share of the points that lie on planes before
    /// the step
    /// @return length of the step in metres
    double gauss_newton_step(std::size_t pose_index, const Pose& start_pose,
                             const std::vector<SubsampledPoint>& scan, int map_level, double kernel_scale_m,
                             double& fraction_on_planes) {
        const SinglePoseEquations equations =
            sum_point_equations(scan.size(), [&](SinglePoseEquations& part, std::size_t i) {
                const WorldPointWithOrigin at = point_to_world(track_, scan[i]);
                // A point fired before the pose moves only by its fraction `s`, because
                // the previous pose is fixed. Later points move fully.
                const double moves_along = scan[i].left + 1 == pose_index ? double(scan[i].s) : 1.0;
                if (const LocalPlane* plane = maps_.find_plane(at.point_m, map_level))
                    part.add_residual(make_residual(at, *plane, kernel_scale_m), moves_along);
            });
        fraction_on_planes = double(equations.count_on_planes()) / double(scan.size());
        Pose pose = track_.pose[pose_index];
        // Coarse maps only bring the scan near to its pose. The finest map decides.
        const bool is_finest = map_level + 1 == PlaneMaps::kLevels;
        const double step_m = equations.move_pose(
            pose, start_pose,
            equations.find_unobserved(min_information(options_.use_pose_motion && is_finest)));
        set_pose(pose_index, pose);
        return step_m;
    }
};

/// Estimates the motion between the first two poses of a section without given poses.
/// Tries several forward motions, the smallest first, and uses the one with which most
/// points of the first scans match planes. Returns the motion after the following scans,
/// because the first scans alone show it only roughly.
Pose find_first_motion(const PoseTrack& initial_track, const SubsampledScans& scans,
                       const OdometryOptions& options, const LogSection& section) {
    const auto track_scans = [&](double step_m, int n_scans) {
        SectionOdometry follower(initial_track, options, section.begin,
                                 Pose{{1.0, 0.0, 0.0, 0.0}, {step_m, 0.0, 0.0}});
        for (std::size_t k = section.begin; k < section.end && n_scans > 0; ++k) {
            follower.add_pose(k, scans[k]);
            if (!scans[k].empty()) --n_scans;  // A scan without points shows nothing.
        }
        return follower;
    };
    double best_step_m = 0.0, best_share = -1.0;
    const auto try_step = [&](double step_m) {
        const double share = track_scans(step_m, kTrialScans).total_share() / kTrialScans;
        if (share <= best_share) return;
        best_share = share;
        best_step_m = step_m;
    };
    for (double step_m = 0.0; step_m <= kMaxTrialMotion_m; step_m += kTrialStep_m) try_step(step_m);
    for (double step_m = kTrialStep_m; step_m <= kMaxTrialReverse_m; step_m += kTrialStep_m)
        try_step(-step_m);
    return track_scans(best_step_m, kSettlingScans).last_motion();
}

/// Estimates the poses of a section. The first pose stays unchanged.
/// @param should_continue called before each scan
/// @return poses of the section; empty if should_continue() returned false
std::vector<Pose> track_section(const PoseTrack& initial_track, const SubsampledScans& scans,
                                const OdometryOptions& options, const LogSection& section,
                                const std::function<bool()>& should_continue) {
    std::optional<Pose> first_motion;  // not needed if the log's poses predict the motion
    if (!options.use_pose_motion) first_motion = find_first_motion(initial_track, scans, options, section);
    SectionOdometry follower(initial_track, options, section.begin, first_motion);
    for (std::size_t k = section.begin; k < section.end; ++k) {
        if (!should_continue()) return {};
        follower.add_pose(k, scans[k]);
    }
    const auto first = follower.track().pose.begin();
    return {first + std::ptrdiff_t(section.begin), first + std::ptrdiff_t(section.end)};
}

/// Divides the log into overlapping sections, so that several threads and processes can
/// share the work. The last section can be up to twice as long as the others.
std::vector<LogSection> divide_log(std::size_t n_scans) {
    std::vector<LogSection> sections{{0, n_scans}};
    for (std::size_t begin = kPosesPerSection; begin + kPosesPerSection <= n_scans;
         begin += kPosesPerSection) {
        sections.back().end = begin;
        sections.push_back({begin - kSectionOverlap, n_scans});
    }
    return sections;
}

/// Joins the sections, which overlap, to one track. Moves each section as a rigid body,
/// so that it agrees with the track at the last scan that both share.
/// @param section_poses  poses of all sections, one section after the other
std::vector<Pose> join_sections(const std::vector<LogSection>& sections,
                                const std::vector<Pose>& section_poses, const SubsampledScans& scans) {
    auto section_begin = section_poses.begin();  // first pose of section i, which is pose `begin` of the log
    std::vector<Pose> track(section_begin, section_begin + std::ptrdiff_t(sections.front().end));
    for (std::size_t i = 1; i < sections.size(); ++i) {
        section_begin += std::ptrdiff_t(sections[i - 1].end - sections[i - 1].begin);
        const auto [begin, end] = sections[i];
        // The pose of a scan without points is a prediction, so it connects no sections.
        std::size_t shared = track.size() - 1;
        while (shared > begin && scans[shared].empty()) --shared;
        const Pose track_from_section =
            track[shared] * inverse(section_begin[std::ptrdiff_t(shared - begin)]);
        track.resize(shared + 1);  // this section replaces the later poses
        for (std::size_t k = shared + 1; k < end; ++k) {
            track.push_back(track_from_section * section_begin[std::ptrdiff_t(k - begin)]);
            track.back().rotation = glm::normalize(track.back().rotation);
        }
    }
    return track;
}

}  // namespace

PoseTrack run_odometry(const PoseTrack& initial_track, const SubsampledScans& scans,
                       const OdometryOptions& options) {
    const std::vector<LogSection> sections = divide_log(scans.size());
    const ProcessGroup::PartRange own = options.group.part_range(sections.size());  // of this process
    std::size_t n_scans = 0;  // in the sections of this process
    for (std::size_t i = own.begin; i < own.end; ++i) n_scans += sections[i].end - sections[i].begin;
    // `options.proceed` may be called only from the calling thread. All other threads
    // read from `is_stopped` whether it has stopped the estimation.
    const std::thread::id caller = std::this_thread::get_id();
    std::atomic<std::size_t> n_done = 0;
    std::atomic<bool> is_stopped = false;
    const auto proceed = [&] {
        const std::size_t n_before = n_done++;
        if (std::this_thread::get_id() == caller && !options.proceed(double(n_before) / double(n_scans)))
            is_stopped = true;
        return !is_stopped;
    };
    std::vector<std::vector<Pose>> parts(own.end - own.begin);
    parallel_for(static_cast<int>(parts.size()), [&](int index) {
        const LogSection& section = sections[own.begin + std::size_t(index)];
        parts[std::size_t(index)] = track_section(initial_track, scans, options, section, proceed);
    });
    if (is_stopped) return initial_track;
    // Each process gets the sections of all processes, so that all have the same track.
    const std::vector<Pose> section_poses = options.group.gather(concatenate(std::move(parts)));
    return {.time_s = initial_track.time_s, .pose = join_sections(sections, section_poses, scans)};
}

}  // namespace relidar
