// SPDX-License-Identifier: Apache-2.0
// Lists the file formats of recordings and the topics that each format contains.
#pragma once

#include <relidar/simulate/scan_files.hpp>

#include "base/codecs/cdr.hpp"
#include "simulate/scan_files/recorded_moment.hpp"

namespace relidar::scan_files {

struct RecordedMessage {
    std::uint64_t logged_ns;
    std::string bytes;
};
using MessageEncoder = std::function<std::vector<RecordedMessage>(const RecordedSweep&)>;

/// Encodes a message for each state in a list of the sweep, logged at the state's time.
template <class State>
MessageEncoder encode_each(std::vector<State> RecordedSweep::*states, std::string (*encode)(const State&)) {
    return [states, encode](const RecordedSweep& sweep) {
        std::vector<RecordedMessage> messages;
        for (const State& state : sweep.*states) messages.push_back({state.time_ns, encode(state)});
        return messages;
    };
}
/// Encodes a message for each sweep.
/// @param log_time  first_ns for constant transforms, so that players can start in the
/// middle of the file; last_ns for messages that need the transforms of the sweep
template <class Encode>
MessageEncoder encode_sweep(std::uint64_t RecordedSweep::*log_time, Encode encode) {
    return [log_time, encode](const RecordedSweep& sweep) {
        return std::vector<RecordedMessage>{{sweep.*log_time, encode(sweep)}};
    };
}

/// A topic of a recording: a named stream of messages of one type.
struct RecordedTopic {
    std::string name;
    std::string type;        ///< message type
    std::string definition;  ///< definition of the message type and of all message types that it contains
    MessageEncoder messages;
    std::map<std::string, std::string> metadata = {};
};

struct RecordingFormat {
    const char* name;  ///< name of the format in ScanOutputOptions::formats
    const char *file, *help;
    const char* profile;  ///< MCAP profile of the file
    const char *definition_encoding, *message_encoding;
    std::map<std::string, std::map<std::string, std::string>> metadata;
    /// Messages with the same time are written in the order of these topics.
    std::vector<RecordedTopic> (*topics)(const RecordedRig&);
};

/// Returns the table of recordings: one MCAP file for Foxglove, and a ROS 2 bag.
std::span<const RecordingFormat> recording_formats();

/// Messages with the same time are in the order of the topics.
std::vector<ScanMessage> sorted_messages(std::span<const RecordedTopic> topics, const RecordedSweep& sweep);

/// Returns the topics of a recording of this rig, and how to encode their messages.
std::vector<RecordedTopic> foxglove_topics(const RecordedRig& rig);
std::vector<RecordedTopic> ros_topics(const RecordedRig& rig);

constexpr std::uint64_t kNsPerSecond = 1'000'000'000;  // nanoseconds per second
// All elements are 0, because simulated poses and velocities are exact.
constexpr int kCovarianceValues = 36;

inline void add_time(codecs::CdrWriter& cdr, std::uint64_t time_ns) {
    cdr.add_number(std::int32_t(time_ns / kNsPerSecond)).add_number(std::uint32_t(time_ns % kNsPerSecond));
}
inline void add_header(codecs::CdrWriter& cdr, std::uint64_t stamp_ns, const std::string& frame_id) {
    add_time(cdr, stamp_ns);
    cdr.append_string(frame_id);
}

inline void add_vector(codecs::CdrWriter& cdr, const glm::dvec3& vector) {
    cdr.add_number(vector.x).add_number(vector.y).add_number(vector.z);
}
inline void add_pose(codecs::CdrWriter& cdr, const Pose& pose) {
    add_vector(cdr, pose.translation);
    cdr.add_number(pose.rotation.x)
        .add_number(pose.rotation.y)
        .add_number(pose.rotation.z)
        .add_number(pose.rotation.w);
}
inline void add_covariance(codecs::CdrWriter& cdr) {
    for (int i = 0; i < kCovarianceValues; ++i) cdr.add_number(0.0);
}
inline void add_velocity(codecs::CdrWriter& cdr, const Velocity& velocity) {
    add_vector(cdr, velocity.linear_mps);
    add_vector(cdr, velocity.angular_radps);
    add_covariance(cdr);
}

/// Returns the topics of a sensor's points, with fields of Velodyne drivers and Autoware.
std::vector<RecordedTopic> ros_cloud_topics(const RecordedRig& rig, std::size_t sensor);
/// Returns the topics of the boxes of actors, for ROS tools and for Autoware.
std::vector<RecordedTopic> ros_actor_topics();
/// Definition of a message type such as "nav_msgs/msg/Odometry" or "nav_msgs/Odometry",
/// followed by those of all types that it contains.
std::string ros_definition(const std::string& type);
/// @param is_latched true if subscribers that join later receive the last message
RecordedTopic make_ros_topic(const std::string& name, const std::string& type, MessageEncoder messages,
                             bool is_latched = false);

}  // namespace relidar::scan_files
