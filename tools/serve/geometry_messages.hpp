// SPDX-License-Identifier: Apache-2.0
// Poses and times between messages and relidar's own types. Whatever a client sends is
// looked at here.
#pragma once

#include <string>

#include <google/protobuf/repeated_ptr_field.h>

#include <relidar/log/sequence.hpp>

#include "relidar/v1/render.pb.h"

namespace relidar::serve {

/// How far the length of a unit vector or quaternion may be from 1: of one that was sent
/// in single precision, or rounded in a text.
inline constexpr double kUnitSlack = 1e-3;

/// @param field  its name in the request, for messages @throws Refusal for what is not
/// finite, too large, or no unit quaternion
Pose read_pose(const v1::Pose& message, const std::string& field);
/// @throws Refusal too for no pose, too many, or times that do not rise
PoseTrack read_track(const google::protobuf::RepeatedPtrField<v1::TimedPose>& messages,
                     const std::string& field);
/// @throws Refusal for what is not finite or beyond 1e10
double read_time(double time_s, const std::string& field);

void write_pose(const Pose& pose, v1::Pose& message);
void write_track(const PoseTrack& track, google::protobuf::RepeatedPtrField<v1::TimedPose>& messages);

}  // namespace relidar::serve
