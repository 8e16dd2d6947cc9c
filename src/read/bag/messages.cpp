// SPDX-License-Identifier: Apache-2.0
#include "read/bag/messages.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/packet_messages.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kMostPointStep = 65536;
constexpr double kMaxLengthError = 1e-2;  // of a quaternion, whose length should be 1

struct MessageTypePurpose {
    std::string_view type;
    MessagePurpose use;
};
constexpr MessageTypePurpose kTypeUses[] = {
    {"foxglove.PointCloud", MessagePurpose::cloud},
    {"foxglove.FrameTransforms", MessagePurpose::transforms},
    {"foxglove.SceneUpdate", MessagePurpose::boxes},
    {"foxglove.LocationFix", MessagePurpose::fix},
    {"sensor_msgs/NavSatFix", MessagePurpose::fix},
    {"sensor_msgs/PointCloud2", MessagePurpose::cloud},
    {"livox_ros_driver/CustomMsg", MessagePurpose::cloud},
    {"livox_ros_driver2/CustomMsg", MessagePurpose::cloud},
    {"tf2_msgs/TFMessage", MessagePurpose::transforms},
    {"tf/tfMessage", MessagePurpose::transforms},
    {"nav_msgs/Odometry", MessagePurpose::pose},
    {kPathType, MessagePurpose::pose},
    {"geometry_msgs/PoseStamped", MessagePurpose::pose},
    {"geometry_msgs/PoseWithCovarianceStamped", MessagePurpose::pose},
    {"geometry_msgs/TransformStamped", MessagePurpose::pose},
    {"vision_msgs/Detection3DArray", MessagePurpose::boxes},
    {"autoware_perception_msgs/TrackedObjects", MessagePurpose::boxes},
    {"autoware_auto_perception_msgs/TrackedObjects", MessagePurpose::boxes},
    {"autoware_perception_msgs/DetectedObjects", MessagePurpose::nameless_boxes},
    {"autoware_auto_perception_msgs/DetectedObjects", MessagePurpose::nameless_boxes},
};

/// Reads the description of a field of a point cloud (sensor_msgs/PointField).
CloudMessage::CloudField read_ros_field(MessageReader& reader) {
    CloudMessage::CloudField field;
    field.name = reader.read_string();
    field.offset = reader.read_number<std::uint32_t>();
    const auto type = reader.read_number<std::uint8_t>();
    const auto count = reader.read_number<std::uint32_t>();
    field.count = std::max<std::size_t>(count, 1);  // some drivers write 0
    // PCL and some drivers also write 64-bit integers, which ROS does not define.
    field.set_type(type, {"I1", "U1", "I2", "U2", "I4", "U4", "F4", "F8", "I8", "U8"});
    return field;
}

/// Throws if the fields, rows or data of a cloud do not fit together.
void check_layout(const CloudMessage& cloud) {
    for (const CloudMessage::CloudField& field : cloud.fields)
        if (field.offset > cloud.point_step || field.size * field.count > cloud.point_step - field.offset)
            fail("the field '{}' starts at byte {} and has {} bytes, expected a point of at most {} bytes",
                 quote(field.name), field.offset, field.size * field.count, cloud.point_step);
    if (cloud.size() == 0) return;
    if (cloud.point_step == 0 || cloud.point_step > kMostPointStep)
        fail("a point has {} bytes, expected 1 to {}", cloud.point_step, kMostPointStep);
    const std::size_t row_bytes = cloud.width * cloud.point_step;  // without padding after the row
    const bool has_rows = cloud.height > 1;
    if (has_rows && cloud.row_step < row_bytes)
        fail("each row of the cloud has {} bytes (row_step), expected at least {} for {} points of {} bytes",
             cloud.row_step, row_bytes, cloud.width, cloud.point_step);
    // The last row may have no padding.
    const bool is_complete =
        cloud.data.size() >= row_bytes &&
        (!has_rows || (cloud.data.size() - row_bytes) / cloud.row_step >= cloud.height - 1);
    if (!is_complete)
        fail("the data of the cloud have {} bytes, expected {} rows of {} bytes with {} points of {} bytes",
             cloud.data.size(), cloud.height, has_rows ? cloud.row_step : row_bytes, cloud.width,
             cloud.point_step);
}

