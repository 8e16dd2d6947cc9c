// SPDX-License-Identifier: Apache-2.0
// Reads point clouds, transforms and boxes in Foxglove's protobuf schemas. `relidar
// render --format mcap` writes these schemas.
#include <utility>

#include <protozero/pbf_reader.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/messages.hpp"

namespace relidar::bag {
namespace {

using protozero::pbf_reader;
using protozero::pbf_wire_type;

constexpr auto kLengthDelimited = pbf_wire_type::length_delimited, kFixed32 = pbf_wire_type::fixed32,
               kVarint = pbf_wire_type::varint;

bool is_field(const pbf_reader& reader, protozero::pbf_tag_type tag, pbf_wire_type type) {
    return reader.tag_and_type() == protozero::tag_and_type(tag, type);
}

/// Reads the coordinates x, y, z and w of a protobuf message. Missing coordinates are 0.
glm::dvec4 read_xyzw(pbf_reader reader) {
    glm::dvec4 v(0.0);
    while (reader.next()) {
        // Reads the tag first, because reading the value resets it.
        const int at = int(reader.tag()) - 1;
        if (at >= 0 && at < 4 && reader.wire_type() == pbf_wire_type::fixed64) v[at] = reader.get_double();
        else reader.skip();
    }
    return v;
}

/// Reads a google.protobuf.Timestamp: seconds (1) and nanoseconds (2).
std::int64_t read_stamp_ns(pbf_reader reader) {
    std::int64_t seconds = 0, nanoseconds = 0;
    while (reader.next()) {
        if (is_field(reader, 1, kVarint)) seconds = reader.get_int64();
        else if (is_field(reader, 2, kVarint)) nanoseconds = reader.get_int32();
        else reader.skip();
    }
    constexpr std::int64_t kMaxRosTime_s = 4294967295;  // limit of ROS times
    if (seconds < 0 || seconds > kMaxRosTime_s)
        fail("found the message time {} s, expected 0 to {} s", seconds, kMaxRosTime_s);
    if (nanoseconds < 0 || nanoseconds > 999999999)
        fail("found {} ns in a message time, expected 0 to 999999999 ns", nanoseconds);
    return seconds * 1000000000 + nanoseconds;
}

PoseComponents to_pose(const glm::dvec4& position, const glm::dvec4& quaternion_xyzw) {
    const glm::dvec4& q = quaternion_xyzw;
    return {position.x, position.y, position.z, q.x, q.y, q.z, q.w};
}

/// Reads a foxglove.PackedElementField: name (1), offset (2) and type (3).
CloudMessage::CloudField read_pbf_field(pbf_reader reader) {
    struct Type {
        char kind;
        std::size_t size;
    };
    // Kind and size in bytes of Foxglove's numeric types 1 to 8.
    static constexpr Type kFoxgloveTypes[] = {{'U', 1}, {'I', 1}, {'U', 2}, {'I', 2},
                                              {'U', 4}, {'I', 4}, {'F', 4}, {'F', 8}};
    CloudMessage::CloudField field;
    std::int32_t type = 0;
    while (reader.next()) {
        if (is_field(reader, 1, kLengthDelimited)) field.name = reader.get_string();
        else if (is_field(reader, 2, kFixed32)) field.offset = reader.get_fixed32();
        else if (is_field(reader, 3, kVarint)) type = reader.get_enum();
        else reader.skip();
    }
    if (type < 1 || type > 8)
        fail(
            "the field '{}' of the cloud has the data type {}, expected 1 to 8 (foxglove.PackedElementField)",
            quote(field.name), type);
    field.kind = kFoxgloveTypes[type - 1].kind;
    field.size = kFoxgloveTypes[type - 1].size;
    return field;
}

/// Throws if a cloud has a pose other than the identity, because relidar does not support
/// such clouds.
void check_identity(pbf_reader reader) {
    while (reader.next()) {
        const bool turns = reader.tag() == 2;
        if (reader.tag() > 2 || reader.wire_type() != kLengthDelimited) reader.skip();
        else if (!(glm::length(glm::dvec3(read_xyzw(reader.get_message()))) <= 1e-9))
            fail("the cloud has a pose with a {}, expected a pose without translation and rotation",
                 turns ? "rotation" : "translation");
    }
}

/// Reads foxglove.PointCloud. It has no width, so the cloud becomes one row of points.
CloudMessage parse_cloud(pbf_reader reader) {
    CloudMessage cloud;
    while (reader.next()) {
        if (is_field(reader, 1, kLengthDelimited))
            cloud.header.stamp_ns = read_stamp_ns(reader.get_message());
        else if (is_field(reader, 2, kLengthDelimited)) cloud.header.frame = reader.get_string();
        else if (is_field(reader, 3, kLengthDelimited)) check_identity(reader.get_message());
        else if (is_field(reader, 4, kFixed32)) cloud.point_step = reader.get_fixed32();
        else if (is_field(reader, 5, kLengthDelimited))
            cloud.fields.push_back(read_pbf_field(reader.get_message()));
        else if (is_field(reader, 6, kLengthDelimited)) {
            const protozero::data_view view = reader.get_view();
            cloud.data = {view.data(), view.size()};
        } else reader.skip();
    }
    cloud.height = 1;
    cloud.width = cloud.point_step == 0 ? 0 : std::uint32_t(cloud.data.size() / cloud.point_step);
    cloud.row_step = cloud.width * cloud.point_step;
    return cloud;
}

/// Reads foxglove.FrameTransform. A missing field is the identity.
void add_transform(TransformListMessage& list, pbf_reader reader) {
    TransformMessage transform;
    glm::dvec4 translation(0.0), rotation(0.0, 0.0, 0.0, 1.0);
    while (reader.next()) {
        if (is_field(reader, 1, kLengthDelimited))
            transform.header.stamp_ns = read_stamp_ns(reader.get_message());
        else if (is_field(reader, 2, kLengthDelimited)) transform.header.frame = reader.get_string();
        else if (is_field(reader, 3, kLengthDelimited)) transform.child = reader.get_string();
        else if (is_field(reader, 4, kLengthDelimited)) translation = read_xyzw(reader.get_message());
        else if (is_field(reader, 5, kLengthDelimited)) rotation = read_xyzw(reader.get_message());
        else reader.skip();
    }
    list.add_if_valid(std::move(transform), to_pose(translation, rotation));
}

/// Reads foxglove.LocationFix: latitude (1), longitude (2), altitude (3), timestamp (6)
/// and frame_id (7).
FixMessage parse_fix(pbf_reader reader) {
    constexpr auto kFixed64 = pbf_wire_type::fixed64;
    FixMessage fix;
    while (reader.next()) {
        if (is_field(reader, 1, kFixed64)) fix.position.latitude_deg = reader.get_double();
        else if (is_field(reader, 2, kFixed64)) fix.position.longitude_deg = reader.get_double();
        else if (is_field(reader, 3, kFixed64)) fix.position.height_m = reader.get_double();
        else if (is_field(reader, 6, kLengthDelimited))
            fix.header.stamp_ns = read_stamp_ns(reader.get_message());
        else if (is_field(reader, 7, kLengthDelimited)) fix.header.frame = reader.get_string();
        else reader.skip();
    }
    return fix;
}

/// Reads the pose and the size of a foxglove.CubePrimitive.
void read_cube(pbf_reader reader, BoxMessage& box, PoseComponents& pose) {
    glm::dvec4 position(0.0), rotation(0.0, 0.0, 0.0, 1.0);
    while (reader.next()) {
        if (is_field(reader, 1, kLengthDelimited)) {
            pbf_reader part = reader.get_message();
            while (part.next()) {
                if (is_field(part, 1, kLengthDelimited)) position = read_xyzw(part.get_message());
                else if (is_field(part, 2, kLengthDelimited)) rotation = read_xyzw(part.get_message());
                else part.skip();
            }
        } else if (is_field(reader, 2, kLengthDelimited)) box.size_m = read_xyzw(reader.get_message());
        else reader.skip();
    }
    pose = to_pose(position, rotation);
}

/// Returns the value of a foxglove.KeyValuePair if it has the expected key, or "".
std::string read_value(pbf_reader reader, std::string_view expected_key) {
    std::string key, value;
    while (reader.next()) {
        if (is_field(reader, 1, kLengthDelimited)) key = reader.get_string();
        else if (is_field(reader, 2, kLengthDelimited)) value = reader.get_string();
        else reader.skip();
    }
    return key == expected_key ? value : "";
}

/// Reads a scene entity. Adds it as a box if it consists of exactly one cube.
void add_entity(BoxListMessage& box_list, pbf_reader reader) {
    BoxMessage box;
    PoseComponents pose{};
    std::size_t n_cubes = 0;
    while (reader.next()) {
        if (is_field(reader, 1, kLengthDelimited)) box.header.stamp_ns = read_stamp_ns(reader.get_message());
        else if (is_field(reader, 2, kLengthDelimited)) box.header.frame = reader.get_string();
        else if (is_field(reader, 3, kLengthDelimited)) box.id = reader.get_string();
        else if (is_field(reader, 6, kLengthDelimited)) {
            const std::string category = read_value(reader.get_message(), "category");
            if (!category.empty()) box.category = category;
        } else if (is_field(reader, 8, kLengthDelimited)) {
            read_cube(reader.get_message(), box, pose);
            ++n_cubes;
        } else reader.skip();
    }
    if (box_list.header.frame.empty()) box_list.header = box.header;
    if (n_cubes == 1) box_list.add_if_valid(std::move(box), pose);
    else if (n_cubes > 1) ++box_list.n_left_out;
}

/// @throws DataError that names the schema
template <class Read>
auto parse(const char* schema, std::string_view message_bytes, const Read& read) {
    try {
        return read(pbf_reader(message_bytes.data(), message_bytes.size()));
    } catch (const protozero::exception& error) {
        fail("the message is not a valid {} in protobuf format: {}", schema, error.what());
    }
}

}  // namespace

BoxListMessage read_foxglove_boxes(std::string_view message_bytes) {
    return parse("foxglove.SceneUpdate", message_bytes, [](pbf_reader reader) {
        BoxListMessage list;
        while (reader.next(2, kLengthDelimited)) add_entity(list, reader.get_message());
        return list;
    });
}

CloudMessage read_foxglove_cloud(std::string_view message_bytes) {
    return parse("foxglove.PointCloud", message_bytes, parse_cloud);
}

FixMessage read_foxglove_fix(std::string_view message_bytes) {
    return parse("foxglove.LocationFix", message_bytes, parse_fix);
}

TransformListMessage read_foxglove_tf(std::string_view message_bytes) {
    return parse("foxglove.FrameTransforms", message_bytes, [](pbf_reader reader) {
        TransformListMessage list;
        while (reader.next(1, kLengthDelimited)) add_transform(list, reader.get_message());
        return list;
    });
}

}  // namespace relidar::bag
