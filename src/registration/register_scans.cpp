// SPDX-License-Identifier: Apache-2.0
// Registration of the sensor's poses: training scans together, then every held-out scan on what they found.
#include <relidar/registration.hpp>

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "registration/plane_adjustment.hpp"

namespace relidar {
namespace {

constexpr double kThin_m = 0.5;                 // 12 thousand points of a 64-beam scan
constexpr RegisterRound kLast{0.5, 0.05};       // cells and kernel of the last rounds
constexpr int kLevels = 5, kStepsALevel = 3;    // of held-out scans

std::vector<ThinPoint> joined(const std::vector<std::vector<ThinPoint>>& scans) {
    std::vector<ThinPoint> points;
    for (const std::vector<ThinPoint>& scan : scans) points.insert(points.end(), scan.begin(), scan.end());
    return points;
}

/// Coarse to fine like the training scans, but on planes that know nothing of them.
void place_held_out(PlaneAdjustment& adjustment, const Split& split, const std::vector<std::vector<ThinPoint>>& scans, const RegisterRound& first, const RegisterOptions& options, std::vector<std::size_t>& lost) {
    std::vector<Pose> as_neighbours;
    for (const int position : split.test) as_neighbours.push_back(adjustment.track().pose[std::size_t(position)]);
    for (int level = 0; level < kLevels && !scans.empty(); ++level) {
        const double t = level / double(kLevels - 1);
        const double scale_m = first.scale_m * std::pow(kLast.scale_m / first.scale_m, t);
        const PlaneMap map = adjustment.planes({first.cell_m * std::pow(kLast.cell_m / first.cell_m, t), kLast.scale_m});
        for (std::size_t i = 0; i < scans.size(); ++i) {
            const auto pose = std::size_t(split.test[i]);
            for (int step = 0; step < kStepsALevel; ++step) adjustment.place_pose(map, pose, scans[i], scale_m);
            if (level + 1 < kLevels || adjustment.is_placed(map, pose, scans[i], scale_m, options.largest_m)) continue;
            adjustment.set_pose(pose, as_neighbours[i]);
            lost.push_back(pose);
        }
    }
}

}  // namespace

Registration register_scans(const Sequence& sequence, const Split& split, const RegisterOptions& options) {
    Registration result{sequence.world_from_sensor, {}, {}, false};
    if (split.train.size() < 2) return result;
    std::vector<bool> is_train(sequence.frames.size(), false);
    for (const int position : split.train) is_train[std::size_t(position)] = true;
    const RegisterRound first{std::max(2.0 * options.largest_m, kLast.cell_m), std::max(0.5 * options.largest_m, kLast.scale_m)};

    PlaneAdjustment adjustment(sequence.world_from_sensor, joined(thin_scans(sequence, split.train, options, kThin_m)), is_train);
    result.rounds = adjustment.run(first, kLast, [&] { return result.stopped = options.stop && options.stop(); });
    if (result.stopped) return result;
    if (result.rounds.back().planes == 0)
        throw DataError(fmt::format("registering the scans of {}: found no surface that two of its {} training scans see, expected some; train.pose_register=false leaves poses where they are", sequence.name, split.train.size()));
    result.lost = adjustment.replace_lost(adjustment.planes(kLast), is_train, kLast.scale_m, options.largest_m);
    place_held_out(adjustment, split, thin_scans(sequence, split.test, options, kThin_m), first, options, result.lost);
    std::sort(result.lost.begin(), result.lost.end());
    result.world_from_sensor = adjustment.track();
    return result;
}

}  // namespace relidar
