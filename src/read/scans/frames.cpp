// SPDX-License-Identifier: Apache-2.0
// Adds frames, poses and boxes to a log while a reader creates it. Checks the frames that
// the user requests.
#include <relidar/read/clouds.hpp>

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "read/scans/frame_range.hpp"

namespace relidar {

Pose make_pose(const glm::dmat3& rotation, const glm::dvec3& translation, const std::string& where) {
    // R^T R - I is zero for a rotation. A reflection has a negative determinant.
    const glm::dmat3 excess = glm::transpose(rotation) * rotation - glm::dmat3(1.0);
    double worst = 0.0;
    for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) worst = std::max(worst, std::abs(excess[c][r]));
    if (!(worst <= 1e-3) || !(glm::determinant(rotation) > 0.0))
        fail(
            "{}: R^T R differs from the identity by {:.3g}, the determinant is {:.3g}, expected a rotation "
            "(orthonormal)",
            where, worst, glm::determinant(rotation));
    return {glm::normalize(glm::quat_cast(rotation)), translation};
}

Pose make_pose(std::span<const double> matrix, const std::string& place) {
    const auto& m = matrix;  // by rows; glm stores columns
    return make_pose({m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]}, {m[3], m[7], m[11]}, place);
}

Frame& add_frame(Log& log, int number, double time_s, const Pose& world_from_vehicle, int lidar) {
    PoseTrack& track = log.world_from_vehicle;
    if (track.time_s.empty() || track.time_s.back() != time_s) track.append(time_s, world_from_vehicle);
    return log.frames.emplace_back(Frame{number, time_s, {}, lidar});
}

void centre_log(Log& log) {
    const std::vector<Pose>& poses = log.world_from_vehicle.pose;
    if (!poses.empty()) centre_log(log, poses[poses.size() / 2].translation);
}

void centre_log(Log& log, glm::dvec3 new_origin_m) {
    log.world_offset_m += new_origin_m;
    for (Pose& pose : log.world_from_vehicle.pose) pose.translation -= new_origin_m;
    for (BoxTrack& box : log.boxes)
        for (Pose& pose : box.world_from_box.pose) pose.translation -= new_origin_m;
}

std::vector<BoxTrack> build_tracks(const std::vector<BoxLabel>& labels) {
    std::vector<BoxTrack> tracks;
    std::unordered_map<std::string, std::size_t> track_index_of_id;
    for (const BoxLabel& label : labels) {
        const auto [known, is_new] = track_index_of_id.try_emplace(label.id, tracks.size());
        if (is_new) tracks.push_back({label.id, label.category, label.size_m, {}});
        PoseTrack& track = tracks[known->second].world_from_box;
        track.append(label.time_s, label.world_from_box);
    }
    return tracks;
}

void fail_empty_range(const FrameRange& range, const std::string& log_name, int first, int last) {
    fail<UsageError>("frames {}:{} select no frame of {}, expected numbers in [{}, {}]", range.begin,
                     range.end < 0 ? "" : std::to_string(range.end), log_name, first, last);
}

FrameRange limit_frames(const FrameRange& range, int n_frames, const std::string& log_name) {
    const int end = range.end < 0 ? n_frames : std::min(range.end, n_frames);
    if (range.begin >= end) fail_empty_range(range, log_name, 0, n_frames - 1);
    return {range.begin, end};
}

}  // namespace relidar
