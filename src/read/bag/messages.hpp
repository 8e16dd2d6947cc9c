// SPDX-License-Identifier: Apache-2.0
// Declares the ROS messages that the bag reader supports: messages of sensor_msgs,
// tf2_msgs, nav_msgs, geometry_msgs, the Livox drivers, vision_msgs and Autoware.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/georeference.hpp>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "read/bag/bag_file.hpp"
#include "read/files/point_table.hpp"

namespace relidar::bag {

/// std_msgs/Header.
struct MessageHeader {
    std::int64_t stamp_ns = 0;
    std::string frame;
};

/// A point cloud from sensor_msgs/PointCloud2 or a similar message.
struct CloudMessage {
    MessageHeader header;
    /// What distinguishes the LiDARs of a topic: the field lidar_id of a Livox message,
    /// otherwise the frame.
    std::string lidar;
    std::uint32_t height = 0, width = 0;
    struct CloudField : read::PointField {
        std::size_t offset = 0;  ///< byte offset in a point

        /// @param type  number type, as a position in `types`, starting at 1
        /// @param types  kind and size of each type, for example "F4"
        void set_type(std::int64_t type, const std::vector<std::string>& types);
    };
    std::vector<CloudField> fields;
    bool is_big_endian = false;
    std::size_t point_step = 0, row_step = 0;
    std::string_view data;  ///< view into the message

    std::size_t size() const { return std::size_t(height) * width; }
};

/// The pose of a child frame in its parent frame at one time.
struct TransformMessage {
    MessageHeader header;  ///< header.frame is the parent frame
    std::string child;     ///< name of the child frame; empty if the message does not contain it
    Pose parent_from_child;
};

struct TransformListMessage {
    std::vector<TransformMessage> transforms;
    std::size_t n_left_out = 0;  ///< number of transforms whose pose is invalid
    std::string problem;         ///< text about the first of them

    /// Adds a transform with a pose. Counts it as left out if the pose is invalid.
    void add_valid_transform(TransformMessage transform, const std::array<double, 7>& pose);
};

struct BoxMessage {
    MessageHeader header;
    std::string id;          ///< track id of the object; empty if the message has none
    std::string category;    ///< category as written in the message; may be empty
    glm::dvec3 size_m{0.0};  ///< length, width and height; all are greater than 0
    Pose frame_from_box;     ///< pose of the box's centre
};
struct BoxListMessage {
    MessageHeader header;
    std::vector<BoxMessage> boxes;
    /// number of boxes that are ignored because their size or their pose is invalid
    std::size_t n_left_out = 0;

    /// Adds a box with a pose. Counts it as left out if its size or its pose is invalid.
    void add_valid_box(BoxMessage box, const std::array<double, 7>& pose);
};

/// How the messages of a topic are used. `nameless_boxes`, which have no track id, are
/// ignored.
enum class MessagePurpose { nothing, cloud, packets, metadata, transforms, pose, boxes, nameless_boxes, fix };
MessagePurpose find_purpose(const BagTopic& topic);

/// Reads the fields of a ROS message one after another. ROS 2 messages are CDR in either
/// byte order (XCDR1 and plain XCDR2). ROS 1 messages are little-endian values without
/// padding.
class MessageReader {
public:
    /// Creates a reader for a message of a topic. Checks the CDR header of ROS 2.
    /// @throws DataError if the first bytes are not a CDR header
    MessageReader(const BagTopic& topic, std::string_view bytes)
        : reader_(bytes), is_ros1_(topic.encoding == "ros1") {
        if (is_ros1_) return;
        constexpr std::size_t kCdrHeaderBytes = 4;
        if (bytes.size() < kCdrHeaderBytes)
            fail("the message has {} bytes, expected at least a CDR header of {} bytes", bytes.size(),
                 kCdrHeaderBytes);
        // The second byte is the encoding: XCDR version 1 (0 and 1) or version 2 (6 and
        // 7). Odd numbers mean little-endian.
        const auto kind = static_cast<unsigned char>(bytes[1]);
        if (bytes[0] != 0 || (kind != 0 && kind != 1 && kind != 6 && kind != 7))
            fail("the message begins with {:02x} {:02x}, expected a CDR header: 00 and 00, 01, 06 or 07{}",
                 static_cast<unsigned char>(bytes[0]), kind,
                 bytes.starts_with("\x28\xb5\x2f\xfd") ? " (damaged zstd data)" : "");
        swapped_ = kind % 2 == 0;
        widest_ = kind >= 6 ? 4 : 8;
        reader_ = codecs::ByteReader(bytes.substr(kCdrHeaderBytes));
    }

