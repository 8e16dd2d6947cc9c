// SPDX-License-Identifier: Apache-2.0
// Messages that the bag reader uses, with the definitions of sensor_msgs, tf2_msgs,
// nav_msgs, geometry_msgs, the Livox drivers, vision_msgs and Autoware.
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

/// sensor_msgs/PointCloud2 or an equivalent message.
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

/// A pose of one frame in another.
struct Transform {
    Header header;      ///< its frame is the parent
    std::string child;  ///< empty if the message does not name it
    Pose parent_from_child;
};

/// A box of a list of boxes.
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

/// Possible uses of a topic's messages. Detections without an id are not read, because
/// they cannot be joined to tracks.
enum class Use { nothing, cloud, packets, calibration, metadata, transforms, pose, boxes, nameless_boxes };
Use use_of(const Topic& topic);

class MessageReader;
/// Reads a ROS time in nanoseconds.
std::int64_t read_time(MessageReader& reader);
Header read_header(MessageReader& reader);
/// A position, and a quaternion as x y z w.
using PoseNumbers = std::array<double, 7>;
PoseNumbers read_pose_numbers(MessageReader& reader);
/// Converts seven numbers to a pose.
/// @throws DataError if the quaternion is zero or a number is not finite
Pose pose_of(const PoseNumbers& numbers);
Cloud read_point_cloud(MessageReader& reader);

/// Reads a cloud.
/// @throws DataError with the invalid field
Cloud read_cloud(const Topic& topic, std::string_view bytes);
/// Returns the points of a cloud with relidar's field names (point_table.hpp) and
/// unchanged values.
/// @param message  message from which the cloud was read
folder::PointTable table_of(const Cloud& cloud, const SharedBytes& message);

/// Reads the transforms of tf2_msgs/TFMessage or tf/tfMessage, or the single pose of
/// nav_msgs/Odometry, geometry_msgs/PoseStamped and similar messages. Rejects zero
/// quaternions.
std::vector<Transform> read_transforms(const Topic& topic, std::string_view bytes);

/// Read foxglove.PointCloud and foxglove.FrameTransforms (foxglove.cpp). The offsets of
/// the fields are not checked yet.
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
