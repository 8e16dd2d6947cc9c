// SPDX-License-Identifier: Apache-2.0
// Defines the topics of a ROS 2 bag: transforms, odometry, clock, sensors and actors.
#include "ros_parts.hpp"

#include <utility>

#include <fmt/format.h>

#include "ros_definitions.hpp"

namespace relidar::scan_files {
namespace {

/// Returns quality-of-service settings in the format of rosbag2. The policies are
/// numbers, as in the rmw library of ROS. All durations are infinite.
std::string format_service_quality(bool is_latched) {
    constexpr int kKeepLast = 1, kReliable = 1, kTransientLocal = 1, kVolatile = 2, kAutomatic = 1;
    constexpr const char* kEndless = "\n    sec: 9223372036\n    nsec: 854775807\n";
    return fmt::format(
        "- history: {}\n  depth: {}\n  reliability: {}\n  durability: {}\n  deadline:{}  lifespan:{}  "
        "liveliness: {}\n"
        "  liveliness_lease_duration:{}  avoid_ros_namespace_conventions: false",
        kKeepLast, is_latched ? 1 : 10, kReliable, is_latched ? kTransientLocal : kVolatile, kEndless,
        kEndless, kAutomatic, kEndless);
}

void add_transform(Cdr& cdr, std::uint64_t stamp_ns, const std::string& parent, const std::string& child,
                   const Pose& pose) {
    add_header(cdr, stamp_ns, parent);
    cdr.add_text(child);
    add_pose(cdr, pose);
}

std::string make_transform_message(const RecordedPose& pose) {
    Cdr cdr;
    cdr.add(std::uint32_t(1));
    add_transform(cdr, pose.time_ns, kWorldFrame, kVehicleFrame, pose.world_from_vehicle);
    return cdr.take();
}

std::string make_odometry_message(const RecordedPose& pose) {
    Cdr cdr;
    add_header(cdr, pose.time_ns, kWorldFrame);
    cdr.add_text(kVehicleFrame);
    add_pose(cdr, pose.world_from_vehicle), add_covariance(cdr);
    add_velocity(cdr, pose.velocity);
    return cdr.take();
}

std::string make_clock_message(const RecordedPose& pose) {
    Cdr cdr;
    add_time(cdr, pose.time_ns);
    return cdr.take();
}

RecordedTopic make_pose_topic(const char* name, const char* type,
                              std::string (*message)(const RecordedPose&)) {
    return make_ros_topic(name, type, [message](const RecordedMoment& moment) {
        std::vector<RecordedMessage> messages;
        for (const RecordedPose& pose : moment.poses) messages.push_back({pose.time_ns, message(pose)});
        return messages;
    });
}

/// Returns the topic /tf_static with the poses of the sensors on the vehicle. The message
/// is repeated with every scan, so that a player that starts in the middle of the file
/// receives it.
RecordedTopic make_mounting_topic(const RecordedRig& rig) {
    const auto message = [rig](const RecordedMoment& moment) {
        Cdr cdr;
        cdr.add(std::uint32_t(rig.sensors.size()));
        for (const RecordedSensor& sensor : rig.sensors)
            add_transform(cdr, moment.first_ns, kVehicleFrame, sensor.frame_id, sensor.vehicle_from_sensor);
        return std::vector<RecordedMessage>{{moment.first_ns, cdr.take()}};
    };
    return make_ros_topic("/tf_static", "tf2_msgs/msg/TFMessage", message, true);
}

}  // namespace

RecordedTopic make_ros_topic(const std::string& name, const std::string& type,
                             std::function<std::vector<RecordedMessage>(const RecordedMoment&)> messages,
                             bool is_latched) {
    return {name,
            type,
            make_ros_definition(type),
            {{"offered_qos_profiles", format_service_quality(is_latched)}},
            std::move(messages)};
}

std::vector<RecordedTopic> list_ros_topics(const RecordedRig& rig) {
    std::vector<RecordedTopic> topics{
        make_pose_topic("/clock", "rosgraph_msgs/msg/Clock", make_clock_message), make_mounting_topic(rig),
        make_pose_topic("/tf", "tf2_msgs/msg/TFMessage", make_transform_message),
        make_pose_topic("/odom", "nav_msgs/msg/Odometry", make_odometry_message)};
    for (RecordedTopic& topic : list_ros_actor_topics()) topics.push_back(std::move(topic));
    for (std::size_t sensor = 0; sensor < rig.sensors.size(); ++sensor)
        for (RecordedTopic& topic : list_ros_cloud_topics(rig, sensor)) topics.push_back(std::move(topic));
    return topics;
}

}  // namespace relidar::scan_files
