// SPDX-License-Identifier: Apache-2.0
#include "frame.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <type_traits>

#include <nlohmann/json.hpp>

#include <relidar/log/log.hpp>
#include <relidar/simulate/place_points.hpp>

namespace relidar::view {
namespace {

static_assert(std::endian::native == std::endian::little,
              "relidar sends arrays in the byte order of this machine, which must be little-endian");

using Json = nlohmann::json;

std::uint8_t to_byte(float fraction) {
    return static_cast<std::uint8_t>(std::lround(255.0f * std::clamp(fraction, 0.0f, 1.0f)));
}

class BinaryArrayPacker {
public:
    /// Appends an array and its entry in the table. Pads it to a multiple of 4 bytes,
    /// because JavaScript requires aligned arrays.
    template <class T>
    void add_array(const std::string& name, const char* type, int n, const std::vector<T>& values) {
        if (values.empty()) return;
        const std::size_t n_bytes = values.size() * sizeof(T);
        table_.push_back({{"name", name},
                          {"type", type},
                          {"components", n},
                          {"count", values.size()},
                          {"offset", bytes_.size()}});
        bytes_.append(reinterpret_cast<const char*>(values.data()), n_bytes);
        bytes_.append((4 - bytes_.size() % 4) % 4, '\0');
    }
    void add_scan(const std::string& array_name_prefix, const ScanColumns& scan) {
        add_array(array_name_prefix + "position", "f32", 3, scan.position_m);
        add_array(array_name_prefix + "range", "f32", 1, scan.range_m);
        add_array(array_name_prefix + "intensity", "u8", 1, scan.intensity);
        add_array(array_name_prefix + "drop", "u8", 1, scan.drop);
        add_array(array_name_prefix + "instance", "u16", 1, scan.instance);
        add_array(array_name_prefix + "ring", "u16", 1, scan.ring);
        const std::string channel_prefix = array_name_prefix + "channel_";
        for (const auto& [info, values, second] : scan.channels) {
            const auto add_one = [&, &name = info.name]<class T>(const std::vector<T>& of_rays) {
                constexpr bool is_vector = std::is_same_v<T, glm::vec3>;
                add_array(channel_prefix + name, std::is_same_v<T, std::int32_t> ? "i32" : "f32",
                          is_vector ? 3 : 1, of_rays);
            };
            std::visit(add_one, values);
        }
    }
    const Json& table_json() const { return table_; }
    const std::string& packed_bytes() const { return bytes_; }

private:
    Json table_ = Json::array();
    std::string bytes_;
};

}  // namespace

ScanColumns simulated_columns(const RenderedScan& scan, const Config& config,
                              const glm::dvec3& world_offset_m) {
    LidarPoints points =
        place_points(scan, config, Pose{{1.0, 0.0, 0.0, 0.0}, world_offset_m}, PointSelection::rays);
    ScanColumns result{.rows = scan.image.rows,
                       .columns = scan.image.columns,
                       .position_m = std::move(points.position_m),
                       .range_m = point_ranges(scan, config),
                       .ring = std::move(points.ring),
                       .channels = std::move(points.channels)};
    constexpr std::uint16_t kNoInstance = 65535;
    for (std::size_t i = 0; i < result.range_m.size(); ++i) {
        result.intensity.push_back(to_byte(scan.image.intensity[i]));
        result.drop.push_back(to_byte(scan.image.drop_prob[i]));
        const int instance = scan.instance[i];  // negative if the ray meets no object
        result.instance.push_back(instance < 0 ? kNoInstance : static_cast<std::uint16_t>(instance));
    }
    return result;
}

ScanColumns measured_columns(const Log& log, const Frame& frame) {
    const Scan& scan = frame.scan;
    const PoseTrack world_from_sensor = log.lidar_track(frame.lidar);
    ScanColumns result{.rows = scan.rays.rows,
                       .columns = scan.rays.columns,
                       .range_m = to_vector(scan.range_m),
                       .ring = to_vector(scan.rays.channel)};
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
        const WorldRay ray =
            make_world_ray(world_from_sensor, frame.time_s, scan.rays, i, log.rolling_shutter);
        result.position_m.push_back(glm::vec3(ray.origin_m + double(scan.range_m[i]) * ray.direction));
        result.intensity.push_back(to_byte(scan.intensity[i]));
        result.drop.push_back(scan.range_m[i] > 0.0f ? 0 : 255);
    }
    return result;
}

Json pose_json(const Pose& pose) {
    const glm::dmat4 m = to_matrix(pose);
    Json result = Json::array();
    for (int column = 0; column < 4; ++column)
        for (int row = 0; row < 4; ++row) result.push_back(m[column][row]);
    return result;
}

std::string encode_scans(Json header, const ScanColumns* simulated, const ScanColumns* measured) {
    BinaryArrayPacker arrays;
    if (simulated) {
        header["image"] = {simulated->rows, simulated->columns};
        arrays.add_scan("", *simulated);
    }
    if (measured) {
        header["real_image"] = {measured->rows, measured->columns};
        arrays.add_scan("real_", *measured);
    }
    header["arrays"] = arrays.table_json();
    std::string header_text = header.dump(-1, ' ', false, Json::error_handler_t::replace);
    header_text.append((4 - header_text.size() % 4) % 4, ' ');  // Pads it to a multiple of 4 bytes.
    const auto header_length = static_cast<std::uint32_t>(header_text.size());
    std::string message = "RLV1";
    message.append(reinterpret_cast<const char*>(&header_length), sizeof header_length);
    return message + header_text + arrays.packed_bytes();
}

}  // namespace relidar::view
