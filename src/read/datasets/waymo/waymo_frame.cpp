// SPDX-License-Identifier: Apache-2.0
// Parses the messages of Waymo Open 1.4, which dataset.proto and label.proto define. A
// message is a list of fields. Each field is a tag and a value. The tag contains the
// number of the field in the .proto file and the encoding of its value (wire type). Skips
// fields with an unexpected wire type, because protobuf also skips unknown fields.
#include "read/datasets/waymo/waymo_frame.hpp"

#include <algorithm>

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

/// Tag of a field with an integer or an enumerator.
constexpr std::uint32_t integer_tag(std::uint32_t field_number) {
    return protozero::tag_and_type(field_number, pbf_wire_type::varint);
}
/// Tag of a field with a message, a text, bytes, or a packed list of numbers.
constexpr std::uint32_t message_tag(std::uint32_t field_number) {
    return protozero::tag_and_type(field_number, pbf_wire_type::length_delimited);
}
constexpr std::uint32_t double_tag(std::uint32_t field_number) {
    return protozero::tag_and_type(field_number, pbf_wire_type::fixed64);
}
constexpr std::uint32_t float_tag(std::uint32_t field_number) {
    return protozero::tag_and_type(field_number, pbf_wire_type::fixed32);
}

// The largest image has 4 MB. A damaged stream must not use up the memory.
constexpr std::size_t kMaxInflatedBytes = std::size_t(32) << 20;

std::string_view read_bytes(pbf_reader& reader) {
    const protozero::data_view view = reader.get_view();
    return {view.data(), view.size()};
}

void append_doubles(pbf_reader& reader, std::vector<double>& values) {
    for (const double value : reader.get_packed_double()) values.push_back(value);
}

/// Parses a message Transform: a 4x4 matrix of doubles, row-major.
Pose parse_transform(pbf_reader reader, const std::string& where) {
    constexpr std::uint32_t kNumber = double_tag(1), kPackedNumbers = message_tag(1);
    std::vector<double> m;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == kNumber) m.push_back(reader.get_double());
        else if (tag == kPackedNumbers) append_doubles(reader, m);
        else reader.skip();
    }
    if (m.size() != 16) fail("{}: found a transform of {} numbers, expected 16 numbers", where, m.size());
    return make_pose(m, where);
}

/// Parses a message LaserCalibration: the beam elevations (inclinations) of a LiDAR and
/// its pose on the vehicle. The list of inclinations is either packed into one field, or
/// has a field for each number, because protobuf allows both.
LaserCalibration parse_calibration(pbf_reader reader, const std::string& where) {
    // A tag is the number of the field in Waymo's dataset.proto, and its encoding.
    constexpr std::uint32_t kLaserName = integer_tag(1), kInclination = double_tag(2),
                            kPackedInclinations = message_tag(2), kMinInclination = double_tag(3),
                            kMaxInclination = double_tag(4), kExtrinsic = message_tag(5);
    LaserCalibration calibration;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == kLaserName) calibration.laser = reader.get_enum();
        else if (tag == kInclination) calibration.inclination_rad.push_back(reader.get_double());
        else if (tag == kPackedInclinations) append_doubles(reader, calibration.inclination_rad);
        else if (tag == kMinInclination) calibration.min_inclination_rad = reader.get_double();
        else if (tag == kMaxInclination) calibration.max_inclination_rad = reader.get_double();
        else if (tag == kExtrinsic)
            calibration.vehicle_from_laser = parse_transform(reader.get_message(), where + ", extrinsic");
        else reader.skip();
    }
    return calibration;
}

/// Parses the calibrations of all LiDARs from a message Context.
void parse_calibrations(pbf_reader reader, SegmentFrame& frame_record, const std::string& where) {
    constexpr std::uint32_t kLaserCalibrations = message_tag(3);
    while (reader.next())
        if (reader.tag_and_type() == kLaserCalibrations)
            frame_record.lasers.push_back(
                parse_calibration(reader.get_message(), where + ": laser_calibrations"));
        else reader.skip();
}

