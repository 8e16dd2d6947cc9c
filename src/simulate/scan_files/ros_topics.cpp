// SPDX-License-Identifier: Apache-2.0
// Defines the topics of a ROS 2 bag: transforms, odometry, clock, sensors and actors.
#include "ros_parts.hpp"

#include <utility>

#include <fmt/format.h>

namespace relidar::scan_files {
namespace {

/// In the format of rosbag2, with the numbers of the rmw library. All durations are
/// infinite.
std::string format_quality_of_service(bool is_latched) {
    constexpr int kKeepLast = 1, kReliable = 1, kTransientLocal = 1, kVolatile = 2, kAutomatic = 1;
    constexpr const char* kEndless = "\n    sec: 9223372036\n    nsec: 854775807\n";
    return fmt::format(
        "- history: {}\n  depth: {}\n  reliability: {}\n  durability: {}\n  deadline:{}  lifespan:{}  "
        "liveliness: {}\n"
        "  liveliness_lease_duration:{}  avoid_ros_namespace_conventions: false",
        kKeepLast, is_latched ? 1 : 10, kReliable, is_latched ? kTransientLocal : kVolatile, kEndless,
        kEndless, kAutomatic, kEndless);
}

void add_stamped_transform(codecs::CdrWriter& cdr, std::uint64_t stamp_ns, const std::string& parent_frame,
                           const std::string& child_frame, const Pose& parent_from_child) {
    add_header(cdr, stamp_ns, parent_frame);
    cdr.append_string(child_frame);
    add_pose(cdr, parent_from_child);
}

/// @param write writes the message of a pose
RecordedTopic make_topic_with_message_per_pose(const char* name, const char* message_type,
                                               void (*write)(codecs::CdrWriter&, const RecordedPose&)) {
    return make_ros_topic(name, message_type, [write](const RecordedSweep& moment) {
        std::vector<RecordedMessage> messages;
        for (const RecordedPose& pose : moment.poses) {
            codecs::CdrWriter cdr;
            write(cdr, pose);
            messages.push_back({pose.time_ns, cdr.take_encoded_message()});
        }
        return messages;
    });
}

/// Each scan repeats the message for players that start in the middle of the file.
RecordedTopic make_static_transform_topic(const RecordedRig& rig) {
    const auto message = [rig](const RecordedSweep& moment) {
        codecs::CdrWriter cdr;
        cdr.append_aligned_number(std::uint32_t(rig.sensors.size()));
        for (const RecordedSensor& sensor : rig.sensors)
            add_stamped_transform(cdr, moment.first_ns, kVehicleFrame, sensor.frame_id,
                                  sensor.vehicle_from_sensor);
        return std::vector<RecordedMessage>{{moment.first_ns, cdr.take_encoded_message()}};
    };
    return make_ros_topic("/tf_static", "tf2_msgs/msg/TFMessage", message, true);
}

}  // namespace

RecordedTopic make_ros_topic(const std::string& name, const std::string& message_type,
                             std::function<std::vector<RecordedMessage>(const RecordedSweep&)> make_messages,
                             bool is_latched) {
    return {name,
            message_type,
            make_ros_message_definition(message_type),
            {{"offered_qos_profiles", format_quality_of_service(is_latched)}},
            std::move(make_messages)};
}

std::vector<RecordedTopic> list_ros_topics(const RecordedRig& rig) {
    std::vector<RecordedTopic> topics{
        make_topic_with_message_per_pose(
            "/clock", "rosgraph_msgs/msg/Clock",
            [](codecs::CdrWriter& cdr, const RecordedPose& pose) { add_time(cdr, pose.time_ns); }),
        make_static_transform_topic(rig),
        make_topic_with_message_per_pose("/tf", "tf2_msgs/msg/TFMessage",
                                         [](codecs::CdrWriter& cdr, const RecordedPose& pose) {
                                             cdr.append_aligned_number(std::uint32_t(1));
                                             add_stamped_transform(cdr, pose.time_ns, kWorldFrame,
                                                                   kVehicleFrame, pose.world_from_vehicle);
                                         }),
        make_topic_with_message_per_pose("/odom", "nav_msgs/msg/Odometry",
                                         [](codecs::CdrWriter& cdr, const RecordedPose& pose) {
                                             add_header(cdr, pose.time_ns, kWorldFrame);
                                             cdr.append_string(kVehicleFrame);
                                             add_pose(cdr, pose.world_from_vehicle);
                                             add_zero_covariance(cdr);
                                             add_velocity_with_covariance(cdr, pose.velocity);
                                         })};
    for (RecordedTopic& topic : list_ros_actor_topics()) topics.push_back(std::move(topic));
    for (std::size_t sensor = 0; sensor < rig.sensors.size(); ++sensor)
        for (RecordedTopic& topic : list_ros_cloud_topics(rig, sensor)) topics.push_back(std::move(topic));
    return topics;
}

}  // namespace relidar::scan_files
