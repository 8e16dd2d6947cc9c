// SPDX-License-Identifier: Apache-2.0
// Defines the topics of a ROS 2 bag: transforms, odometry, clock, sensors and actors.

#include <fmt/format.h>

#include "simulate/scan_files/recording_format.hpp"

namespace relidar::scan_files {
namespace {

/// Returns the quality of service of a topic (how long messages are kept) as YAML of
/// rosbag2, with the numbers of the rmw library. All durations are infinite.
/// @param is_latched true if subscribers that join later receive the last message
std::string format_qos(bool is_latched) {
    constexpr int kKeepLast = 1, kReliable = 1, kTransientLocal = 1, kVolatile = 2, kAutomatic = 1;
    constexpr const char* kEndlessDuration = "\n    sec: 9223372036\n    nsec: 854775807\n";
    return fmt::format(
        "- history: {}\n  depth: {}\n  reliability: {}\n  durability: {}\n  deadline:{}  lifespan:{}  "
        "liveliness: {}\n"
        "  liveliness_lease_duration:{}  avoid_ros_namespace_conventions: false",
        kKeepLast, is_latched ? 1 : 10, kReliable, is_latched ? kTransientLocal : kVolatile, kEndlessDuration,
        kEndlessDuration, kAutomatic, kEndlessDuration);
}

void add_transform(codecs::CdrWriter& cdr, std::uint64_t stamp_ns, const std::string& parent,
                   const std::string& child, const Pose& parent_from_child) {
    add_header(cdr, stamp_ns, parent);
    cdr.append_string(child);
    add_pose(cdr, parent_from_child);
}

/// Returns a topic with one message for each pose of the vehicle.
/// @param write writes the message of a pose
RecordedTopic pose_topic(const char* name, const char* type,
                         void (*write)(codecs::CdrWriter&, const RecordedPose&)) {
    return make_ros_topic(name, type, [write](const RecordedSweep& moment) {
        std::vector<RecordedMessage> messages;
        for (const RecordedPose& pose : moment.poses) {
            codecs::CdrWriter cdr;
            write(cdr, pose);
            messages.push_back({pose.time_ns, cdr.take_message()});
        }
        return messages;
    });
}

void write_clock(codecs::CdrWriter& cdr, const RecordedPose& pose) { add_time(cdr, pose.time_ns); }

void write_vehicle_transform(codecs::CdrWriter& cdr, const RecordedPose& pose) {
    cdr.add_number(std::uint32_t(1));  // number of transforms in the message
    add_transform(cdr, pose.time_ns, kWorldFrame, kVehicleFrame, pose.world_from_vehicle);
}

void write_odometry(codecs::CdrWriter& cdr, const RecordedPose& pose) {
    add_header(cdr, pose.time_ns, kWorldFrame);
    cdr.append_string(kVehicleFrame);
    add_pose(cdr, pose.world_from_vehicle);
    add_covariance(cdr);
    add_velocity(cdr, pose.velocity);
}

/// Returns the topic of the constant transforms, from the vehicle to its sensors. Each
/// scan repeats the message for players that start in the middle of the file.
RecordedTopic static_tf_topic(const RecordedRig& rig) {
    const auto make_message = [rig](const RecordedSweep& moment) {
        codecs::CdrWriter cdr;
        const std::vector<StaticTransform> transforms = rig.static_transforms();
        cdr.add_number(std::uint32_t(transforms.size()));
        for (const auto& [parent, child, parent_from_child] : transforms)
            add_transform(cdr, moment.first_ns, parent, child, parent_from_child);
        return std::vector<RecordedMessage>{{moment.first_ns, cdr.take_message()}};
    };
    constexpr bool kIsLatched = true;
    return make_ros_topic("/tf_static", "tf2_msgs/msg/TFMessage", make_message, kIsLatched);
}

/// Returns the topic of the vehicle's position on the earth, a message for each scan.
RecordedTopic fix_topic() {
    // Constants of sensor_msgs/NavSatStatus and NavSatFix.
    constexpr std::int8_t kHasFix = 0;
    constexpr std::uint16_t kGps = 1;
    constexpr std::uint8_t kUnknownCovariance = 0;
    constexpr int kPositionCovariances = 9;
    return make_ros_topic("/fix", "sensor_msgs/msg/NavSatFix", [](const RecordedSweep& moment) {
        if (!moment.fix) return std::vector<RecordedMessage>{};
        codecs::CdrWriter cdr;
        add_header(cdr, moment.fix->time_ns, kVehicleFrame);
        cdr.add_number(kHasFix).add_number(kGps);
        const GeodeticPosition& p = moment.fix->position;
        cdr.add_number(p.latitude_deg).add_number(p.longitude_deg).add_number(p.height_m);
        for (int i = 0; i < kPositionCovariances; ++i) cdr.add_number(0.0);
        cdr.add_number(kUnknownCovariance);
        return std::vector<RecordedMessage>{{moment.fix->time_ns, cdr.take_message()}};
    });
}

}  // namespace

RecordedTopic make_ros_topic(const std::string& name, const std::string& type,
                             std::function<std::vector<RecordedMessage>(const RecordedSweep&)> make_messages,
                             bool is_latched) {
    return {name,
            type,
            ros_definition(type),
            {{"offered_qos_profiles", format_qos(is_latched)}},
            std::move(make_messages)};
}

/// Returns the topics of a ROS 2 bag. Messages with the same time are written in this
/// order: the clock, then transforms.
std::vector<RecordedTopic> ros_topics(const RecordedRig& rig) {
    std::vector<RecordedTopic> topics{pose_topic("/clock", "rosgraph_msgs/msg/Clock", write_clock),
                                      static_tf_topic(rig),
                                      pose_topic("/tf", "tf2_msgs/msg/TFMessage", write_vehicle_transform),
                                      pose_topic("/odom", "nav_msgs/msg/Odometry", write_odometry)};
    if (rig.earth) topics.push_back(fix_topic());
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

std::vector<ScanMessage> sorted_messages(std::span<const RecordedTopic> topics, const RecordedSweep& moment) {
    std::vector<ScanMessage> messages;
    for (std::size_t topic = 0; topic < topics.size(); ++topic)
        for (auto& [time_ns, bytes] : topics[topic].messages(moment))
            messages.push_back({topic, time_ns, std::move(bytes)});
    std::ranges::stable_sort(messages, {}, &ScanMessage::time_ns);
    return messages;
}

}  // namespace relidar::scan_files
