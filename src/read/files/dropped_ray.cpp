// SPDX-License-Identifier: Apache-2.0
#include "read/files/dropped_ray.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace relidar {
namespace {

// relative difference of equal ranges
constexpr float kSameRange = 1e-5f;
// The maximum range of a sensor is assumed to be a multiple of this length.
constexpr float kRangeUnit_m = 0.5f;
// Minimum number of points at the maximum range, and their minimum share.
constexpr std::size_t kMinFarReturns = 64;
constexpr double kLeastShare = 0.005;

float round_range(float range_m) { return kRangeUnit_m * std::round(range_m / kRangeUnit_m); }
bool are_ranges_equal(float first_range_m, float second_range_m) {
    return std::abs(first_range_m - second_range_m) <= kSameRange * second_range_m;
}

/// Returns of a LiDAR at its largest range.
struct FarReturns {
    float range_m = 0.0f;   ///< largest range of the log
    std::size_t n = 0;      ///< returns with this range
    std::size_t n_all = 0;  ///< returns with any range

    /// Returns true if these returns stand for dropped rays.
    bool are_markers() const {
        return n >= kMinFarReturns && double(n) >= kLeastShare * double(n_all) &&
               are_ranges_equal(range_m, round_range(range_m));
    }
};

/// Counts the returns of a LiDAR at its largest range in the log.
FarReturns find_far_returns(const Log& log, int lidar_index) {
    FarReturns far;
    for (const Frame& frame : log.frames)
        if (frame.lidar == lidar_index)
            for (const float range_m : frame.scan.range_m) far.range_m = std::max(far.range_m, range_m);
    for (const Frame& frame : log.frames) {
        if (frame.lidar != lidar_index) continue;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (frame.scan.range_m[i] > 0.0f) ++far.n_all;
            if (are_ranges_equal(frame.scan.range_m[i], far.range_m)) ++far.n;
        }
    }
    return far;
}

}  // namespace

void remove_drop_markers(Log& log) {
    for (std::size_t l = 0; l < log.lidars.size(); ++l) {
        const FarReturns far = find_far_returns(log, int(l));
        if (!far.are_markers()) continue;
        // slightly below the largest range, so that equal ranges are dropped
        const double limit_m = double(far.range_m) * (1.0 - double(kSameRange));
        for (Frame& frame : log.frames)
            if (frame.lidar == int(l)) limit_ranges(frame.scan, {0.0, limit_m});
        const std::string& name = log.lidars[l].name;
        log.notes.push_back(
            fmt::format("range{}: {} of {} points have exactly the largest range, {} m: rays without return",
                        name.empty() ? "" : " of " + name, far.n, far.n_all, round_range(far.range_m)));
    }
}

}  // namespace relidar
