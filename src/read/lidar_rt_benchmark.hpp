// SPDX-License-Identifier: Apache-2.0
// Lists the sequences of KITTI-360 and Waymo on which the LiDAR-RT paper evaluates. The
// names are from the supplementary tables of the paper.
#pragma once

#include <algorithm>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <fmt/format.h>

#include <relidar/read/dataset.hpp>

#include "base/fail.hpp"

namespace relidar {

struct BenchmarkSequence {
    const char* name;
    const char* drive;  ///< part of the drive's name in the dataset that is unique
    int first, last;    ///< first and last frame
    /// Test frames of the LiDAR-RT paper: test_first, test_first + test_every, and so on.
    int test_first, test_every;
};
inline constexpr int kBenchmarkTestFrames = 4;

inline constexpr BenchmarkSequence kKitti360Benchmark[] = {
    {"ks1", "0000", 1538, 1601, 1551, 13},    {"ks2", "0000", 1728, 1791, 1741, 13},
    {"ks3", "0000", 1908, 1971, 1921, 13},    {"ks4", "0000", 3353, 3415, 3366, 13},
    {"kd1", "0000", 2351, 2400, 2360, 10},    {"kd2", "0000", 4951, 5000, 4960, 10},
    {"kd3", "0000", 8121, 8170, 8130, 10},    {"kd4", "0000", 10201, 10250, 10210, 10},
    {"kd5", "0000", 10751, 10800, 10760, 10}, {"kd6", "0000", 11401, 11450, 11410, 10},
};
inline constexpr BenchmarkSequence kWaymoBenchmark[] = {
    {"ws1", "113792", 1, 50, 10, 10},     {"ws2", "106762", 1, 50, 10, 10},
    {"ws3", "177619", 1, 50, 10, 10},     {"ws4", "117240", 1, 50, 10, 10},
    {"wd1", "108305", 148, 197, 157, 10}, {"wd2", "132712", 51, 100, 60, 10},
    {"wd3", "100721", 1, 50, 10, 10},     {"wd4", "105003", 148, 197, 157, 10},
};

struct DriveFrames {
    /// Name of a drive (a recording of the dataset), or a unique part of it.
    std::string drive;
    /// Range of frames, limited to the sequence of the LiDAR-RT paper if the user named
    /// one.
    FrameRange frames;
    bool is_benchmark = false;
    /// Test frames of the LiDAR-RT paper in `frames`. Empty if the user named no
    /// sequence.
    std::vector<int> test_frames = {};
    Notes notes = {};
};
/// Returns the drive (a recording of the dataset) and the frames that the user requested.
/// options.sequence is the name of a drive, or of a sequence of the LiDAR-RT paper.
/// @throws UsageError if this sequence contains none of the requested frames
inline DriveFrames find_drive(const DatasetOptions& options, std::span<const BenchmarkSequence> sequences) {
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

/// Returns one of the drives of a dataset, and which of its frames to read: the first
/// drive that find_drive() describes, or nothing without such a drive. If the user named
/// no drive, returns the first one, and a note.
/// @param kind  plural of the dataset's word for a drive
/// @param is_called  is_called(drive, name) returns true if `name` describes a drive
template <class IsCalled>
std::optional<DriveFrames> choose_drive(const std::vector<std::string>& drives, const char* kind,
                                        const DatasetOptions& options,
                                        std::span<const BenchmarkSequence> sequences,
                                        const IsCalled& is_called) {
    DriveFrames chosen = find_drive(options, sequences);
    auto drive = drives.begin();
    if (!chosen.drive.empty())
        drive = std::find_if(drives.begin(), drives.end(),
                             [&](const std::string& name) { return is_called(name, chosen.drive); });
    else if (drives.size() > 1)
        chosen.notes = {fmt::format("the first of {} {} is read; use dataset.sequence to select another one",
                                    drives.size(), kind)};
    if (drive == drives.end()) return std::nullopt;
    chosen.drive = *drive;
    return chosen;
}

}  // namespace relidar
