// SPDX-License-Identifier: Apache-2.0
// Parses the messages of Waymo Open 1.4. The field numbers are defined in dataset.proto
// and label.proto. Skips fields with an unexpected wire type, because protobuf also skips
// unknown fields.
#include "read/datasets/waymo/waymo_frame.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <zlib.h>
#include <protozero/pbf_reader.hpp>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"

namespace relidar::waymo {
namespace {

using protozero::pbf_reader;
using protozero::pbf_wire_type;

constexpr std::uint32_t make_varint_tag(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::varint);
}
constexpr std::uint32_t message_tag(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::length_delimited);
}
constexpr std::uint32_t make_double_tag(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::fixed64);
}
constexpr std::uint32_t make_float_tag(std::uint32_t field) {
    return protozero::tag_and_type(field, pbf_wire_type::fixed32);
}

// bytes; six channels of TOP have 4 MB
constexpr std::size_t kMostInflated = std::size_t(32) << 20;

std::string_view read_bytes(pbf_reader& reader) {
    const protozero::data_view view = reader.get_view();
    return {view.data(), view.size()};
}

void append_doubles(pbf_reader& reader, std::vector<double>& values) {
    for (const double value : reader.get_packed_double()) values.push_back(value);
}

/// Parses a 4x4 matrix of doubles, row-major.
Pose parse_transform(pbf_reader reader, const std::string& where) {
    std::vector<double> m;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == make_double_tag(1)) m.push_back(reader.get_double());
        else if (tag == message_tag(1)) append_doubles(reader, m);
        else reader.skip();
    }
    if (m.size() != 16) fail("{}: found a transform of {} numbers, expected 16 numbers", where, m.size());
    return make_pose(m, where);
}

/// Accepts packed and unpacked inclinations, because writers of protobuf may choose.
LaserCalibration parse_calibration(pbf_reader reader, const std::string& where) {
    LaserCalibration calibration;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == make_varint_tag(1)) calibration.laser = reader.get_enum();
        else if (tag == make_double_tag(2)) calibration.inclination_rad.push_back(reader.get_double());
        else if (tag == message_tag(2)) append_doubles(reader, calibration.inclination_rad);
        else if (tag == make_double_tag(3)) calibration.min_inclination_rad = reader.get_double();
        else if (tag == make_double_tag(4)) calibration.max_inclination_rad = reader.get_double();
        else if (tag == message_tag(5))
            calibration.vehicle_from_laser = parse_transform(reader.get_message(), where + ", extrinsic");
        else reader.skip();
    }
    return calibration;
}

void parse_calibrations(pbf_reader reader, SegmentFrame& frame_record, const std::string& where) {
    while (reader.next())
        if (reader.tag_and_type() == message_tag(3))
            frame_record.lasers.push_back(
                parse_calibration(reader.get_message(), where + ": laser_calibrations"));
        else reader.skip();
}

/// Parses the image of returns, the poses of its pixels, and their labels.
void parse_return_images(pbf_reader reader, LaserImages& laser) {
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == message_tag(2)) laser.first = read_bytes(reader);
        else if (tag == message_tag(4)) laser.pixel_pose = read_bytes(reader);
        else if (tag == message_tag(6)) laser.labels = read_bytes(reader);
        else reader.skip();
    }
}

/// Both returns are messages of one type. Only the ranges of the second return are used.
LaserImages parse_laser(pbf_reader reader) {
    LaserImages laser, second;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == make_varint_tag(1)) laser.laser = reader.get_enum();
        else if (tag == message_tag(2)) parse_return_images(reader.get_message(), laser);
        else if (tag == message_tag(3)) parse_return_images(reader.get_message(), second);
        else reader.skip();
    }
    laser.second = second.first;
    return laser;
}

