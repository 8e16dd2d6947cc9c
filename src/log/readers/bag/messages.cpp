// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/messages.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "log/readers/bag/message_reader.hpp"
#include "log/readers/bag/packets/packet_messages.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kMostPointStep = 65536;
constexpr double kUnitLength = 1e-2;  // maximum difference of a quaternion's length from 1

struct TypeUse {
    const char* type;
    Use use;
};
constexpr TypeUse kTypeUses[] = {
    {"foxglove.PointCloud", Use::cloud},
    {"foxglove.FrameTransforms", Use::transforms},
    {"foxglove.SceneUpdate", Use::boxes},
    {"sensor_msgs/PointCloud2", Use::cloud},
    {"livox_ros_driver/CustomMsg", Use::cloud},
    {"livox_ros_driver2/CustomMsg", Use::cloud},
    {"tf2_msgs/TFMessage", Use::transforms},
    {"tf/tfMessage", Use::transforms},
    {"nav_msgs/Odometry", Use::pose},
    {"geometry_msgs/PoseStamped", Use::pose},
    {"geometry_msgs/PoseWithCovarianceStamped", Use::pose},
    {"geometry_msgs/TransformStamped", Use::pose},
    {"vision_msgs/Detection3DArray", Use::boxes},
    {"autoware_perception_msgs/TrackedObjects", Use::boxes},
    {"autoware_auto_perception_msgs/TrackedObjects", Use::boxes},
    {"autoware_perception_msgs/DetectedObjects", Use::nameless_boxes},
    {"autoware_auto_perception_msgs/DetectedObjects", Use::nameless_boxes},
};

MessageReader make_reader(const Topic& topic, std::string_view bytes) {
    return {bytes, topic.encoding == "ros1"};
}

/// Reads a field of a point cloud. The type is a number as defined in
/// sensor_msgs/PointField.
Cloud::Field read_field(MessageReader& reader) {
    struct Type {
        char kind;
        std::size_t size;
    };
    static constexpr Type kTypes[] = {{'I', 1}, {'U', 1}, {'I', 2}, {'U', 2},
                                      {'I', 4}, {'U', 4}, {'F', 4}, {'F', 8}};
    Cloud::Field field{std::string(reader.text())};
    field.offset = reader.number<std::uint32_t>();
    const auto type = reader.number<std::uint8_t>();
    const auto count = reader.number<std::uint32_t>();
    field.count = std::max<std::size_t>(count, 1);  // some drivers write 0
    if (type < 1 || type > std::size(kTypes))
        throw DataError(fmt::format("the field '{}' has the type {}, expected 1 to {}",
                                    make_excerpt(field.name), type, std::size(kTypes)));
    field.kind = kTypes[type - 1].kind;
    field.size = kTypes[type - 1].size;
    return field;
}

void check_layout(const Cloud& cloud) {
    for (const Cloud::Field& field : cloud.fields)
        if (field.offset > cloud.point_step || field.size * field.count > cloud.point_step - field.offset)
            throw DataError(fmt::format(
                "the field '{}' starts at byte {} and has {} bytes, expected a field inside "
                "the point of {} bytes",
                make_excerpt(field.name), field.offset, field.size * field.count, cloud.point_step));
    if (cloud.size() == 0) return;
    if (cloud.point_step == 0 || cloud.point_step > kMostPointStep)
        throw DataError(
            fmt::format("a point has {} bytes, expected 1 to {}", cloud.point_step, kMostPointStep));
    const std::size_t row = cloud.width * cloud.point_step;
    if (cloud.row_step < row && cloud.height > 1)
        throw DataError(fmt::format("a row of the cloud has {} bytes, expected {} points of {} bytes",
                                    cloud.row_step, cloud.width, cloud.point_step));
    if (cloud.data.size() < row ||
        (cloud.height > 1 && (cloud.data.size() - row) / cloud.row_step < cloud.height - 1))
        throw DataError(fmt::format("the cloud has {} bytes, expected {} x {} points of {} bytes",
                                    cloud.data.size(), cloud.height, cloud.width, cloud.point_step));
}

/// Reads a CustomMsg of the Livox drivers. A point has the fields offset_time (uint32,
/// ns), x, y, z (float32), reflectivity, tag and line (uint8). CDR pads all points but
/// the last to 20 bytes.
Cloud read_livox(MessageReader& reader) {
    constexpr std::size_t kPoint = 19;
    Cloud cloud;
    cloud.header = read_header(reader);
    reader.number<std::uint64_t>();  // skips the timebase, because it equals the time stamp
    reader.number<std::uint32_t>();  // skips the number of points
    reader.take(4);                  // skips the LiDAR's number and reserved bytes
    const std::size_t n = reader.length(kPoint);
    cloud.height = 1;
    cloud.width = std::uint32_t(n);
    cloud.is_big_endian = reader.is_swapped();
    cloud.point_step = reader.is_ros1() ? kPoint : kPoint + 1;
    cloud.row_step = n * cloud.point_step;
    cloud.fields = {{"offset_time", 0, 'U', 4},   {"x", 4, 'F', 4},    {"y", 8, 'F', 4},    {"z", 12, 'F', 4},
                    {"reflectivity", 16, 'U', 1}, {"tag", 17, 'U', 1}, {"line", 18, 'U', 1}};
    cloud.data = n == 0 ? std::string_view() : reader.take((n - 1) * cloud.point_step + kPoint);
    return cloud;
}