/// Reads a CustomMsg of the Livox drivers. A point has the fields offset_time (uint32,
/// ns), x, y, z (float32), reflectivity, tag and line (uint8). In CDR, each point except
/// the last has 20 bytes, including padding.
CloudMessage read_livox(MessageReader& reader) {
    constexpr std::size_t kLivoxPointBytes = 19;
    CloudMessage cloud;
    cloud.header = read_header(reader);
    reader.read_number<std::uint64_t>();  // skips the timebase, because it equals the time stamp
    reader.read_number<std::uint32_t>();  // skips the number of points
    cloud.lidar = fmt::format("{}", reader.read_number<std::uint8_t>());
    reader.read_bytes(3);  // skips reserved bytes
    const std::size_t n = reader.read_length(kLivoxPointBytes);
    cloud.height = 1;
    cloud.width = std::uint32_t(n);
    cloud.is_big_endian = reader.is_swapped();
    cloud.point_step = reader.is_ros1() ? kLivoxPointBytes : kLivoxPointBytes + 1;
    cloud.row_step = n * cloud.point_step;
    cloud.fields = {
        {{"offset_time", 'U', 4}, 0},   {{"x", 'F', 4}, 4},    {{"y", 'F', 4}, 8},    {{"z", 'F', 4}, 12},
        {{"reflectivity", 'U', 1}, 16}, {{"tag", 'U', 1}, 17}, {{"line", 'U', 1}, 18}};
    if (n > 0) cloud.data = reader.read_bytes((n - 1) * cloud.point_step + kLivoxPointBytes);
    return cloud;
}

/// Returns the memory layout of a point: its known fields, sorted by offset. Unused
/// fields fill the gaps between the known fields.
std::vector<read::PointField> make_layout(const CloudMessage& cloud,
                                          const std::vector<CloudMessage::CloudField>& sorted_fields) {
    std::vector<read::PointField> layout;
    std::size_t end = 0;  // of the fields so far
    const auto fill_gap = [&](std::size_t offset) {
        if (offset > end) layout.push_back({std::string(read::kPaddingName), 'U', 1, offset - end});
        end = offset;
    };
    for (const CloudMessage::CloudField& field : sorted_fields) {
        if (field.offset < end)
            fail(
                "the field '{}' starts at byte {} of a point and overlaps another field, expected byte {} or "
                "more",
                quote(field.name), field.offset, end);
        fill_gap(field.offset);
        layout.push_back(field);
        end += field.size * field.count;
    }
    fill_gap(cloud.point_step);
    return layout;
}

/// Copies all points of a cloud. Removes the padding between rows, and converts the
/// values to the byte order of this computer.
std::string pack_points(const CloudMessage& cloud, const std::vector<CloudMessage::CloudField>& fields) {
    const std::size_t row_bytes = cloud.width * cloud.point_step;
    const std::size_t row_step = cloud.height > 1 ? cloud.row_step : 0;  // unused for a single row
    std::string points;
    points.reserve(cloud.height * row_bytes);
    for (std::size_t row = 0; row < cloud.height; ++row)
        points += cloud.data.substr(row * row_step, row_bytes);
    // The last point may be truncated. Its missing bytes become 0.
    points.resize(cloud.height * row_bytes, '\0');
    if (!cloud.is_big_endian) return points;
    for (std::size_t i = 0; i < cloud.size(); ++i)
        for (const CloudMessage::CloudField& field : fields)
            std::reverse(points.begin() + std::ptrdiff_t(i * cloud.point_step + field.offset),
                         points.begin() + std::ptrdiff_t(i * cloud.point_step + field.offset + field.size));
    return points;
}

}  // namespace

void CloudMessage::CloudField::set_type(std::int64_t type, const std::vector<std::string>& types) {
    if (type < 1 || type > std::ssize(types))
        fail("the field '{}' of the cloud has the data type {}, expected 1 to {}", quote(name), type,
             types.size());
    const std::string& name_of_type = types[std::size_t(type - 1)];
    kind = name_of_type[0];
    size = std::size_t(name_of_type[1] - '0');
}

