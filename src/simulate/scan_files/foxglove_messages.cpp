// SPDX-License-Identifier: Apache-2.0
// Converts scans to Foxglove's protobuf messages. Also writes the descriptors that
// readers need to decode these messages.
#include "simulate/scan_files/recording_format.hpp"

#include <initializer_list>

#include <fmt/format.h>
#include <protozero/pbf_writer.hpp>

#include <relidar/simulate/actor_boxes.hpp>
#include "base/bytes.hpp"

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
    const char* type_name = "";  ///< name of the message or enumeration type; empty for other types
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

constexpr int kLabelOptional = 1, kLabelRepeated = 3;  // labels of fields in descriptor.proto

/// Returns the bytes that `write` writes.
template <class Write>
std::string encode(const Write& write) {
    std::string bytes;
    pbf_writer writer(bytes);
    write(writer);
    return bytes;
}

/// Returns a DescriptorProto, which tells readers the fields of a message type: name (1)
/// and fields (2). The numbers are field numbers of descriptor.proto.
std::string describe_message(const ProtobufMessageType& message) {
    return encode([&](pbf_writer& writer) {
        writer.add_string(1, message.name);
        for (const ProtobufField& field : message.fields)
            writer.add_message(2, encode([&](pbf_writer& of_field) {
                                   of_field.add_string(1, field.name);
                                   of_field.add_int32(3, field.number);
                                   of_field.add_enum(4, field.repeated ? kLabelRepeated : kLabelOptional);
                                   of_field.add_enum(5, field.type);
                                   if (*field.type_name) of_field.add_string(6, field.type_name);
                               }));
    });
}

/// Returns an EnumDescriptorProto. The numbers are field numbers of descriptor.proto.
std::string describe_enum(const ProtobufEnumType& type) {
    return encode([&](pbf_writer& writer) {
        writer.add_string(1, type.name);
        int value = 0;  // the values of an enum count from 0
        for (const char* name : type.values) {
            writer.add_message(2, encode([&](pbf_writer& of_value) {
                                   of_value.add_string(1, name);
                                   of_value.add_int32(2, value);
                               }));
            ++value;
        }
    });
}

/// Returns a FileDescriptorProto. The numbers are field numbers of descriptor.proto.
/// @param imported file that defines further types, empty if none
std::string describe_file(const char* file, const char* package, const char* imported,
                          std::initializer_list<ProtobufMessageType> messages,
                          std::initializer_list<ProtobufEnumType> enums) {
    return encode([&](pbf_writer& writer) {
        writer.add_string(1, file);
        writer.add_string(2, package);
        if (*imported) writer.add_string(3, imported);
        for (const ProtobufMessageType& message : messages) writer.add_message(4, describe_message(message));
        for (const ProtobufEnumType& type : enums) writer.add_message(5, describe_enum(type));
        writer.add_string(12, "proto3");
    });
}

