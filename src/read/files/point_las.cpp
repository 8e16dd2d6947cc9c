// SPDX-License-Identifier: Apache-2.0
// Reads the points of LAS files (ASPRS LAS 1.0 to 1.4, point formats 0 to 10). Rejects
// files with a map in survey coordinates. Such files are usual, but they are not scans.
#include <algorithm>
#include <array>
#include <cstdint>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "read/files/point_table.hpp"

namespace relidar::read {
namespace {

using codecs::number_at;

// byte offsets in the header
constexpr std::size_t kVersionAt = 24, kPointsAt = 96, kFormatAt = 104, kRecordAt = 105, kCountAt = 107,
                      kScaleAt = 131, kOffsetAt = 155, kHeaderBytes = 227, kLongCountAt = 247,
                      kLongHeader = 255;
constexpr int kMostFormat = 10, kFirstLongFormat = 6;
// byte offsets in a point of every format
constexpr std::size_t kIntensityAt = 12, kReturnAt = 14;
constexpr double kMostAway_m = 100.0;  // a scan has points closer to the origin than this along x and y
constexpr int kPackedFlag = 128;       // added to the point format if the points are compressed

struct LasHeader {
    int format = 0;
    std::size_t first_point = 0, point_bytes = 0;  ///< byte offset of the first point
    std::uint64_t n_points = 0;
    std::array<double, 3> scale{}, offset_m{};

    bool is_extended() const { return format >= kFirstLongFormat; }
    bool has_gps_time() const { return is_extended() || format == 1 || format >= 3; }
    std::size_t gps_time_offset() const { return is_extended() ? 22 : 20; }
};

/// Parses the header of a LAS file. Checks that the file contains all its points.
LasHeader parse_header(std::string_view bytes, const std::string& where) {
    if (bytes.size() < kHeaderBytes || !bytes.starts_with("LASF"))
        fail("{}: found {} bytes that do not begin with LASF, expected a LAS file", where, bytes.size());
    LasHeader header;
    header.format = number_at<std::uint8_t>(bytes, kFormatAt);
    if (header.format >= kPackedFlag)
        fail("{}: found compressed points (LAZ), expected LAS; 'laszip IN.laz OUT.las' unpacks them", where);
    if (header.format > kMostFormat)
        fail("{}: found the point format {}, expected a format from 0 to {}", where, header.format,
             kMostFormat);
    header.first_point = number_at<std::uint32_t>(bytes, kPointsAt);
    header.point_bytes = number_at<std::uint16_t>(bytes, kRecordAt);
    header.n_points = number_at<std::uint32_t>(bytes, kCountAt);
    // Since version 1.4, files also have a number with 64 bits. One of both can be 0.
    const int minor_version = number_at<std::uint8_t>(bytes, kVersionAt + 1);
    if (minor_version >= 4 && bytes.size() >= kLongHeader)
        header.n_points = std::max(header.n_points, number_at<std::uint64_t>(bytes, kLongCountAt));
    for (std::size_t axis = 0; axis < 3; ++axis) {
        header.scale[axis] = number_at<double>(bytes, kScaleAt + 8 * axis);
        header.offset_m[axis] = number_at<double>(bytes, kOffsetAt + 8 * axis);
    }
    const std::size_t min_point_bytes = header.gps_time_offset() + (header.has_gps_time() ? 8 : 0);
    if (header.point_bytes < min_point_bytes || header.first_point > bytes.size() ||
        header.n_points > (bytes.size() - header.first_point) / header.point_bytes)
        fail("{}: the file is truncated: found {} bytes, expected {} points of {} bytes from byte {}", where,
             bytes.size(), header.n_points, header.point_bytes, header.first_point);
    return header;
}

/// Throws if the points are a map or in survey coordinates. The sensor of a scan is at
/// the origin, so some points must be near the origin. They can all be on one side,
/// because some sensors only look forward.
void check_near_origin(const std::array<std::vector<double>, 3>& coordinates_m, const std::string& where) {
    for (std::size_t axis = 0; axis < 2; ++axis) {
        const auto [least, most] = std::ranges::minmax(coordinates_m[axis]);
        if (least <= kMostAway_m && most >= -kMostAway_m) continue;
        fail(
            "{}: the {} coordinates are from {:.6g} to {:.6g} m, so the points are probably a map or in "
            "survey coordinates; expected one scan with the sensor at the origin",
            where, axis == 0 ? "x" : "y", least, most);
    }
}

}  // namespace

PointTable parse_las(const SharedBytes& file, const std::string& where) {
    const LasHeader header = parse_header(file.bytes, where);
    const auto n = std::size_t(header.n_points);
    check_point_count(n, where);
    const char* points = file.bytes.data() + header.first_point;
    std::array<std::vector<double>, 3> coordinates_m;
    std::vector<std::uint8_t> return_numbers(n);
    for (std::size_t axis = 0; axis < 3; ++axis) coordinates_m[axis].resize(n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::string_view point(points + i * header.point_bytes, header.point_bytes);
        for (std::size_t axis = 0; axis < 3; ++axis)  // a point begins with three integers
            coordinates_m[axis][i] =
                header.scale[axis] * number_at<std::int32_t>(point, 4 * axis) + header.offset_m[axis];
        // The return number has 4 bits in new point formats and 3 bits in old ones. A ray
        // keeps at most 8 returns.
        return_numbers[i] = std::uint8_t(std::min(point[kReturnAt] & (header.is_extended() ? 15 : 7), 8));
    }
    check_near_origin(coordinates_m, where);
    PointTable table(n);
    table.keep_alive(file.memory);
    const char* names[] = {"x", "y", "z"};
    for (std::size_t axis = 0; axis < 3; ++axis)
        table.add_value_field(names[axis], ScalarType::f8, std::move(coordinates_m[axis]), where);
    table.add_value_field("intensity", {ScalarType::u2, points + kIntensityAt, header.point_bytes}, where);
    // Some programs write 0 for all return numbers.
    if (std::ranges::any_of(return_numbers, [](std::uint8_t number) { return number > 1; }))
        table.add_value_field("return_number", ScalarType::u1, std::move(return_numbers), where);
    if (!header.has_gps_time()) return table;
    const PointFieldView times(ScalarType::f8, points + header.gps_time_offset(), header.point_bytes);
    bool is_constant = true;  // some programs write the time 0 for all points
    for (std::size_t i = 1; i < n; ++i) is_constant = is_constant && times[i] == times[0];
    if (!is_constant) table.add_value_field("time", times, where);
    return table;
}

}  // namespace relidar::read