std::int64_t read_time_ns(MessageReader& reader) {
    const std::int64_t seconds = reader.is_ros1() ? std::int64_t(reader.read_number<std::uint32_t>())
                                                  : reader.read_number<std::int32_t>();
    return seconds * 1000000000 + reader.read_number<std::uint32_t>();
}

MessageHeader read_header(MessageReader& reader) {
    if (reader.is_ros1()) reader.read_number<std::uint32_t>();  // skips the sequence number
    const std::int64_t stamp_ns = read_time_ns(reader);
    std::string frame(reader.read_string());
    // Removes the leading slash of ROS 1 frame names, so that names can be compared.
    if (frame.starts_with('/')) frame.erase(0, 1);
    return {stamp_ns, std::move(frame)};
}

PoseComponents read_pose(MessageReader& reader) {
    PoseComponents numbers{};
    for (double& x : numbers) x = reader.read_number<double>();
    return numbers;
}

Pose make_pose(const PoseComponents& position_and_quaternion) {
    const auto& [x, y, z, qx, qy, qz, qw] = position_and_quaternion;
    const glm::dquat rotation(qw, qx, qy, qz);
    const double length = glm::length(rotation);
    if (!(std::abs(length - 1.0) <= kMaxLengthError) || !std::isfinite(x + y + z))
        fail(
            "found a pose at ({}, {}, {}) with a quaternion of length {}, expected finite numbers and length "
            "1",
            x, y, z, length);
    return {glm::normalize(rotation), {x, y, z}};
}

/// Reads the fields of sensor_msgs/PointCloud2 in the order of its definition.
CloudMessage read_ros_cloud(MessageReader& reader) {
    CloudMessage cloud;
    cloud.header = read_header(reader);
    cloud.height = reader.read_number<std::uint32_t>();
    cloud.width = reader.read_number<std::uint32_t>();
    constexpr std::size_t kLeastField = 13;  // bytes of a field with an empty name
    const std::size_t n_fields = reader.read_length(kLeastField);
    for (std::size_t i = 0; i < n_fields; ++i) cloud.fields.push_back(read_ros_field(reader));
    cloud.is_big_endian = reader.read_number<std::uint8_t>() != 0;
    cloud.point_step = reader.read_number<std::uint32_t>();
    cloud.row_step = reader.read_number<std::uint32_t>();
    cloud.data = reader.read_bytes(reader.read_length(1));
    // Without padding, row_step is not needed. Some drivers write 0 or the size of all
    // data.
    if (cloud.data.size() == cloud.size() * cloud.point_step) cloud.row_step = cloud.width * cloud.point_step;
    check_layout(cloud);
    return cloud;
}

MessagePurpose find_purpose(const BagTopic& topic) {
    if (has_packets(topic)) return MessagePurpose::packets;
    const bool is_protobuf = topic.encoding == "protobuf";
    if (!is_protobuf && topic.encoding != "cdr" && topic.encoding != "ros1") return MessagePurpose::nothing;
    if (can_have_metadata(topic)) return MessagePurpose::metadata;
    if (is_protobuf != topic.type.starts_with("foxglove.")) return MessagePurpose::nothing;
    const auto matching_type = std::ranges::find(kTypeUses, topic.type, &MessageTypePurpose::type);
    return matching_type == std::end(kTypeUses) ? MessagePurpose::nothing : matching_type->use;
}

CloudMessage read_cloud(const BagTopic& topic, std::string_view message_bytes) {
    CloudMessage cloud;
    if (topic.encoding == "protobuf") {
        cloud = read_foxglove_cloud(message_bytes);
        check_layout(cloud);
    } else {
        MessageReader reader(topic, message_bytes);
        // A Livox message has a fixed layout, and contains the number of the LiDAR.
        if (topic.type != "sensor_msgs/PointCloud2") return read_livox(reader);
        cloud = read_ros_cloud(reader);
    }
    // Other LiDARs that share a topic differ in their frame.
    cloud.lidar = cloud.header.frame;
    return cloud;
}

