// SPDX-License-Identifier: Apache-2.0
// Registration of the sensor's poses: training scans together, then every held-out scan on what they found.
#include <relidar/registration.hpp>

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "core/parallel.hpp"
#include "registration/loops.hpp"
#include "registration/odometry.hpp"
#include "registration/plane_adjustment.hpp"

namespace relidar {
namespace {

constexpr double kThin_m = 0.5;                 // 12 thousand points of a 64-beam scan
constexpr RegisterRound kLast{0.5, 0.05};       // cells and kernel of the last rounds
constexpr RegisterRound kLastFollowed{0.5, 0.1};   // of a scan that is followed: a map of running sums is coarser
constexpr int kLevels = 5, kStepsALevel = 3;    // of held-out scans

std::vector<ThinPoint> joined(const std::vector<std::vector<ThinPoint>>& scans) {
    std::vector<ThinPoint> points;
    for (const std::vector<ThinPoint>& scan : scans) points.insert(points.end(), scan.begin(), scan.end());
    return points;
}

/// Coarse to fine like the training scans, but on planes that know nothing of them.
/// @param scans [held-out frames] their points @return poses of those that did not find their place
std::vector<std::size_t> place_held_out(PlaneAdjustment& adjustment, const Split& split, const std::vector<bool>& is_train,
                                        const std::vector<std::vector<ThinPoint>>& scans, const RegisterRound& first, double largest_m) {
    std::vector<std::size_t> lost;
    std::vector<Pose> as_neighbours;
    for (const int position : split.test) as_neighbours.push_back(adjustment.track().pose[std::size_t(position)]);
    for (int level = 0; level < kLevels && !scans.empty(); ++level) {
        const RegisterRound round = between(first, kLast, level / double(kLevels - 1));
        const double scale_m = round.scale_m;
        const PlaneMap map = adjustment.planes({round.cell_m, kLast.scale_m});
        for (std::size_t i = 0; i < scans.size(); ++i) {
            const auto pose = std::size_t(split.test[i]);
            for (int step = 0; step < kStepsALevel; ++step) adjustment.place_pose(map, pose, scans[i], scale_m);
            if (level + 1 < kLevels) continue;
            const bool found = PlaneAdjustment::is_placed(adjustment.share_on_planes(map, scans[i], scale_m), scans[i].size());
            if (found && adjustment.stands_out_m(pose, is_train) <= largest_m) continue;
            adjustment.set_pose(pose, as_neighbours[i]);
            lost.push_back(pose);
        }
    }
    return lost;
}

/// [poses] those of training.
std::vector<bool> marked(const std::vector<int>& positions, std::size_t n) {
    std::vector<bool> is(n, false);
    for (const int position : positions) is[std::size_t(position)] = true;
    return is;
}

double median_share(const PlaneAdjustment& adjustment, const PlaneMap& map, const std::vector<std::vector<ThinPoint>>& scans) {
    std::vector<double> shares(scans.size());
    run_parallel(static_cast<int>(scans.size()),
                 [&](int i) { shares[std::size_t(i)] = adjustment.share_on_planes(map, scans[std::size_t(i)], kLast.scale_m); });
    std::nth_element(shares.begin(), shares.begin() + std::ptrdiff_t(shares.size() / 2), shares.end());
    return shares[shares.size() / 2];
}

}  // namespace

Registration register_scans(const Sequence& sequence, const Split& split, const RegisterOptions& options) {
    if (sequence.lidars.size() > 1)
        throw UsageError(
            fmt::format("registering the scans of {}: found {} LiDARs, expected one; train.pose_register=false keeps the log's own poses",
                        sequence.name, sequence.lidars.size()));
    Registration result;
    result.world_from_vehicle = sequence.world_from_vehicle;
    if (split.train.size() < 2) return result;
    const auto proceed = [&](const char* what) {
        return [&, what](double done) {
            if (options.progress) options.progress(what, done);
            return !(result.stopped = options.stop && options.stop());
        };
    };
    const std::vector<bool> is_train = marked(split.train, sequence.frames.size());
    const RegisterRound first{std::max(2.0 * options.largest_m, kLast.cell_m), std::max(0.5 * options.largest_m, kLast.scale_m)};

    const std::vector<std::vector<ThinPoint>> scans = thin_scans(sequence, split.train, options, kThin_m);
    std::vector<std::vector<ThinPoint>> by_pose(sequence.frames.size());
    for (std::size_t i = 0; i < scans.size(); ++i) by_pose[std::size_t(split.train[i])] = scans[i];
    const PoseTrack followed = follow_scans(
        sequence.world_from_vehicle, by_pose, {first, kLastFollowed, options.given_motion, proceed("following the scans"), options.team});
    if (result.stopped || !options.team.is_first()) return result;
    const ClosedLoops closed = close_loops(followed, by_pose, {first, kLastFollowed, proceed("looking for roads driven again")});
    if (result.stopped) return result;
    result.places_again = closed.places;
    result.loops_off_m = closed.largest_m;

    const std::vector<bool> gauge = options.given_motion ? is_train : marked({split.train[split.train.size() / 2]}, sequence.frames.size());
    PlaneAdjustment adjustment(sequence.world_from_vehicle, closed.track, joined(scans), gauge);
    result.rounds = adjustment.run(first, kLast, proceed("registering all scans together"));
    if (result.stopped) return result;
    if (result.rounds.back().planes == 0)
        throw DataError(
            fmt::format("registering the scans of {}: found no surface that two of its {} training scans see, expected some; "
                        "train.pose_register=false leaves poses where they are",
                        sequence.name, split.train.size()));
    const PlaneMap map = adjustment.planes(kLast);
    result.on_planes = median_share(adjustment, map, scans);
    result.lost = adjustment.replace_lost(map, is_train, kLast.scale_m, options.largest_m);
    const std::vector<std::size_t> lost =
        place_held_out(adjustment, split, is_train, thin_scans(sequence, split.test, options, kThin_m), first, options.largest_m);
    result.lost.insert(result.lost.end(), lost.begin(), lost.end());
    std::sort(result.lost.begin(), result.lost.end());
    result.world_from_vehicle = adjustment.track();
    result.done = true;
    return result;
}

}  // namespace relidar
