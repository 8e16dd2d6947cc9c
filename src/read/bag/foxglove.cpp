// SPDX-License-Identifier: Apache-2.0
// Reads point clouds, transforms and boxes in Foxglove's protobuf schemas
// (github.com/foxglove/foxglove-sdk/tree/main/schemas/proto). `relidar render --format
// mcap` writes these schemas. A protobuf message is a list of fields, each with a number
// (tag) and a type. The schema defines the meaning of each number.
#include <algorithm>
#include <functional>
#include <utility>

#include <protozero/pbf_reader.hpp>

#include "base/fail.hpp"
#include "read/bag/messages.hpp"

namespace relidar::bag {
namespace {

using protozero::pbf_reader;
using protozero::pbf_wire_type;

/// A field of a message, and the function that reads it.
struct PbfField {
    protozero::pbf_tag_type tag;
    pbf_wire_type type;
    std::function<void(pbf_reader&)> read;
};

/// Reads the given fields of a message. Ignores other fields, and fields of other types.
void read_fields(pbf_reader reader, const std::vector<PbfField>& fields) {
    while (reader.next()) {
        const auto field = std::ranges::find_if(fields, [&](const PbfField& f) {
            return reader.tag_and_type() == protozero::tag_and_type(f.tag, f.type);
        });
        if (field == fields.end()) reader.skip();
        else field->read(reader);
    }
}

// Each of these functions describes a field that is stored in `value`.
PbfField number(unsigned tag, double& value) {
    return {tag, pbf_wire_type::fixed64, [&value](pbf_reader& reader) { value = reader.get_double(); }};
}
PbfField size_number(unsigned tag, std::size_t& value) {
    return {tag, pbf_wire_type::fixed32, [&value](pbf_reader& reader) { value = reader.get_fixed32(); }};
}
PbfField integer(unsigned tag, std::int64_t& value) {
    return {tag, pbf_wire_type::varint, [&value](pbf_reader& reader) { value = reader.get_int64(); }};
}
PbfField text(unsigned tag, std::string& value) {
    return {tag, pbf_wire_type::length_delimited,
            [&value](pbf_reader& reader) { value = reader.get_string(); }};
}
/// Describes a field that contains a message.
/// @param read  reads the message
template <class Read>
PbfField message(unsigned tag, const Read& read) {
    return {tag, pbf_wire_type::length_delimited, [read](pbf_reader& reader) { read(reader.get_message()); }};
}
/// Describes a field that contains a foxglove.Vector3 or foxglove.Quaternion and is
/// stored in `v`. Missing coordinates are 0.
PbfField vector(unsigned tag, glm::dvec4& v) {
    return message(tag, [&v](const pbf_reader& reader) {
        v = glm::dvec4(0.0);
        read_fields(reader, {number(1, v.x), number(2, v.y), number(3, v.z), number(4, v.w)});
    });
}
/// Describes a field that contains a google.protobuf.Timestamp, which consists of seconds
/// and nanoseconds, and is stored in `stamp_ns`. Rejects times that ROS cannot represent.
PbfField stamp(unsigned tag, std::int64_t& stamp_ns) {
    return message(tag, [&stamp_ns](const pbf_reader& reader) {
        std::int64_t seconds = 0, nanoseconds = 0;
        read_fields(reader, {integer(1, seconds), integer(2, nanoseconds)});
        constexpr std::int64_t kMaxRosTime_s = 4294967295;  // limit of ROS times
        constexpr std::int64_t kNsPerSecond = 1000000000;
        if (seconds < 0 || seconds > kMaxRosTime_s)
            fail("found the message time {} s, expected 0 to {} s", seconds, kMaxRosTime_s);
        if (nanoseconds < 0 || nanoseconds >= kNsPerSecond)
            fail("found {} ns in a message time, expected 0 to {} ns", nanoseconds, kNsPerSecond - 1);
        stamp_ns = seconds * kNsPerSecond + nanoseconds;
    });
}

/// Position and quaternion of a pose. A missing part is the identity.
struct PbfPose {
    glm::dvec4 position{0.0}, rotation{0.0, 0.0, 0.0, 1.0};

