// SPDX-License-Identifier: Apache-2.0
// The table of all checks of a loaded log. Later rows rely on earlier rows.
#include "log/checks/checks.hpp"

#include <algorithm>

#include <relidar/log/checks.hpp>

#include "base/parallel.hpp"

namespace relidar::checks {
namespace {

constexpr Check kChecks[] = {
    {"frames", test_frames, "found no frame, expected at least one frame", true},
    {"lidar_names", test_lidar_names, "found two LiDARs with the name '{}', expected different names", true},
    {"frame_numbers", test_frame_numbers,
     "frame {}: found a second frame with this number, expected each number once for each LiDAR", true},
    {"frame_times", test_frame_times,
     "frame {}: found the time {} s after frame {} at {} s, expected a time at least {} s later, or the same "
     "time and a higher LiDAR index",
     true},
    {"clock_jump", test_clock_jump,
     "frame {}: found a time {:.1f} s after frame {}, expected a step of at most {} s (the median step is "
     "{:.3g} s); use --frames to select frames before or after the gap",
     true},
    {"poses", test_poses,
     "{}: found the position ({}, {}, {}) and a quaternion of length {}, expected a position at most {} m "
     "from the origin of the world and length 1",
     true},
    {"array_sizes", test_array_sizes, "frame {}, {}: found {} entries, expected {} x {}", true},
    {"rays", test_rays, "frame {}, ray {}, {}: found {}, expected {} to {}", true},
    {"box_sizes", test_box_sizes, "box '{}': found the size {} x {} x {} m, expected sides above 0 m", true},
    {"box_times", test_box_times,
     "box '{}', pose {}: found the time {} s after the time {} s, expected increasing times", true},
    {"box_places", test_box_places,
     "box '{}', pose {}: found a distance of {:.0f} m from the vehicle, expected at most {} m, because boxes "
     "and vehicle poses must be in the same world frame",
     true},
    {"time_gaps", test_time_gaps,
     "the frame times have {} gaps of more than a second; the longest is {:.1f} s, between frames {} and {} "
     "(the median step is {:.3g} s); poses in gaps are interpolated"},
    {"time_unit", test_time_unit,
     "the unit of the times is probably wrong: frames are {:.6g} s apart, but a sweep takes {:.3g} s; the "
     "times of frames seem to be in {}, expected seconds"},
    {"speed", test_speed,
     "the poses or their times are probably wrong: the vehicle moves faster than {} m/s in {} of {} steps "
     "between frames, and at {:.0f} m/s from frame {} to frame {}; expected positions in metres and times in "
     "seconds"},
    {"float_positions", test_float_positions,
     "the positions of the vehicle have lost their precision: all {} coordinates are multiples of {:.3g} m, "
     "which is the precision of float32 at {:.0f} m; expected double precision"},
    {"few_returns", test_few_returns,
     "some scans are probably incomplete: {} of {} scans have fewer than half of the returns of neighbouring "
     "scans; frame {} has only {} instead of about {}"},
    {"rotation", test_rotation,
     "the direction of rotation is probably wrong: by the times of the points, the head turns {}, but its "
     "sensor turns {}; check the sign of the times and of y"},
    {"equal_intensities", test_equal_intensities,
     "all intensities of the log are {:.4g} of the maximum, so rendered intensities have no meaning"},
    {"dark", test_dark,
     "the scale of the intensities is probably wrong: the largest intensity is {:.2g} of the maximum"},
    {"saturated", test_saturated,
     "the scale of the intensities is probably wrong: {:.0f} % of the returns have the maximum intensity"},
    {"box_convention", test_box_convention, "the boxes are probably wrong: {}"},
};

}  // namespace

void note_faults(Log& sequence) {
    CheckedLog log{sequence, std::vector<ReturnStatistics>(sequence.frames.size())};
    parallel_for(int(log.scans.size()), [&](int index) {
        const Scan& scan = sequence.frames[std::size_t(index)].scan;
        ReturnStatistics& statistics = log.scans[std::size_t(index)];
        for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
            if (!(scan.range_m[ray] > 0.0f)) continue;
            ++statistics.n_returns;
            statistics.n_at_maximum += scan.intensity[ray] == 1.0f;
            statistics.lowest = std::min(statistics.lowest, scan.intensity[ray]);
            statistics.highest = std::max(statistics.highest, scan.intensity[ray]);
        }
    });
    for (const Check& check : kChecks)
        if (!check.is_error) check.test(log, {check, sequence, sequence.notes});
}

}  // namespace relidar::checks

namespace relidar {

void check_sequence(const Log& sequence) {
    Notes none;
    for (const checks::Check& check : checks::kChecks)
        if (check.is_error) check.test({sequence}, {check, sequence, none});
}

}  // namespace relidar
