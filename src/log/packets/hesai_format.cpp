// SPDX-License-Identifier: Apache-2.0
// Writes packets of Hesai's Pandar40P, Pandar64, PandarXT-16, PandarXT-32 and XT32M2X
// (user manuals, "Point cloud data packet"). Also writes the beam angles as a file for
// the drivers: "Laser id,Elevation,Azimuth" in degrees, azimuth clockwise.
#include <array>
#include <chrono>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/math.hpp>

#include "base/bytes.hpp"
#include "log/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

constexpr int kHesaiPort = 2368;
constexpr std::uint8_t kSingleReturn = 0x37, kLastAndStrongest = 0x39, kFactory = 0x42;
constexpr std::uint8_t kUnit_mm = 4;
constexpr std::int64_t kSecond_ns = 1'000'000'000;

struct HesaiProduct {
    const char* sensor;
    std::array<std::uint8_t, 12> header;
    std::size_t n_header;
    std::size_t reserved;  ///< number of bytes between the blocks and the motor speed or return mode
    bool is_xt;      ///< if true, the return mode is stored before the speed, and the date before the time
    int first_year;  ///< year from which the date is counted: 2000 for Pandar, 1900 for XT
};
// Header of a packet, and format of the fields after the blocks, for each product. The
// header of an XT contains: protocol version, numbers of lasers and blocks, position of
// the last return, unit in millimetres, number of returns, flag for packet numbers.
constexpr HesaiProduct kHesais[] = {
    {"Pandar40P", {}, 0, 8, false, 2000},
    {"Pandar64", {0xEE, 0xFF, 64, 6, 0, kUnit_mm, 0, 0}, 8, 8, false, 2000},
    {"XT32", {0xEE, 0xFF, 6, 1, 0, 0, 32, 8, 0, kUnit_mm, 1, 1}, 12, 10, true, 1900},
    {"XT16", {0xEE, 0xFF, 6, 1, 0, 0, 16, 8, 0, kUnit_mm, 1, 1}, 12, 10, true, 1900},
    {"XT32M", {0xEE, 0xFF, 6, 1, 0, 0, 32, 6, 0, kUnit_mm, 1, 1}, 12, 10, true, 1900},
};

class HesaiFormat : public PacketFormat {
public:
    HesaiFormat(const HesaiProduct& product, const SpinningSensor& sensor, const PacketOptions& options)
        : product_(product),
          sensor_(sensor),
          blocks_(find_layout_of_product(product.sensor), sensor, options) {}

    int port() const override { return kHesaiPort; }
    int firings() const override { return blocks_.firings(); }
    double cycle_us() const override { return blocks_.layout().cycle_us; }
    std::vector<double> offsets_us() const override { return blocks_.offsets_us(); }

    PacketCalibration calibration(const std::vector<bool>&) const override {
        std::vector<std::string> lines(blocks_.layout().lasers());
        for (std::size_t ring = 0; ring < lines.size(); ++ring) {
            const Beam& beam = sensor_.beams[ring];
            // azimuth of the laser relative to the head, minus the rotation of the head
            // from the start of the block until the laser fires
            const double azimuth_rad =
                -beam.azimuth_offset_rad - 2e-6 * kPi / sensor_.period_s * blocks_.offsets_us()[ring];
            const std::size_t laser = blocks_.find_laser(ring);
            lines[laser] = fmt::format("{},{:.4f},{:.4f}\n", laser + 1, beam.elevation_rad * 180.0 / kPi,
                                       azimuth_rad * 180.0 / kPi);
        }
        std::string text = "Laser id,Elevation,Azimuth\n";
        for (const std::string& line : lines) text += line;
        return {".csv", text};
    }

    SensorPacket write(std::span<const FiredColumn> columns, std::uint32_t number) const override {
        SensorPacket packet{blocks_.compute_packet_time_ns(columns, &FiredColumn::time_s), {}};
        const std::int64_t clock_ns = blocks_.compute_packet_time_ns(columns, &FiredColumn::clock_s);
        std::string& bytes = packet.bytes;
        bytes.append(product_.header.begin(), product_.header.begin() + std::ptrdiff_t(product_.n_header));
        // According to the manual, an XT32 stores the last return in the first of two
        // blocks.
        if (product_.is_xt && blocks_.is_dual()) bytes[8] = 1, bytes[10] = 2;
        blocks_.append_blocks(bytes, columns, 1e-3 * kUnit_mm);
        bytes.append(product_.reserved, '\0');
        const std::uint8_t mode = blocks_.is_dual() ? kLastAndStrongest : kSingleReturn;
        const auto speed_rpm = std::uint16_t(std::lround(60.0 / sensor_.period_s));
        const std::int64_t time_us = (clock_ns + 500) / 1000, second_us = kSecond_ns / 1000;
        if (product_.is_xt) append(bytes, mode);
        append(bytes, speed_rpm);
        if (product_.is_xt) append_date(bytes, time_us / second_us);
        append(bytes, std::uint32_t(time_us % second_us));
        if (!product_.is_xt) append(bytes, mode);
        append(bytes, kFactory);
        if (!product_.is_xt) append_date(bytes, time_us / second_us);
        append(bytes, number);
        return packet;
    }

private:
    const HesaiProduct& product_;
    SpinningSensor sensor_;
    BlockWriter blocks_;

    /// Appends year, month, day, hour, minute and second in UTC, with one byte each.
    void append_date(std::string& bytes, std::int64_t unix_s) const {
        using namespace std::chrono;
        const sys_seconds time{seconds(unix_s)};
        const sys_days day = floor<days>(time);
        const year_month_day date(day);
        const hh_mm_ss clock(time - day);
        append(bytes, std::uint8_t(int(date.year()) - product_.first_year));
        append(bytes, std::uint8_t(unsigned(date.month())));
        append(bytes, std::uint8_t(unsigned(date.day())));
        append(bytes, std::uint8_t(clock.hours().count()));
        append(bytes, std::uint8_t(clock.minutes().count()));
        append(bytes, std::uint8_t(clock.seconds().count()));
    }
};

}  // namespace

std::vector<std::string> list_hesai_names() {
    std::vector<std::string> names;
    for (const HesaiProduct& product : kHesais) names.emplace_back(product.sensor);
    return names;
}

std::unique_ptr<PacketFormat> make_hesai_format(const SpinningSensor& sensor, const PacketOptions& options) {
    for (const HesaiProduct& product : kHesais)
        if (sensor.name == product.sensor) return std::make_unique<HesaiFormat>(product, sensor, options);
    return nullptr;
}

}  // namespace relidar::packets