/// Reads a geometry_msgs/TransformStamped, or the pose at the start of a
/// nav_msgs/Odometry, which has the same fields.
Transform read_transform(MessageReader& reader) {
    Transform transform{read_header(reader), std::string(reader.text()), {}};
    if (transform.child.starts_with('/')) transform.child.erase(0, 1);
    transform.parent_from_child = make_pose(read_pose_numbers(reader));
    return transform;
}

}  // namespace

std::int64_t read_time(MessageReader& reader) {
    const std::int64_t seconds =
        reader.is_ros1() ? std::int64_t(reader.number<std::uint32_t>()) : reader.number<std::int32_t>();
    return seconds * 1000000000 + reader.number<std::uint32_t>();
}

Header read_header(MessageReader& reader) {
    if (reader.is_ros1()) reader.number<std::uint32_t>();  // skips the sequence number
    const std::int64_t stamp_ns = read_time(reader);
    std::string frame(reader.text());
    // Removes the leading slash that ROS 1 frame names may have, so that names can be
    // compared.
    if (frame.starts_with('/')) frame.erase(0, 1);
    return {stamp_ns, std::move(frame)};
}

PoseNumbers read_pose_numbers(MessageReader& reader) {
    PoseNumbers numbers{};
    for (double& x : numbers) x = reader.number<double>();
    return numbers;
}

Pose make_pose(const PoseNumbers& numbers) {
    const glm::dquat q(numbers[6], numbers[3], numbers[4], numbers[5]);
    const double length = glm::length(q);
    if (!(std::abs(length - 1.0) <= kUnitLength) || !std::isfinite(numbers[0] + numbers[1] + numbers[2]))
        throw DataError(
            fmt::format("found a pose at ({}, {}, {}) with a quaternion of length {}, expected finite "
                        "coordinates in metres and length 1",
                        numbers[0], numbers[1], numbers[2], length));
    return {glm::normalize(q), {numbers[0], numbers[1], numbers[2]}};
}

Cloud read_point_cloud(MessageReader& reader) {
    Cloud cloud;
    cloud.header = read_header(reader);
    cloud.height = reader.number<std::uint32_t>();
    cloud.width = reader.number<std::uint32_t>();
    const std::size_t n = reader.length(13);
    for (std::size_t i = 0; i < n; ++i) cloud.fields.push_back(read_field(reader));
    cloud.is_big_endian = reader.number<std::uint8_t>() != 0;
    cloud.point_step = reader.number<std::uint32_t>();
    cloud.row_step = reader.number<std::uint32_t>();
    cloud.data = reader.take(reader.length(1));
    check_layout(cloud);
    return cloud;
}

Use get_topic_use(const Topic& topic) {
    if (packets::has_packets(topic)) return Use::packets;
    const bool is_protobuf = topic.encoding == "protobuf";
    if (!is_protobuf && topic.encoding != "cdr" && topic.encoding != "ros1") return Use::nothing;
    if (packets::can_be_ouster_metadata(topic)) return Use::metadata;
    if (is_protobuf != topic.type.starts_with("foxglove.")) return Use::nothing;
    const auto known =
        std::ranges::find_if(kTypeUses, [&](const TypeUse& t) { return topic.type == t.type; });
    return known == std::end(kTypeUses) ? Use::nothing : known->use;
}

Cloud read_cloud(const Topic& topic, std::string_view bytes) {
    if (topic.encoding == "protobuf") {
        Cloud cloud = read_foxglove_cloud(bytes);
        check_layout(cloud);
        return cloud;
    }
    MessageReader reader = make_reader(topic, bytes);
    return topic.type == "sensor_msgs/PointCloud2" ? read_point_cloud(reader) : read_livox(reader);
}

std::vector<Transform> read_transforms(const Topic& topic, std::string_view bytes) {
    if (topic.encoding == "protobuf") return read_foxglove_transforms(bytes);
    MessageReader reader = make_reader(topic, bytes);
    std::vector<Transform> transforms;
    if (get_topic_use(topic) == Use::transforms) {
        const std::size_t n = reader.length(72);
        for (std::size_t i = 0; i < n; ++i) transforms.push_back(read_transform(reader));
    } else if (topic.type == "nav_msgs/Odometry" || topic.type == "geometry_msgs/TransformStamped") {
        transforms.push_back(read_transform(reader));
    } else {
        const Header header = read_header(reader);
        transforms.push_back({header, "", make_pose(read_pose_numbers(reader))});
    }
    return transforms;
}

}  // namespace relidar::bag
