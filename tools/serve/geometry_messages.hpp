// SPDX-License-Identifier: Apache-2.0
// Converts and checks poses and times of messages. The templates accept the messages of
// both services, whose numbers are double in render.proto and float in sensorsim.proto.
#pragma once

#include <string>

#include <google/protobuf/repeated_ptr_field.h>

#include <relidar/log/log.hpp>

#include "relidar/v1/render.pb.h"

namespace relidar::serve {

/// Of a unit vector or quaternion. Clients may send float values or rounded text.
inline constexpr double kUnitSlack = 1e-3;

/// Normalises the rotation, which clients may send with float precision.
Pose checked_pose(const Pose& pose, const std::string& name);
PoseTrack read_track(const google::protobuf::RepeatedPtrField<v1::TimedPose>& messages,
                     const std::string& name);
/// @param value coordinate in metres, or time in seconds
double checked_number(double value, const std::string& name);

template <class PoseMessage>
Pose read_pose(const PoseMessage& message, const std::string& name) {
    const auto& t = message.translation();
    Pose pose;
    pose.translation = {t.x(), t.y(), t.z()};
    if (message.has_rotation()) {
        const auto& q = message.rotation();
        pose.rotation = glm::dquat(q.w(), q.x(), q.y(), q.z());
    }
    return checked_pose(pose, name);
}

template <class VectorMessage>
void write_vector(const glm::dvec3& vector, VectorMessage& message) {
    using Number = decltype(message.x());
    message.set_x(Number(vector.x));
    message.set_y(Number(vector.y));
    message.set_z(Number(vector.z));
}

template <class PoseMessage>
void write_pose(const Pose& pose, PoseMessage& message) {
    write_vector(pose.translation, *message.mutable_translation());
    auto& rotation = *message.mutable_rotation();
    write_vector({pose.rotation.x, pose.rotation.y, pose.rotation.z}, rotation);
    rotation.set_w(decltype(rotation.w())(pose.rotation.w));
}

void write_track(const PoseTrack& track, google::protobuf::RepeatedPtrField<v1::TimedPose>& messages);

}  // namespace relidar::serve
