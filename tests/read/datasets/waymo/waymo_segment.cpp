// SPDX-License-Identifier: Apache-2.0
// Computes the geometry with 4x4 products, independently of the library.
#include "read/datasets/waymo/waymo_segment.hpp"

#include <cstring>

#include <zlib.h>
#include <glm/gtc/matrix_transform.hpp>
#include <protozero/pbf_writer.hpp>

#include "base/codecs/tfrecord.hpp"
#include "base/random.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar::test {
namespace {

/// Returns Rz Ry Rx with a translation.
glm::dmat4 make_euler_matrix(double roll, double pitch, double yaw, const glm::dvec3& translation) {
    const glm::dvec3 x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
    const glm::dmat4 turned = glm::rotate(glm::translate(glm::dmat4(1.0), translation), yaw, z);
    return glm::rotate(glm::rotate(turned, pitch, y), roll, x);
}

/// Returns roll, pitch, yaw, x, y and z of the vehicle at a time.
std::vector<double> make_vehicle_state(double time_us) {
    const double t = 1e-6 * (time_us - WaymoSegment::kStart_us);
    return {0.01 * std::sin(3 * t),    0.02 * std::cos(2 * t), 2.0 + 0.3 * t + 0.4 * t * t,
            1200 + 12 * t + 2 * t * t, -3400 + 3 * t,          20 + 0.1 * t};
}

constexpr glm::dvec3 kRoomMiddle{1203, -3399, 22}, kRoomHalf{40, 25, 4};
constexpr glm::dvec3 kParkedSize{4.6, 2.0, 1.6};
constexpr double kFarthest_m = 35.0;

/// Returns where a ray leaves a box around the origin if it starts inside, otherwise
/// where it enters the box, or 0 if it misses the box.
double compute_box_range(const glm::dvec3& origin, const glm::dvec3& direction, const glm::dvec3& half,
                         bool inside) {
    double enters = -1e9, leaves = 1e9;
    for (int a = 0; a < 3; ++a) {
        const double p = (-half[a] - origin[a]) / direction[a], q = (half[a] - origin[a]) / direction[a];
        enters = std::max(enters, std::min(p, q));
        leaves = std::min(leaves, std::max(p, q));
    }
    if (enters > leaves) return 0.0;
    return inside ? leaves : std::max(enters, 0.0);
}

/// Returns 0 if the first surface is too far away.
double cast(const glm::dvec3& origin, const glm::dvec3& direction) {
    double range = compute_box_range(origin - kRoomMiddle, direction, kRoomHalf, true);
    const glm::dmat4 to_parked = glm::inverse(WaymoSegment::get_world_from_parked());
    const double parked =
        compute_box_range(glm::dvec3(to_parked * glm::dvec4(origin, 1)),
                          glm::dvec3(to_parked * glm::dvec4(direction, 0)), 0.5 * kParkedSize, false);
    if (parked > 0.0) range = std::min(range, parked);
    return range < kFarthest_m ? range : 0.0;
}

struct Rig {
    int laser, rows, columns;
    glm::dmat4 extrinsic;
    std::vector<double> elevations;  ///< elevations of the rows, highest first
};

glm::dmat4 make_side_extrinsic() { return make_euler_matrix(0.02, 0.01, 1.5, {3.2, 1.0, 0.7}); }
constexpr double kSideLow = -kPi / 2, kSideHigh = kPi / 6;

Rig make_top_rig() {
    std::vector<double> rows = WaymoSegment::list_top_inclinations();
    return {1,
            WaymoSegment::kTopRows,
            WaymoSegment::kTopColumns,
            WaymoSegment::get_top_extrinsic(),
            {rows.rbegin(), rows.rend()}};
}

Rig make_side_rig() {
    std::vector<double> rows;
    for (int r = 0; r < WaymoSegment::kSideRows; ++r)
        rows.push_back(kSideHigh - (r + 0.5) / WaymoSegment::kSideRows * (kSideHigh - kSideLow));
    return {3, WaymoSegment::kSideRows, WaymoSegment::kSideColumns, make_side_extrinsic(), rows};
}

/// Same as in the dataset's tool.
glm::dvec3 compute_pixel_direction(const Rig& rig, int row, int column) {
    const double yaw = std::atan2(rig.extrinsic[0][1], rig.extrinsic[0][0]);
    const double azimuth = kPi * (2.0 * (rig.columns - column - 0.5) / rig.columns - 1.0) - yaw,
                 up = rig.elevations[std::size_t(row)];
    return {std::cos(azimuth) * std::cos(up), std::sin(azimuth) * std::cos(up), std::sin(up)};
}

WaymoPixel make_pixel(const Rig& rig, int row, int column, int frame, double time_us) {
    const glm::dmat4 world_from_laser = WaymoSegment::world_from_vehicle(time_us) * rig.extrinsic;
    const glm::dvec3 origin(world_from_laser[3]),
        direction(world_from_laser * glm::dvec4(compute_pixel_direction(rig, row, column), 0));
    const std::uint64_t luck =
        hash_pair(std::uint64_t(row * 10000 + column), std::uint64_t(frame * 10 + rig.laser));
    WaymoPixel pixel{{}, time_us};
    const double range = luck % 10 == 0 ? 0.0 : cast(origin, direction);
    pixel.range_m = float(range);
    pixel.second_m = luck % 20 == 1 ? pixel.range_m + 1.5f : 0.0f;
    pixel.intensity = range > 0.0 ? float(0.1 + double(luck % 100) * 0.03) : 0.0f;
    pixel.point_m = origin + (range > 0.0 ? range : 10.0) * direction;
    return pixel;
}

std::vector<WaymoPixel> make_image(const Rig& rig, int frame) {
    std::vector<WaymoPixel> pixels;
    for (int row = 0; row < rig.rows; ++row)
        for (int column = 0; column < rig.columns; ++column) {
            // A pixel of TOP is fired within five columns of the mean firing position of
            // its column.
            const double fired = column + 0.5 + 5.0 * std::sin(double(row));
            const double time_us =
                WaymoSegment::kStart_us + WaymoSegment::kPeriod_us * (frame + fired / rig.columns);
            pixels.push_back(make_pixel(rig, row, column, frame,
                                        rig.laser == 1 ? time_us : WaymoSegment::label_time_us(frame)));
        }
    return pixels;
}

std::string image_of(const std::vector<WaymoPixel>& pixels, const Rig& rig, bool second) {
    std::vector<float> values;
    for (const WaymoPixel& pixel : pixels) {
        const float range = second ? pixel.second_m : pixel.range_m;
        const std::vector<float> four = range > 0 ? std::vector{range, pixel.intensity, 0.5f, -1.0f}
                                                  : std::vector{-1.0f, -1.0f, -1.0f, -1.0f};
        values.insert(values.end(), four.begin(), four.end());
    }
    return make_waymo_matrix(values, {rig.rows, rig.columns, 4});
}

std::string make_pixel_poses(const std::vector<WaymoPixel>& pixels, const Rig& rig) {
    std::vector<float> values;
    for (const WaymoPixel& pixel : pixels)
        for (const double x : make_vehicle_state(pixel.time_us))
            values.push_back(pixel.range_m > 0 ? float(x) : 0.0f);
    return make_waymo_matrix(values, {rig.rows, rig.columns, 6});
}

template <class T>
std::string bytes_of(T value) {
    std::string bytes(sizeof value, '\0');
    std::memcpy(bytes.data(), &value, sizeof value);
    return bytes;
}

}  // namespace

