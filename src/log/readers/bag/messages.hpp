// SPDX-License-Identifier: Apache-2.0
// Declares the ROS messages that the bag reader supports: messages of sensor_msgs,
// tf2_msgs, nav_msgs, geometry_msgs, the Livox drivers, vision_msgs and Autoware.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/base/math.hpp>

#include "log/clouds/point_table.hpp"
#include "log/readers/bag/bag_file.hpp"

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
    struct CloudField {
        std::string name;
        std::size_t offset = 0;  ///< byte offset in a point
        char kind = 'F';         ///< 'F' means float, 'I' signed integer, 'U' unsigned integer
        std::size_t size = 4, count = 1;
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
    void add_if_valid(TransformMessage transform, const std::array<double, 7>& pose);
};

/// A box in a message that contains a list of boxes.
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
};

/// How the messages of a topic are used. `nameless_boxes` are object boxes without a
/// track id. They are ignored, because they cannot be assigned to tracked objects.
enum class MessagePurpose { nothing, cloud, packets, metadata, transforms, pose, boxes, nameless_boxes };
MessagePurpose get_message_purpose_of_topic(const BagTopic& topic);

class MessageReader;
/// Reads a ROS time and converts it to nanoseconds.
std::int64_t read_ros_time_ns(MessageReader& reader);
MessageHeader read_header(MessageReader& reader);
/// Seven numbers of a pose: position x y z and quaternion x y z w.
using PoseComponents = std::array<double, 7>;
PoseComponents read_position_and_quaternion(MessageReader& reader);
/// Converts a position and a quaternion to a pose.
/// @throws DataError if the quaternion is zero or a number is not finite
Pose make_pose(const PoseComponents& position_and_quaternion);
CloudMessage read_point_cloud(MessageReader& reader);

/// Reads a point cloud message of any supported type.
/// @throws DataError with the name of the invalid field
CloudMessage read_cloud_of_message(const BagTopic& topic, std::string_view message_bytes);
/// Converts a cloud to a table of points with relidar's field names. Values keep the
/// units of the message.
/// @param message_bytes  message from which the cloud was read
folder::PointTable make_point_table(const CloudMessage& cloud, const SharedBytes& message_bytes);

/// Reads the transforms of a tf2_msgs/TFMessage or tf/tfMessage. Messages with a pose,
/// such as nav_msgs/Odometry and geometry_msgs/PoseStamped, give one transform.
/// @throws DataError if the message is invalid
TransformListMessage read_transforms_of_message(const BagTopic& topic, std::string_view message_bytes);

/// Reads a Foxglove PointCloud message. Does not check the offsets of its fields.
CloudMessage read_foxglove_cloud(std::string_view message_bytes);
TransformListMessage read_foxglove_transforms(std::string_view message_bytes);

/// Reads the boxes of vision_msgs/Detection3DArray, Autoware's TrackedObjects or
/// foxglove.SceneUpdate.
/// @throws DataError if the message is invalid
BoxListMessage read_boxes_of_message(const BagTopic& topic, std::string_view message_bytes);
/// Reads a foxglove.SceneUpdate message. Each entity that consists of exactly one cube
/// becomes a box.
/// @throws DataError if the message is invalid
BoxListMessage read_foxglove_boxes(std::string_view message_bytes);

}  // namespace relidar::bag
