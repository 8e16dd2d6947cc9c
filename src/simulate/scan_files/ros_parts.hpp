// SPDX-License-Identifier: Apache-2.0
// Writes parts of ROS 2 messages that several topics contain: headers, poses and
// velocities.
#pragma once

#include <cstdint>
#include <string>

#include "base/codecs/cdr.hpp"
#include "recording_format.hpp"

namespace relidar::scan_files {

constexpr std::uint64_t kNanoseconds = 1'000'000'000;  // nanoseconds per second
// Number of elements of a covariance matrix. All elements are 0, because simulated poses
// and velocities are exact.
constexpr int kCovariance = 36;

inline void add_time(Cdr& cdr, std::uint64_t time_ns) {
    cdr.add(std::int32_t(time_ns / kNanoseconds)).add(std::uint32_t(time_ns % kNanoseconds));
}
inline void add_header(Cdr& cdr, std::uint64_t stamp_ns, const std::string& frame) {
    add_time(cdr, stamp_ns), cdr.add_text(frame);
}

inline void add_vector(Cdr& cdr, const glm::dvec3& vector) { cdr.add(vector.x).add(vector.y).add(vector.z); }
/// Adds a pose or a transform.
inline void add_pose(Cdr& cdr, const Pose& pose) {
    add_vector(cdr, pose.translation);
    cdr.add(pose.rotation.x).add(pose.rotation.y).add(pose.rotation.z).add(pose.rotation.w);
}
inline void add_covariance(Cdr& cdr) {
    for (int i = 0; i < kCovariance; ++i) cdr.add(0.0);
}
inline void add_velocity(Cdr& cdr, const Velocity& velocity) {
    add_vector(cdr, velocity.linear_mps), add_vector(cdr, velocity.angular_radps);
    add_covariance(cdr);
}

/// Returns the topics that contain the point clouds of one sensor.
std::vector<RecordedTopic> list_ros_cloud_topics(const RecordedRig& rig, std::size_t sensor);
/// Returns the topics with the boxes of the actors.
std::vector<RecordedTopic> list_ros_actor_topics();
/// Returns a topic whose quality of service is "reliable".
/// @param is_latched true if subscribers that join later receive the last message
RecordedTopic make_ros_topic(const std::string& name, const std::string& type,
                             std::function<std::vector<RecordedMessage>(const RecordedMoment&)> messages,
                             bool is_latched = false);

}  // namespace relidar::scan_files