read::PointTable to_point_table(const CloudMessage& cloud, const SharedBytes& message_bytes) {
    if (cloud.size() == 0) throw DataError("the cloud has no points, expected at least one");
    std::vector<CloudMessage::CloudField> known_fields;
    std::ranges::copy_if(cloud.fields, std::back_inserter(known_fields),
                         [](const CloudMessage::CloudField& f) { return read::is_known_field(f.name); });
    std::ranges::sort(known_fields, {}, &CloudMessage::CloudField::offset);
    const std::vector<read::PointField> layout = make_layout(cloud, known_fields);
    // Points without gaps between rows, in our byte order, are not copied.
    const std::size_t n_bytes = cloud.size() * cloud.point_step;
    const bool has_gaps = cloud.height > 1 && cloud.row_step != cloud.width * cloud.point_step;
    const bool can_share = !cloud.is_big_endian && !has_gaps && cloud.data.size() >= n_bytes;
    const SharedBytes points = can_share ? message_bytes.share_part(cloud.data.substr(0, n_bytes))
                                         : share_bytes(pack_points(cloud, known_fields));
    read::PointTable table =
        read::table_of_records(points, layout, cloud.size(), read::PointMemoryLayout::by_point, "points");
    for (const CloudMessage::CloudField& field : cloud.fields)
        if (!read::is_known_field(field.name)) table.unread.push_back(field.name);
    return table;
}

void TransformListMessage::add_valid_transform(TransformMessage transform, const PoseComponents& pose) {
    try {
        transform.parent_from_child = make_pose(pose);
        transforms.push_back(std::move(transform));
    } catch (const DataError& error) {
        if (n_left_out == 0)
            problem = fmt::format("from '{}' to '{}': {}", quote(transform.header.frame),
                                  quote(transform.child), error.what());
        ++n_left_out;
    }
}

TransformListMessage read_transforms(const BagTopic& topic, std::string_view message_bytes) {
    if (topic.encoding == "protobuf") return read_foxglove_tf(message_bytes);
    MessageReader reader(topic, message_bytes);
    TransformListMessage list;
    // Four forms: a list of transforms with child frames, one such transform (also at the
    // start of a nav_msgs/Odometry), a pose whose message does not name the child, or a
    // path, which is a list of such poses after a header.
    const bool is_path = topic.type == kPathType;
    const bool has_transforms = find_purpose(topic) == MessagePurpose::transforms;
    const bool has_child =
        has_transforms || topic.type == "nav_msgs/Odometry" || topic.type == "geometry_msgs/TransformStamped";
    if (is_path) read_header(reader);
    constexpr std::size_t kLeastTransform = 68;  // bytes of a pose without its names
    const std::size_t n = is_path || has_transforms ? reader.read_length(kLeastTransform) : 1;
    for (std::size_t i = 0; i < n; ++i) {
        TransformMessage transform{.header = read_header(reader), .child = {}, .parent_from_child = {}};
        if (has_child) transform.child = reader.read_string();
        if (transform.child.starts_with('/')) transform.child.erase(0, 1);
        list.add_valid_transform(std::move(transform), read_pose(reader));
    }
    return list;
}

bool FixMessage::is_valid() const {
    return has_fix && std::abs(position.latitude_deg) < 90.0 && std::abs(position.longitude_deg) <= 360.0 &&
           std::isfinite(position.height_m);
}

FixMessage read_fix(const BagTopic& topic, std::string_view message_bytes) {
    if (topic.encoding == "protobuf") return read_foxglove_fix(message_bytes);
    MessageReader reader(topic, message_bytes);
    // sensor_msgs/NavSatFix: header, status, latitude, longitude and altitude
    FixMessage fix{read_header(reader), {}};
    const auto status = reader.read_number<std::int8_t>();
    reader.read_number<std::uint16_t>();  // skips the satellite systems
    fix.position.latitude_deg = reader.read_number<double>();
    fix.position.longitude_deg = reader.read_number<double>();
    fix.position.height_m = reader.read_number<double>();
    fix.has_fix = status >= 0;  // -1: no fix
    return fix;
}

}  // namespace relidar::bag
