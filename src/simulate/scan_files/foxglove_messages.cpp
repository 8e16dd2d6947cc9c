// SPDX-License-Identifier: Apache-2.0
// Converts scans to Foxglove's protobuf messages. Also writes the descriptors that
// readers need to decode these messages.
#include "simulate/scan_files/recording_format.hpp"

#include <initializer_list>
#include <type_traits>

#include <fmt/format.h>
#include <protozero/pbf_writer.hpp>

#include <relidar/scene/labels.hpp>
#include <relidar/simulate/actor_boxes.hpp>
#include "base/bytes.hpp"
#include "base/fail.hpp"

namespace relidar::scan_files {
namespace {

using protozero::pbf_writer;

enum ProtobufFieldType {
    kDouble = 1,
    kInt64 = 3,
    kInt32 = 5,
    kFixed32 = 7,
    kBool = 8,
    kString = 9,
    kMessage = 11,
    kBytes = 12,
    kEnum = 14
};

struct ProtobufField {
    int number;
    const char* name;
    ProtobufFieldType type;
    const char* type_name = nullptr;  ///< name of the message or enumeration type, null for other types
    bool repeated = false;
};
struct ProtobufMessageType {
    const char* name;
    std::initializer_list<ProtobufField> fields;
};
struct ProtobufEnumType {
    const char* name;
    std::initializer_list<const char*> values;  ///< names of the values 0, 1, ...
};

constexpr const char *kTimestampType = ".google.protobuf.Timestamp",
                     *kDurationType = ".google.protobuf.Duration";
constexpr const char *kPoseType = ".foxglove.Pose", *kVectorType = ".foxglove.Vector3",
                     *kQuaternion = ".foxglove.Quaternion";

/// Shapes that relidar never writes have no fields: readers expect a list for each kind
/// of shape, even if it is empty.
const std::initializer_list<ProtobufMessageType> kMessageTypes = {
    {"Vector3", {{1, "x", kDouble}, {2, "y", kDouble}, {3, "z", kDouble}}},
    {"Quaternion", {{1, "x", kDouble}, {2, "y", kDouble}, {3, "z", kDouble}, {4, "w", kDouble}}},
    {"Pose", {{1, "position", kMessage, kVectorType}, {2, "orientation", kMessage, kQuaternion}}},
    {"Color", {{1, "r", kDouble}, {2, "g", kDouble}, {3, "b", kDouble}, {4, "a", kDouble}}},
    {"PackedElementField",
     {{1, "name", kString}, {2, "offset", kFixed32}, {3, "type", kEnum, ".foxglove.NumericType"}}},
    {"PointCloud",
     {{1, "timestamp", kMessage, kTimestampType},
      {2, "frame_id", kString},
      {3, "pose", kMessage, kPoseType},
      {4, "point_stride", kFixed32},
      {5, "fields", kMessage, ".foxglove.PackedElementField", true},
      {6, "data", kBytes}}},
    {"FrameTransform",
     {{1, "timestamp", kMessage, kTimestampType},
      {2, "parent_frame_id", kString},
      {3, "child_frame_id", kString},
      {4, "translation", kMessage, kVectorType},
      {5, "rotation", kMessage, kQuaternion}}},
    {"FrameTransforms", {{1, "transforms", kMessage, ".foxglove.FrameTransform", true}}},
    {"KeyValuePair", {{1, "key", kString}, {2, "value", kString}}},
    {"CubePrimitive",
     {{1, "pose", kMessage, kPoseType},
      {2, "size", kMessage, kVectorType},
      {3, "color", kMessage, ".foxglove.Color"}}},
    {"ArrowPrimitive", {}},
    {"SpherePrimitive", {}},
    {"CylinderPrimitive", {}},
    {"LinePrimitive", {}},
    {"TriangleListPrimitive", {}},
    {"TextPrimitive", {}},
    {"ModelPrimitive", {}},
    {"SceneEntityDeletion",
     {{1, "timestamp", kMessage, kTimestampType},
      {2, "type", kEnum, ".foxglove.SceneEntityDeletionType"},
      {3, "id", kString}}},
    {"SceneEntity",
     {{1, "timestamp", kMessage, kTimestampType},
      {2, "frame_id", kString},
      {3, "id", kString},
      {4, "lifetime", kMessage, kDurationType},
      {5, "frame_locked", kBool},
      {6, "metadata", kMessage, ".foxglove.KeyValuePair", true},
      {7, "arrows", kMessage, ".foxglove.ArrowPrimitive", true},
      {8, "cubes", kMessage, ".foxglove.CubePrimitive", true},
      {9, "spheres", kMessage, ".foxglove.SpherePrimitive", true},
      {10, "cylinders", kMessage, ".foxglove.CylinderPrimitive", true},
      {11, "lines", kMessage, ".foxglove.LinePrimitive", true},
      {12, "triangles", kMessage, ".foxglove.TriangleListPrimitive", true},
      {13, "texts", kMessage, ".foxglove.TextPrimitive", true},
      {14, "models", kMessage, ".foxglove.ModelPrimitive", true}}},
    {"SceneUpdate",
     {{1, "deletions", kMessage, ".foxglove.SceneEntityDeletion", true},
      {2, "entities", kMessage, ".foxglove.SceneEntity", true}}},
};

const std::initializer_list<ProtobufMessageType> kFixTypes = {
    {"LocationFix",
     {{1, "latitude", kDouble},
      {2, "longitude", kDouble},
      {3, "altitude", kDouble},
      {6, "timestamp", kMessage, kTimestampType},
      {7, "frame_id", kString}}},
};

const std::initializer_list<ProtobufEnumType> kEnumTypes = {
    {"NumericType", {"UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"}},
    {"SceneEntityDeletionType", {"MATCHING_ID", "ALL"}},
};

const std::initializer_list<ProtobufMessageType> kTimeTypes = {
    {"Timestamp", {{1, "seconds", kInt64}, {2, "nanos", kInt32}}},
    {"Duration", {{1, "seconds", kInt64}, {2, "nanos", kInt32}}},
};

/// Types of google/protobuf/descriptor.proto, which readers know.
const std::initializer_list<ProtobufMessageType> kDescriptorTypes = {
    {"FileDescriptorSet", {{1, "file", kMessage}}},
    {"FileDescriptorProto",
     {{1, "name", kString},
      {2, "package", kString},
      {3, "dependency", kString},
      {4, "message_type", kMessage},
      {5, "enum_type", kMessage},
      {12, "syntax", kString}}},
    {"DescriptorProto", {{1, "name", kString}, {2, "field", kMessage}}},
    {"FieldDescriptorProto",
     {{1, "name", kString},
      {3, "number", kInt32},
      {4, "label", kEnum},
      {5, "type", kEnum},
      {6, "type_name", kString}}},
    {"EnumDescriptorProto", {{1, "name", kString}, {2, "value", kMessage}}},
    {"EnumValueDescriptorProto", {{1, "name", kString}, {2, "number", kInt32}}},
};

/// Returns the definition of a field of a message type in the tables above.
const ProtobufField& find_field(std::string_view type, std::string_view name) {
    for (const auto& types : {kMessageTypes, kFixTypes, kTimeTypes, kDescriptorTypes})
        for (const ProtobufMessageType& message : types)
            if (type == message.name) return *std::ranges::find(message.fields, name, &ProtobufField::name);
    fail("unknown message type {}", type);
}

struct FieldValue {
    std::string_view name;
    std::string bytes = {};  ///< a text, bytes or an encoded message
    double number = 0.0;     ///< exact for all integers below 2^53

