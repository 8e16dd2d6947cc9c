// SPDX-License-Identifier: Apache-2.0
// Writes packets of Ouster's sensors (firmware user manual, "Lidar Data"). The encoder
// first writes the metadata and parses it. Then it writes packets in the format that the
// metadata describes. Signal and ambient light are 0, because a scan does not store them.
#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/bytes.hpp"
#include "log/packets/packet_format.hpp"
#include "log/readers/bag/packets/ouster.hpp"

namespace relidar::packets {
namespace {

constexpr int kOusterPort = 7502, kColumnsPerPacket = 16;
constexpr const char* kSerial = "100000000001";
constexpr std::uint64_t kSerialNumber = 100'000'000'001;
constexpr std::size_t kEndBytes = 32;  // size of the header and of the footer of a packet
// number of encoder ticks per turn in the legacy packet format
constexpr std::uint32_t kEncoderTicks = 90112;

/// Returns Ouster's name of a product line, such as "OS-1-64" for "OS1-64".
std::string get_product_line(const std::string& name) {
    return name.starts_with("OS") && name.size() > 3 && name[3] == '-' ? "OS-" + name.substr(2) : name;
}

/// Returns the first and the last column of the smallest azimuth window in which the
/// sensor fires. The window can cross the end of the image and continue at column 0.
std::array<int, 2> find_azimuth_window(const std::vector<bool>& fired) {
    const int n = int(fired.size());
    // Finds the longest run of columns that do not fire; `begin` is the column after it.
    int begin = 0, longest = 0;
    for (int start = 0; start < n; ++start) {
        int length = 0;
        while (length < n && !fired[std::size_t((start + length) % n)]) ++length;
        if (length > longest) longest = length, begin = (start + length) % n;
    }
    return longest == n ? std::array{0, n - 1} : std::array{begin, (begin + n - longest - 1) % n};
}

/// Returns the metadata of an Ouster sensor as JSON text. Ouster's LiDAR frame has its x
/// axis at the back, relidar's frame at the front. The metadata contain the transform.
std::string make_ouster_metadata(const SpinningSensor& sensor, const std::string& profile,
                                 const std::array<int, 2>& window) {
    std::vector<double> altitude_deg, azimuth_deg;
    std::vector<int> shift;
    for (const Beam& beam : sensor.beams) {
        altitude_deg.push_back(beam.elevation_rad * 180.0 / kPi);
        azimuth_deg.push_back(-beam.azimuth_offset_rad * 180.0 / kPi);
        shift.push_back(int(std::lround(azimuth_deg.back() * sensor.columns / 360.0)));
    }
    const nlohmann::ordered_json json = {
        {"prod_line", get_product_line(sensor.name)},
        {"prod_sn", kSerial},
        {"status", "RUNNING"},
        {"lidar_mode", fmt::format("{}x{}", sensor.columns, std::lround(1.0 / sensor.period_s))},
        {"udp_port_lidar", kOusterPort},
        {"beam_altitude_angles", altitude_deg},
        {"beam_azimuth_angles", azimuth_deg},
        {"lidar_origin_to_beam_origin_mm", 1000.0 * sensor.beams.front().origin_offset_m},
        {"lidar_to_sensor_transform", {-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}},
        {"data_format",
         {{"columns_per_frame", sensor.columns},
          {"columns_per_packet", kColumnsPerPacket},
          {"pixels_per_column", sensor.beams.size()},
          {"pixel_shift_by_row", shift},
          {"column_window", window},
          {"udp_profile_lidar", profile}}}};
    return json.dump(1) + "\n";
}

class OusterWriter : public PacketFormat {
public:
    OusterWriter(const SpinningSensor& sensor, const PacketOptions& options)
        : start_ns_(options.start_ns),
          sensor_(sensor),
          format_(read_ouster_metadata(
              make_ouster_metadata(sensor, profile_name(options), {0, sensor.columns - 1}), sensor.name)) {
        if (format_->profile->returns < options.returns)
            throw UsageError(fmt::format(
                "cannot write packets of {0}: the packet format {1} has only one return per ray, expected "
                "a format with two returns",
                sensor.name, format_->profile->name));
    }

    int port() const override { return kOusterPort; }
    int firings() const override { return format_->columns_per_packet; }
    double cycle_us() const override { return 1e6 * format_->sensor.period_s / columns(); }
    int columns() const override { return format_->sensor.columns; }
    std::vector<double> offsets_us() const override {
        return std::vector<double>(format_->sensor.beams.size(), 0.0);
    }
    PacketCalibration calibration(const std::vector<bool>& fired) const override {
        return {".json", make_ouster_metadata(sensor_, format_->profile->name, find_azimuth_window(fired))};
    }

