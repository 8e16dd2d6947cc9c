// SPDX-License-Identifier: Apache-2.0
// Converts and checks poses and times of messages.
#pragma once

#include <string>

#include <google/protobuf/repeated_ptr_field.h>

#include <relidar/log/sequence.hpp>

#include "relidar/v1/render.pb.h"

namespace relidar::serve {

/// Of a unit vector or quaternion. Clients may send float values or rounded text.
inline constexpr double kUnitSlack = 1e-3;

Pose read_pose(const v1::Pose& message, const std::string& name);
PoseTrack read_track(const google::protobuf::RepeatedPtrField<v1::TimedPose>& messages,
                     const std::string& name);
double checked_time(double time_s, const std::string& name);

void write_vector(const glm::dvec3& vector, v1::Vector& message);
void write_pose(const Pose& pose, v1::Pose& message);
void write_track(const PoseTrack& track, google::protobuf::RepeatedPtrField<v1::TimedPose>& messages);

}  // namespace relidar::serve
