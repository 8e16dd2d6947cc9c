// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/blocks.hpp>

#include <algorithm>

#include <fmt/ranges.h>

#include "base/list_text.hpp"
#include "run/blocks/frame_places.hpp"

namespace relidar {
namespace {

// farther boxes have hardly any returns
constexpr double kMaxBoxDistance_m = 100.0;

/// Returns the vehicle poses at the times of some frames, and the poses directly before
/// and after each. These are needed to interpolate the motion during a sweep.
PoseTrack cut_track(const Log& sequence, const std::vector<int>& frame_indices) {
    const PoseTrack& all = sequence.world_from_vehicle;
    std::vector<bool> is_used(all.time_s.size(), false);
    for (const int position : frame_indices) {
        const double time_s = sequence.frames[std::size_t(position)].time_s;
        const auto at =
            std::size_t(std::lower_bound(all.time_s.begin(), all.time_s.end(), time_s) - all.time_s.begin());
        for (std::size_t i = at > 0 ? at - 1 : 0; i <= std::min(at + 1, is_used.size() - 1); ++i)
            is_used[i] = true;
    }
    PoseTrack track;
    for (std::size_t i = 0; i < is_used.size(); ++i)
        if (is_used[i]) {
            track.time_s.push_back(all.time_s[i]);
            track.pose.push_back(all.pose[i]);
        }
    return track;
}

/// Removes actors without a box in this part of the log from options.actor_tracks, the
/// user's list. If none remains, also clears options.actor_classes, because with an empty
/// list the classes would select actors.
void drop_missing_tracks(InitOptions& options, const std::vector<BoxTrack>& boxes) {
    if (options.actor_tracks.empty()) return;
    std::vector<std::string> remaining_tracks;
    for (const std::string& track : split_list(options.actor_tracks))
        if (std::any_of(boxes.begin(), boxes.end(), [&](const BoxTrack& b) { return b.id == track; }))
            remaining_tracks.push_back(track);
    options.actor_tracks = fmt::format("{}", fmt::join(remaining_tracks, ","));
    if (remaining_tracks.empty()) options.actor_classes.clear();
}

}  // namespace

/// Returns the part of the log that a block needs: its training frames, its held-out
/// frames, and the poses and boxes near them.
BlockTrainingLog cut_log(const Log& sequence, const Split& split, const TrajectoryBlock& block,
                         const Config& config) {
    // in the order of the log
    std::vector<int> frames = block.train;
    for (const int position : block.recorded_frames)
        if (std::find(split.test.begin(), split.test.end(), position) != split.test.end())
            frames.push_back(position);
    std::sort(frames.begin(), frames.end());
    BlockTrainingLog log{strip_frames(sequence), {}, config};
    Log& part = log.sequence;
    part.name = fmt::format("{}, metres {:.0f} to {:.0f}", sequence.name, block.begin_m, block.end_m);
    part.world_from_vehicle = cut_track(sequence, frames);
    part.boxes.clear();
    for (const int position : frames) {
        const bool trains = std::binary_search(block.train.begin(), block.train.end(), position);
        (trains ? log.split.train : log.split.test).push_back(static_cast<int>(part.frames.size()));
        part.frames.push_back(sequence.frames[std::size_t(position)]);
    }
    for (const BoxTrack& box : sequence.boxes)
        if (std::any_of(frames.begin(), frames.end(), [&](int position) {
                return is_near_box(box, sequence, position, kMaxBoxDistance_m);
            }))
            part.boxes.push_back(box);
    log.config.blocks.length_m = 0.0;
    drop_missing_tracks(log.config.init, part.boxes);
    return log;
}

}  // namespace relidar
