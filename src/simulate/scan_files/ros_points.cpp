// SPDX-License-Identifier: Apache-2.0
// Writes point clouds as sensor_msgs/PointCloud2 messages.
#include "simulate/scan_files/recording_format.hpp"

namespace relidar::scan_files {
namespace {

struct RosField {
    std::string name;
    std::uint32_t offset;
    std::uint8_t type;  ///< datatype, a constant of sensor_msgs/PointField
};
constexpr std::uint8_t kRosUint8 = 2, kRosUint16 = 4, kRosInt32 = 5, kRosUint32 = 6, kRosFloat32 = 7;
/// Names of Velodyne drivers. Optional channels follow.
const std::vector<RosField> kPlainFields = {{"x", 0, kRosFloat32},     {"y", 4, kRosFloat32},
                                            {"z", 8, kRosFloat32},     {"intensity", 12, kRosFloat32},
                                            {"time", 16, kRosFloat32}, {"ring", 20, kRosUint16}};
/// PointXYZIRCAEDT, the point type of Autoware and Nebula.
const std::vector<RosField> kAutowareFields = {
    {"x", 0, kRosFloat32},         {"y", 4, kRosFloat32},          {"z", 8, kRosFloat32},
    {"intensity", 12, kRosUint8},  {"return_type", 13, kRosUint8}, {"channel", 14, kRosUint16},
    {"azimuth", 16, kRosFloat32},  {"elevation", 20, kRosFloat32}, {"distance", 24, kRosFloat32},
    {"time_stamp", 28, kRosUint32}};

/// as Nebula defines them
enum ReturnType : std::uint8_t { kLast = 1, kStrongest = 3, kSecondStrongest = 8 };

/// Packs points as PointXYZIRCAEDT. Angles are in radians. Azimuth increases from the x
/// axis to the left, and elevation increases upwards. Times are in nanoseconds.
std::string pack_autoware(const LidarPoints& cloud) {
    std::string bytes;
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        const glm::vec3& p = cloud.position_m[i];
        // A second return that is nearer than the first return is the second strongest.
        const bool is_second = !cloud.return_number.empty() && cloud.return_number[i] == 2;
        ReturnType return_type = kStrongest;
        // The first return of the ray is the previous point.
        if (is_second && i > 0)
            return_type = glm::length(p) > glm::length(cloud.position_m[i - 1]) ? kLast : kSecondStrongest;
        append_raw(bytes, p);
        append_raw(bytes, std::uint8_t(std::lround(255.0f * std::clamp(cloud.intensity[i], 0.0f, 1.0f))));
        append_raw(bytes, std::uint8_t(return_type));
        append_raw(bytes, cloud.ring[i]);
        append_raw(bytes, std::atan2(p.y, p.x));
        append_raw(bytes, std::atan2(p.z, std::hypot(p.x, p.y)));
        append_raw(bytes, glm::length(p));
        append_raw(bytes, std::uint32_t(std::llround(1e9 * std::max(0.0, double(cloud.time_offset_s[i])))));
    }
    return bytes;
}

/// Packs points as x, y, z, intensity, time, ring and optional channels.
std::string pack_velodyne(const LidarPoints& cloud) {
    std::string bytes;
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        append_raw(bytes, cloud.position_m[i]);
        append_raw(bytes, cloud.intensity[i]);
        append_raw(bytes, cloud.time_offset_s[i]);
        append_raw(bytes, cloud.ring[i]);
        append_raw(bytes, std::uint16_t(0));  // padding to a multiple of 4 bytes
        append_values(bytes, cloud.channels, i);
    }
    return bytes;
}

struct RosPointType {
    const std::vector<RosField>& fields;
    std::uint32_t step;  ///< bytes per point without channels
    std::string (*points)(const LidarPoints&);
    bool has_channels;
};
const RosPointType kPlainType{kPlainFields, 24, pack_velodyne, true},
    kAutowareType{kAutowareFields, 32, pack_autoware, false};

/// Returns a PointCloud2 message with the points in one row (height 1).
std::string encode_cloud2(const RecordedCloud& recorded, const std::string& frame, const RosPointType& type) {
    const LidarPoints& cloud = recorded.points;
    const std::string points = type.points(cloud);
    std::vector<RosField> fields = type.fields;
    std::uint32_t step = type.step;
    for (const auto& [name, is_integer] :
         type.has_channels ? list_columns(cloud.channels) : std::vector<ChannelColumn>{}) {
        fields.push_back({name, step, is_integer ? kRosInt32 : kRosFloat32});
        step += 4;
    }
    codecs::CdrWriter cdr;
    add_header(cdr, recorded.stamp_ns, frame);
    cdr.add_number(std::uint32_t(1))
        .add_number(std::uint32_t(cloud.size()))
        .add_number(std::uint32_t(fields.size()));
    for (const RosField& field : fields)
        cdr.append_string(field.name)
            .add_number(field.offset)
            .add_number(field.type)
            .add_number(std::uint32_t(1));
    cdr.add_number(std::uint8_t(0))
        .add_number(step)
        .add_number(std::uint32_t(points.size()))
        .add_bytes(points)
        .add_number(std::uint8_t(1));
    return cdr.take_message();
}

}  // namespace

std::vector<RecordedTopic> ros_cloud_topics(const RecordedRig& rig, std::size_t sensor) {
    const std::string& topic = rig.sensors[sensor].topic;
    const std::string frame = rig.cloud_frame(sensor);
    const auto of_type = [&](const std::string& name, const RosPointType& type) {
        return make_ros_topic(name, "sensor_msgs/msg/PointCloud2", [=, &type](const RecordedSweep& moment) {
            return std::vector<RecordedMessage>{
                {moment.last_ns, encode_cloud2(moment.clouds[sensor], frame, type)}};
        });
    };
    std::vector<RecordedTopic> topics{of_type(topic, kPlainType)};
    // Leaves out this topic in the world frame, because such points have no azimuth and
    // elevation relative to the sensor.
    if (!rig.world) topics.push_back(of_type(topic + "_xyzircaedt", kAutowareType));
    return topics;
}

}  // namespace relidar::scan_files
