// SPDX-License-Identifier: Apache-2.0
// Defines the topics of a ROS 2 bag: transforms, odometry, clock, sensors and actors.

#include <fmt/format.h>

#include "simulate/scan_files/recording_format.hpp"

namespace relidar::scan_files {
namespace {

/// Returns the quality of service of a topic (how long messages are kept) as YAML of
/// rosbag2. The numbers are those of the rmw library: history 1 keeps the last `depth`
/// messages, reliability 1 repeats lost messages, durability 1 (transient local) sends
/// kept messages to later subscribers, 2 (volatile) does not. Durations are infinite.
/// @param is_latched true if subscribers that join later receive the last message
std::string format_qos(bool is_latched) {
    constexpr const char* kForever = "\n    sec: 9223372036\n    nsec: 854775807\n";
    return fmt::format(
        "- history: 1\n  depth: {}\n  reliability: 1\n  durability: {}\n  deadline:{forever}  "
        "lifespan:{forever}"
        "  liveliness: 1\n  liveliness_lease_duration:{forever}  avoid_ros_namespace_conventions: false",
        is_latched ? 1 : 10, is_latched ? 1 : 2, fmt::arg("forever", kForever));
}

void add_transform(codecs::CdrWriter& cdr, std::uint64_t stamp_ns, const std::string& parent,
                   const std::string& child, const Pose& parent_from_child) {
    add_header(cdr, stamp_ns, parent);
    cdr.append_string(child);
    add_pose(cdr, parent_from_child);
}

std::string encode_clock(const ObjectState& vehicle) {
    codecs::CdrWriter cdr;
    add_time(cdr, vehicle.time_ns);
    return cdr.take_message();
}

std::string encode_tf(const ObjectState& vehicle) {
    codecs::CdrWriter cdr;
    cdr.add_number(std::uint32_t(1));  // number of transforms in the message
    add_transform(cdr, vehicle.time_ns, kWorldFrame, kVehicleFrame, vehicle.world_from_object);
    return cdr.take_message();
}

std::string encode_odometry(const ObjectState& vehicle) {
    codecs::CdrWriter cdr;
    add_header(cdr, vehicle.time_ns, kWorldFrame);
    cdr.append_string(kVehicleFrame);
    add_pose(cdr, vehicle.world_from_object);
    add_covariance(cdr);
    add_velocity(cdr, vehicle.velocity);
    return cdr.take_message();
}

/// Returns the topic of the constant transforms, from the vehicle to its sensors.
RecordedTopic static_tf_topic(const RecordedRig& rig) {
    const auto encode = [transforms = rig.static_transforms()](const RecordedSweep& sweep) {
        codecs::CdrWriter cdr;
        cdr.add_number(std::uint32_t(transforms.size()));
        for (const auto& [parent, child, parent_from_child] : transforms)
            add_transform(cdr, sweep.first_ns, parent, child, parent_from_child);
        return cdr.take_message();
    };
    constexpr bool kIsLatched = true;
    return make_ros_topic("/tf_static", "tf2_msgs/msg/TFMessage",
                          encode_sweep(&RecordedSweep::first_ns, encode), kIsLatched);
}

/// Returns a NavSatFix message. Unknown covariances are 0.
std::string encode_nav_fix(const RecordedFix& fix) {
    // Constants of sensor_msgs/NavSatStatus and NavSatFix.
    constexpr std::int8_t kHasFix = 0;
    constexpr std::uint16_t kGps = 1;
    constexpr std::uint8_t kUnknownCovariance = 0;
    constexpr int kPositionCovariances = 9;
    const GeodeticPosition& p = fix.position;
    codecs::CdrWriter cdr;
    add_header(cdr, fix.time_ns, kVehicleFrame);
    cdr.add_number(kHasFix).add_number(kGps);
    cdr.add_number(p.latitude_deg).add_number(p.longitude_deg).add_number(p.height_m);
    for (int i = 0; i < kPositionCovariances; ++i) cdr.add_number(0.0);
    cdr.add_number(kUnknownCovariance);
    return cdr.take_message();
}

}  // namespace

RecordedTopic make_ros_topic(const std::string& name, const std::string& type, MessageEncoder messages,
                             bool is_latched) {
    return {name,
            type,
            ros_definition(type),
            std::move(messages),
            {{"offered_qos_profiles", format_qos(is_latched)}}};
}

/// Returns the topics of a ROS 2 bag. Messages with the same time are written in this
/// order, so that players know the time and the transforms of the messages that follow.
std::vector<RecordedTopic> ros_topics(const RecordedRig& rig) {
    std::vector<RecordedTopic> topics{
        make_ros_topic("/clock", "rosgraph_msgs/msg/Clock", encode_each(&RecordedSweep::poses, encode_clock)),
        static_tf_topic(rig),
        make_ros_topic("/tf", "tf2_msgs/msg/TFMessage", encode_each(&RecordedSweep::poses, encode_tf)),
        make_ros_topic("/odom", "nav_msgs/msg/Odometry",
                       encode_each(&RecordedSweep::poses, encode_odometry))};
    if (rig.earth)
        topics.push_back(make_ros_topic("/fix", "sensor_msgs/msg/NavSatFix",
                                        encode_each(&RecordedSweep::fixes, encode_nav_fix)));
    for (RecordedTopic& topic : ros_actor_topics()) topics.push_back(std::move(topic));
    for (std::size_t sensor = 0; sensor < rig.sensors.size(); ++sensor)
        for (RecordedTopic& topic : ros_cloud_topics(rig, sensor)) topics.push_back(std::move(topic));
    return topics;
}

std::span<const RecordingFormat> recording_formats() {
    // rosbag2 reads the quality-of-service policies as numbers because of the empty
    // metadata entry `serialized_metadata`.
    static const RecordingFormat formats[] = {
        {.name = "mcap",
         .file = "scans.mcap",
         .help = "one file with all scans of all sensors, for Foxglove.",
         .profile = "",
         .definition_encoding = "protobuf",
         .message_encoding = "protobuf",
         .metadata = {},
         .topics = foxglove_topics},
        {.name = "rosbag",
         .file = "rosbag.mcap",
         .help = R"(a ROS 2 bag. Both contain the transforms of world, base_link (the log's vehicle)
and sensors, and the boxes of actors. --deskew moves points to the time of the first ray.)",
         .profile = "ros2",
         .definition_encoding = "ros2msg",
         .message_encoding = "cdr",
         .metadata = {{"rosbag2", {{"serialized_metadata", ""}}}},
         .topics = ros_topics},
    };
    return formats;
}

std::vector<ScanMessage> sorted_messages(std::span<const RecordedTopic> topics, const RecordedSweep& sweep) {
    std::vector<ScanMessage> messages;
    for (std::size_t topic = 0; topic < topics.size(); ++topic)
        for (auto& [time_ns, bytes] : topics[topic].messages(sweep))
            messages.push_back({topic, time_ns, std::move(bytes)});
    std::ranges::stable_sort(messages, {}, &ScanMessage::time_ns);
    return messages;
}

}  // namespace relidar::scan_files