    FieldValue(std::string_view field, std::string value) : name(field), bytes(std::move(value)) {}
    template <class Number>
    requires std::is_arithmetic_v<Number> || std::is_enum_v<Number> FieldValue(std::string_view field,
                                                                               Number value)
        : name(field), number(double(value)) {}
};

/// Encodes a message of a type in the tables above.
std::string encode_message(std::string_view type, const std::vector<FieldValue>& values) {
    std::string bytes;
    pbf_writer writer(bytes);
    for (const FieldValue& value : values) {
        const ProtobufField& field = find_field(type, value.name);
        switch (field.type) {
            case kString:
            case kMessage:
            case kBytes: writer.add_bytes(field.number, value.bytes); break;
            case kDouble: writer.add_double(field.number, value.number); break;
            case kFixed32: writer.add_fixed32(field.number, std::uint32_t(value.number)); break;
            default: writer.add_int64(field.number, std::int64_t(value.number));
        }
    }
    return bytes;
}

/// Returns a DescriptorProto, which tells readers the fields of a message type.
std::string describe_message(const ProtobufMessageType& type) {
    constexpr int kOptional = 1, kRepeated = 3;  // labels of fields in descriptor.proto
    std::vector<FieldValue> message{{"name", type.name}};
    for (const ProtobufField& field : type.fields) {
        std::vector<FieldValue> description{{"name", field.name},
                                            {"number", field.number},
                                            {"label", field.repeated ? kRepeated : kOptional},
                                            {"type", field.type}};
        if (field.type_name) description.emplace_back("type_name", field.type_name);
        message.emplace_back("field", encode_message("FieldDescriptorProto", description));
    }
    return encode_message("DescriptorProto", message);
}

/// Returns an EnumDescriptorProto.
std::string describe_enum(const ProtobufEnumType& type) {
    std::vector<FieldValue> message{{"name", type.name}};
    int number = 0;
    for (const char* name : type.values)
        message.emplace_back(
            "value", encode_message("EnumValueDescriptorProto", {{"name", name}, {"number", number++}}));
    return encode_message("EnumDescriptorProto", message);
}

/// Returns a FileDescriptorProto.
/// @param imported file that defines further types, empty if none
std::string describe_file(const char* name, const char* package, const std::string& imported,
                          std::initializer_list<ProtobufMessageType> messages,
                          std::initializer_list<ProtobufEnumType> enums) {
    std::vector<FieldValue> file{{"name", name}, {"package", package}};
    if (!imported.empty()) file.emplace_back("dependency", imported);
    for (const ProtobufMessageType& type : messages)
        file.emplace_back("message_type", describe_message(type));
    for (const ProtobufEnumType& type : enums) file.emplace_back("enum_type", describe_enum(type));
    file.emplace_back("syntax", "proto3");
    return encode_message("FileDescriptorProto", file);
}

/// Returns the definition of message types, which a recording stores for its readers: the
/// files that declare these types and their times.
std::string define_types(std::initializer_list<ProtobufMessageType> messages,
                         std::initializer_list<ProtobufEnumType> enums) {
    constexpr const char *kTimesFile = "google/protobuf/times.proto", *kFile = "foxglove/relidar.proto";
    return encode_message("FileDescriptorSet",
                          {{"file", describe_file(kTimesFile, "google.protobuf", "", kTimeTypes, {})},
                           {"file", describe_file(kFile, "foxglove", kTimesFile, messages, enums)}});
}

std::string encode_time(std::uint64_t time_ns) {
    return encode_message("Timestamp",
                          {{"seconds", time_ns / kNsPerSecond}, {"nanos", time_ns % kNsPerSecond}});
}

std::string encode_vector(const glm::dvec3& v) {
    return encode_message("Vector3", {{"x", v.x}, {"y", v.y}, {"z", v.z}});
}

std::string encode_rotation(const glm::dquat& q) {
    return encode_message("Quaternion", {{"x", q.x}, {"y", q.y}, {"z", q.z}, {"w", q.w}});
}

std::string encode_pose(const Pose& pose) {
    return encode_message("Pose", {{"position", encode_vector(pose.translation)},
                                   {"orientation", encode_rotation(pose.rotation)}});
}

enum FoxgloveNumericType { kUint8 = 1, kUint16 = 3, kInt32Number = 6, kFloat32 = 7 };
struct FoxglovePointField {
    std::string name;
    std::uint32_t offset;
    FoxgloveNumericType type;
};
const FoxglovePointField kPointFields[] = {{"x", 0, kFloat32},     {"y", 4, kFloat32},
                                           {"z", 8, kFloat32},     {"intensity", 12, kFloat32},
                                           {"time", 16, kFloat32}, {"instance", 20, kInt32Number},
                                           {"ring", 24, kUint16},  {"return", 26, kUint8}};
// Bytes per point without optional channels: a multiple of 4.
constexpr std::uint32_t kBytesPerPoint = 28;

std::vector<FoxglovePointField> point_fields(const LidarPoints& cloud) {
    std::vector<FoxglovePointField> fields(std::begin(kPointFields), std::end(kPointFields));
    std::uint32_t offset = kBytesPerPoint;
    for (const auto& [name, is_integer] : list_columns(cloud.channels)) {
        fields.push_back({name, offset, is_integer ? kInt32Number : kFloat32});
        offset += 4;
    }
    return fields;
}

/// Packs points in the layout of point_fields().
std::string pack_points(const LidarPoints& cloud) {
    std::string bytes;
    bytes.reserve(cloud.size() * kBytesPerPoint);
    for (std::size_t i = 0; i < cloud.size(); ++i) {
        append_raw(bytes, cloud.position_m[i]);
        append_raw(bytes, cloud.intensity[i]);
        append_raw(bytes, cloud.time_offset_s[i]);
        append_raw(bytes, cloud.instance[i]);
        append_raw(bytes, cloud.ring[i]);
        append_raw(bytes, cloud.return_number.empty() ? std::uint8_t(1) : cloud.return_number[i]);
        append_raw(bytes, std::uint8_t(0));  // padding to a multiple of 4 bytes
        append_values(bytes, cloud.channels, i);
    }
    return bytes;
}

/// Returns a foxglove.PointCloud message. Its pose is the identity, because the points
/// are already in the frame `frame_id`.
std::string encode_cloud(const RecordedCloud& recorded, const std::string& frame_id) {
    const std::vector<FoxglovePointField> fields = point_fields(recorded.points);
    const std::size_t n_optional = fields.size() - std::size(kPointFields);  // of 4 bytes each
    std::vector<FieldValue> message{{"timestamp", encode_time(recorded.stamp_ns)},
                                    {"frame_id", frame_id},
                                    {"pose", encode_pose({})},
                                    {"point_stride", kBytesPerPoint + 4 * n_optional}};
    for (const auto& [name, offset, type] : fields)
        message.emplace_back("fields", encode_message("PackedElementField",
                                                      {{"name", name}, {"offset", offset}, {"type", type}}));
    message.emplace_back("data", pack_points(recorded.points));
    return encode_message("PointCloud", message);
}

/// Returns a foxglove.FrameTransforms message with one transform.
std::string encode_transform(std::uint64_t time_ns, const std::string& parent, const std::string& child,
                             const Pose& parent_from_child) {
    const std::string transform =
        encode_message("FrameTransform", {{"timestamp", encode_time(time_ns)},
                                          {"parent_frame_id", parent},
                                          {"child_frame_id", child},
                                          {"translation", encode_vector(parent_from_child.translation)},
                                          {"rotation", encode_rotation(parent_from_child.rotation)}});
    return encode_message("FrameTransforms", {{"transforms", transform}});
}

/// Returns the box of an actor. It is translucent, so that the points in it stay visible.
std::string encode_box(const RecordedActor& actor) {
    const std::string color = encode_message("Color", {{"r", 1.0}, {"g", 0.6}, {"b", 0.1}, {"a", 0.3}});
    return encode_message("CubePrimitive", {{"pose", encode_pose(actor.faced.world_from_object)},
                                            {"size", encode_vector(actor.box->size_m)},
                                            {"color", color}});
}

std::string format_vector(const glm::dvec3& vector) {
    return fmt::format("{:.6g} {:.6g} {:.6g}", vector.x, vector.y, vector.z);
}

/// Returns a foxglove.SceneEntity with the box of an actor at the time when the sensor
/// faces it, so that the box fits its points. Velocities are in the world frame.
std::string encode_actor(const RecordedActor& actor) {
    const ObjectState& state = actor.faced;
    const glm::dquat& world_from_box = state.world_from_object.rotation;
    std::vector<std::pair<const char*, std::string>> metadata = {
        {"class", name_of(class_of(*actor.box))},
        {"category", actor.box->category},
        {"velocity_mps", format_vector(world_from_box * state.velocity.linear_mps)},
        {"angular_velocity_radps", format_vector(world_from_box * state.velocity.angular_radps)},
        {"is_static", actor.is_static ? "true" : "false"},
        {"points", fmt::format("{}", actor.n_points)}};
    if (actor.note != LabelNote::none) metadata.emplace_back("note", name_of(actor.note));
    if (actor.visible_share)
        metadata.emplace_back("visible_share", fmt::format("{:.6g}", *actor.visible_share));
    std::vector<FieldValue> entity{
        {"timestamp", encode_time(state.time_ns)}, {"frame_id", kWorldFrame}, {"id", actor.box->id}};
    for (const auto& [key, value] : metadata)
        entity.emplace_back("metadata", encode_message("KeyValuePair", {{"key", key}, {"value", value}}));
    entity.emplace_back("cubes", encode_box(actor));
    return encode_message("SceneEntity", entity);
}

/// Returns a foxglove.SceneUpdate with the boxes of the actors. First deletes all earlier
/// boxes, so that no boxes of absent actors remain.
std::string encode_scene_update(const RecordedSweep& sweep) {
    constexpr int kDeleteAll = 1;  // value ALL of SceneEntityDeletionType
    std::vector<FieldValue> update{
        {"deletions", encode_message("SceneEntityDeletion",
                                     {{"timestamp", encode_time(sweep.first_ns)}, {"type", kDeleteAll}})}};
    for (const RecordedActor& actor : sweep.actors) update.emplace_back("entities", encode_actor(actor));
    return encode_message("SceneUpdate", update);
}

std::string encode_vehicle_transform(const ObjectState& vehicle) {
    return encode_transform(vehicle.time_ns, kWorldFrame, kVehicleFrame, vehicle.world_from_object);
}

/// Returns a foxglove.LocationFix with the position of base_link on the earth.
std::string encode_fix(const RecordedFix& fix) {
    return encode_message("LocationFix", {{"latitude", fix.position.latitude_deg},
                                          {"longitude", fix.position.longitude_deg},
                                          {"altitude", fix.position.height_m},
                                          {"timestamp", encode_time(fix.time_ns)},
                                          {"frame_id", kVehicleFrame}});
}

}  // namespace

std::vector<RecordedTopic> foxglove_topics(const RecordedRig& rig) {
    const auto static_transforms = [transforms = rig.static_transforms()](const RecordedSweep& sweep) {
        // Concatenated protobuf messages are one message with all list entries.
        std::string bytes;
        for (const auto& [parent, child, parent_from_child] : transforms)
            bytes += encode_transform(sweep.first_ns, parent, child, parent_from_child);
        return bytes;
    };
    const std::string definition = define_types(kMessageTypes, kEnumTypes);  // of all types except /fix
    std::vector<RecordedTopic> topics{{"/tf_static", "foxglove.FrameTransforms", definition,
                                       encode_sweep(&RecordedSweep::first_ns, static_transforms)},
                                      {"/tf", "foxglove.FrameTransforms", definition,
                                       encode_each(&RecordedSweep::poses, encode_vehicle_transform)},
                                      {"/actors", "foxglove.SceneUpdate", definition,
                                       encode_sweep(&RecordedSweep::last_ns, encode_scene_update)}};
    if (rig.earth)
        topics.push_back({"/fix", "foxglove.LocationFix", define_types(kFixTypes, {}),
                          encode_each(&RecordedSweep::fixes, encode_fix)});
    for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
        const auto cloud = [s, frame = rig.cloud_frame(s)](const RecordedSweep& sweep) {
            return encode_cloud(sweep.clouds[s], frame);
        };
        topics.push_back({rig.sensors[s].topic, "foxglove.PointCloud", definition,
                          encode_sweep(&RecordedSweep::last_ns, cloud)});
    }
    return topics;
}

}  // namespace relidar::scan_files
