// SPDX-License-Identifier: Apache-2.0
// Decodes Livox packets. A packet consists of a header of 36 bytes and points of one of
// these kinds (protocol of Livox SDK2, "point cloud data"):
//    1: x y z int32 in mm, reflectivity, tag
//    2: x y z int16 in cm, reflectivity, tag
//    3: range uint32 in mm, angle from the z axis and azimuth uint16 in 0.01 degrees,
//       reflectivity, tag
// The header contains the time of the first point in nanoseconds, and the duration of the
// packet in units of 0.1 us.
#include "log/readers/bag/packets/livox.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>

#include "base/bytes.hpp"
#include "base/codecs/byte_reader.hpp"

namespace relidar::packets {
namespace {

constexpr std::size_t kLivoxHeader = 36, kDurationAt = 3, kCountAt = 5, kKindAt = 10, kLivoxTimeAt = 28;
constexpr std::int64_t kLargestDrift_ns = 50'000'000;

template <class T>
T number_at(std::string_view bytes, std::size_t offset) {
    return bag::ByteReader(bytes.substr(offset)).number<T>();
}

/// Returns the bytes per point for a type of point data, or 0 if the type is unknown.
std::size_t get_point_bytes(int kind) {
    constexpr std::size_t kBytes[] = {0, 14, 8, 10};
    return kind >= 1 && kind <= 3 ? kBytes[kind] : 0;
}

glm::vec3 read_position(bag::ByteReader& reader, int kind) {
    if (kind == 1) {
        const auto x = reader.number<std::int32_t>(), y = reader.number<std::int32_t>();
        return 1e-3f * glm::vec3(x, y, reader.number<std::int32_t>());
    }
    if (kind == 2) {
        const auto x = reader.number<std::int16_t>(), y = reader.number<std::int16_t>();
        return 1e-2f * glm::vec3(x, y, reader.number<std::int16_t>());
    }
    const double range_m = 1e-3 * reader.number<std::uint32_t>();
    const double from_z_rad = reader.number<std::uint16_t>() * 1e-2 * kPi / 180.0;
    const double azimuth_rad = reader.number<std::uint16_t>() * 1e-2 * kPi / 180.0;
    return glm::vec3(range_m * glm::dvec3(std::sin(from_z_rad) * std::cos(azimuth_rad),
                                          std::sin(from_z_rad) * std::sin(azimuth_rad),
                                          std::cos(from_z_rad)));
}

/// Returns the time from the first to the second time stamp, clamped to one hour in both
/// directions.
std::int64_t compute_time_between(std::int64_t first_ns, std::int64_t second_ns) {
    constexpr std::int64_t kHour_ns = 3'600'000'000'000;
    const auto passed_ns = std::int64_t(std::uint64_t(second_ns) - std::uint64_t(first_ns));
    return std::clamp(passed_ns, -kHour_ns, kHour_ns);
}

/// Appends the points of a packet to a cloud.
/// @param after_ns  time of the first point of the packet, relative to the time of the
/// cloud
/// @return number of points
std::uint32_t append_points(std::string& points, std::string_view packet, std::int64_t after_ns) {
    const int kind = std::uint8_t(packet[kKindAt]);
    const auto n = number_at<std::uint16_t>(packet, kCountAt);
    const double step_ns = 100.0 * number_at<std::uint16_t>(packet, kDurationAt) / std::max(int(n), 1);
    bag::ByteReader reader(packet.substr(kLivoxHeader));
    std::uint32_t n_points = 0;
    for (int i = 0; i < int(n); ++i) {
        const glm::vec3 position_m = read_position(reader, kind);
        const std::string_view reflectivity_and_tag = reader.take(2);
        if (position_m == glm::vec3(0.0f)) continue;
        append(points, std::uint32_t(std::max(after_ns + std::llround(step_ns * i), 0ll)));
        append(points, position_m.x), append(points, position_m.y), append(points, position_m.z);
        points.append(reflectivity_and_tag);
        // laser line; always 0, because packets do not contain the line
        append(points, std::uint8_t(0));
        ++n_points;
    }
    return n_points;
}

}  // namespace

bool is_livox(std::string_view bytes) {
    if (bytes.size() <= kLivoxHeader || bytes[0] != 0) return false;
    const std::size_t size = get_point_bytes(std::uint8_t(bytes[kKindAt]));
    return size > 0 && bytes.size() == kLivoxHeader + size * number_at<std::uint16_t>(bytes, kCountAt);
}

std::string decode_livox_cloud(std::string_view packets, std::string_view frame) {
    std::string points;
    std::uint32_t n_points = 0;
    std::int64_t first_stamp_ns = 0, first_clock_ns = 0;
    bool is_first = true;
    for (bag::ByteReader reader(packets); reader.left() > 0; is_first = false) {
        const auto stamp_ns = reader.number<std::int64_t>();
        const std::string_view packet = reader.read_sized_string();
        if (!is_livox(packet)) continue;
        const auto clock_ns = number_at<std::int64_t>(packet, kLivoxTimeAt);
        if (is_first) first_stamp_ns = stamp_ns, first_clock_ns = clock_ns;
        // If the sensor's clock has jumped, the receive times of the packets are used
        // instead.
        const std::int64_t passed_ns = compute_time_between(first_stamp_ns, stamp_ns);
        const std::int64_t passed_clock_ns = compute_time_between(first_clock_ns, clock_ns);
        const bool has_jumped = std::abs(passed_clock_ns - passed_ns) > kLargestDrift_ns;
        n_points += append_points(points, packet, has_jumped ? passed_ns : passed_clock_ns);
    }
    std::string message;
    append(message, std::uint32_t(0));
    append(message, std::uint32_t(first_stamp_ns / 1'000'000'000));
    append(message, std::uint32_t(first_stamp_ns % 1'000'000'000));
    append(message, std::uint32_t(frame.size()));
    message.append(frame);
    append(message, std::uint64_t(first_stamp_ns));
    append(message, n_points);
    append(message, std::uint32_t(0));  // number of the LiDAR and reserved bytes, all 0
    append(message, n_points);
    return message.append(points);
}

}  // namespace relidar::packets
