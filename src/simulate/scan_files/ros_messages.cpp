// SPDX-License-Identifier: Apache-2.0
// Writes points as sensor_msgs/PointCloud2 messages, and the boxes of actors as
// vision_msgs/Detection3DArray messages and as Autoware's tracked objects.

#include <cctype>
#include <sstream>

#include <relidar/scene/labels.hpp>
#include "base/text_hash.hpp"
#include "simulate/scan_files/recording_format.hpp"

namespace relidar::scan_files {
namespace {

struct RosField {
    std::string name;
    std::uint32_t offset;
    std::uint8_t type;  ///< datatype, a constant of sensor_msgs/PointField
};
constexpr std::uint8_t kRosUint8 = 2, kRosUint16 = 4, kRosInt32 = 5, kRosUint32 = 6, kRosFloat32 = 7;
/// Names of Velodyne drivers, and the number of the return. Optional channels follow.
const std::vector<RosField> kPlainFields = {{"x", 0, kRosFloat32},     {"y", 4, kRosFloat32},
                                            {"z", 8, kRosFloat32},     {"intensity", 12, kRosFloat32},
                                            {"time", 16, kRosFloat32}, {"ring", 20, kRosUint16},
                                            {"return", 22, kRosUint8}};
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
        const bool is_second = !cloud.return_number.empty() && cloud.return_number[i] == 2;
        ReturnType return_type = kStrongest;
        if (is_second && i > 0) {
            // The first return of the ray is the previous point. A second return that is
            // nearer cannot be the last one.
            const bool is_farther = glm::length(p) > glm::length(cloud.position_m[i - 1]);
            return_type = is_farther ? kLast : kSecondStrongest;
        }
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

/// Packs points as x, y, z, intensity, time, ring, return and optional channels.
std::string pack_velodyne(const LidarPoints& cloud) {
    std::string bytes;
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        append_raw(bytes, cloud.position_m[i]);
        append_raw(bytes, cloud.intensity[i]);
        append_raw(bytes, cloud.time_offset_s[i]);
        append_raw(bytes, cloud.ring[i]);
        append_raw(bytes, cloud.return_number.empty() ? std::uint8_t(1) : cloud.return_number[i]);
        append_raw(bytes, std::uint8_t(0));  // padding to a multiple of 4 bytes
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
    // Optional channels follow the fixed fields of a point, with 4 bytes each.
    std::vector<RosField> fields = type.fields;
    std::uint32_t bytes_per_point = type.step;
    std::vector<ChannelColumn> columns;
    if (type.has_channels) columns = list_columns(cloud.channels);
    for (const auto& [name, is_integer] : columns) {
        fields.push_back({name, bytes_per_point, is_integer ? kRosInt32 : kRosFloat32});
        bytes_per_point += 4;
    }
    constexpr std::uint32_t kHeight = 1, kCount = 1;
    constexpr std::uint8_t kIsBigEndian = 0, kIsDense = 1;
    const auto width = std::uint32_t(cloud.size()), bytes_per_row = std::uint32_t(points.size());
    codecs::CdrWriter cdr;
    add_header(cdr, recorded.stamp_ns, frame);
    cdr.add_number(kHeight).add_number(width).add_number(std::uint32_t(fields.size()));
    for (const RosField& field : fields)
        cdr.append_string(field.name).add_number(field.offset).add_number(field.type).add_number(kCount);
    cdr.add_number(kIsBigEndian).add_number(bytes_per_point).add_number(bytes_per_row);
    cdr.add_bytes(points).add_number(kIsDense);
    return cdr.take_message();
}

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

/// Returns a Detection3DArray message with one detection per actor: header, class with
/// its pose, bounding box, id. Each has the time at which the sensor points at the box.
std::string encode_detections(const RecordedSweep& sweep) {
    codecs::CdrWriter cdr;
    add_header(cdr, sweep.first_ns, kWorldFrame);
    cdr.add_number(std::uint32_t(sweep.actors.size()));
    for (const RecordedActor& actor : sweep.actors) {
        add_header(cdr, actor.faced.time_ns, kWorldFrame);
        // one class with a score of 1, because the class is known exactly
        cdr.add_number(std::uint32_t(1))
            .append_string(is_discovered(*actor.box) ? name_of(class_of(*actor.box)) : actor.box->category)
            .add_number(1.0);
        add_pose(cdr, actor.faced.world_from_object);
        add_covariance(cdr);
        add_pose(cdr, actor.faced.world_from_object);
        add_vector(cdr, actor.box->size_m);
        cdr.append_string(actor.box->id);
    }
    return cdr.take_message();
}

/// [ObjectClass] numbers of Autoware's classes; 0: unknown
constexpr std::uint8_t kAutowareLabels[] = {1, 1, 2, 3, 4, 6, 5, 7, 0};

/// Adds a UUID that depends only on a name, so that an actor has the same UUID in all
/// files. It consists of two FNV-1a hashes. Its version is 8 (custom UUID).
void add_uuid(codecs::CdrWriter& cdr, const std::string& name) {
    constexpr int kVersionByte = 6, kVariantByte = 8;
    std::string bytes;
    for (const std::uint64_t hash : hash_text_twice(name)) append_raw(bytes, hash);
    for (int i = 0; i < 16; ++i) {
        // The high bits of two bytes are the version (8) and the variant (binary 10).
        auto byte = static_cast<std::uint8_t>(bytes[std::size_t(i)]);
        if (i == kVersionByte) byte = 0x80 | (byte & 0x0f);
        if (i == kVariantByte) byte = 0x80 | (byte & 0x3f);
        cdr.add_number(byte);
    }
}

/// Returns a TrackedObjects message with the boxes of all actors. The objects have no
/// time stamps, so their poses are at the time of the message.
std::string encode_tracked(const RecordedSweep& sweep) {
    constexpr std::uint8_t kOrientationAvailable = 2, kBoundingBox = 0;
    codecs::CdrWriter cdr;
    add_header(cdr, sweep.first_ns, kWorldFrame);
    cdr.add_number(std::uint32_t(sweep.actors.size()));
    for (const RecordedActor& actor : sweep.actors) {
        add_uuid(cdr, actor.box->id);
        // Existence probability, then one class with its label and probability. Both
        // probabilities are 1.
        cdr.add_number(1.0f)
            .add_number(std::uint32_t(1))
            .add_number(kAutowareLabels[std::size_t(class_of(*actor.box))])
            .add_number(1.0f);
        add_pose(cdr, actor.at_stamp.world_from_object);
        add_covariance(cdr);
        add_velocity(cdr, actor.at_stamp.velocity);
        add_velocity(cdr, {});  // zero acceleration, because the acceleration is unknown
        cdr.add_number(kOrientationAvailable).add_number(std::uint8_t(!actor.box->is_moving()));
        cdr.add_number(kBoundingBox).add_number(std::uint32_t(0));  // an empty footprint
        add_vector(cdr, actor.box->size_m);
    }
    return cdr.take_message();
}

}  // namespace

std::vector<RecordedTopic> ros_cloud_topics(const RecordedRig& rig, std::size_t sensor) {
    const std::string& topic = rig.sensors[sensor].topic;
    const std::string frame = rig.cloud_frame(sensor);
    const auto make_topic = [&](const std::string& name, const RosPointType& type) {
        return make_ros_topic(name, "sensor_msgs/msg/PointCloud2",
                              encode_sweep(&RecordedSweep::last_ns, [=, &type](const RecordedSweep& sweep) {
                                  return encode_cloud2(sweep.clouds[sensor], frame, type);
                              }));
    };
    std::vector<RecordedTopic> topics{make_topic(topic, kPlainType)};
    // Leaves out this topic in the world frame, because such points have no azimuth and
    // elevation relative to the sensor.
    if (!rig.world) topics.push_back(make_topic(topic + "_xyzircaedt", kAutowareType));
    return topics;
}

std::string ros_definition(const std::string& message_type) {
    // Definitions name types package/Type instead of package/msg/Type.
    const std::size_t slash = message_type.find('/');
    std::vector<std::string> types{message_type.substr(0, slash) +
                                   message_type.substr(message_type.rfind('/'))};
    std::string definition;
    // `types` grows while the loop finds further message types in the fields.
    for (std::size_t i = 0; i < types.size(); ++i) {
        const std::string& fields = message_texts().at(types[i]);
        if (i > 0) definition += std::string(80, '=') + "\nMSG: " + types[i] + "\n";
        definition += fields;
        std::istringstream lines(fields);  // a line has the type and the name of a field
        std::string type, rest;
        while (lines >> type && std::getline(lines, rest)) {
            const bool is_message = type.find('/') != std::string::npos;      // not a number or a string
            const std::string element_type = type.substr(0, type.find('['));  // of an array
            const bool is_known = std::ranges::find(types, element_type) != types.end();
            if (is_message && !is_known) types.push_back(element_type);
        }
    }
    return definition;
}

std::vector<RecordedTopic> ros_actor_topics() {
    return {make_ros_topic("/actors", "vision_msgs/msg/Detection3DArray",
                           encode_sweep(&RecordedSweep::last_ns, encode_detections)),
            make_ros_topic("/actors_autoware", "autoware_perception_msgs/msg/TrackedObjects",
                           encode_sweep(&RecordedSweep::last_ns, encode_tracked))};
}

}  // namespace relidar::scan_files
