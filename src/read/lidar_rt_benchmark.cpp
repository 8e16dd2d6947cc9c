// SPDX-License-Identifier: Apache-2.0
// Converts a sequence name of the LiDAR-RT paper to a drive and a range of frames.
#include "read/lidar_rt_benchmark.hpp"

#include <algorithm>

#include "base/fail.hpp"

namespace relidar {

DriveFrames find_drive(const DatasetOptions& options, std::span<const BenchmarkSequence> sequences) {
    const auto part = std::find_if(sequences.begin(), sequences.end(),
                                   [&](const BenchmarkSequence& p) { return options.sequence == p.name; });
    // Any name that is not a sequence of the paper is the name of a drive.
    if (part == sequences.end()) return {options.sequence, options.frames};
    const int begin = std::max(options.frames.begin, part->first);
    // FrameRange::end is exclusive, and negative without a limit. `last` is inclusive.
    const int end = options.frames.end < 0 ? part->last + 1 : std::min(options.frames.end, part->last + 1);
    if (begin >= end)
        fail<UsageError>("frames {}:{} contain no frame of {}, which has the frames {} to {}",
                         options.frames.begin, options.frames.end, part->name, part->first, part->last);
    std::vector<int> test_frames;
    for (int k = 0, frame = part->test_first; k < kBenchmarkTestFrames; ++k, frame += part->test_every)
        if (frame >= begin && frame < end) test_frames.push_back(frame);
    return {part->drive, {begin, end}, true, test_frames};
}

}  // namespace relidar