std::string encode_time(std::uint64_t time_ns) {
    return encode([&](pbf_writer& writer) {
        writer.add_int64(1, std::int64_t(time_ns / 1'000'000'000));
        writer.add_int32(2, std::int32_t(time_ns % 1'000'000'000));
    });
}

std::string encode_doubles(std::initializer_list<double> values) {
    return encode([&](pbf_writer& writer) {
        protozero::pbf_tag_type number = 0;
        for (const double value : values) writer.add_double(++number, value);
    });
}

std::string encode_vector(const glm::dvec3& vector) { return encode_doubles({vector.x, vector.y, vector.z}); }
std::string encode_rotation(const glm::dquat& quaternion) {
    return encode_doubles({quaternion.x, quaternion.y, quaternion.z, quaternion.w});
}

std::string encode_pose(const Pose& pose) {
    return encode([&](pbf_writer& writer) {
        writer.add_message(1, encode_vector(pose.translation));
        writer.add_message(2, encode_rotation(pose.rotation));
    });
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
/// are already in the frame `frame_id`. The numbers are the field numbers in
/// kMessageTypes, here and in the functions below.
std::string encode_cloud(const RecordedCloud& recorded, const std::string& frame_id) {
    const LidarPoints& cloud = recorded.points;
    return encode([&](pbf_writer& writer) {
        writer.add_message(1, encode_time(recorded.stamp_ns));
        writer.add_string(2, frame_id);
        writer.add_message(3, encode_pose({}));
        const std::vector<FoxglovePointField> fields = point_fields(cloud);
        const std::size_t n_optional = fields.size() - std::size(kPointFields);  // of 4 bytes each
        writer.add_fixed32(4, kBytesPerPoint + 4 * std::uint32_t(n_optional));
        for (const FoxglovePointField& field : fields)
            writer.add_message(5, encode([&](pbf_writer& element) {
                                   element.add_string(1, field.name);
                                   element.add_fixed32(2, field.offset);
                                   element.add_enum(3, field.type);
                               }));
        writer.add_bytes(6, pack_points(cloud));
    });
}

/// Returns a foxglove.FrameTransforms message with one transform.
std::string encode_transform(std::uint64_t time_ns, const std::string& parent, const std::string& child,
                             const Pose& parent_from_child) {
    const std::string transform = encode([&](pbf_writer& writer) {
        writer.add_message(1, encode_time(time_ns));
        writer.add_string(2, parent);
        writer.add_string(3, child);
        writer.add_message(4, encode_vector(parent_from_child.translation));
        writer.add_message(5, encode_rotation(parent_from_child.rotation));
    });
    return encode([&](pbf_writer& transforms) { transforms.add_message(1, transform); });
}

std::string encode_box(const RecordedActor& actor) {
    return encode([&](pbf_writer& writer) {
        writer.add_message(1, encode_pose(actor.faced.world_from_box));
        writer.add_message(2, encode_vector(actor.size_m));
        // translucent so that the points inside the box stay visible
        writer.add_message(3, encode_doubles({1.0, 0.6, 0.1, 0.3}));
    });
}

std::string format_vector(const glm::dvec3& vector) {
    return fmt::format("{:.6g} {:.6g} {:.6g}", vector.x, vector.y, vector.z);
}

/// Returns a foxglove.SceneEntity with the box of an actor at the time when the sensor
/// faces it, so that the box fits its points. Velocities are in the world frame.
std::string encode_actor(const RecordedActor& actor) {
    const BoxState& state = actor.faced;
    const glm::dquat& world_from_box = state.world_from_box.rotation;
    std::vector<std::pair<const char*, std::string>> metadata = {
        {"category", actor.category},
        {"velocity_mps", format_vector(world_from_box * state.velocity.linear_mps)},
        {"angular_velocity_radps", format_vector(world_from_box * state.velocity.angular_radps)},
        {"is_static", actor.is_static ? "true" : "false"},
        {"points", fmt::format("{}", actor.n_points)}};
    if (actor.note != LabelNote::none) metadata.emplace_back("note", name_of(actor.note));
    if (actor.visible_share)
        metadata.emplace_back("visible_share", fmt::format("{:.6g}", *actor.visible_share));
    return encode([&](pbf_writer& entity) {
        entity.add_message(1, encode_time(state.time_ns));
        entity.add_string(2, kWorldFrame);
        entity.add_string(3, actor.name);
        for (const auto& entry : metadata)
            entity.add_message(6, encode([&](pbf_writer& pair) {
                                   pair.add_string(1, entry.first);
                                   pair.add_string(2, entry.second);
                               }));
        entity.add_message(8, encode_box(actor));
    });
}

/// Returns a foxglove.SceneUpdate with the boxes of the actors. First deletes all earlier
/// boxes, so that no boxes of absent actors remain.
std::string encode_scene_update(std::uint64_t stamp_ns, const std::vector<RecordedActor>& actors) {
    constexpr int kDeleteAll = 1;  // value ALL of SceneEntityDeletionType
    return encode([&](pbf_writer& writer) {
        writer.add_message(1, encode([&](pbf_writer& deletion) {
                               deletion.add_message(1, encode_time(stamp_ns));
                               deletion.add_enum(2, kDeleteAll);
                           }));
        for (const RecordedActor& actor : actors) writer.add_message(2, encode_actor(actor));
    });
}

std::vector<RecordedMessage> vehicle_transforms(const RecordedSweep& moment) {
    std::vector<RecordedMessage> messages;
    for (const RecordedPose& pose : moment.poses)
        messages.push_back({pose.time_ns, encode_transform(pose.time_ns, kWorldFrame, kVehicleFrame,
                                                           pose.world_from_vehicle)});
    return messages;
}

/// Returns one message with the poses of all sensors on the vehicle, and of the map. Each
/// scan repeats this message, so that playback can start anywhere. Concatenated protobuf
/// messages are one message with all list entries.
std::vector<RecordedMessage> sensor_transforms(const RecordedRig& rig, const RecordedSweep& moment) {
    std::string bytes;
    for (const auto& [parent, child, parent_from_child] : rig.static_transforms())
        bytes += encode_transform(moment.first_ns, parent, child, parent_from_child);
    return {{moment.first_ns, bytes}};
}

/// Returns a foxglove.LocationFix with the position of base_link on the earth.
std::vector<RecordedMessage> location_fixes(const RecordedSweep& moment) {
    if (!moment.fix) return {};
    const auto& [time_ns, position] = *moment.fix;
    return {{time_ns, encode([&](pbf_writer& writer) {
                 writer.add_double(1, position.latitude_deg);
                 writer.add_double(2, position.longitude_deg);
                 writer.add_double(3, position.height_m);
                 writer.add_message(6, encode_time(time_ns));
                 writer.add_string(7, kVehicleFrame);
             })}};
}

/// Returns the definition of message types, which a recording stores for its readers: a
/// FileDescriptorSet with the files that declare these types and their times.
std::string define_types(std::initializer_list<ProtobufMessageType> messages,
                         std::initializer_list<ProtobufEnumType> enums) {
    constexpr const char *kTimesFile = "google/protobuf/times.proto", *kFile = "foxglove/relidar.proto";
    return encode([&](pbf_writer& writer) {
        writer.add_message(1, describe_file(kTimesFile, "google.protobuf", "", kTimeTypes, {}));
        writer.add_message(1, describe_file(kFile, "foxglove", kTimesFile, messages, enums));
    });
}

}  // namespace

std::vector<RecordedTopic> foxglove_topics(const RecordedRig& rig) {
    std::vector<RecordedTopic> topics;
    const auto add_topic = [&](const std::string& name, const char* type, const std::string& definition,
                               auto encode_messages) {
        topics.push_back({name, type, definition, /*metadata=*/{}, std::move(encode_messages)});
    };
    const std::string definition = define_types(kMessageTypes, kEnumTypes);  // of all types except /fix
    const auto static_transforms = [rig](const RecordedSweep& moment) {
        return sensor_transforms(rig, moment);
    };
    const auto scene_updates = [](const RecordedSweep& moment) {
        const std::string update = encode_scene_update(moment.first_ns, moment.actors);
        return std::vector<RecordedMessage>{{moment.last_ns, update}};
    };
    add_topic("/tf_static", "foxglove.FrameTransforms", definition, static_transforms);
    add_topic("/tf", "foxglove.FrameTransforms", definition, vehicle_transforms);
    add_topic("/actors", "foxglove.SceneUpdate", definition, scene_updates);
    if (rig.earth) add_topic("/fix", "foxglove.LocationFix", define_types(kFixTypes, {}), location_fixes);
    for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
        const auto cloud = [s, frame = rig.cloud_frame(s)](const RecordedSweep& moment) {
            return std::vector<RecordedMessage>{{moment.last_ns, encode_cloud(moment.clouds[s], frame)}};
        };
        add_topic(rig.sensors[s].topic, "foxglove.PointCloud", definition, cloud);
    }
    return topics;
}

}  // namespace relidar::scan_files
