// SPDX-License-Identifier: Apache-2.0
// Parses the messages of Waymo Open 1.4. The field numbers are defined in dataset.proto
// and label.proto. Skips fields with an unexpected wire type, as protobuf skips unknown
// fields.
#include "log/readers/waymo/waymo_frame.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <zlib.h>
#include <protozero/pbf_reader.hpp>

#include <relidar/base/error.hpp>
#include <relidar/log/clouds.hpp>
#include "base/files.hpp"

namespace relidar::waymo {
namespace {

using protozero::pbf_reader;
using protozero::pbf_wire_type;

constexpr std::uint32_t number(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::varint);
}
constexpr std::uint32_t make_message_tag(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::length_delimited);
}
constexpr std::uint32_t make_real_tag(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::fixed64);
}
constexpr std::uint32_t make_single_real_tag(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::fixed32);
}

// Maximum size in bytes of a decompressed image. A six-channel image of TOP has 4 MB.
constexpr std::size_t kMostInflated = std::size_t(32) << 20;
constexpr double kLargestOfFrame = 1e8;  // maximum value of all numbers in a frame (metres or radians)

std::string_view to_string_view(pbf_reader& reader) {
    const protozero::data_view view = reader.get_view();
    return {view.data(), view.size()};
}

double check_finite_number(double value, const char* field, const std::string& location) {
    if (!(std::abs(value) <= kLargestOfFrame))
        throw DataError(fmt::format("{}: {} is {}, expected a finite number of at most {:.0e}", location,
                                    field, value, kLargestOfFrame));
    return value;
}

void append_packed(pbf_reader& reader, std::vector<double>& values) {
    for (const double value : reader.get_packed_double()) values.push_back(value);
}

/// Parses a Transform message: a 4x4 matrix of doubles, row-major.
Pose parse_transform(pbf_reader reader, const std::string& location) {
    std::vector<double> m;
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case make_real_tag(1):
                m.push_back(reader.get_double());
                break;
            case make_message_tag(1):
                append_packed(reader, m);
                break;
            default:
                reader.skip();
        }
    }
    if (m.size() != 16)
        throw DataError(
            fmt::format("{}: found a transform of {} numbers, expected 16 numbers", location, m.size()));
    for (const double value : m) check_finite_number(value, "a number of the transform", location);
    return make_rigid_pose({m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]}, {m[3], m[7], m[11]},
                           location);
}

Calibration parse_calibration(pbf_reader reader, const std::string& location) {
    Calibration calibration;
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case number(1):
                calibration.laser = reader.get_enum();
                break;
            case make_real_tag(2):
                calibration.inclination_rad.push_back(reader.get_double());
                break;
            case make_message_tag(2):
                append_packed(reader, calibration.inclination_rad);
                break;
            case make_real_tag(3):
                calibration.min_inclination_rad = reader.get_double();
                break;
            case make_real_tag(4):
                calibration.max_inclination_rad = reader.get_double();
                break;
            case make_message_tag(5):
                calibration.vehicle_from_laser =
                    parse_transform(reader.get_message(), location + ", extrinsic");
                break;
            default:
                reader.skip();
        }
    }
    return calibration;
}

void parse_context(pbf_reader reader, FrameRecord& frame, const std::string& location) {
    while (reader.next()) {
        if (reader.tag_and_type() == make_message_tag(3))
            frame.lasers.push_back(
                parse_calibration(reader.get_message(), location + ": laser_calibrations"));
        else reader.skip();
    }
}

/// Compressed images of a RangeImage message: the range image, the vehicle poses of its
/// pixels, and their labels.
struct ReturnImages {
    std::string_view image, pixel_pose, labels;
};

ReturnImages parse_range_image(pbf_reader reader) {
    ReturnImages images;
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case make_message_tag(2):
                images.image = to_string_view(reader);
                break;
            case make_message_tag(4):
                images.pixel_pose = to_string_view(reader);
                break;
            case make_message_tag(6):
                images.labels = to_string_view(reader);
                break;
            default:
                reader.skip();
        }
    }
    return images;
}