    SensorPacket write(std::span<const FiredColumn> columns, std::uint32_t number) const override {
        const auto per_turn = std::uint32_t(format_->sensor.columns / format_->columns_per_packet);
        const auto frame = std::uint16_t(number / per_turn);
        const bool is_legacy = format_->profile->is_legacy;
        SensorPacket packet;
        if (!is_legacy) append_header(packet.bytes, frame);
        for (const FiredColumn& column : columns) {
            const std::int64_t time_ns = to_unix_ns(column.time_s, start_ns_);
            const int position = get_column_number(column);
            append(packet.bytes, std::uint64_t(std::max<std::int64_t>(time_ns, 0)));
            append(packet.bytes, std::uint16_t(position));
            if (is_legacy) {
                append(packet.bytes, frame);
                append(packet.bytes,
                       std::uint32_t(position) * (kEncoderTicks / std::uint32_t(this->columns())));
            } else {
                append(packet.bytes, std::uint16_t(column.is_measured));
            }
            append_pixels(packet.bytes, column);
            if (is_legacy) append(packet.bytes, column.is_measured ? 0xFFFFFFFFu : 0u);
            if (column.is_measured || packet.time_ns == 0) packet.time_ns = time_ns;
        }
        if (!is_legacy) packet.bytes.append(kEndBytes, '\0');
        return packet;
    }

private:
    const std::int64_t start_ns_;
    const SpinningSensor sensor_;
    const std::shared_ptr<const OusterFormat> format_;

    static std::string profile_name(const PacketOptions& options) {
        if (!options.ouster_profile.empty()) return options.ouster_profile;
        return options.returns == 2 ? "RNG19_RFL8_SIG16_NIR16_DUAL" : "RNG19_RFL8_SIG16_NIR16";
    }

    int get_column_number(const FiredColumn& column) const {
        const double place = (column.azimuth_deg - 180.0) / 360.0 * columns();
        return int((std::lround(place) + columns()) % columns());
    }

    /// Appends the packet type, the frame number, the initialization number of the sensor
    /// and the serial number.
    static void append_header(std::string& bytes, std::uint16_t frame) {
        const std::size_t begin = bytes.size();
        append(bytes, std::uint16_t(1));
        append(bytes, frame);
        bytes.append(3, '\0');
        for (int k = 0; k < 5; ++k) append(bytes, std::uint8_t(kSerialNumber >> (8 * k)));
        bytes.resize(begin + kEndBytes, '\0');
    }

    void append_pixels(std::string& bytes, const FiredColumn& column) const {
        const OusterProfile& profile = *format_->profile;
        for (const std::size_t ring : format_->ring_of) {
            std::string pixel(profile.pixel_bytes, '\0');
            for (int k = 0; k < profile.returns && !column.returns.empty(); ++k)
                set_return(pixel, 4 * std::size_t(k), column.returns[ring][std::size_t(k)],
                           format_->sensor.beams[ring].origin_offset_m);
            bytes += pixel;
        }
    }

    /// Writes the range and the reflectivity of a return into a pixel. Ouster's ranges
    /// start at the axis of rotation, so they include the distance of the beam origin
    /// from the axis.
    void set_return(std::string& pixel, std::size_t offset, const LaserReturn& echo, double start_m) const {
        const OusterProfile& profile = *format_->profile;
        if (echo.range_m <= 0.0f) return;
        const double range = std::round((double(echo.range_m) + start_m) / profile.range_unit_m);
        if (!(range >= 1.0 && range <= double(profile.range_bits))) return;
        const auto number = std::uint32_t(range);
        for (std::size_t k = 0; k < 4 && number >> (8 * k) != 0; ++k)
            pixel[offset + k] = char(number >> (8 * k));
        pixel[offset + profile.reflectivity_at] = char(to_reflectivity(echo));
    }
};

}  // namespace

std::unique_ptr<PacketFormat> make_ouster_format(const SpinningSensor& sensor, const PacketOptions& options) {
    if (!sensor.name.starts_with("OS") && sensor.name != "Ouster" && options.ouster_profile.empty())
        return nullptr;
    return std::make_unique<OusterWriter>(sensor, options);
}

}  // namespace relidar::packets
