// SPDX-License-Identifier: Apache-2.0
#include "read/scans/dropped_ray.hpp"

#include <algorithm>
#include <cmath>
#include <set>

#include <fmt/format.h>

namespace relidar {
namespace {

// relative difference of equal ranges
constexpr float kSameRange = 1e-5f;
// The maximum range of a sensor is assumed to be a multiple of this length.
constexpr float kRangeUnit_m = 0.5f;
// Limits of the share of points at the maximum range.
constexpr double kLeastShare = 0.005, kMostShare = 0.95;
constexpr std::size_t kMinFarReturns = 64;  // minimum number of returns that have the largest range
constexpr std::size_t kFewestRows = 2;      // minimum number of beams with a return at the largest range

float round_range(float range_m) { return kRangeUnit_m * std::round(range_m / kRangeUnit_m); }
bool are_ranges_equal(float first_range_m, float second_range_m) {
    return std::abs(first_range_m - second_range_m) <= kSameRange * second_range_m;
}

struct MaxRangeReturns {
    float range_m = 0.0f;
    std::size_t n = 0, n_all = 0;
    std::set<std::uint16_t> rows;
};

/// Returns the largest range of a LiDAR, with the number and the beams of its returns.
MaxRangeReturns find_far_returns(const Log& sequence, int lidar_index) {
    MaxRangeReturns far;
    for (const Frame& frame : sequence.frames)
        if (frame.lidar == lidar_index)
            for (const float range_m : frame.scan.range_m) far.range_m = std::max(far.range_m, range_m);
    for (const Frame& frame : sequence.frames) {
        if (frame.lidar != lidar_index) continue;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            far.n_all += frame.scan.range_m[i] > 0.0f;
            if (!are_ranges_equal(frame.scan.range_m[i], far.range_m)) continue;
            ++far.n;
            far.rows.insert(frame.scan.rays.channel[i]);
        }
    }
    return far;
}

}  // namespace

void remove_drop_markers(Log& sequence) {
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l) {
        const MaxRangeReturns far = find_far_returns(sequence, int(l));
        const double share = double(far.n) / double(std::max<std::size_t>(far.n_all, 1));
        const bool marks_dropped_rays = far.n >= kMinFarReturns && far.rows.size() >= kFewestRows &&
                                        share >= kLeastShare && share <= kMostShare &&
                                        are_ranges_equal(far.range_m, round_range(far.range_m));
        if (!marks_dropped_rays) continue;
        for (Frame& frame : sequence.frames)
            if (frame.lidar == int(l))
                // slightly below the largest range, so that equal ranges are dropped
                limit_ranges(frame.scan, {0.0, double(far.range_m) * (1.0 - double(kSameRange))});
        const std::string& name = sequence.lidars[l].name;
        sequence.notes.push_back(
            fmt::format("range{}: {} of {} points have exactly the largest range, {} m: rays without return",
                        name.empty() ? "" : " of " + name, far.n, far.n_all, round_range(far.range_m)));
    }
}

}  // namespace relidar
