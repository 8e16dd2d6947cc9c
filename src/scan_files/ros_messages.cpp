// SPDX-License-Identifier: Apache-2.0
#include "ros_messages.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <string_view>

#include "core/bytes.hpp"

namespace relidar::scan_files {
namespace {

/// Common Data Representation, little-endian: every number at a multiple of its size, counted behind the first four bytes.
class Cdr {
public:
    template <class T>
    Cdr& add(T value) {
        while ((bytes_.size() - kHead) % sizeof(T) != 0) bytes_ += '\0';
        append(bytes_, value);
        return *this;
    }
    Cdr& add_text(std::string_view text) {
        add(std::uint32_t(text.size() + 1));
        bytes_ += text;
        bytes_ += '\0';
        return *this;
    }
    Cdr& add_bytes(std::string_view bytes) {
        add(std::uint32_t(bytes.size()));
        bytes_ += bytes;
        return *this;
    }
    std::string take() { return std::move(bytes_); }

private:
    static constexpr std::size_t kHead = 4;
    std::string bytes_ = std::string("\0\1\0\0", kHead);
};

constexpr const char* kSeparator = "================================================================================\n";
constexpr const char* kHeaderParts =
    "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    "================================================================================\n"
    "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";

struct PointField {
    const char* name;
    std::uint32_t offset;
    std::uint8_t type;   ///< a constant of sensor_msgs/PointField
};
constexpr std::uint8_t kUint8 = 2, kUint16 = 4, kUint32 = 6, kFloat32 = 7;
constexpr PointField kPlain[] = {{"x", 0, kFloat32}, {"y", 4, kFloat32}, {"z", 8, kFloat32}, {"intensity", 12, kFloat32}};
constexpr PointField kAutoware[] = {{"x", 0, kFloat32},          {"y", 4, kFloat32},           {"z", 8, kFloat32},
                                    {"intensity", 12, kUint8},   {"return_type", 13, kUint8},  {"channel", 14, kUint16},
                                    {"azimuth", 16, kFloat32},   {"elevation", 20, kFloat32},  {"distance", 24, kFloat32},
                                    {"time_stamp", 28, kUint32}};

/// Nebula's numbers of returns.
enum ReturnType : std::uint8_t { kLast = 1, kStrongest = 3, kSecondStrongest = 8 };

/// A second return lies behind its first: it is the last; or before it: then the first was the last, and this the next strongest.
ReturnType return_type(const PointCloud& cloud, std::size_t point) {
    const bool second = cloud.return_number && (*cloud.return_number)[point] == 2;
    if (!second || point == 0) return kStrongest;
    return glm::length(cloud.position_m[point]) > glm::length(cloud.position_m[point - 1]) ? kLast : kSecondStrongest;
}

std::string autoware_points(const RecordedScan& scan) {
    const PointCloud& cloud = scan.cloud;
    std::string bytes;
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        const glm::vec3& p = cloud.position_m[i];
        append(bytes, p);
        append(bytes, std::uint8_t(std::lround(255.0f * std::clamp(cloud.intensity[i], 0.0f, 1.0f))));
        append(bytes, std::uint8_t(return_type(cloud, i)));
        append(bytes, (*cloud.ring)[i]);
        append(bytes, std::atan2(p.y, p.x)), append(bytes, std::atan2(p.z, std::hypot(p.x, p.y))), append(bytes, glm::length(p));
        append(bytes, std::uint32_t(std::llround(1e9 * std::max(0.0, double((*cloud.time)[i]) - scan.first_time_s))));
    }
    return bytes;
}

std::string plain_points(const PointCloud& cloud) {
    std::string bytes;
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) append(bytes, cloud.position_m[i]), append(bytes, cloud.intensity[i]);
    return bytes;
}

void add_header(Cdr& cdr, std::uint64_t stamp_ns, const char* frame) {
    cdr.add(std::int32_t(stamp_ns / 1'000'000'000)).add(std::uint32_t(stamp_ns % 1'000'000'000)).add_text(frame);
}

}  // namespace

std::string ros_points_definition() {
    return std::string(
               "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
               "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n") +
           kSeparator + "MSG: sensor_msgs/PointField\n" +
           "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\n"
           "uint8 FLOAT32=7\nuint8 FLOAT64=8\n"
           "string name\nuint32 offset\nuint8 datatype\nuint32 count\n" +
           kSeparator + kHeaderParts;
}

std::string ros_transform_definition() {
    return std::string("geometry_msgs/TransformStamped[] transforms\n") + kSeparator +
           "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n" +
           kSeparator + "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n" +
           kSeparator + "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n" + kSeparator +
           "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n" + kSeparator + kHeaderParts;
}

std::uint64_t ros_stamp_ns(const RecordedScan& scan) {
    return std::uint64_t(std::int64_t(scan.time_ns) + std::llround(1e9 * scan.first_time_s));
}

std::string ros_points(const RecordedScan& scan, RosPoints kind) {
    const bool plain = kind == RosPoints::plain;
    const std::span<const PointField> fields = plain ? std::span<const PointField>(kPlain) : std::span<const PointField>(kAutoware);
    const std::string points = plain ? plain_points(scan.cloud) : autoware_points(scan);
    const std::uint32_t step = plain ? 16 : 32;
    Cdr cdr;
    add_header(cdr, ros_stamp_ns(scan), scan.world ? kWorldFrame : kSensorFrame);
    cdr.add(std::uint32_t(1)).add(std::uint32_t(scan.cloud.position_m.size())).add(std::uint32_t(fields.size()));
    for (const PointField& field : fields) cdr.add_text(field.name).add(field.offset).add(field.type).add(std::uint32_t(1));
    cdr.add(std::uint8_t(0)).add(step).add(std::uint32_t(points.size())).add_bytes(points).add(std::uint8_t(1));
    return cdr.take();
}

std::string ros_transform(const RecordedScan& scan) {
    const auto& [q, t] = scan.world_from_sensor_at_first;
    Cdr cdr;
    cdr.add(std::uint32_t(1));
    add_header(cdr, ros_stamp_ns(scan), kWorldFrame);
    cdr.add_text(kSensorFrame);
    for (const double x : {t.x, t.y, t.z, q.x, q.y, q.z, q.w}) cdr.add(x);
    return cdr.take();
}

}  // namespace relidar::scan_files