LaserImages parse_laser(pbf_reader reader) {
    LaserImages laser;
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case number(1):
                laser.laser = reader.get_enum();
                break;
            case make_message_tag(2): {
                const ReturnImages first = parse_range_image(reader.get_message());
                laser.first = first.image, laser.pixel_pose = first.pixel_pose, laser.labels = first.labels;
                break;
            }
            case make_message_tag(3):
                laser.second = parse_range_image(reader.get_message()).image;
                break;
            default:
                reader.skip();
        }
    }
    return laser;
}

/// Parses a Box message, whose fields are centre, width, length, height and heading.
void parse_box(pbf_reader reader, BoxLabel& label, const std::string& location) {
    double v[8] = {};
    while (reader.next()) {
        if (reader.tag() >= 1 && reader.tag() <= 7 && reader.wire_type() == pbf_wire_type::fixed64) {
            const std::uint32_t field = reader.tag();
            v[field] = check_finite_number(reader.get_double(), "a number of the box", location);
        } else {
            reader.skip();
        }
    }
    label.size_m = {v[5], v[4], v[6]};
    label.world_from_box = {glm::angleAxis(v[7], glm::dvec3(0, 0, 1)), {v[1], v[2], v[3]}};
}

/// Returns the category of an object, or null for signs, which cannot move and belong to
/// the background.
const char* get_category(int type) {
    constexpr int kVehicle = 1, kPedestrian = 2, kCyclist = 4;
    return type == kVehicle      ? "vehicle"
           : type == kPedestrian ? "pedestrian"
           : type == kCyclist    ? "cyclist"
                                 : nullptr;
}

void parse_label(pbf_reader reader, FrameRecord& frame, const std::string& location) {
    BoxLabel label;
    int type = 0;
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case make_message_tag(1):
                parse_box(reader.get_message(), label, location);
                break;
            case number(3):
                type = reader.get_enum();
                break;
            case make_message_tag(4):
                label.id = reader.get_string();
                break;
            default:
                reader.skip();
        }
    }
    const char* category = get_category(type);
    if (!category) return;
    label.category = category;
    if (label.id.empty() || !(std::min({label.size_m.x, label.size_m.y, label.size_m.z}) > 0.0))
        throw DataError(fmt::format(
            "{}: found a {} with id '{}' and size {} x {} x {} m, expected an id and three lengths "
            "above 0",
            location, category, make_excerpt(label.id), label.size_m.x, label.size_m.y, label.size_m.z));
    frame.labels.push_back(std::move(label));
}

/// Parses a MatrixFloat or MatrixInt32 message, which contains values and dimensions.
void parse_matrix(pbf_reader reader, PixelType type, std::vector<float>& values,
                  std::vector<std::int32_t>& dims) {
    while (reader.next()) {
        switch (reader.tag_and_type()) {
            case make_single_real_tag(1):
                values.push_back(reader.get_float());
                break;
            case number(1):
                if (type == PixelType::integer) values.push_back(float(reader.get_int32()));
                else reader.skip();
                break;
            case make_message_tag(1):
                if (type == PixelType::real)
                    for (const float value : reader.get_packed_float()) values.push_back(value);
                else
                    for (const std::int32_t value : reader.get_packed_int32()) values.push_back(float(value));
                break;
            case make_message_tag(2):
                for (pbf_reader shape = reader.get_message(); shape.next();) {
                    if (shape.tag_and_type() == number(1)) dims.push_back(shape.get_int32());
                    else if (shape.tag_and_type() == make_message_tag(1)) {
                        for (const std::int32_t dim : shape.get_packed_int32()) dims.push_back(dim);
                    } else shape.skip();
                }
                break;
            default:
                reader.skip();
        }
    }
}

std::string inflate(std::string_view packed, const std::string& location) {
    z_stream stream{};
    if (inflateInit(&stream) != Z_OK) throw std::bad_alloc();
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
    stream.avail_in = static_cast<uInt>(std::min<std::size_t>(packed.size(), UINT32_MAX));
    std::string bytes;
    int status = Z_OK;
    while (status == Z_OK && bytes.size() <= kMostInflated) {
        const std::size_t have = bytes.size();
        bytes.resize(std::min(std::max(2 * have, 4 * packed.size() + 64), kMostInflated + 1));
        stream.next_out = reinterpret_cast<Bytef*>(&bytes[have]);
        stream.avail_out = static_cast<uInt>(bytes.size() - have);
        status = ::inflate(&stream, Z_NO_FLUSH);
        bytes.resize(bytes.size() - stream.avail_out);
    }
    inflateEnd(&stream);
    if (bytes.size() > kMostInflated)
        throw DataError(fmt::format("{}: a zlib stream unpacks to more than {} bytes, expected a range image",
                                    location, kMostInflated));
    if (status != Z_STREAM_END)
        throw DataError(fmt::format("{}: a zlib stream of {} bytes is damaged", location, bytes.size()));
    return bytes;
}

