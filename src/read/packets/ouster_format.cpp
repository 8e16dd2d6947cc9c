// SPDX-License-Identifier: Apache-2.0
// Writes packets of Ouster's sensors (firmware user manual, "Lidar Data"). The encoder
// first creates the metadata and parses them. Then it writes packets in the format that
// the metadata describe. Signal and ambient light are 0, which no scan stores.
#include <algorithm>
#include <array>
#include <cmath>

#include <nlohmann/json.hpp>

#include <relidar/base/math.hpp>

#include "base/bytes.hpp"
#include "base/fail.hpp"
#include "base/geometry/circular_gap.hpp"
#include "read/packets/ouster.hpp"
#include "read/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

constexpr int kOusterPort = 7502, kColumnsPerPacket = 16;
constexpr std::uint64_t kSerialNumber = 100'000'000'001;
constexpr std::size_t kEndBytes = 32;  // size of the header and of the footer of a packet
// number of encoder ticks per turn in the legacy packet format
constexpr std::uint32_t kEncoderTicks = 90112;

/// Returns the first and the last column of the smallest azimuth window with all columns
/// in which the sensor fires. The window may cross the end of the range image.
std::array<int, 2> find_window(const std::vector<bool>& column_has_fired) {
    const int n = int(column_has_fired.size());
    // The window is the circle without its widest gap.
    const CircularGap gap =
        find_widest_gap(std::size_t(n), [&](std::size_t c) { return column_has_fired[c]; });
    const int n_empty = int(gap.length);
    if (n_empty >= n) return {0, n - 1};
    const int begin = int(gap.end) % n;
    return {begin, (begin + n - n_empty - 1) % n};
}

/// Returns the metadata of an Ouster sensor as JSON text. The x axis of Ouster's LiDAR
/// frame points backward; the metadata contain the transform.
std::string write_metadata(const SpinningSensor& sensor, const std::string& packet_profile,
                           const std::array<int, 2>& column_window, int udp_port) {
    // In Ouster's metadata, the product line of "OS1-64" is called "OS-1-64".
    const bool has_short_name =
        sensor.name.starts_with("OS") && sensor.name.size() > 3 && sensor.name[3] == '-';
    const std::string product_line = has_short_name ? "OS-" + sensor.name.substr(2) : sensor.name;
    std::vector<double> altitude_deg, azimuth_deg;
    std::vector<int> shift;
    for (const Beam& beam : sensor.beams) {
        altitude_deg.push_back(beam.elevation_rad * 180.0 / kPi);
        azimuth_deg.push_back(-beam.azimuth_offset_rad * 180.0 / kPi);
        shift.push_back(int(std::lround(azimuth_deg.back() * sensor.columns / 360.0)));
    }
    const nlohmann::ordered_json json = {
        {"prod_line", product_line},
        {"prod_sn", std::to_string(kSerialNumber)},
        {"status", "RUNNING"},
        {"lidar_mode", fmt::format("{}x{}", sensor.columns, std::lround(1.0 / sensor.period_s))},
        {"udp_port_lidar", udp_port},
        {"udp_port_imu", udp_port + 1},
        {"beam_altitude_angles", altitude_deg},
        {"beam_azimuth_angles", azimuth_deg},
        {"lidar_origin_to_beam_origin_mm", 1000.0 * sensor.beams.front().origin_offset_m},
        {"lidar_to_sensor_transform", {-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}},
        {"data_format",
         {{"columns_per_frame", sensor.columns},
          {"columns_per_packet", kColumnsPerPacket},
          {"pixels_per_column", sensor.beams.size()},
          {"pixel_shift_by_row", shift},
          {"column_window", column_window},
          {"udp_profile_lidar", packet_profile}}}};
    return json.dump(1) + "\n";
}

class OusterWriter : public PacketFormat {
public:
    OusterWriter(const SpinningSensor& sensor, const PacketOptions& options)
        : start_ns_(options.start_ns),
          // Each sensor of a rig has two UDP ports, one after the other.
          port_(kOusterPort + 2 * options.unit),
          sensor_(sensor),
          // Parses the metadata that it writes, so that encoder and decoder agree.
          format_(parse_metadata(
              write_metadata(sensor, choose_profile(options), {0, sensor.columns - 1}, port_), sensor.name)) {
        if (format_->profile->returns < options.returns)
            fail<UsageError>("cannot write packets of {}: the format {} has one return per ray, expected two",
                             sensor.name, format_->profile->name);
    }

