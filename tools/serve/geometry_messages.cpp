// SPDX-License-Identifier: Apache-2.0
#include "geometry_messages.hpp"

#include <cmath>

#include "refusal.hpp"

namespace relidar::serve {
namespace {

// Metres or seconds. ScanRenderer rejects larger values.
constexpr double kMaxCoordinate_m = 1e10;
// Normalising a unit quaternion would only add rounding errors.
constexpr double kDoublePrecision = 1e-12;
constexpr int kMostPoses = 100'000;

double checked_number(double value, const std::string& name) {
    if (!(std::abs(value) <= kMaxCoordinate_m))
        reject_field(name, fmt::format("{}", value), "a finite number of at most 1e10");
    return value;
}

}  // namespace

double checked_time(double time_s, const std::string& name) { return checked_number(time_s, name); }

/// Reads a pose and checks its values. Normalises the rotation, which clients may send
/// with float precision.
Pose read_pose(const v1::Pose& message, const std::string& name) {
    const v1::Vector& t = message.translation();
    Pose pose;
    pose.translation = {checked_number(t.x(), name + ".translation.x"),
                        checked_number(t.y(), name + ".translation.y"),
                        checked_number(t.z(), name + ".translation.z")};
    if (!message.has_rotation()) return pose;
    const v1::Quaternion& q = message.rotation();
    pose.rotation = glm::dquat(q.w(), q.x(), q.y(), q.z());
    const double length = glm::length(pose.rotation);
    if (!(std::abs(length - 1.0) <= kUnitSlack))
        reject_field(name + ".rotation", fmt::format("a quaternion of length {}", length), "length 1");
    if (std::abs(length - 1.0) > kDoublePrecision) pose.rotation = glm::normalize(pose.rotation);
    return pose;
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
        const double time_s = checked_time(messages[i].time_s(), entry + ".time_s");
        if (i > 0 && !(time_s > track.time_s.back()))
            reject_field(entry + ".time_s", fmt::format("{} after {}", time_s, track.time_s.back()),
                         "increasing times");
        track.time_s.push_back(time_s);
        track.pose.push_back(read_pose(messages[i].pose(), entry + ".pose"));
    }
    return track;
}

void write_vector(const glm::dvec3& vector, v1::Vector& message) {
    message.set_x(vector.x);
    message.set_y(vector.y);
    message.set_z(vector.z);
}

void write_pose(const Pose& pose, v1::Pose& message) {
    write_vector(pose.translation, *message.mutable_translation());
    message.mutable_rotation()->set_w(pose.rotation.w);
    message.mutable_rotation()->set_x(pose.rotation.x);
    message.mutable_rotation()->set_y(pose.rotation.y);
    message.mutable_rotation()->set_z(pose.rotation.z);
}

void write_track(const PoseTrack& track, google::protobuf::RepeatedPtrField<v1::TimedPose>& messages) {
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        v1::TimedPose& message = *messages.Add();
        message.set_time_s(track.time_s[i]);
        write_pose(track.pose[i], *message.mutable_pose());
    }
}

}  // namespace relidar::serve