/// Parses centre, width, length, height and heading of a box. Their field numbers are 1
/// to 7.
void parse_box(pbf_reader reader, BoxLabel& label) {
    double v[8] = {};
    while (reader.next()) {
        const std::uint32_t field = reader.tag();
        if (field >= 1 && field <= 7 && reader.wire_type() == pbf_wire_type::fixed64)
            v[field] = reader.get_double();
        else reader.skip();
    }
    label.size_m = {v[5], v[4], v[6]};
    label.world_from_box = {glm::angleAxis(v[7], glm::dvec3(0, 0, 1)), {v[1], v[2], v[3]}};
}

/// Parses a labelled object. Ignores signs, which belong to the background.
void parse_label(pbf_reader reader, SegmentFrame& frame_record) {
    BoxLabel label;
    int type = 0;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == message_tag(1)) parse_box(reader.get_message(), label);
        else if (tag == make_varint_tag(3)) type = reader.get_enum();
        else if (tag == message_tag(4)) label.id = reader.get_string();
        else reader.skip();
    }
    constexpr int kVehicleType = 1, kPedestrianType = 2, kCyclistType = 4;
    if (type == kVehicleType) label.category = "vehicle";
    else if (type == kPedestrianType) label.category = "pedestrian";
    else if (type == kCyclistType) label.category = "cyclist";
    else return;  // a sign, which belongs to the background because it cannot move
    frame_record.labels.push_back(std::move(label));
}

/// Parses a message of the type MatrixFloat or MatrixInt32. It contains values and
/// dimensions.
void parse_matrix(pbf_reader reader, PixelType pixel_type, std::vector<float>& values,
                  std::vector<std::int32_t>& dimensions) {
    const bool is_integer = pixel_type == PixelType::integer;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == make_float_tag(1)) values.push_back(reader.get_float());
        else if (tag == make_varint_tag(1) && is_integer) values.push_back(float(reader.get_int32()));
        else if (tag == message_tag(1) && is_integer)
            for (const std::int32_t value : reader.get_packed_int32()) values.push_back(float(value));
        else if (tag == message_tag(1))
            for (const float value : reader.get_packed_float()) values.push_back(value);
        else if (tag == message_tag(2))
            for (pbf_reader shape = reader.get_message(); shape.next();) {
                const std::uint32_t kind = shape.tag_and_type();
                if (kind == make_varint_tag(1)) dimensions.push_back(shape.get_int32());
                else if (kind == message_tag(1))
                    for (const std::int32_t dim : shape.get_packed_int32()) dimensions.push_back(dim);
                else shape.skip();
            }
        else reader.skip();
    }
}

/// Decompresses a zlib stream of unknown size. Doubles the output until it fits, up to
/// kMostInflated bytes.
std::string inflate_zlib(std::string_view compressed_bytes, const std::string& where) {
    z_stream stream{};
    if (inflateInit(&stream) != Z_OK) throw std::bad_alloc();
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(compressed_bytes.data()));
    stream.avail_in = static_cast<uInt>(std::min<std::size_t>(compressed_bytes.size(), UINT32_MAX));
    std::string bytes;
    int status = Z_OK;
    while (status == Z_OK && bytes.size() <= kMostInflated) {
        const std::size_t have = bytes.size();
        bytes.resize(std::min(std::max(2 * have, 4 * compressed_bytes.size() + 64), kMostInflated + 1));
        stream.next_out = reinterpret_cast<Bytef*>(&bytes[have]);
        stream.avail_out = static_cast<uInt>(bytes.size() - have);
        status = ::inflate(&stream, Z_NO_FLUSH);
        bytes.resize(bytes.size() - stream.avail_out);
    }
    inflateEnd(&stream);
    if (bytes.size() > kMostInflated)
        fail("{}: a zlib stream unpacks to more than {} bytes, expected a range image", where, kMostInflated);
    if (status != Z_STREAM_END) fail("{}: a zlib stream of {} bytes is damaged", where, bytes.size());
    return bytes;
}

