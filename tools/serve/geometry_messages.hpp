// SPDX-License-Identifier: Apache-2.0
// Converts poses and times between messages and relidar's types. Messages are untrusted
// input and are checked here.
#pragma once

#include <string>

#include <google/protobuf/repeated_ptr_field.h>

#include <relidar/log/sequence.hpp>

#include "relidar/v1/render.pb.h"

namespace relidar::serve {

/// Tolerance for the length of a unit vector or quaternion, which may have been sent in
/// single precision or rounded in a text.
inline constexpr double kUnitSlack = 1e-3;

/// Reads a pose.
/// @param field name of the field in the request, for messages
/// @throws Refusal for values that are not finite, too large, or not a unit quaternion
Pose read_pose(const v1::Pose& message, const std::string& field);
/// Reads a track of poses.
/// @throws Refusal as read_pose(), for no or too many poses, and for times that do not
/// increase
PoseTrack read_track(const google::protobuf::RepeatedPtrField<v1::TimedPose>& messages,
                     const std::string& field);
/// Returns a time after checking its value.
/// @throws Refusal for a value that is not finite or exceeds 1e10
double read_time(double time_s, const std::string& field);

void write_pose(const Pose& pose, v1::Pose& message);
void write_track(const PoseTrack& track, google::protobuf::RepeatedPtrField<v1::TimedPose>& messages);

}  // namespace relidar::serve
