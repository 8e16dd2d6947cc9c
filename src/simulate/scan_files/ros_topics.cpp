// SPDX-License-Identifier: Apache-2.0
// Defines the topics of a ROS 2 bag: transforms, odometry, clock, sensors and actors.

#include <fmt/format.h>

#include "simulate/scan_files/recording_format.hpp"

namespace relidar::scan_files {
namespace {

/// In the format of rosbag2, with the numbers of the rmw library. All durations are
/// infinite.
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

/// Each scan repeats the message for players that start in the middle of the file.
RecordedTopic static_tf_topic(const RecordedRig& rig) {
    const auto message = [rig](const RecordedSweep& moment) {
        codecs::CdrWriter cdr;
        const std::vector<StaticTransform> transforms = rig.static_transforms();
        cdr.add_number(std::uint32_t(transforms.size()));
        for (const auto& [parent, child, parent_from_child] : transforms)
            add_transform(cdr, moment.first_ns, parent, child, parent_from_child);
        return std::vector<RecordedMessage>{{moment.first_ns, cdr.take_message()}};
    };
    return make_ros_topic("/tf_static", "tf2_msgs/msg/TFMessage", message, true);
}

/// Writes the position of base_link on the earth, once for each scan.
RecordedTopic fix_topic() {
    constexpr std::int8_t kHasFix = 0;
    constexpr std::uint16_t kGps = 1;
    constexpr int kPositionCovariances = 9;
    return make_ros_topic("/fix", "sensor_msgs/msg/NavSatFix", [](const RecordedSweep& moment) {
        if (!moment.fix) return std::vector<RecordedMessage>{};
        codecs::CdrWriter cdr;
        add_header(cdr, moment.fix->time_ns, kVehicleFrame);
        cdr.add_number(kHasFix).add_number(kGps);
        const GeodeticPosition& p = moment.fix->position;
        cdr.add_number(p.latitude_deg).add_number(p.longitude_deg).add_number(p.height_m);
        for (int i = 0; i < kPositionCovariances; ++i) cdr.add_number(0.0);
        cdr.add_number(std::uint8_t(0));  // unknown covariance
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

std::vector<RecordedTopic> ros_topics(const RecordedRig& rig) {
    std::vector<RecordedTopic> topics{
        pose_topic("/clock", "rosgraph_msgs/msg/Clock",
                   [](codecs::CdrWriter& cdr, const RecordedPose& pose) { add_time(cdr, pose.time_ns); }),
        static_tf_topic(rig),
        pose_topic("/tf", "tf2_msgs/msg/TFMessage",
                   [](codecs::CdrWriter& cdr, const RecordedPose& pose) {
                       // number of transforms in the message
                       cdr.add_number(std::uint32_t(1));
                       add_transform(cdr, pose.time_ns, kWorldFrame, kVehicleFrame, pose.world_from_vehicle);
                   }),
        pose_topic("/odom", "nav_msgs/msg/Odometry", [](codecs::CdrWriter& cdr, const RecordedPose& pose) {
            add_header(cdr, pose.time_ns, kWorldFrame);
            cdr.append_string(kVehicleFrame);
            add_pose(cdr, pose.world_from_vehicle);
            add_covariance(cdr);
            add_velocity(cdr, pose.velocity);
        })};
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
        {"mcap",
         "scans.mcap",
         "one file with all scans of all sensors, for Foxglove.",
         "",
         "protobuf",
         "protobuf",
         {},
         foxglove_topics},
        {"rosbag",
         "rosbag.mcap",
         R"(a ROS 2 bag. Both contain the transforms of world, base_link (the log's vehicle)
and sensors, and the boxes of actors. --deskew moves points to the time of the first ray.)",
         "ros2",
         "ros2msg",
         "cdr",
         {{"rosbag2", {{"serialized_metadata", ""}}}},
         ros_topics},
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
