// SPDX-License-Identifier: Apache-2.0
// Parts that messages of ROS 2 share.
#pragma once

#include <cstdint>
#include <string>

#include "base/codecs/cdr.hpp"
#include "recording_format.hpp"

namespace relidar::scan_files {

constexpr std::uint64_t kNanoseconds = 1'000'000'000;  // a second
constexpr int kCovariance = 36;  // numbers of a covariance: 0 where nothing is uncertain

inline void add_time(Cdr& cdr, std::uint64_t time_ns) {
    cdr.add(std::int32_t(time_ns / kNanoseconds)).add(std::uint32_t(time_ns % kNanoseconds));
}
inline void add_header(Cdr& cdr, std::uint64_t stamp_ns, const std::string& frame) {
    add_time(cdr, stamp_ns), cdr.add_text(frame);
}

inline void add_vector(Cdr& cdr, const glm::dvec3& v) { cdr.add(v.x).add(v.y).add(v.z); }
/// A pose, or a transform.
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

/// Topics of one sensor's clouds.
std::vector<RecordedTopic> ros_cloud_topics(const RecordedRig& rig, std::size_t sensor);
/// Topics of the actors' boxes.
std::vector<RecordedTopic> ros_actor_topics();
/// A topic of a type, reliably published. @param is_latched  the last message is there
/// for who comes later
RecordedTopic ros_topic(const std::string& name, const std::string& type,
                        std::function<std::vector<RecordedMessage>(const RecordedMoment&)> messages,
                        bool is_latched = false);

}  // namespace relidar::scan_files
