// SPDX-License-Identifier: Apache-2.0
// Decodes Livox packets. A packet consists of a header of 36 bytes and points of one of
// these kinds (protocol of Livox SDK2, "point cloud data"):
//    1: x y z int32 in mm, reflectivity, tag
//    2: x y z int16 in cm, reflectivity, tag
//    3: range uint32 in mm, angle from the z axis and azimuth uint16 in 0.01 degrees,
//       reflectivity, tag
// The header contains the time of the first point in nanoseconds, and the duration of the
// packet in units of 0.1 us.
#include "read/packets/decoder.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>

#include "base/bytes.hpp"
#include "base/codecs/byte_reader.hpp"

namespace relidar::packets {
namespace {

using codecs::number_at;

constexpr std::size_t kLivoxHeader = 36, kDurationAt = 3, kCountAt = 5, kKindAt = 10, kLivoxTimeAt = 28;
constexpr std::int64_t kLargestDrift_ns = 50'000'000;

/// Reads the position of a point of type 1 (millimetres), 2 (centimetres) or 3 (spherical
/// coordinates).
glm::vec3 read_position_m(codecs::ByteReader& reader, int point_type) {
    if (point_type == 1) {
        const auto x = reader.read_number<std::int32_t>(), y = reader.read_number<std::int32_t>();
        return 1e-3f * glm::vec3(x, y, reader.read_number<std::int32_t>());
    }
    if (point_type == 2) {
        const auto x = reader.read_number<std::int16_t>(), y = reader.read_number<std::int16_t>();
        return 1e-2f * glm::vec3(x, y, reader.read_number<std::int16_t>());
    }
    const double range_m = 1e-3 * reader.read_number<std::uint32_t>();
    const double from_z_rad = reader.read_number<std::uint16_t>() * 1e-2 * kPi / 180.0;
    const double azimuth_rad = reader.read_number<std::uint16_t>() * 1e-2 * kPi / 180.0;
    return glm::vec3(range_m * glm::dvec3(std::sin(from_z_rad) * std::cos(azimuth_rad),
                                          std::sin(from_z_rad) * std::sin(azimuth_rad),
                                          std::cos(from_z_rad)));
}

/// Returns the time from the first to the second time. Limits it to one hour in both
/// directions, because damaged times could overflow.
std::int64_t clamped_step_ns(std::int64_t first_ns, std::int64_t second_ns) {
    constexpr std::int64_t kMaxStep_ns = 3'600'000'000'000;
    const auto passed_ns = std::int64_t(std::uint64_t(second_ns) - std::uint64_t(first_ns));
    return std::clamp(passed_ns, -kMaxStep_ns, kMaxStep_ns);
}

/// Appends the points of a packet to a cloud, in the layout of Livox's driver.
/// @param offset_ns  time of the first point minus the time of the cloud
/// @return number of points
std::uint32_t append_points(std::string& point_bytes, std::string_view packet, std::int64_t offset_ns) {
    const int point_type = std::uint8_t(packet[kKindAt]);
    const auto n_stored = number_at<std::uint16_t>(packet, kCountAt);
    const double step_ns = 100.0 * number_at<std::uint16_t>(packet, kDurationAt) / std::max(int(n_stored), 1);
    codecs::ByteReader reader(packet.substr(kLivoxHeader));
    std::uint32_t n_points = 0;
    for (int i = 0; i < int(n_stored); ++i) {
        const glm::vec3 p = read_position_m(reader, point_type);
        const std::string_view reflectivity_and_tag = reader.read_bytes(2);
        // A ray without a return is stored as a point at the origin.
        if (p == glm::vec3(0.0f)) continue;
        append_raw(point_bytes, std::uint32_t(std::max(offset_ns + std::llround(step_ns * i), 0ll)));
        append_raw(point_bytes, p.x);
        append_raw(point_bytes, p.y);
        append_raw(point_bytes, p.z);
        point_bytes.append(reflectivity_and_tag);
        // number of the laser line; always 0, because packets do not contain it
        append_raw(point_bytes, std::uint8_t(0));
        ++n_points;
    }
    return n_points;
}

}  // namespace

bool is_livox_packet(std::string_view packet_bytes) {
    if (packet_bytes.size() <= kLivoxHeader || packet_bytes[0] != 0) return false;
    constexpr std::size_t kPointBytes[] = {0, 14, 8, 10};  // by type of point data, 1 to 3
    const int point_type = std::uint8_t(packet_bytes[kKindAt]);
    if (point_type < 1 || point_type > 3) return false;
    return packet_bytes.size() ==
           kLivoxHeader + kPointBytes[point_type] * number_at<std::uint16_t>(packet_bytes, kCountAt);
}

std::string join_livox_packets(std::string_view packed_packets, std::string_view frame_id) {
    std::string points;
    std::uint32_t n_points = 0;
    std::int64_t first_stamp_ns = 0, first_clock_ns = 0;
    bool is_first = true;
    for (codecs::ByteReader reader(packed_packets); reader.remaining() > 0;) {
        const auto stamp_ns = reader.read_number<std::int64_t>();
        const std::string_view packet = reader.read_string();
        if (!is_livox_packet(packet)) continue;
        const auto clock_ns = number_at<std::int64_t>(packet, kLivoxTimeAt);
        if (std::exchange(is_first, false)) {
            first_stamp_ns = stamp_ns;
            first_clock_ns = clock_ns;
        }
        // Time since the first packet by the sensor's clock, or after a jump, by receipt.
        const std::int64_t passed_ns = clamped_step_ns(first_stamp_ns, stamp_ns);
        const std::int64_t passed_clock_ns = clamped_step_ns(first_clock_ns, clock_ns);
        const bool has_jumped = std::abs(passed_clock_ns - passed_ns) > kLargestDrift_ns;
        n_points += append_points(points, packet, has_jumped ? passed_ns : passed_clock_ns);
    }
    // The header: sequence number, seconds, nanoseconds, and the frame with its length.
    constexpr std::int64_t kNsPerSecond = 1'000'000'000;
    std::string message;
    append_raw(message, std::uint32_t(0));
    append_raw(message, std::uint32_t(first_stamp_ns / kNsPerSecond));
    append_raw(message, std::uint32_t(first_stamp_ns % kNsPerSecond));
    append_raw(message, std::uint32_t(frame_id.size()));
    message.append(frame_id);
    append_raw(message, std::uint64_t(first_stamp_ns));
    append_raw(message, n_points);
    append_raw(message, std::uint32_t(0));  // number of the LiDAR and reserved bytes, all 0
    append_raw(message, n_points);          // length of the list
    return message.append(points);
}

}  // namespace relidar::packets
