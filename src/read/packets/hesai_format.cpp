// SPDX-License-Identifier: Apache-2.0
// Writes packets of Hesai's Pandar40P, Pandar64, PandarXT-16, PandarXT-32, XT32M2X,
// PandarQT, QT128C2X and OT128 (user manuals, "Point cloud data packet"). Also writes the
// beam angles as a file for the drivers: "Laser id,Elevation,Azimuth" in degrees, azimuth
// clockwise.
#include <array>
#include <chrono>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/math.hpp>

#include "base/bytes.hpp"
#include "read/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

constexpr std::uint8_t kSingleReturn = 0x37, kLastAndStrongest = 0x39, kFactory = 0x42;
constexpr std::uint8_t kRangeUnit_mm = 4;
constexpr std::int64_t kNsPerSecond = 1'000'000'000;

using HesaiHeader = std::array<std::uint8_t, 12>;
struct HesaiProduct {
    const char* layout;  ///< name in the table kLayouts
    HesaiHeader header;
    std::size_t n_header;
    std::size_t reserved;  ///< number of bytes between the blocks and the motor speed or return mode
    /// If true, the return mode is stored before the motor speed, and the date before the
    /// time.
    bool is_mode_first;
    int first_year;  ///< year from which the date is counted
    /// If true, a safety field and a checksum follow the blocks, and a second checksum
    /// ends the packet.
    bool has_checksums = false;
    std::uint8_t operation_mode = 0;  ///< byte before the return mode, if `is_mode_first`
    std::size_t motion_bytes = 0;     ///< size of the motion data after the packet number
};
// One row per product: the header of a packet and the fields after the blocks. A header
// of 12 bytes stores the protocol version, the numbers of lasers and blocks, and the
// position of the last return. Then it stores the unit in millimetres, the number of
// returns, and flags for the optional fields: 1 packet number, 2 motion data, 4 safety
// field.
constexpr HesaiHeader kOt128Header = {0xEE, 0xFF, 1, 4, 0, 0, 128, 2, 0, kRangeUnit_mm, 1, 7};
constexpr HesaiProduct kHesaiProducts[] = {
    {"Pandar40P", {}, 0, 8, false, 2000},
    {"Pandar64", {0xEE, 0xFF, 64, 6, 0, kRangeUnit_mm, 0, 0}, 8, 8, false, 2000},
    {"XT32", {0xEE, 0xFF, 6, 1, 0, 0, 32, 8, 0, kRangeUnit_mm, 1, 1}, 12, 10, true, 1900},
    {"XT16", {0xEE, 0xFF, 6, 1, 0, 0, 16, 8, 0, kRangeUnit_mm, 1, 1}, 12, 10, true, 1900},
    {"XT32M", {0xEE, 0xFF, 6, 1, 0, 0, 32, 6, 0, kRangeUnit_mm, 1, 1}, 12, 10, true, 1900},
    {"QT64", {0xEE, 0xFF, 3, 1, 0, 0, 64, 4, 0, kRangeUnit_mm, 1, 1}, 12, 10, false, 1900},
    {"QT128", {0xEE, 0xFF, 3, 2, 0, 0, 128, 2, 0, kRangeUnit_mm, 1, 5}, 12, 12, true, 1900, true},
    {"OT128", kOt128Header, 12, 12, true, 1900, true, 1, 22},
    {"OT128 in high resolution", kOt128Header, 12, 12, true, 1900, true, 0, 22},
};

/// Appends the checksum CRC-32/MPEG-2 of all bytes from `first_byte`.
void append_crc32(std::string& bytes, std::size_t first_byte) {
    std::uint32_t sum = 0xFFFFFFFF;
    for (std::size_t i = first_byte; i < bytes.size(); ++i) {
        sum ^= std::uint32_t(std::uint8_t(bytes[i])) << 24;
        for (int bit = 0; bit < 8; ++bit) sum = sum << 1 ^ (sum >> 31 ? 0x04C11DB7u : 0u);
    }
    append_raw(bytes, sum);
}

class HesaiFormat : public BlockWriter {
public:
    HesaiFormat(const HesaiProduct& product, const SpinningSensor& sensor, const PacketOptions& options)
        : BlockWriter(find_layout(product.layout), sensor, options), product_(product), sensor_(sensor) {}

    PacketCalibrationFile make_calibration(const std::vector<bool>&) const override {
        const std::vector<double> offsets_us = beam_delays();
        std::vector<std::string> lines(layout().n_lasers());
        for (std::size_t ring = 0; ring < sensor_.beams.size(); ++ring) {
            const Beam& beam = sensor_.beams[ring];
            // Azimuth at which the laser is mounted in the head. The offset of the beam
            // also includes the rotation during the firing delay of the laser.
            const double azimuth_rad =
                -beam.azimuth_offset_rad - 2e-6 * kPi / sensor_.period_s * offsets_us[ring];
            const std::size_t laser = laser_of_ring(ring);
            lines[laser] = fmt::format("{},{:.4f},{:.4f}\n", laser + 1, beam.elevation_rad * 180.0 / kPi,
                                       azimuth_rad * 180.0 / kPi);
        }
        std::string text = "Laser id,Elevation,Azimuth\n";
        for (const std::string& line : lines) text += line;
        return {".csv", text};
    }

