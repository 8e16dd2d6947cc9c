// SPDX-License-Identifier: Apache-2.0
// ROS messages that the bag reader supports. The layouts are those of sensor_msgs,
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
struct Header {
    std::int64_t stamp_ns = 0;
    std::string frame;
};

/// A point cloud from sensor_msgs/PointCloud2 or a similar message.
struct Cloud {
    Header header;
    std::uint32_t height = 0, width = 0;
    struct Field {
        std::string name;
        std::size_t offset = 0;  ///< byte offset in a point
        char kind = 'F';         ///< 'F', 'I' or 'U': float, signed or unsigned
        std::size_t size = 4, count = 1;
    };
    std::vector<Field> fields;
    bool is_big_endian = false;
    std::size_t point_step = 0, row_step = 0;
    std::string_view data;  ///< view into the message

    std::size_t size() const { return std::size_t(height) * width; }
};

/// The pose of a child frame in its parent frame.
struct Transform {
    Header header;      ///< header.frame is the parent frame
    std::string child;  ///< child frame; empty if the message does not name it
    Pose parent_from_child;
};

/// One box of a message with a list of boxes.
struct Box {
    Header header;
    std::string id;          ///< track id; empty if the message has none
    std::string category;    ///< category as in the message; may be empty
    glm::dvec3 size_m{0.0};  ///< length, width, height, all above 0
    Pose frame_from_box;     ///< pose of the box's centre
};
struct BoxList {
    Header header;
    std::vector<Box> boxes;
    std::size_t n_left_out = 0;  ///< boxes without a size or a pose
};

/// What relidar does with the messages of a topic. Boxes without a track id are not read,
/// because they cannot be joined to tracks.
enum class Use { nothing, cloud, packets, metadata, transforms, pose, boxes, nameless_boxes };
Use use_of(const Topic& topic);

class MessageReader;
/// Reads a ROS time in nanoseconds.
std::int64_t read_time(MessageReader& reader);
Header read_header(MessageReader& reader);
/// Position x y z and quaternion x y z w.
using PoseNumbers = std::array<double, 7>;
PoseNumbers read_pose_numbers(MessageReader& reader);
/// Converts a position and a quaternion to a pose.
/// @throws DataError if the quaternion is zero or a number is not finite
Pose pose_of(const PoseNumbers& numbers);
Cloud read_point_cloud(MessageReader& reader);

/// Reads a point cloud message.
/// @throws DataError with the invalid field
Cloud read_cloud(const Topic& topic, std::string_view bytes);
/// Returns the points of a cloud as a table with relidar's field names (point_table.hpp).
/// The values are not converted.
/// @param message  message from which the cloud was read
folder::PointTable table_of(const Cloud& cloud, const SharedBytes& message);

/// Reads transforms from tf2_msgs/TFMessage or tf/tfMessage. Also reads the pose of
/// nav_msgs/Odometry, geometry_msgs/PoseStamped and similar messages.
/// @throws DataError if a quaternion is zero
std::vector<Transform> read_transforms(const Topic& topic, std::string_view bytes);

/// Read the Foxglove messages PointCloud and FrameTransforms. The offsets of the point
/// fields are not checked here.
Cloud read_foxglove_cloud(std::string_view bytes);
std::vector<Transform> read_foxglove_transforms(std::string_view bytes);

/// Reads the boxes of vision_msgs/Detection3DArray, Autoware's TrackedObjects or
/// foxglove.SceneUpdate.
/// @throws DataError if the message is invalid
BoxList read_boxes(const Topic& topic, std::string_view bytes);
/// Reads foxglove.SceneUpdate. Each entity with exactly one cube is a box.
/// @throws DataError if the message is invalid
BoxList read_foxglove_boxes(std::string_view bytes);

}  // namespace relidar::bag
