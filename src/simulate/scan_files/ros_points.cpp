// SPDX-License-Identifier: Apache-2.0
// Writes point clouds as sensor_msgs/PointCloud2 messages.
#include "ros_parts.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::scan_files {
namespace {

struct RosField {
    std::string name;
    std::uint32_t offset;
    std::uint8_t type;  ///< datatype, a constant of sensor_msgs/PointField
};
constexpr std::uint8_t kRosUint8 = 2, kRosUint16 = 4, kRosInt32 = 5, kRosUint32 = 6, kRosFloat32 = 7;
/// Fields of a point, with the names that Velodyne drivers use. Optional channels are
/// stored after these fields.
const std::vector<RosField> kPlain = {{"x", 0, kRosFloat32},     {"y", 4, kRosFloat32},
                                      {"z", 8, kRosFloat32},     {"intensity", 12, kRosFloat32},
                                      {"time", 16, kRosFloat32}, {"ring", 20, kRosUint16}};
/// Fields of PointXYZIRCAEDT, the point type of Autoware and Nebula.
const std::vector<RosField> kAutoware = {{"x", 0, kRosFloat32},          {"y", 4, kRosFloat32},
                                         {"z", 8, kRosFloat32},          {"intensity", 12, kRosUint8},
                                         {"return_type", 13, kRosUint8}, {"channel", 14, kRosUint16},
                                         {"azimuth", 16, kRosFloat32},   {"elevation", 20, kRosFloat32},
                                         {"distance", 24, kRosFloat32},  {"time_stamp", 28, kRosUint32}};

/// Values of the field `get_return_type`, as Nebula defines them.
enum ReturnType : std::uint8_t { kLast = 1, kStrongest = 3, kSecondStrongest = 8 };

/// Returns the type of a return: strongest, last or second strongest. A second return is
/// the last return if its range is larger than the range of the first return. Otherwise,
/// the second return is the second strongest.
ReturnType get_return_type(const Points& cloud, std::size_t point) {
    const bool second = !cloud.return_number.empty() && cloud.return_number[point] == 2;
    if (!second || point == 0) return kStrongest;
    return glm::length(cloud.position_m[point]) > glm::length(cloud.position_m[point - 1]) ? kLast
                                                                                           : kSecondStrongest;
}

/// Packs points as PointXYZIRCAEDT. Computes the angles in radians from x, y and z.
/// Azimuth increases from the x axis to the left, and elevation increases upwards.
std::string make_autoware_points(const Points& cloud) {
    std::string bytes;
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        const glm::vec3& p = cloud.position_m[i];
        append(bytes, p);
        append(bytes, std::uint8_t(std::lround(255.0f * std::clamp(cloud.intensity[i], 0.0f, 1.0f))));
        append(bytes, std::uint8_t(get_return_type(cloud, i)));
        append(bytes, cloud.ring[i]);
        append(bytes, std::atan2(p.y, p.x)), append(bytes, std::atan2(p.z, std::hypot(p.x, p.y))),
            append(bytes, glm::length(p));
        append(bytes, std::uint32_t(std::llround(1e9 * std::max(0.0, double(cloud.time_offset_s[i])))));
    }
    return bytes;
}

std::string make_plain_points(const Points& cloud) {
    std::string bytes;
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        append(bytes, cloud.position_m[i]), append(bytes, cloud.intensity[i]);
        append(bytes, cloud.time_offset_s[i]), append(bytes, cloud.ring[i]);
        append(bytes, std::uint16_t(0));  // padding to a multiple of 4 bytes
        append_channel_values(bytes, cloud.channels, i);
    }
    return bytes;
}

/// Describes the fields of a point cloud message, and how its points are packed into
/// bytes.
struct PointType {
    const std::vector<RosField>& fields;
    std::uint32_t step;  ///< bytes per point without channels
    std::string (*points)(const Points&);
    bool has_channels;
};
const PointType kPlainType{kPlain, 24, make_plain_points, true},
    kAutowareType{kAutoware, 32, make_autoware_points, false};

std::string make_cloud_message(const Points& cloud, const std::string& frame, const PointType& type) {
    const std::string points = type.points(cloud);
    std::vector<RosField> fields = type.fields;
    std::uint32_t step = type.step;
    for (const auto& [name, is_integer] :
         type.has_channels ? list_channel_numbers(cloud.channels) : std::vector<ChannelNumber>{}) {
        fields.push_back({name, step, is_integer ? kRosInt32 : kRosFloat32});
        step += 4;
    }
    Cdr cdr;
    add_header(cdr, to_stamp(cloud.time_s), frame);
    cdr.add(std::uint32_t(1)).add(std::uint32_t(cloud.size())).add(std::uint32_t(fields.size()));
    for (const RosField& field : fields)
        cdr.add_text(field.name).add(field.offset).add(field.type).add(std::uint32_t(1));
    cdr.add(std::uint8_t(0))
        .add(step)
        .add(std::uint32_t(points.size()))
        .add_bytes(points)
        .add(std::uint8_t(1));
    return cdr.take();
}

}  // namespace

std::vector<RecordedTopic> list_ros_cloud_topics(const RecordedRig& rig, std::size_t sensor) {
    const std::string& topic = rig.sensors[sensor].topic;
    const std::string frame = rig.world ? kWorldFrame : rig.sensors[sensor].frame_id;
    const auto of_type = [&](const std::string& name, const PointType& type) {
        return make_ros_topic(name, "sensor_msgs/msg/PointCloud2", [=, &type](const RecordedMoment& moment) {
            return std::vector<RecordedMessage>{
                {moment.last_ns, make_cloud_message(moment.clouds[sensor], frame, type)}};
        });
    };
    std::vector<RecordedTopic> topics{of_type(topic, kPlainType)};
    // This topic contains azimuth and elevation relative to the sensor. It is left out if
    // the points are in the world frame.
    if (!rig.world) topics.push_back(of_type(topic + "_xyzircaedt", kAutowareType));
    return topics;
}

}  // namespace relidar::scan_files