    SensorPacket encode_packet(std::span<const FiringColumn> columns, std::uint32_t number) const override {
        SensorPacket packet{packet_time_ns(columns, number, &FiringColumn::time_s), {}};
        const std::int64_t clock_ns = packet_time_ns(columns, number, &FiringColumn::clock_s);
        std::string& bytes = packet.bytes;
        bytes.append(product_.header.begin(), product_.header.begin() + std::ptrdiff_t(product_.n_header));
        if (product_.n_header == 12 && is_dual()) {
            bytes[8] = 1;   // block that contains the last return (1: first block)
            bytes[10] = 2;  // number of returns
        }
        append_blocks(bytes, columns, number, 1e-3 * kRangeUnit_mm);
        if (product_.has_checksums) {
            append_crc32(bytes, product_.n_header);
            // safety field of a sensor without faults
            const std::size_t field_offset = bytes.size();
            append_raw(bytes, std::uint8_t(1));  // version
            bytes.append(12, '\0');
            append_crc32(bytes, field_offset + 1);
        }
        const std::size_t tail_offset = bytes.size();
        bytes.append(product_.reserved, '\0');
        write_mode(bytes, number);
        const std::uint8_t mode = is_dual() ? kLastAndStrongest : kSingleReturn;
        const auto speed_rpm = std::uint16_t(std::lround(60.0 / sensor_.period_s));
        const std::int64_t time_us = (clock_ns + 500) / 1000, second_us = kNsPerSecond / 1000;
        if (product_.is_mode_first) append_raw(bytes, mode);
        append_raw(bytes, speed_rpm);
        if (product_.is_mode_first) append_utc(bytes, time_us / second_us);
        append_raw(bytes, std::uint32_t(time_us % second_us));
        if (!product_.is_mode_first) append_raw(bytes, mode);
        append_raw(bytes, kFactory);
        if (!product_.is_mode_first) append_utc(bytes, time_us / second_us);
        append_raw(bytes, number);
        bytes.append(product_.motion_bytes, '\0');
        if (product_.has_checksums) append_crc32(bytes, tail_offset);
        return packet;
    }

private:
    const HesaiProduct& product_;
    SpinningSensor sensor_;

    /// Writes the operation mode of the sensor. If the lasers fire in two alternating
    /// sequences, also writes which sequence each block of the packet contains.
    void write_mode(std::string& bytes, std::uint32_t packet_number) const {
        const PacketLayout& layout = this->layout();
        bytes.back() = char(product_.operation_mode);
        if (layout.part_rule == FiringSequenceRule::mode_flag)
            bytes[layout.part_at] = char(1 - sequence_of_block(0, packet_number));
        if (layout.part_rule != FiringSequenceRule::azimuth_state) return;
        for (std::size_t block = 0; block < layout.n_blocks; ++block)
            bytes[layout.part_at + 1] |= char(sequence_of_block(block, packet_number) << (6 - 2 * block));
    }

    /// Appends year, month, day, hour, minute and second in UTC, with one byte each.
    void append_utc(std::string& bytes, std::int64_t unix_s) const {
        using namespace std::chrono;
        const sys_seconds time{seconds(unix_s)};
        const sys_days day = floor<days>(time);
        const year_month_day date(day);
        const hh_mm_ss clock(time - day);
        for (const long value : {long(int(date.year()) - product_.first_year), long(unsigned(date.month())),
                                 long(unsigned(date.day())), long(clock.hours().count()),
                                 long(clock.minutes().count()), long(clock.seconds().count())})
            append_raw(bytes, std::uint8_t(value));
    }
};

}  // namespace

std::vector<std::string> hesai_names() {
    std::vector<std::string> names;
    for (const HesaiProduct& product : kHesaiProducts)
        if (const std::string sensor = find_layout(product.layout).sensor; sensor == product.layout)
            names.push_back(sensor);
    return names;
}

std::unique_ptr<PacketFormat> make_hesai(const SpinningSensor& sensor, const PacketOptions& options) {
    const HesaiProduct* best = nullptr;
    double least_error = 0.0;
    for (const HesaiProduct& product : kHesaiProducts) {
        const PacketLayout& layout = find_layout(product.layout);
        if (sensor.name != layout.sensor) continue;
        // Chooses the product with the nearest time between two scan columns. The error
        // is relative, plus 1 if the numbers of beams differ.
        const double step_us = 1e6 * sensor.period_s / sensor.columns;
        const double expected_us =
            layout.cycle_us * double(layout.n_sequences()) / count_columns(layout, sensor);
        const bool fits =
            sensor.beams.size() == layout.n_lasers() || sensor.beams.size() == list_beams(layout).size();
        const double error = std::abs(step_us / expected_us - 1.0) + (fits ? 0.0 : 1.0);
        if (!best || error < least_error) {
            best = &product;
            least_error = error;
        }
    }
    return best ? std::make_unique<HesaiFormat>(*best, sensor, options) : nullptr;
}

}  // namespace relidar::packets