    int udp_port() const override { return port_; }
    int firings_per_packet() const override { return format_->columns_per_packet; }
    double firing_period_us() const override { return 1e6 * format_->sensor.period_s / fixed_columns(); }
    int fixed_columns() const override { return format_->sensor.columns; }
    std::vector<double> beam_delays() const override {
        return std::vector<double>(format_->sensor.beams.size(), 0.0);
    }
    PacketCalibrationFile make_calibration(const std::vector<bool>& fired) const override {
        return {".json", write_metadata(sensor_, format_->profile->name, find_window(fired), port_)};
    }

    /// Encodes the columns of one packet. A column has a time stamp, its number, a status
    /// and its pixels. Legacy packets have no header and no footer.
    SensorPacket encode_packet(std::span<const FiringColumn> columns, std::uint32_t number) const override {
        const auto packets_per_revolution =
            std::uint32_t(format_->sensor.columns / format_->columns_per_packet);
        const auto frame = std::uint16_t(number / packets_per_revolution);
        const bool is_legacy = format_->profile->is_legacy;
        SensorPacket packet;
        if (!is_legacy) {
            append_raw(packet.bytes, std::uint16_t(1));  // packet type
            append_raw(packet.bytes, frame);
            packet.bytes.append(3, '\0');  // initialization number of the sensor
            for (int k = 0; k < 5; ++k) append_raw(packet.bytes, std::uint8_t(kSerialNumber >> (8 * k)));
            packet.bytes.resize(kEndBytes, '\0');
        }
        for (const FiringColumn& column : columns) {
            const std::int64_t time_ns = to_unix_ns(column.time_s, start_ns_);
            const int n = format_->sensor.columns;
            // Number of the column; column 0 faces backward (180 degrees).
            const auto position = int((std::lround((column.azimuth_deg - 180.0) / 360.0 * n) + n) % n);
            append_raw(packet.bytes, std::uint64_t(std::max<std::int64_t>(time_ns, 0)));
            append_raw(packet.bytes, std::uint16_t(position));
            if (is_legacy) {
                append_raw(packet.bytes, frame);
                append_raw(packet.bytes, std::uint32_t(position) * (kEncoderTicks / std::uint32_t(n)));
            } else {
                append_raw(packet.bytes, std::uint16_t(column.is_measured));
            }
            append_pixels(packet.bytes, column);
            if (is_legacy) append_raw(packet.bytes, column.is_measured ? 0xFFFFFFFFu : 0u);
            if (column.is_measured || packet.time_ns == 0) packet.time_ns = time_ns;
        }
        if (!is_legacy) packet.bytes.append(kEndBytes, '\0');
        return packet;
    }

private:
    const std::int64_t start_ns_;
    const int port_;
    const SpinningSensor sensor_;
    const std::shared_ptr<const OusterMetadata> format_;

    static std::string choose_profile(const PacketOptions& options) {
        if (!options.ouster_profile.empty()) return options.ouster_profile;
        return options.returns == 2 ? "RNG19_RFL8_SIG16_NIR16_DUAL" : "RNG19_RFL8_SIG16_NIR16";
    }

    /// Appends the pixels of a column, in the order of beams in the metadata.
    void append_pixels(std::string& bytes, const FiringColumn& column) const {
        const OusterProfile& profile = *format_->profile;
        for (const std::size_t ring : format_->ring_of) {
            const std::size_t at = bytes.size();
            bytes.append(profile.pixel_bytes, '\0');
            for (int k = 0; k < profile.returns && !column.returns.empty(); ++k)
                write_pixel(&bytes[at + 4 * std::size_t(k)], column.returns[ring][std::size_t(k)],
                            format_->sensor.beams[ring].origin_offset_m);
        }
    }

    /// Writes the range and the reflectivity of a return into a pixel. Ouster's ranges
    /// begin at the axis of rotation, so adds the beam's distance from it.
    void write_pixel(char* pixel, const DecodedReturn& laser_return, double beam_origin_offset_m) const {
        const OusterProfile& profile = *format_->profile;
        if (laser_return.range_m <= 0.0f) return;
        const double range =
            std::round((double(laser_return.range_m) + beam_origin_offset_m) / profile.range_unit_m);
        if (!(range >= 1.0 && range <= double(profile.range_bits))) return;
        const auto number = std::uint32_t(range);
        // Leaves bytes that are 0, because they can belong to another value.
        for (std::size_t k = 0; k < 4 && number >> (8 * k) != 0; ++k) pixel[k] = char(number >> (8 * k));
        pixel[profile.reflectivity_at] = char(to_reflectivity(laser_return));
    }
};

}  // namespace

std::unique_ptr<PacketFormat> make_ouster(const SpinningSensor& sensor, const PacketOptions& options) {
    if (!sensor.name.starts_with("OS") && sensor.name != "Ouster" && options.ouster_profile.empty())
        return nullptr;
    return std::make_unique<OusterWriter>(sensor, options);
}

}  // namespace relidar::packets
