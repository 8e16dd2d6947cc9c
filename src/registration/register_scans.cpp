// SPDX-License-Identifier: Apache-2.0
// Registers the poses of the sensor: optimises the poses of all training scans together,
// and then aligns each held-out scan with the resulting planes.
#include <relidar/registration/registration.hpp>

#include <algorithm>
#include <cmath>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "registration/loops.hpp"
#include "registration/odometry.hpp"
#include "registration/plane_adjustment.hpp"

namespace relidar {
namespace {

// A grid keeps one point of a scan per cell. Largest and smallest cell size: cells of 0.5
// m keep 12 thousand points of a 64-beam scan, cells of 0.1 m nearly all.
constexpr double kMaxThinningCell_m = 0.5, kMinThinningCell_m = 0.1;
// The points of a plane usually come from about this many scans. If the log has fewer
// scans, each scan keeps more points (smaller thinning cells).
constexpr double kScansPerCell = 24.0;
constexpr FitRound kFinalRound{0.5, 0.05};  // cell size and robust-kernel scale of the last rounds
// The same of the finest map of odometry, which is less accurate than the optimisation of
// all poses together. So the scale is larger.
constexpr FitRound kFinalOdometryRound{0.5, 0.1};
constexpr int kTestLevels = 5, kStepsPerLevel = 3;  // number of levels and steps per level for held-out scans

/// The poses of a log may drift by metres and jump now and then, but from scan to scan
/// they are right to decimetres.
PoseCorrectionPrior make_prior(const RegistrationOptions& options) {
    return {1.0, 0.1, 0.1, 0.01, options.use_pose_motion};
}

/// Returns the cell size for thinning. Few scans need small cells for enough points.
double thinning_cell_m(std::size_t n_scans) {
    return std::clamp(kMaxThinningCell_m * std::sqrt(double(n_scans) / kScansPerCell), kMinThinningCell_m,
                      kMaxThinningCell_m);
}

/// Returns the share of each scan's points that lie on planes of the final map, [sweeps].
std::vector<double> measure_shares(const PoseAdjustment& adjustment, const SubsampledScans& scans) {
    const PlaneMap map = adjustment.fit_planes(kFinalRound);
    std::vector<double> shares(scans.size());
    parallel_for(static_cast<int>(scans.size()), [&](int index) {
        const auto k = std::size_t(index);
        shares[k] = adjustment.share_on_planes(map, scans[k], kFinalRound.scale_m);
    });
    return shares;
}

/// Aligns the held-out (test) scans with planes of the training scans, coarse to fine. A
/// scan has failed if too few of its points lie on planes, or if its correction differs
/// too much from those of the neighbouring training scans.
/// @param test_scans [sweeps] points of the held-out scans; empty for other sweeps
/// @param first_round cell size and kernel scale of the coarsest level
/// @return indices of the failed scans, which keep the poses that they had before
std::vector<std::size_t> align_test_sweeps(PoseAdjustment& adjustment, const std::vector<bool>& is_test_sweep,
                                           const std::vector<bool>& is_training_sweep,
                                           const SubsampledScans& test_scans, const FitRound& first_round,
                                           double max_deviation_m) {
    std::vector<std::size_t> lost;
    if (std::ranges::count(is_test_sweep, true) == 0) return lost;
    const std::vector<Pose> poses_before = adjustment.track().pose;
    for (int level = 0; level < kTestLevels; ++level) {
        const bool is_finest = level + 1 == kTestLevels;
        const FitRound round = blend_rounds(first_round, kFinalRound, level / double(kTestLevels - 1));
        // The poses of the training scans are exact, so all maps have the final scale.
        const PlaneMap map = adjustment.fit_planes({round.cell_m, kFinalRound.scale_m});
        const auto has_failed = [&](std::size_t k) {
            const double share = adjustment.share_on_planes(map, test_scans[k], round.scale_m);
            return !PoseAdjustment::has_enough_planes(share, test_scans[k].size()) ||
                   adjustment.deviation_m(k, is_training_sweep) > max_deviation_m;
        };
        for (std::size_t k = 0; k < test_scans.size(); ++k) {
            if (!is_test_sweep[k]) continue;
            for (int step = 0; step < kStepsPerLevel; ++step)
                adjustment.align_pose(map, k, poses_before[k], test_scans[k], round.scale_m);
            if (!is_finest || !has_failed(k)) continue;
            adjustment.set_pose(k, poses_before[k]);
            lost.push_back(k);
        }
    }
    return lost;
}

/// Returns for each sweep whether one of the given frames belongs to it.
std::vector<bool> flag_sweeps(const SweepSet& sweeps, const std::vector<int>& frames, std::size_t n_frames) {
    std::vector<bool> is_given(n_frames, false), has_given_frame(sweeps.frames.size(), false);
    for (const int frame : frames) is_given[std::size_t(frame)] = true;
    for (std::size_t k = 0; k < sweeps.frames.size(); ++k)
        for (const int frame : sweeps.frames[k])
            if (is_given[std::size_t(frame)]) has_given_frame[k] = true;
    return has_given_frame;
}

/// Returns one flag per sweep. Only the flag of the middle selected sweep is true.
std::vector<bool> keep_middle(const std::vector<bool>& is_selected) {
    std::vector<bool> is_middle(is_selected.size(), false);
    auto n_before = std::ranges::count(is_selected, true) / 2;
    for (std::size_t k = 0; k < is_selected.size(); ++k)
        if (is_selected[k] && n_before-- == 0) is_middle[k] = true;
    return is_middle;
}

}  // namespace

RegistrationResult register_scans(const Log& log, const Split& split, const RegistrationOptions& options) {
    RegistrationResult result;
    result.world_from_vehicle = log.world_from_vehicle;
    const SweepSet sweeps = group_sweeps(log);
    const std::vector<bool> is_train = flag_sweeps(sweeps, split.train, log.frames.size()),
                            is_test = flag_sweeps(sweeps, split.test, log.frames.size());
    const auto n_train = static_cast<std::size_t>(std::ranges::count(is_train, true));
    if (n_train < 2) return result;
    const double cell_m = thinning_cell_m(n_train);
    const auto proceed = [&](const char* text) {
        return [&, text](double done) {
            if (options.progress) options.progress(text, done);
            return !(result.stopped = options.stop && options.stop());
        };
    };
    // The first cells are twice as large as the largest pose error, so that all scans of
    // a surface have points in the same cell.
    const FitRound first{std::max(2.0 * options.largest_m, kFinalRound.cell_m),
                         std::max(0.5 * options.largest_m, kFinalRound.scale_m)};

    // Odometry: aligns each scan with a map of the scans before.
    const SubsampledScans scans = thin_sweeps(log, sweeps, is_train, options, cell_m);
    const PoseTrack followed = run_odometry(
        sweeps.track, scans,
        {first, kFinalOdometryRound, options.use_pose_motion, proceed("tracking the scans"), options.group});
    if (result.stopped || !options.group.is_first()) return result;
    // Loop closure: aligns a second pass over a road with the first one.
    const LoopClosureResult closed = close_loops(followed, scans, first, kFinalOdometryRound,
                                                 proceed("detecting loops in the path of the vehicle"));
    if (result.stopped) return result;
    result.n_loop_closures = closed.n_closures;
    result.largest_loop_error_m = closed.largest_m;

    // Bundle adjustment: optimises the poses of all training scans together.
    std::vector<SubsampledPoint> points;
    for (const std::vector<SubsampledPoint>& scan : scans)
        points.insert(points.end(), scan.begin(), scan.end());
    PoseAdjustment adjustment(sweeps.track, closed.track,
                              options.use_pose_motion ? sweeps.track : closed.track, make_prior(options),
                              std::move(points), options.use_pose_motion ? is_train : keep_middle(is_train));
    result.rounds = adjustment.adjust_poses(first, kFinalRound, proceed("registering all scans jointly"));
    if (result.stopped) return result;
    if (result.rounds.back().planes == 0)
        fail(
            "cannot register the scans of {}: no two of its {} training scans show the same surface; try "
            "train.refine_poses=none",
            log.name, split.train.size());
    const std::vector<double> shares = measure_shares(adjustment, scans);
    std::vector<double> train_shares;
    for (std::size_t k = 0; k < shares.size(); ++k)
        if (is_train[k]) train_shares.push_back(shares[k]);
    result.on_planes = compute_median(std::move(train_shares));
    result.lost = adjustment.interpolate_lost(scans, shares, is_train, options.largest_m);

    // Held-out scans follow last, because they must not affect the training scans.
    const SubsampledScans held_out = thin_sweeps(log, sweeps, is_test, options, cell_m);
    const std::vector<std::size_t> lost =
        align_test_sweeps(adjustment, is_test, is_train, held_out, first, options.largest_m);
    result.lost.insert(result.lost.end(), lost.begin(), lost.end());
    std::ranges::sort(result.lost);
    for (std::size_t& k : result.lost) k = sweeps.pose[k];
    result.world_from_vehicle = spread_corrections(log.world_from_vehicle, sweeps, adjustment.track());
    result.done = true;
    return result;
}

std::vector<std::vector<UnobservedMotion>> find_unobserved_motions(const Log& log,
                                                                   const std::vector<int>& map_frames,
                                                                   const RegistrationOptions& options) {
    const SweepSet sweeps = group_sweeps(log);
    const std::vector<bool> is_in_map = flag_sweeps(sweeps, map_frames, log.frames.size());
    const double cell_m = thinning_cell_m(std::size_t(std::ranges::count(is_in_map, true)));
    const SubsampledScans scans =
        thin_sweeps(log, sweeps, std::vector<bool>(is_in_map.size(), true), options, cell_m);
    std::vector<SubsampledPoint> map_points;
    for (std::size_t k = 0; k < scans.size(); ++k)
        if (is_in_map[k]) map_points.insert(map_points.end(), scans[k].begin(), scans[k].end());
    const PoseAdjustment adjustment(sweeps.track, sweeps.track, sweeps.track, make_prior(options),
                                    std::move(map_points), is_in_map);
    const PlaneMap map = adjustment.fit_planes(kFinalRound);
    std::vector<std::vector<UnobservedMotion>> motions(sweeps.pose.size());
    parallel_for(static_cast<int>(motions.size()), [&](int index) {
        const auto k = std::size_t(index);
        motions[k] = adjustment.equations_of_pose(map, k, scans[k], kFinalRound.scale_m)
                         .find_unobserved(min_information(true));
    });
    std::vector<std::vector<UnobservedMotion>> of_poses;
    for (const double time_s : log.world_from_vehicle.time_s) {
        const TrackInterpolation at = sweeps.track.find_segment(time_s);
        of_poses.push_back(motions[at.s < 0.5 ? at.left : at.left + 1]);
    }
    return of_poses;
}

}  // namespace relidar
