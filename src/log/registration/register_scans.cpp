// SPDX-License-Identifier: Apache-2.0
// Registers the poses of the sensor: optimises the poses of all training scans together,
// and then aligns each held-out scan with the resulting planes.
#include <relidar/log/registration.hpp>

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/median.hpp"
#include "base/parallel.hpp"
#include "log/registration/loops.hpp"
#include "log/registration/odometry.hpp"
#include "log/registration/plane_adjustment.hpp"

namespace relidar {
namespace {

// One point of a scan is kept per cell. These are the largest and the smallest cell size.
// Cells of 0.5 m keep 12 thousand points of a 64-beam scan, cells of 0.1 m nearly all.
constexpr double kThinned_m = 0.5, kThinnest_m = 0.1;
// Usual number of scans that observe a cell. Shorter logs need more points per scan,
// because a plane needs at least eight points.
constexpr double kScansOnACell = 24.0;
constexpr RegisterRound kLast{0.5, 0.05};  // cell size and robust-kernel scale of the last rounds
// Cell size and robust-kernel scale of the last odometry step. The scale is larger than
// in the last rounds, because the map of odometry is less accurate.
constexpr RegisterRound kLastFollowed{0.5, 0.1};
constexpr int kLevels = 5, kStepsALevel = 3;  // number of levels and steps per level for held-out scans

/// Returns the size of the cells in which one point of a scan is kept.
double choose_thinning_cell_m(std::size_t n_scans) {
    return std::clamp(kThinned_m * std::sqrt(double(n_scans) / kScansOnACell), kThinnest_m, kThinned_m);
}

std::vector<ThinPoint> concatenate(const std::vector<std::vector<ThinPoint>>& scans) {
    std::vector<ThinPoint> points;
    for (const std::vector<ThinPoint>& scan : scans) points.insert(points.end(), scan.begin(), scan.end());
    return points;
}

/// Aligns the held-out (test) scans with planes that were fitted to the training scans,
/// from coarse to fine.
/// @param scans [sweeps] points of the held-out scans; empty for others
/// @return indices of the scans that could not be aligned
std::vector<std::size_t> align_held_out_sweeps(PlaneAdjustment& adjustment, const std::vector<bool>& is_test,
                                               const std::vector<bool>& is_train,
                                               const std::vector<std::vector<ThinPoint>>& scans,
                                               const RegisterRound& first, double largest_m) {
    std::vector<std::size_t> lost;
    const std::vector<Pose> as_neighbours = adjustment.track().pose;
    if (std::ranges::count(is_test, true) == 0) return lost;
    for (int level = 0; level < kLevels; ++level) {
        const RegisterRound round = interpolate_rounds(first, kLast, level / double(kLevels - 1));
        const double scale_m = round.scale_m;
        const PlaneMap map = adjustment.planes({round.cell_m, kLast.scale_m});
        for (std::size_t k = 0; k < scans.size(); ++k) {
            if (!is_test[k]) continue;
            for (int step = 0; step < kStepsALevel; ++step)
                adjustment.align_pose_to_planes(map, k, scans[k], scale_m);
            if (level + 1 < kLevels) continue;
            const bool found = PlaneAdjustment::is_placed(
                adjustment.compute_fraction_on_planes(map, scans[k], scale_m), scans[k].size());
            if (found && adjustment.compute_deviation_m(k, is_train) <= largest_m) continue;
            adjustment.set_pose(k, as_neighbours[k]);
            lost.push_back(k);
        }
    }
    return lost;
}

/// Returns for each sweep whether it contains one of the given frames.
std::vector<bool> mark_selected_sweeps(const Sweeps& sweeps, const std::vector<int>& positions,
                                       std::size_t n_frames) {
    std::vector<bool> among(n_frames, false), is(sweeps.frames.size(), false);
    for (const int position : positions) among[std::size_t(position)] = true;
    for (std::size_t k = 0; k < is.size(); ++k)
        is[k] =
            std::ranges::any_of(sweeps.frames[k], [&](int position) { return among[std::size_t(position)]; });
    return is;
}

/// Returns one flag per sweep, which is true only for the middle one of the selected
/// sweeps.
std::vector<bool> select_middle_sweep(const std::vector<bool>& selected) {
    std::vector<bool> is(selected.size(), false);
    auto to_go = std::ranges::count(selected, true) / 2;
    for (std::size_t k = 0; k < selected.size(); ++k)
        if (selected[k] && to_go-- == 0) is[k] = true;
    return is;
}

/// Returns the share of a scan's points that lie on planes, as the median over sweeps.
/// @param selected [sweeps] sweeps that are included
double compute_median_share(const PlaneAdjustment& adjustment, const PlaneMap& map,
                            const std::vector<std::vector<ThinPoint>>& scans,
                            const std::vector<bool>& selected) {
    std::vector<double> all(scans.size()), shares;
    parallel_for(static_cast<int>(scans.size()), [&](int index) {
        all[std::size_t(index)] =
            adjustment.compute_fraction_on_planes(map, scans[std::size_t(index)], kLast.scale_m);
    });
    for (std::size_t k = 0; k < all.size(); ++k)
        if (selected[k]) shares.push_back(all[k]);
    return compute_median(std::move(shares));
}

}  // namespace

Registration register_scans(const Sequence& sequence, const Split& split, const RegisterOptions& options) {
    Registration result;
    result.world_from_vehicle = sequence.world_from_vehicle;
    const Sweeps sweeps = group_frames_by_sweep(sequence);
    const std::vector<bool> is_train = mark_selected_sweeps(sweeps, split.train, sequence.frames.size()),
                            is_test = mark_selected_sweeps(sweeps, split.test, sequence.frames.size());
    const auto n_train = static_cast<std::size_t>(std::ranges::count(is_train, true));
    if (n_train < 2) return result;
    const double thin_m = choose_thinning_cell_m(n_train);
    const auto proceed = [&](const char* description) {
        return [&, description](double done) {
            if (options.progress) options.progress(description, done);
            return !(result.stopped = options.stop && options.stop());
        };
    };
    const RegisterRound first{std::max(2.0 * options.largest_m, kLast.cell_m),
                              std::max(0.5 * options.largest_m, kLast.scale_m)};

    const std::vector<std::vector<ThinPoint>> scans = thin_scans(sequence, sweeps, is_train, options, thin_m);
    const PoseTrack followed = estimate_poses(
        sweeps.track, scans,
        {first, kLastFollowed, options.use_pose_motion, proceed("tracking the scans"), options.group});
    if (result.stopped || !options.group.is_first()) return result;
    const ClosedLoops closed =
        close_loops(followed, scans, {first, kLastFollowed, proceed("detecting loop closures")});
    if (result.stopped) return result;
    result.n_loop_closures = closed.places;
    result.largest_loop_error_m = closed.largest_m;

    PlaneAdjustment adjustment(sweeps.track, closed.track, concatenate(scans),
                               options.use_pose_motion ? is_train : select_middle_sweep(is_train));
    result.rounds = adjustment.run(first, kLast, proceed("registering all scans jointly"));
    if (result.stopped) return result;
    if (result.rounds.back().planes == 0)
        throw DataError(fmt::format(
            "cannot register the scans of {}: no surface is visible in two of its {} training scans; "
            "use train.refine_poses=none to keep the poses of the log",
            sequence.name, split.train.size()));
    const PlaneMap map = adjustment.planes(kLast);
    result.on_planes = compute_median_share(adjustment, map, scans, is_train);
    result.lost = adjustment.replace_lost_poses(map, is_train, kLast.scale_m, options.largest_m);
    const std::vector<std::vector<ThinPoint>> held_out =
        thin_scans(sequence, sweeps, is_test, options, thin_m);
    const std::vector<std::size_t> lost =
        align_held_out_sweeps(adjustment, is_test, is_train, held_out, first, options.largest_m);
    result.lost.insert(result.lost.end(), lost.begin(), lost.end());
    std::sort(result.lost.begin(), result.lost.end());
    for (std::size_t& k : result.lost) k = sweeps.pose[k];
    result.world_from_vehicle =
        apply_correction_to_track(sequence.world_from_vehicle, sweeps, adjustment.track());
    result.done = true;
    return result;
}

}  // namespace relidar
