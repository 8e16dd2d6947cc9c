// SPDX-License-Identifier: Apache-2.0
#include "read/scans/pose_files.hpp"

#include <cmath>

#include <fmt/format.h>

#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/scans/folder_head.hpp"

namespace relidar::read {
namespace fs = std::filesystem;
namespace {

/// Returns the frames whose poses a pose file must contain: one frame per time, because
/// LiDARs that sweep simultaneously share a pose.
std::vector<LogFrame> list_posed_frames(const Log& log) {
    std::vector<LogFrame> frames;
    for (const Frame& frame : log.frames)
        if (frames.empty() || frames.back().time_s != frame.time_s)
            frames.push_back({frame.index, frame.time_s, frame.lidar, {}});
    return frames;
}

}  // namespace

std::vector<double> parse_finite(const std::string& line, std::size_t count, const std::string& place) {
    const auto numbers = parse_numbers(line);
    if (!numbers) fail("{}: found a word that is not a number, expected {} numbers", place, count);
    if (numbers->size() != count) fail("{}: found {} numbers, expected {}", place, numbers->size(), count);
    for (std::size_t i = 0; i < count; ++i)
        if (!std::isfinite((*numbers)[i]))
            fail("{}: number {} is {}, expected a finite value", place, i + 1, (*numbers)[i]);
    return *numbers;
}

Pose parse_pose(const std::string& line, const std::string& place) {
    return make_pose(parse_finite(line, 12, place), place);
}

std::vector<FrameLine> read_frame_lines(const fs::path& file, const std::vector<int>& frame_numbers) {
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    std::vector<FrameLine> frame_lines;
    for (const int frame : frame_numbers) {
        const std::size_t index = std::size_t(frame);
        if (index >= lines.size())
            fail("{}: found {} lines, but frame {} needs line {}", file.string(), lines.size(), frame,
                 index + 1);
        frame_lines.push_back({lines[index], fmt::format("{} line {}", file.string(), index + 1)});
    }
    return frame_lines;
}

std::vector<Pose> read_matrices(const fs::path& pose_file, const std::vector<int>& frame_numbers) {
    std::vector<Pose> poses;
    for (const auto& [text, where] : read_frame_lines(pose_file, frame_numbers))
        poses.push_back(parse_pose(text, where));
    return poses;
}

void replace_poses(Log& log, const DatasetOptions& options, const ScanPairReader& read_scan_pairs) {
    const fs::path& pose_file = options.poses_file;
    if (pose_file.empty()) return;
    const std::vector<double>& times_s = log.world_from_vehicle.time_s;
    if (pose_file == kNoPoses) {
        // Identity poses, until they are estimated from the scans.
        log.notes.push_back(kNoPosesNote);
        set_trajectory(log, {times_s, std::vector<Pose>(times_s.size())});
        return;
    }
    const auto poses =
        load_poses(pose_file, list_posed_frames(log), read_scan_pairs, options.conventions, log);
    if (!poses) fail("{}: no such file, expected poses (dataset.poses)", pose_file.string());
    // The file has poses in the world of the dataset, which the log shifts.
    set_trajectory(log, shift_track({times_s, *poses}, -log.world_offset_m));
}

}  // namespace relidar::read
