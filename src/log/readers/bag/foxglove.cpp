// SPDX-License-Identifier: Apache-2.0
// Reads point clouds, transforms and boxes in Foxglove's protobuf schemas. `relidar
// render --format mcap` writes these schemas.
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <protozero/pbf_reader.hpp>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/readers/bag/messages.hpp"

namespace relidar::bag {
namespace {

using protozero::pbf_reader;
using protozero::pbf_wire_type;
using protozero::tag_and_type;

constexpr auto kBytes = pbf_wire_type::length_delimited, kFixed32 = pbf_wire_type::fixed32,
               kVarint = pbf_wire_type::varint;

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

std::int64_t read_timestamp_ns(pbf_reader reader) {
    std::int64_t seconds = 0, nanoseconds = 0;
    while (reader.next()) {
        if (reader.tag_and_type() == tag_and_type(1, kVarint)) seconds = reader.get_int64();
        else if (reader.tag_and_type() == tag_and_type(2, kVarint)) nanoseconds = reader.get_int32();
        else reader.skip();
    }
    constexpr std::int64_t kLatest_s = 4294967295;  // limit of ROS times
    if (seconds < 0 || seconds > kLatest_s)
        fail("found the message time {} s, expected 0 to {} s", seconds, kLatest_s);
    return seconds * 1000000000 + nanoseconds;
}

PoseComponents make_pose_components(const glm::dvec4& position, const glm::dvec4& quaternion_xyzw) {
    const glm::dvec4& q = quaternion_xyzw;
    return {position.x, position.y, position.z, q.x, q.y, q.z, q.w};
}

CloudMessage::CloudField read_foxglove_point_field(pbf_reader reader) {
    struct Type {
        char kind;
        std::size_t size;
    };
    // Kind (unsigned, signed, floating) and size in bytes of Foxglove's numeric types 1
    // to 8.
    static constexpr Type kTypes[] = {{'U', 1}, {'I', 1}, {'U', 2}, {'I', 2},
                                      {'U', 4}, {'I', 4}, {'F', 4}, {'F', 8}};
    CloudMessage::CloudField field;
    std::int32_t type = 0;
    while (reader.next()) {
        if (reader.tag_and_type() == tag_and_type(1, kBytes)) field.name = reader.get_string();
        else if (reader.tag_and_type() == tag_and_type(2, kFixed32)) field.offset = reader.get_fixed32();
        else if (reader.tag_and_type() == tag_and_type(3, kVarint)) type = reader.get_enum();
        else reader.skip();
    }
    if (type < 1 || type > 8)
        fail(
            "the field '{}' of the cloud has the data type {}, expected a number from 1 to 8 as defined in "
            "foxglove.PackedElementField",
            shorten_for_error_message(field.name), type);
    field.kind = kTypes[type - 1].kind;
    field.size = kTypes[type - 1].size;
    return field;
}

/// Throws if a cloud has a pose other than the identity. The reader does not support such
/// clouds.
void require_identity_pose(pbf_reader reader) {
    while (reader.next()) {
        if (reader.tag() > 2 || reader.wire_type() != kBytes) {
            reader.skip();
            continue;
        }
        const bool turns = reader.tag() == 2;
        const glm::dvec4 v = read_xyzw(reader.get_message());
        if (!(glm::length(glm::dvec3(v)) <= 1e-9))
            fail("the cloud has a pose with a {}, expected a pose without translation and rotation",
                 turns ? "rotation" : "translation");
    }
}

CloudMessage parse_foxglove_cloud_message(std::string_view message_bytes) {
    CloudMessage cloud;
    pbf_reader reader(message_bytes.data(), message_bytes.size());
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case tag_and_type(1, kBytes):
                cloud.header.stamp_ns = read_timestamp_ns(reader.get_message());
                break;
            case tag_and_type(2, kBytes):
                cloud.header.frame = reader.get_string();
                break;
            case tag_and_type(3, kBytes):
                require_identity_pose(reader.get_message());
                break;
            case tag_and_type(4, kFixed32):
                cloud.point_step = reader.get_fixed32();
                break;
            case tag_and_type(5, kBytes):
                cloud.fields.push_back(read_foxglove_point_field(reader.get_message()));
                break;
            case tag_and_type(6, kBytes): {
                const protozero::data_view view = reader.get_view();
                cloud.data = {view.data(), view.size()};
                break;
            }
            default:
                reader.skip();
        }
    }
    cloud.height = 1;
    cloud.width = cloud.point_step == 0 ? 0 : std::uint32_t(cloud.data.size() / cloud.point_step);
    cloud.row_step = cloud.width * cloud.point_step;
    return cloud;
}

