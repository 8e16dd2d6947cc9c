// SPDX-License-Identifier: Apache-2.0
#include "geometry_messages.hpp"

#include <cmath>

#include "refusal.hpp"

namespace relidar::serve {
namespace {

// ScanRenderer rejects larger values.
constexpr double kMaxCoordinate_m = 1e10;
// Normalising a unit quaternion would only add rounding errors.
constexpr double kDoublePrecision = 1e-12;
constexpr int kMostPoses = 100'000;

}  // namespace

double checked_number(double value, const std::string& name) {
    if (!(std::abs(value) <= kMaxCoordinate_m))
        reject_field(name, fmt::format("{}", value), "a finite number of at most 1e10");
    return value;
}

Pose checked_pose(const Pose& pose, const std::string& name) {
    for (int axis = 0; axis < 3; ++axis)
        checked_number(pose.translation[axis], fmt::format("{}.translation.{}", name, "xyz"[axis]));
    const double length = glm::length(pose.rotation);
    if (!(std::abs(length - 1.0) <= kUnitSlack))
        reject_field(name + ".rotation", fmt::format("a quaternion of length {}", length), "length 1");
    if (std::abs(length - 1.0) <= kDoublePrecision) return pose;
    return {glm::normalize(pose.rotation), pose.translation};
}

/// Reads a list of poses. Times must increase, because poses are interpolated in time.
PoseTrack read_track(const google::protobuf::RepeatedPtrField<v1::TimedPose>& messages,
                     const std::string& name) {
    if (messages.empty() || messages.size() > kMostPoses)
        reject_field(name, fmt::format("{} poses", messages.size()),
                     fmt::format("1 to {} poses", kMostPoses));
    PoseTrack track;
    for (int i = 0; i < messages.size(); ++i) {
        const std::string entry = fmt::format("{}[{}]", name, i);
        const double time_s = checked_number(messages[i].time_s(), entry + ".time_s");
        if (i > 0 && !(time_s > track.time_s.back()))
            reject_field(entry + ".time_s", fmt::format("{} after {}", time_s, track.time_s.back()),
                         "increasing times");
        track.time_s.push_back(time_s);
        track.pose.push_back(read_pose(messages[i].pose(), entry + ".pose"));
    }
    return track;
}

void write_track(const PoseTrack& track, google::protobuf::RepeatedPtrField<v1::TimedPose>& messages) {
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        v1::TimedPose& message = *messages.Add();
        message.set_time_s(track.time_s[i]);
        write_pose(track.pose[i], *message.mutable_pose());
    }
}

}  // namespace relidar::serve