/// Parses a message RangeImage: three compressed images with the returns, the vehicle
/// pose of each pixel, and the label of each pixel. The images stay compressed here.
void parse_return_images(pbf_reader reader, LaserImages& laser) {
    constexpr std::uint32_t kReturns = message_tag(2), kPixelPoses = message_tag(4),
                            kPixelLabels = message_tag(6);
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == kReturns) laser.first = read_bytes(reader);
        else if (tag == kPixelPoses) laser.pixel_pose = read_bytes(reader);
        else if (tag == kPixelLabels) laser.labels = read_bytes(reader);
        else reader.skip();
    }
}

/// Parses a message Laser: the images of a LiDAR in one frame. First and second returns
/// have messages of the same type. Poses and labels of the second message are ignored,
/// because both returns share the pixels of the first.
LaserImages parse_laser(pbf_reader reader) {
    constexpr std::uint32_t kLaserName = integer_tag(1), kFirstReturn = message_tag(2),
                            kSecondReturn = message_tag(3);
    LaserImages laser, second;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == kLaserName) laser.laser = reader.get_enum();
        else if (tag == kFirstReturn) parse_return_images(reader.get_message(), laser);
        else if (tag == kSecondReturn) parse_return_images(reader.get_message(), second);
        else reader.skip();
    }
    laser.second = second.first;
    return laser;
}

/// Parses a message Box, whose fields are doubles with the numbers of `BoxField`. The
/// heading is an angle about z in radians.
void parse_box(pbf_reader reader, BoxLabel& label) {
    enum BoxField : std::uint32_t { kX = 1, kY, kZ, kWidth, kLength, kHeight, kHeading, kEnd };
    double value[kEnd] = {};
    while (reader.next()) {
        const std::uint32_t field = reader.tag();
        const bool is_box_field = field >= kX && field < kEnd;
        if (is_box_field && reader.wire_type() == pbf_wire_type::fixed64) value[field] = reader.get_double();
        else reader.skip();
    }
    label.size_m = {value[kLength], value[kWidth], value[kHeight]};
    label.world_from_box = {glm::angleAxis(value[kHeading], glm::dvec3(0, 0, 1)),
                            {value[kX], value[kY], value[kZ]}};
}

/// Parses a message Label: a labelled object with box, type and track id. Ignores signs,
/// which belong to the background because they cannot move.
void parse_label(pbf_reader reader, SegmentFrame& frame_record) {
    constexpr std::uint32_t kBox = message_tag(1), kType = integer_tag(3), kTrackId = message_tag(4);
    BoxLabel label;
    int type = 0;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == kBox) parse_box(reader.get_message(), label);
        else if (tag == kType) type = reader.get_enum();
        else if (tag == kTrackId) label.id = reader.get_string();
        else reader.skip();
    }
    constexpr int kVehicleType = 1, kPedestrianType = 2, kCyclistType = 4;
    if (type == kVehicleType) label.category = "vehicle";
    else if (type == kPedestrianType) label.category = "pedestrian";
    else if (type == kCyclistType) label.category = "cyclist";
    else return;  // a sign
    frame_record.labels.push_back(std::move(label));
}

/// Parses a message MatrixShape: the lengths of the dimensions of an image.
void parse_dimensions(pbf_reader reader, std::vector<std::int32_t>& dimensions) {
    constexpr std::uint32_t kLength = integer_tag(1), kPackedLengths = message_tag(1);
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == kLength) dimensions.push_back(reader.get_int32());
        else if (tag == kPackedLengths)
            for (const std::int32_t length : reader.get_packed_int32()) dimensions.push_back(length);
        else reader.skip();
    }
}