std::string WaymoFrame::encode_frame_message() const {
    std::string text;
    protozero::pbf_writer frame(text);
    frame.add_message(1, context);
    frame.add_int64(2, timestamp_us);
    if (!pose.empty()) frame.add_message(3, pose);
    frame.add_message(4, std::string("\x08\x01"));  // camera images, which are not read
    for (const std::string& laser : lasers) frame.add_message(5, laser);
    for (const std::string& label : labels) frame.add_message(6, label);
    return text;
}

std::string make_waymo_transform(const glm::dmat4& a_from_b) {
    std::string text;
    protozero::pbf_writer transform(text);
    for (int i = 0; i < 16; ++i) transform.add_double(1, a_from_b[i % 4][i / 4]);  // proto2: not packed
    return text;
}

std::string make_waymo_calibration(int laser, const std::vector<double>& inclinations, double low,
                                   double high, const glm::dmat4& extrinsic) {
    std::string text;
    protozero::pbf_writer calibration(text);
    calibration.add_enum(1, laser);
    for (const double inclination : inclinations) calibration.add_double(2, inclination);
    calibration.add_double(3, low);
    calibration.add_double(4, high);
    calibration.add_message(5, make_waymo_transform(extrinsic));
    return text;
}

std::string make_waymo_context(const std::vector<std::string>& calibrations) {
    std::string text;
    protozero::pbf_writer context(text);
    context.add_string(1, "1083056_0001");
    for (const std::string& calibration : calibrations) context.add_message(3, calibration);
    return text;
}

std::string deflate_bytes(const std::string& bytes) {
    uLongf size = compressBound(uLong(bytes.size()));
    std::string packed(size, '\0');
    if (compress(reinterpret_cast<Bytef*>(packed.data()), &size, reinterpret_cast<const Bytef*>(bytes.data()),
                 uLong(bytes.size())) != Z_OK)
        throw std::runtime_error("compress");
    packed.resize(size);
    return packed;
}

std::string make_waymo_shape(const std::vector<int>& dims) {
    std::string shape;
    protozero::pbf_writer dimensions(shape);
    for (const int dim : dims) dimensions.add_int32(1, dim);
    return shape;
}

std::string make_waymo_unpacked_matrix(const std::vector<float>& values, const std::vector<int>& dims) {
    std::string text;
    protozero::pbf_writer matrix(text);
    matrix.add_packed_float(1, values.begin(), values.end());
    matrix.add_message(2, make_waymo_shape(dims));
    return text;
}

std::string make_waymo_matrix(const std::vector<float>& values, const std::vector<int>& dims) {
    return deflate_bytes(make_waymo_unpacked_matrix(values, dims));
}