    PoseComponents components() const {
        return {position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w};
    }
};
/// Describes a field that contains a foxglove.Pose and is stored in `value`.
PbfField pose(unsigned tag, PbfPose& value) {
    return message(tag, [&value](const pbf_reader& reader) {
        read_fields(reader, {vector(1, value.position), vector(2, value.rotation)});
    });
}

/// Reads a foxglove.PackedElementField.
CloudMessage::CloudField parse_field(const pbf_reader& reader) {
    CloudMessage::CloudField field;
    std::int64_t type = 0;
    read_fields(reader, {text(1, field.name), size_number(2, field.offset), integer(3, type)});
    field.set_type(type, {"U1", "I1", "U2", "I2", "U4", "I4", "F4", "F8"});
    return field;
}

/// Reads foxglove.PointCloud. It has no width, so the cloud becomes one row of points.
CloudMessage parse_cloud(const pbf_reader& reader) {
    CloudMessage cloud;
    PbfPose cloud_pose;
    const auto add_field = [&](const pbf_reader& field) { cloud.fields.push_back(parse_field(field)); };
    const auto set_data = [&](pbf_reader& field) {
        const protozero::data_view view = field.get_view();  // not copied
        cloud.data = {view.data(), view.size()};
    };
    read_fields(reader, {stamp(1, cloud.header.stamp_ns),
                         text(2, cloud.header.frame),
                         pose(3, cloud_pose),
                         size_number(4, cloud.point_step),
                         message(5, add_field),
                         {6, pbf_wire_type::length_delimited, set_data}});
    // The vector part of a quaternion is 0 without rotation.
    const double pose_size =
        glm::length(glm::dvec3(cloud_pose.position)) + glm::length(glm::dvec3(cloud_pose.rotation));
    if (!(pose_size <= 1e-9)) fail("the cloud has a pose, expected a pose without translation and rotation");
    cloud.height = 1;
    cloud.width = cloud.point_step == 0 ? 0 : std::uint32_t(cloud.data.size() / cloud.point_step);
    cloud.row_step = cloud.width * cloud.point_step;
    return cloud;
}

/// Reads foxglove.FrameTransform.
void add_transform(TransformListMessage& list, const pbf_reader& reader) {
    TransformMessage transform;
    PbfPose parent_from_child;
    read_fields(reader, {stamp(1, transform.header.stamp_ns), text(2, transform.header.frame),
                         text(3, transform.child), vector(4, parent_from_child.position),
                         vector(5, parent_from_child.rotation)});
    list.add_valid_transform(std::move(transform), parent_from_child.components());
}

/// Reads foxglove.LocationFix.
FixMessage parse_fix(const pbf_reader& reader) {
    FixMessage fix;
    read_fields(reader,
                {number(1, fix.position.latitude_deg), number(2, fix.position.longitude_deg),
                 number(3, fix.position.height_m), stamp(6, fix.header.stamp_ns), text(7, fix.header.frame)});
    return fix;
}

/// Reads a foxglove.SceneEntity, which has a pose, an id and geometric shapes. Adds it as
/// a box if it contains exactly one cube. Several cubes have no common track.
void add_entity(BoxListMessage& box_list, const pbf_reader& reader) {
    BoxMessage box;
    PbfPose box_pose;
    std::size_t n_cubes = 0;
    const auto read_metadata = [&](const pbf_reader& pair) {
        std::string key, value;
        read_fields(pair, {text(1, key), text(2, value)});
        if (key == "category" && !value.empty()) box.category = value;
    };
    const auto read_cube = [&](const pbf_reader& cube) {
        glm::dvec4 size(box.size_m, 0.0);
        read_fields(cube, {pose(1, box_pose), vector(2, size)});
        box.size_m = size;
        ++n_cubes;
    };
    read_fields(reader, {stamp(1, box.header.stamp_ns), text(2, box.header.frame), text(3, box.id),
                         message(6, read_metadata), message(8, read_cube)});
    if (box_list.header.frame.empty()) box_list.header = box.header;
    if (n_cubes == 1) box_list.add_valid_box(std::move(box), box_pose.components());
    else if (n_cubes > 1) ++box_list.n_left_out;
}

/// Returns read(reader of the message).
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
        while (reader.next(2, pbf_wire_type::length_delimited)) add_entity(list, reader.get_message());
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
        while (reader.next(1, pbf_wire_type::length_delimited)) add_transform(list, reader.get_message());
        return list;
    });
}

}  // namespace relidar::bag