/// Calls a function that parses protobuf. Converts exceptions of the library protozero to
/// DataError.
template <class Parse>
auto guard_parse(const std::string& where, const Parse& parse_function) {
    try {
        return parse_function();
    } catch (const protozero::exception& failure) {
        fail("{}: malformed protobuf: {}", where, failure.what());
    }
}

}  // namespace

SegmentFrame parse_frame(std::string_view record_bytes, const std::string& where) {
    SegmentFrame frame;
    bool has_pose = false;
    // Field numbers of Waymo's message Frame: 1 context (calibrations), 2 time stamp, 3
    // pose, 5 lasers (range images), 6 laser labels.
    guard_parse(where, [&] {
        for (pbf_reader from(record_bytes.data(), record_bytes.size()); from.next();) {
            const std::uint32_t tag = from.tag_and_type();
            if (tag == message_tag(1)) parse_calibrations(from.get_message(), frame, where);
            else if (tag == make_varint_tag(2)) frame.timestamp_us = from.get_int64();
            else if (tag == message_tag(3)) {
                frame.world_from_vehicle = parse_transform(from.get_message(), where + ": pose");
                has_pose = true;
            } else if (tag == message_tag(5)) frame.images.push_back(parse_laser(from.get_message()));
            else if (tag == message_tag(6)) parse_label(from.get_message(), frame);
            else from.skip();
        }
    });
    if (!has_pose)
        fail(
            "{}: the pose of the vehicle is missing, expected a frame of the Waymo Open Dataset, which has "
            "one",
            where);
    const auto by_laser = [](const auto& first, const auto& second) { return first.laser < second.laser; };
    std::stable_sort(frame.lasers.begin(), frame.lasers.end(), by_laser);
    std::stable_sort(frame.images.begin(), frame.images.end(), by_laser);
    return frame;
}

InflatedImage inflate_image(std::string_view compressed_image, int n_channels, const std::string& where,
                            PixelType pixel_type) {
    constexpr int kMostRows = 1024, kMostColumns = 8192;
    InflatedImage image;
    std::vector<std::int32_t> dims;
    const std::string bytes = inflate_zlib(compressed_image, where);
    guard_parse(
        where, [&] { parse_matrix(pbf_reader(bytes.data(), bytes.size()), pixel_type, image.values, dims); });
    const bool fits =
        dims.size() == 3 && dims[0] >= 1 && dims[0] <= kMostRows && dims[1] >= 1 && dims[1] <= kMostColumns &&
        dims[2] == n_channels &&
        image.values.size() == std::size_t(dims[0]) * std::size_t(dims[1]) * std::size_t(n_channels);
    if (!fits)
        fail(
            "{}: found an image with {} values and {} dimensions{}; expected rows x columns x {} values, "
            "with at most {} rows and {} columns",
            where, image.values.size(), dims.size(),
            dims.size() == 3 ? fmt::format(" ({} x {} x {})", dims[0], dims[1], dims[2]) : "", n_channels,
            kMostRows, kMostColumns);
    image.rows = dims[0];
    image.columns = dims[1];
    image.channels = n_channels;
    return image;
}

std::vector<double> row_elevations_rad(const LaserCalibration& calibration, int n_rows,
                                       const std::string& where) {
    std::vector<double> elevations = calibration.inclination_rad;
    const double low = calibration.min_inclination_rad, high = calibration.max_inclination_rad;
    // Without a list, each row is at the centre of one of n_rows equal intervals.
    if (elevations.empty())
        for (int k = 0; k < n_rows; ++k) elevations.push_back(low + (k + 0.5) / n_rows * (high - low));
    if (elevations.size() != std::size_t(n_rows))
        fail("{}: found {} beam_inclinations for laser {} with {} rows, expected one per row", where,
             elevations.size(), calibration.laser, n_rows);
    // Inclinations start with the lowest row, but image rows start with the highest.
    std::reverse(elevations.begin(), elevations.end());
    return elevations;
}

}  // namespace relidar::waymo
