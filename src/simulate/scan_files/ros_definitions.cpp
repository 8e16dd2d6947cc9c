// SPDX-License-Identifier: Apache-2.0
#include "simulate/scan_files/recording_format.hpp"

#include <sstream>

namespace relidar::scan_files {
namespace {

constexpr const char* kXyzDefinition = "float64 x\nfloat64 y\nfloat64 z\n";

const std::map<std::string, std::string>& message_texts() {
    static const std::map<std::string, std::string> types = {
        {"builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"},
        {"std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"},
        {"unique_identifier_msgs/UUID", "uint8[16] uuid\n"},
        {"geometry_msgs/Vector3", kXyzDefinition},
        {"geometry_msgs/Point", kXyzDefinition},
        {"geometry_msgs/Point32", "float32 x\nfloat32 y\nfloat32 z\n"},
        {"geometry_msgs/Polygon", "geometry_msgs/Point32[] points\n"},
        {"geometry_msgs/Quaternion", std::string(kXyzDefinition) + "float64 w\n"},
        {"geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"},
        {"geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n"},
        {"geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"},
        {"geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n"},
        {"geometry_msgs/Accel", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"},
        {"geometry_msgs/AccelWithCovariance", "geometry_msgs/Accel accel\nfloat64[36] covariance\n"},
        {"geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"},
        {"geometry_msgs/TransformStamped",
         "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"},
        {"tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"},
        {"sensor_msgs/PointField",
         "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 "
         "FLOAT32=7\nuint8 FLOAT64=8\n"
         "string name\nuint32 offset\nuint8 datatype\nuint32 count\n"},
        {"sensor_msgs/PointCloud2",
         "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool "
         "is_bigendian\nuint32 point_step\n"
         "uint32 row_step\nuint8[] data\nbool is_dense\n"},
        {"sensor_msgs/NavSatStatus", "int8 status\nuint16 service\n"},
        {"sensor_msgs/NavSatFix",
         "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 "
         "longitude\nfloat64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type\n"},
        {"nav_msgs/Odometry",
         "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance "
         "pose\ngeometry_msgs/TwistWithCovariance twist\n"},
        {"rosgraph_msgs/Clock", "builtin_interfaces/Time clock\n"},
        {"vision_msgs/ObjectHypothesis", "string class_id\nfloat64 score\n"},
        {"vision_msgs/ObjectHypothesisWithPose",
         "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"},
        {"vision_msgs/BoundingBox3D", "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n"},
        {"vision_msgs/Detection3D",
         "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D "
         "bbox\nstring id\n"},
        {"vision_msgs/Detection3DArray", "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n"},
        {"autoware_perception_msgs/ObjectClassification", "uint8 label\nfloat32 probability\n"},
        {"autoware_perception_msgs/Shape",
         "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions\n"},
        {"autoware_perception_msgs/TrackedObjectKinematics",
         "geometry_msgs/PoseWithCovariance pose_with_covariance\ngeometry_msgs/TwistWithCovariance "
         "twist_with_covariance\n"
         "geometry_msgs/AccelWithCovariance acceleration_with_covariance\nuint8 "
         "orientation_availability\nbool is_stationary\n"},
        {"autoware_perception_msgs/TrackedObject",
         "unique_identifier_msgs/UUID object_id\nfloat32 existence_probability\n"
         "autoware_perception_msgs/ObjectClassification[] "
         "classification\nautoware_perception_msgs/TrackedObjectKinematics kinematics\n"
         "autoware_perception_msgs/Shape shape\n"},
        {"autoware_perception_msgs/TrackedObjects",
         "std_msgs/Header header\nautoware_perception_msgs/TrackedObject[] objects\n"},
    };
    return types;
}

}  // namespace

std::string ros_definition(const std::string& message_type) {
    constexpr std::string_view kMessageFolder = "/msg/";
    const std::size_t middle = message_type.find(kMessageFolder);
    const bool is_short = middle == std::string::npos;
    // Definitions name types package/Type instead of package/msg/Type.
    std::vector<std::string> types{is_short ? message_type
                                            : message_type.substr(0, middle) +
                                                  message_type.substr(middle + kMessageFolder.size() - 1)};
    std::string definition;
    // `types` grows while the loop finds further message types in the fields.
    for (std::size_t i = 0; i < types.size(); ++i) {
        const std::string& fields = message_texts().at(types[i]);
        if (i > 0) definition += std::string(80, '=') + "\nMSG: " + types[i] + "\n";
        definition += fields;
        std::istringstream lines(fields);
        for (std::string type, rest; lines >> type && std::getline(lines, rest);) {
            if (type.find('/') == std::string::npos) continue;  // a number or a string, not a message
            const std::string used = type.substr(0, type.find('['));
            if (std::ranges::find(types, used) == types.end()) types.push_back(used);
        }
    }
    return definition;
}

}  // namespace relidar::scan_files