/// Calls a function that parses protobuf, and converts exceptions of the library
/// protozero to DataError.
template <class Parse>
auto parse_with_context(const std::string& location, const Parse& parse) {
    try {
        return parse();
    } catch (const protozero::exception& failure) {
        throw DataError(fmt::format("{}: malformed protobuf: {}", location, failure.what()));
    }
}

}  // namespace

FrameRecord parse_frame(std::string_view record, const std::string& location) {
    FrameRecord frame;
    bool has_pose = false;
    parse_with_context(location, [&] {
        for (pbf_reader from(record.data(), record.size()); from.next();) {
            switch (from.tag_and_type()) {
                case make_message_tag(1):
                    parse_context(from.get_message(), frame, location);
                    break;
                case number(2):
                    frame.timestamp_us = from.get_int64();
                    break;
                case make_message_tag(3):
                    frame.world_from_vehicle = parse_transform(from.get_message(), location + ": pose"),
                    has_pose = true;
                    break;
                case make_message_tag(5):
                    frame.images.push_back(parse_laser(from.get_message()));
                    break;
                case make_message_tag(6):
                    parse_label(from.get_message(), frame, location + ": laser_labels");
                    break;
                default:
                    from.skip();
            }
        }
    });
    if (!has_pose)
        throw DataError(fmt::format("{}: the pose is missing, expected a Frame of Waymo Open", location));
    const auto by_laser = [](const auto& first, const auto& second) { return first.laser < second.laser; };
    std::stable_sort(frame.lasers.begin(), frame.lasers.end(), by_laser);
    std::stable_sort(frame.images.begin(), frame.images.end(), by_laser);
    return frame;
}

Image inflate_image(std::string_view packed, int channels, const std::string& location, PixelType type) {
    constexpr int kMostRows = 1024, kMostColumns = 8192;
    Image image;
    std::vector<std::int32_t> dims;
    const std::string bytes = inflate(packed, location);
    parse_with_context(
        location, [&] { parse_matrix(pbf_reader(bytes.data(), bytes.size()), type, image.values, dims); });
    const bool fits =
        dims.size() == 3 && dims[0] >= 1 && dims[0] <= kMostRows && dims[1] >= 1 && dims[1] <= kMostColumns &&
        dims[2] == channels &&
        image.values.size() == std::size_t(dims[0]) * std::size_t(dims[1]) * std::size_t(channels);
    if (!fits)
        throw DataError(fmt::format(
            "{}: found {} values in {} dimensions{}, expected rows x columns x {} values", location,
            image.values.size(), dims.size(),
            dims.size() == 3 ? fmt::format(" {} x {} x {}", dims[0], dims[1], dims[2]) : "", channels));
    image.rows = dims[0];
    image.columns = dims[1];
    image.channels = channels;
    return image;
}

std::vector<double> compute_row_elevations(const Calibration& calibration, int rows,
                                           const std::string& location) {
    std::vector<double> elevations = calibration.inclination_rad;
    const double low = calibration.min_inclination_rad, high = calibration.max_inclination_rad;
    if (elevations.empty())
        for (int k = 0; k < rows; ++k) elevations.push_back(low + (k + 0.5) / rows * (high - low));
    if (elevations.size() != std::size_t(rows))
        throw DataError(
            fmt::format("{}: found {} beam_inclinations for laser {} with {} rows, expected one per row",
                        location, elevations.size(), calibration.laser, rows));
    for (const double elevation : elevations)
        if (!(std::abs(elevation) <= kPi / 2))
            throw DataError(fmt::format(
                "{}: a beam inclination is {} for laser {}, expected radians between -pi/2 and pi/2",
                location, elevation, calibration.laser));
    std::reverse(elevations.begin(), elevations.end());
    return elevations;
}

}  // namespace relidar::waymo