std::string make_waymo_integer_matrix(const std::vector<int>& values, const std::vector<int>& dims) {
    std::string text;
    protozero::pbf_writer matrix(text);
    matrix.add_packed_int32(1, values.begin(), values.end());
    matrix.add_message(2, make_waymo_shape(dims));
    return deflate_bytes(text);
}

std::string make_waymo_laser(int laser, const std::string& first, const std::string& second,
                             const std::string& poses, const std::string& labels) {
    const auto range_image = [](const std::string& image, const std::string& pixel_poses,
                                const std::string& pixel_labels) {
        std::string text;
        protozero::pbf_writer writer(text);
        writer.add_bytes(2, image);
        if (!pixel_poses.empty()) writer.add_bytes(4, pixel_poses);
        if (!pixel_labels.empty()) writer.add_bytes(6, pixel_labels);
        return text;
    };
    std::string text;
    protozero::pbf_writer writer(text);
    writer.add_enum(1, laser);
    if (!first.empty()) writer.add_message(2, range_image(first, poses, labels));
    if (!second.empty()) writer.add_message(3, range_image(second, "", ""));
    return text;
}

std::string make_waymo_label(const std::string& id, int type, const glm::dvec3& centre,
                             const glm::dvec3& length_width_height, double heading) {
    std::string text, box;
    protozero::pbf_writer fields(box);
    const double values[] = {
        centre.x, centre.y, centre.z, length_width_height.y, length_width_height.x, length_width_height.z,
        heading};
    for (int i = 0; i < 7; ++i) fields.add_double(protozero::pbf_tag_type(i + 1), values[i]);
    protozero::pbf_writer label(text);
    label.add_message(1, box);
    label.add_enum(3, type);
    label.add_string(4, id);
    label.add_int32(7, 100);
    return text;
}

std::string make_tfrecord(const std::string& data) {
    const auto masked = [](const std::string& bytes) { return bytes_of(masked_crc32c(bytes)); };
    const std::string length = bytes_of(std::uint64_t(data.size()));
    return length + masked(length) + data + masked(data);
}

glm::dmat4 WaymoSegment::get_top_extrinsic() {
    return make_euler_matrix(0.005, -0.008, 2.58, {1.43, 0.02, 2.18});
}

std::vector<double> WaymoSegment::list_top_inclinations() {
    std::vector<double> rows;
    // rows are denser at the top
    for (int r = 0; r < kTopRows; ++r) rows.push_back(-0.31 + 0.35 * std::sqrt((r + 0.5) / kTopRows));
    return rows;
}

glm::dmat4 WaymoSegment::world_from_vehicle(double time_us) {
    const std::vector<double> s = make_vehicle_state(time_us);
    return make_euler_matrix(s[0], s[1], s[2], {s[3], s[4], s[5]});
}

double WaymoSegment::label_time_us(int frame) { return kStart_us + kPeriod_us * (frame + 0.5) + 7000; }

glm::dmat4 WaymoSegment::get_world_from_parked() { return make_euler_matrix(0, 0, 0.7, {1206, -3389, 20.8}); }

WaymoSegment::WaymoSegment(const std::string& name)
    : LogFolder("relidar_" + name), file(folder / "segment-1083056_0001_with_camera_labels.tfrecord") {
    const Rig top_of = make_top_rig(), side_of = make_side_rig();
    for (int i = 0; i < kFrames; ++i) {
        top.push_back(make_image(top_of, i));
        side.push_back(make_image(side_of, i));
        const glm::dmat4 world_from_frame = world_from_vehicle(label_time_us(i)),
                         frame_from_world = glm::inverse(world_from_frame);
        const glm::dmat4 parked = frame_from_world * get_world_from_parked();
        WaymoFrame& frame = frames.emplace_back();
        frame.timestamp_us = kStart_us + i * kPeriod_us;
        frame.context = make_waymo_context(
            {make_waymo_calibration(3, {}, kSideLow, kSideHigh, side_of.extrinsic),
             make_waymo_calibration(1, list_top_inclinations(), -0.31, 0.04, top_of.extrinsic)});
        frame.pose = make_waymo_transform(world_from_frame);
        frame.lasers = {
            make_waymo_laser(3, image_of(side.back(), side_of, false), "", ""),
            make_waymo_laser(1, image_of(top.back(), top_of, false), image_of(top.back(), top_of, true),
                             make_pixel_poses(top.back(), top_of))};
        frame.labels = {make_waymo_label("parked", 1, glm::dvec3(parked[3]), kParkedSize,
                                         std::atan2(parked[0][1], parked[0][0])),
                        make_waymo_label("walker", 2, {10.0 + i, 2.0, 1.0}, {0.8, 0.7, 1.8}, 0.5),
                        make_waymo_label("sign", 3, {12, 5, 2}, {0.1, 0.8, 0.8}, 0.0)};
    }
    write();
}

void WaymoSegment::write() const {
    std::string records;
    for (const WaymoFrame& frame : frames) records += make_tfrecord(frame.encode_frame_message());
    write_text(file, records);
}

}  // namespace relidar::test