    bool is_ros1() const { return is_ros1_; }
    bool is_swapped() const { return swapped_; }

    template <class T>
    T read_number() {
        const std::size_t alignment = is_ros1_ ? 1 : std::min(sizeof(T), widest_);
        read_bytes((alignment - reader_.position() % alignment) % alignment);  // padding
        char raw[sizeof(T)];
        std::memcpy(raw, read_bytes(sizeof(T)).data(), sizeof(T));
        if (swapped_) std::reverse(raw, raw + sizeof(T));
        T value;
        std::memcpy(&value, raw, sizeof(T));
        return value;
    }
    /// Reads a string. Removes the terminating 0, which CDR counts in the length.
    std::string_view read_string() {
        std::string_view text = read_bytes(read_number<std::uint32_t>());
        if (!is_ros1_ && !text.empty() && text.back() == '\0') text.remove_suffix(1);
        return text;
    }
    /// Reads the number of entries of a list.
    /// @throws DataError if the message is too short for so many entries
    std::size_t read_length(std::size_t min_entry_bytes) {
        const auto n = read_number<std::uint32_t>();
        if (n > remaining() / min_entry_bytes)
            fail(
                "the message has a list of {} entries, but only {} bytes are left, expected at most {} "
                "entries",
                n, remaining(), remaining() / min_entry_bytes);
        return n;
    }
    std::string_view read_bytes(std::size_t n_bytes) { return reader_.read_bytes(n_bytes); }
    std::size_t remaining() const { return reader_.remaining(); }

private:
    codecs::ByteReader reader_;
    std::size_t widest_ = 8;  ///< largest alignment
    bool is_ros1_ = false, swapped_ = false;
};

std::int64_t read_time_ns(MessageReader& reader);
MessageHeader read_header(MessageReader& reader);
/// Seven numbers of a pose: position x y z and quaternion x y z w.
using PoseComponents = std::array<double, 7>;
PoseComponents read_pose(MessageReader& reader);
/// Converts a position and a quaternion to a pose.
/// @throws DataError if the quaternion has not the length 1 or a number is not finite
Pose make_pose(const PoseComponents& position_and_quaternion);
CloudMessage read_ros_cloud(MessageReader& reader);

/// Reads a cloud: sensor_msgs/PointCloud2, CustomMsg of Livox, or foxglove.PointCloud.
/// @throws DataError with the name of the invalid field
CloudMessage read_cloud(const BagTopic& topic, std::string_view message_bytes);
/// Converts a cloud to a table of points, in the units of the message.
/// @param message_bytes  message from which the cloud was read
read::PointTable to_point_table(const CloudMessage& cloud, const SharedBytes& message_bytes);

inline constexpr std::string_view kPathType = "nav_msgs/Path";

/// Reads the transforms of a tf2_msgs/TFMessage or tf/tfMessage, or the poses of a
/// nav_msgs/Path. Messages with a pose, such as nav_msgs/Odometry and
/// geometry_msgs/PoseStamped, give one transform.
TransformListMessage read_transforms(const BagTopic& topic, std::string_view message_bytes);

/// Reads a Foxglove PointCloud message. Does not check the offsets of its fields.
CloudMessage read_foxglove_cloud(std::string_view message_bytes);
TransformListMessage read_foxglove_tf(std::string_view message_bytes);

/// A position on the earth of sensor_msgs/NavSatFix or foxglove.LocationFix.
struct FixMessage {
    MessageHeader header;
    GeodeticPosition position;
    bool has_fix = true;

    bool is_valid() const;
};
/// Reads a position. A message without a fix is not valid.
FixMessage read_fix(const BagTopic& topic, std::string_view message_bytes);
FixMessage read_foxglove_fix(std::string_view message_bytes);

/// Reads the boxes of vision_msgs/Detection3DArray, Autoware's TrackedObjects or
/// foxglove.SceneUpdate.
BoxListMessage read_boxes(const BagTopic& topic, std::string_view message_bytes);
/// Reads a foxglove.SceneUpdate. Each entity of exactly one cube becomes a box.
BoxListMessage read_foxglove_boxes(std::string_view message_bytes);

}  // namespace relidar::bag