/// Parses a message MatrixFloat or MatrixInt32, an image of any number of channels. Both
/// have the values in field 1 and the dimensions in field 2. The values are either packed
/// into one field, or have a field each.
void parse_matrix(pbf_reader reader, PixelType pixel_type, std::vector<float>& values,
                  std::vector<std::int32_t>& dimensions) {
    constexpr std::uint32_t kFloat = float_tag(1), kInteger = integer_tag(1), kPackedValues = message_tag(1),
                            kShape = message_tag(2);
    const bool is_integer = pixel_type == PixelType::integer;
    while (reader.next()) {
        const std::uint32_t tag = reader.tag_and_type();
        if (tag == kFloat) values.push_back(reader.get_float());
        else if (tag == kInteger && is_integer) values.push_back(float(reader.get_int32()));
        else if (tag == kPackedValues && is_integer)
            for (const std::int32_t value : reader.get_packed_int32()) values.push_back(float(value));
        else if (tag == kPackedValues)
            for (const float value : reader.get_packed_float()) values.push_back(value);
        else if (tag == kShape) parse_dimensions(reader.get_message(), dimensions);
        else reader.skip();
    }
}

/// Decompresses a zlib stream, which does not contain the size of its output.
/// @throws DataError if the stream is damaged or has more than kMaxInflatedBytes
std::string inflate_zlib(std::string_view compressed_bytes, const std::string& where) {
    z_stream stream{};
    if (inflateInit(&stream) != Z_OK) throw std::bad_alloc();
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(compressed_bytes.data()));
    stream.avail_in = static_cast<uInt>(std::min<std::size_t>(compressed_bytes.size(), UINT32_MAX));

    std::string bytes, part(std::size_t(1) << 18, '\0');
    int status = Z_OK;
    while (status == Z_OK && bytes.size() <= kMaxInflatedBytes) {
        stream.next_out = reinterpret_cast<Bytef*>(part.data());
        stream.avail_out = static_cast<uInt>(part.size());
        status = ::inflate(&stream, Z_NO_FLUSH);
        bytes.append(part, 0, part.size() - stream.avail_out);
    }
    inflateEnd(&stream);

    if (bytes.size() > kMaxInflatedBytes)
        fail("{}: a zlib stream unpacks to more than {} bytes, expected a range image", where,
             kMaxInflatedBytes);
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
    // fields of Waymo's message Frame
    constexpr std::uint32_t kContext = message_tag(1), kTimestamp = integer_tag(2), kPose = message_tag(3),
                            kLasers = message_tag(5), kLaserLabels = message_tag(6);
    SegmentFrame frame;
    bool has_pose = false;
    guard_parse(where, [&] {
        pbf_reader reader(record_bytes.data(), record_bytes.size());
        while (reader.next()) {
            const std::uint32_t tag = reader.tag_and_type();
            if (tag == kContext) parse_calibrations(reader.get_message(), frame, where);
            else if (tag == kTimestamp) frame.timestamp_us = reader.get_int64();
            else if (tag == kPose) {
                frame.world_from_vehicle = parse_transform(reader.get_message(), where + ": pose");
                has_pose = true;
            } else if (tag == kLasers) frame.images.push_back(parse_laser(reader.get_message()));
            else if (tag == kLaserLabels) parse_label(reader.get_message(), frame);
            else reader.skip();
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
    const std::string bytes = inflate_zlib(compressed_image, where);
    InflatedImage image;
    std::vector<std::int32_t> dims;  // rows, columns, channels
    guard_parse(
        where, [&] { parse_matrix(pbf_reader(bytes.data(), bytes.size()), pixel_type, image.values, dims); });

    const auto is_length = [](std::int32_t n, int most) { return n >= 1 && n <= most; };
    const bool has_valid_size = dims.size() == 3 && is_length(dims[0], kMostRows) &&
                                is_length(dims[1], kMostColumns) && dims[2] == n_channels;
    const bool is_complete =
        has_valid_size &&
        image.values.size() == std::size_t(dims[0]) * std::size_t(dims[1]) * std::size_t(n_channels);
    if (!is_complete) {
        const std::string size =
            dims.size() == 3 ? fmt::format(" ({} x {} x {})", dims[0], dims[1], dims[2]) : "";
        fail(
            "{}: found an image with {} values and {} dimensions{}; expected rows x columns x {} values, "
            "with at most {} rows and {} columns",
            where, image.values.size(), dims.size(), size, n_channels, kMostRows, kMostColumns);
    }
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