void add_frame_transform(TransformListMessage& list, pbf_reader reader) {
    TransformMessage transform;
    glm::dvec4 translation(0.0), rotation(0.0, 0.0, 0.0, 1.0);
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case tag_and_type(1, kBytes):
                transform.header.stamp_ns = read_timestamp_ns(reader.get_message());
                break;
            case tag_and_type(2, kBytes):
                transform.header.frame = reader.get_string();
                break;
            case tag_and_type(3, kBytes):
                transform.child = reader.get_string();
                break;
            case tag_and_type(4, kBytes):
                translation = read_xyzw(reader.get_message());
                break;
            case tag_and_type(5, kBytes):
                rotation = read_xyzw(reader.get_message());
                break;
            default:
                reader.skip();
        }
    }
    list.add_if_valid(std::move(transform), make_pose_components(translation, rotation));
}

/// Pose and size of a foxglove.CubePrimitive.
struct FoxgloveCube {
    glm::dvec4 position{0.0}, rotation{0.0, 0.0, 0.0, 1.0};
    glm::dvec3 size_m{0.0};
};

FoxgloveCube read_cube(pbf_reader reader) {
    FoxgloveCube cube;
    while (reader.next()) {
        if (reader.tag_and_type() == tag_and_type(1, kBytes)) {
            pbf_reader pose = reader.get_message();
            while (pose.next()) {
                if (pose.tag_and_type() == tag_and_type(1, kBytes))
                    cube.position = read_xyzw(pose.get_message());
                else if (pose.tag_and_type() == tag_and_type(2, kBytes))
                    cube.rotation = read_xyzw(pose.get_message());
                else pose.skip();
            }
        } else if (reader.tag_and_type() == tag_and_type(2, kBytes)) {
            cube.size_m = read_xyzw(reader.get_message());
        } else {
            reader.skip();
        }
    }
    return cube;
}

/// Reads a foxglove.KeyValuePair. Returns its value if it has the expected key, otherwise
/// an empty string.
std::string read_value_if_key_matches(pbf_reader reader, std::string_view expected_key) {
    std::string key, value;
    while (reader.next()) {
        if (reader.tag_and_type() == tag_and_type(1, kBytes)) key = reader.get_string();
        else if (reader.tag_and_type() == tag_and_type(2, kBytes)) value = reader.get_string();
        else reader.skip();
    }
    return key == expected_key ? value : "";
}

/// Reads a scene entity. An entity that consists of exactly one cube is added to the list
/// as a box.
void add_box_from_scene_entity(BoxListMessage& box_list, pbf_reader reader) {
    BoxMessage box;
    std::vector<FoxgloveCube> cubes;
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case tag_and_type(1, kBytes):
                box.header.stamp_ns = read_timestamp_ns(reader.get_message());
                break;
            case tag_and_type(2, kBytes):
                box.header.frame = reader.get_string();
                break;
            case tag_and_type(3, kBytes):
                box.id = reader.get_string();
                break;
            case tag_and_type(6, kBytes):
                if (const std::string category = read_value_if_key_matches(reader.get_message(), "category");
                    !category.empty())
                    box.category = category;
                break;
            case tag_and_type(8, kBytes):
                cubes.push_back(read_cube(reader.get_message()));
                break;
            default:
                reader.skip();
        }
    }
    if (box_list.header.frame.empty()) box_list.header = box.header;
    if (cubes.empty()) return;
    const glm::dvec3& size = cubes.front().size_m;
    const bool is_box = cubes.size() == 1 && std::isfinite(size.x + size.y + size.z) && size.x > 0.0 &&
                        size.y > 0.0 && size.z > 0.0;
    box.size_m = size;
    try {
        box.frame_from_box = make_pose(make_pose_components(cubes.front().position, cubes.front().rotation));
        if (is_box) box_list.boxes.push_back(std::move(box));
        else ++box_list.n_left_out;
    } catch (const DataError&) {
        ++box_list.n_left_out;
    }
}

}  // namespace

BoxListMessage read_foxglove_boxes(std::string_view message_bytes) {
    try {
        BoxListMessage list;
        pbf_reader reader(message_bytes.data(), message_bytes.size());
        while (reader.next(2, protozero::pbf_wire_type::length_delimited))
            add_box_from_scene_entity(list, reader.get_message());
        return list;
    } catch (const protozero::exception& error) {
        fail("the message is not a valid foxglove.SceneUpdate in protobuf format: {}", error.what());
    }
}

CloudMessage read_foxglove_cloud(std::string_view message_bytes) {
    try {
        return parse_foxglove_cloud_message(message_bytes);
    } catch (const protozero::exception& error) {
        fail("the message is not a valid foxglove.PointCloud in protobuf format: {}", error.what());
    }
}

TransformListMessage read_foxglove_transforms(std::string_view message_bytes) {
    try {
        TransformListMessage list;
        pbf_reader reader(message_bytes.data(), message_bytes.size());
        while (reader.next(1, protozero::pbf_wire_type::length_delimited))
            add_frame_transform(list, reader.get_message());
        return list;
    } catch (const protozero::exception& error) {
        fail("the message is not a valid foxglove.FrameTransforms in protobuf format: {}", error.what());
    }
}

}  // namespace relidar::bag
