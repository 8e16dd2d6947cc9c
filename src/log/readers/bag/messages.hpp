// SPDX-License-Identifier: Apache-2.0
// The messages that a log is made of, by their definitions in sensor_msgs, tf2_msgs,
// nav_msgs, geometry_msgs, the drivers of Livox, vision_msgs and Autoware.
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

/// sensor_msgs/PointCloud2, or what comes to the same.
struct Cloud {
    Header header;
    std::uint32_t height = 0, width = 0;
    struct Field {
        std::string name;
        std::size_t offset = 0;  ///< bytes, in a point
        char kind = 'F';         ///< as PointField has it
        std::size_t size = 4, count = 1;
    };
    std::vector<Field> fields;
    bool is_big_endian = false;
    std::size_t point_step = 0, row_step = 0;
    std::string_view data;  ///< of the message that was read

    std::size_t size() const { return std::size_t(height) * width; }
};

/// A pose of one frame in another.
struct Transform {
    Header header;      ///< its frame: the parent
    std::string child;  ///< empty where the message does not say
    Pose parent_from_child;
};

/// A thing of a list of boxes.
struct Box {
    Header header;
    std::string id;          ///< empty: the message does not say which thing of other messages it is
    std::string category;    ///< in the words of the message; empty where it has none
    glm::dvec3 size_m{0.0};  ///< length, width, height, all above 0
    Pose frame_from_box;     ///< of its centre
};
struct BoxList {
    Header header;
    std::vector<Box> boxes;
    std::size_t n_left_out = 0;  ///< without a size or a pose
};

/// What a topic's messages may be used as. Detections without an identity are not read:
/// they cannot be joined to tracks.
enum class Use { nothing, cloud, packets, calibration, metadata, transforms, pose, boxes, nameless_boxes };
Use use_of(const Topic& topic);

class MessageReader;
/// A time of ROS, in nanoseconds.
std::int64_t read_time(MessageReader& reader);
Header read_header(MessageReader& reader);
/// A position, and a quaternion as x y z w.
using PoseNumbers = std::array<double, 7>;
PoseNumbers read_pose_numbers(MessageReader& reader);
/// @throws DataError where the quaternion has no direction or a number is not finite
Pose pose_of(const PoseNumbers& numbers);
Cloud read_point_cloud(MessageReader& reader);

/// A cloud. @throws DataError naming the field that is wrong
Cloud read_cloud(const Topic& topic, std::string_view bytes);
/// Points of a cloud by the names that relidar knows (point_table.hpp), numbers as they
/// stand. @param message  that the cloud was read from
folder::PointTable table_of(const Cloud& cloud, const SharedBytes& message);

/// Transforms of tf2_msgs/TFMessage or tf/tfMessage, or the one pose of
/// nav_msgs/Odometry, geometry_msgs/PoseStamped and the like. Quaternions that have no
/// direction are refused.
std::vector<Transform> read_transforms(const Topic& topic, std::string_view bytes);

/// The same of foxglove.PointCloud and foxglove.FrameTransforms; foxglove.cpp. The
/// fields' places are not checked yet.
Cloud read_foxglove_cloud(std::string_view bytes);
std::vector<Transform> read_foxglove_transforms(std::string_view bytes);

/// Boxes of vision_msgs/Detection3DArray, of Autoware's TrackedObjects, or of
/// foxglove.SceneUpdate. @throws DataError
BoxList read_boxes(const Topic& topic, std::string_view bytes);
/// Of foxglove.SceneUpdate: entities of one cube each. @throws DataError
BoxList read_foxglove_boxes(std::string_view bytes);

}  // namespace relidar::bag
