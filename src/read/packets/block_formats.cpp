// SPDX-License-Identifier: Apache-2.0
// Writes the packets of Velodyne and Hesai, which consist of blocks. block_decoder.cpp
// describes them and lists the manuals. Also writes the beam angles of a Hesai as a file
// for the drivers: "Laser id,Elevation,Azimuth" in degrees, azimuth clockwise.
#include <algorithm>
#include <chrono>
#include <cmath>

#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/bytes.hpp"
#include "base/fail.hpp"
#include "read/packets/block_layouts.hpp"
#include "read/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

// maximum angle between a beam and its nominal elevation
constexpr double kMostAngle_rad = 1.0 * kPi / 180.0;
constexpr double kMostRange = 65535.0;
constexpr std::size_t kNoBeam = std::size_t(-1);  // for a laser that does not fire

constexpr std::uint8_t kSingleReturn = 0x37, kTwoReturns = 0x39, kFactory = 0x42;
constexpr std::uint8_t kRangeUnit_mm = 4;
constexpr std::int64_t kNsPerSecond = 1'000'000'000, kNsPerHour = 3600 * kNsPerSecond;

/// Throws if the beam angles of a sensor differ from those of the product. Drivers would
/// compute wrong points, because they use the product's.
void check_beams(const PacketLayout& layout, const std::vector<PacketBeam>& product_beams,
                 const SpinningSensor& sensor) {
    const auto nominal = std::get<SpinningSensor>(find_built_in(layout.sensor)->pattern);
    const bool fits =
        product_beams.size() == sensor.beams.size() &&
        std::ranges::equal(product_beams, sensor.beams, [&](const PacketBeam& first, const Beam& second) {
            return std::abs(nominal.beams[first.line].elevation_rad - second.elevation_rad) < kMostAngle_rad;
        });
    if (!fits)
        fail<UsageError>(
            "cannot write packets of {}: found {} beams, expected the {} beams of the data sheet",
            layout.sensor, sensor.beams.size(), nominal.beams.size());
    if (!sensor.clockwise)
        fail<UsageError>("cannot write packets of {}: it turns counter-clockwise, expected clockwise",
                         layout.sensor);
}

const PacketLayout& find_layout(const std::string& product_name) {
    return *std::ranges::find_if(kLayouts, [&](const PacketLayout& row) { return product_name == row.name; });
}

/// Returns the number of scan columns that form one firing, like
/// PacketFormat::columns_per_firing(). Scans that were decoded from packets store both
/// sequences in one column.
int count_columns(const PacketLayout& layout, const SpinningSensor& sensor) {
    return sensor.beams.size() == layout.n_lasers() ? int(layout.n_sequences()) : 1;
}

/// Packets of Velodyne and Hesai, which consist of the same kind of blocks.
class BlockWriter : public PacketFormat {
public:
    /// @throws UsageError if `sensor` does not have the beams that `layout` describes
    BlockWriter(const PacketLayout& layout, const SpinningSensor& sensor, const PacketOptions& options)
        : layout_(layout),
          returns_(std::max(options.returns, 1)),
          columns_per_firing_(count_columns(layout, sensor)),
          unit_(options.unit),
          start_ns_(options.start_ns),
          sequence_deg_(360e-6 * layout.cycle_us / sensor.period_s),
          beams_(list_beams(layout)) {
        // Beams (rows) that the scan must have. A laser that fires in both firing
        // sequences is twice in `beams_`. It has one row if the scan stores each sequence
        // in a column.
        std::vector<PacketBeam> fired = beams_;
        if (columns_per_firing_ > 1) {
            const auto repeats = std::ranges::unique(fired, {}, &PacketBeam::line);
            fired.erase(repeats.begin(), repeats.end());
        }
        check_beams(layout, fired, sensor);
        if (layout.n_blocks % (layout.banks * std::size_t(returns_)) != 0)
            fail<UsageError>("cannot write packets of {}: found {} returns per ray, expected 1",
                             layout.sensor, options.returns);
        ring_of_.assign(layout.n_sequences(), std::vector<std::size_t>(layout.n_lasers(), kNoBeam));
        for (std::size_t ring = 0; ring < beams_.size(); ++ring)
            ring_of_[beams_[ring].sequence][beams_[ring].laser] = ring;
        for (const PacketBeam& beam : fired) {
            laser_of_.push_back(beam.laser);
            offsets_us_.push_back(columns_per_firing_ > 1 ? mean_delay_us(beam.laser) : beam.offset_us);
        }
    }

    int udp_port() const override { return 2368 + 2 * unit_; }
    double firing_period_us() const override { return layout_.cycle_us * double(layout_.n_sequences()); }
    int columns_per_firing() const override { return columns_per_firing_; }
    std::vector<double> beam_delays() const override { return offsets_us_; }
    int packets_per_firing() const override {
        return int(std::max<std::size_t>(count_blocks() / layout_.n_blocks, 1));
    }

    int firings_per_packet() const override {
        return int(layout_.n_blocks * std::size_t(packets_per_firing()) * layout_.firings / count_blocks());
    }
    std::vector<FiringColumn> merge_columns(std::vector<FiringColumn> scan_columns) const override {
        if (columns_per_firing_ == 1) return scan_columns;
        std::vector<FiringColumn> firings;
        for (std::size_t c = 0; c < scan_columns.size(); ++c) {
            FiringColumn& firing = firings.emplace_back(std::move(scan_columns[c]));
            // The scan stores the two sequences of a firing in neighbouring columns. If
            // the second column is missing, the second sequence has no returns.
            const bool has_next = c + 1 < scan_columns.size() &&
                                  scan_columns[c + 1].time_s - firing.time_s < 1.5e-6 * layout_.cycle_us;
            const std::vector<std::array<DecodedReturn, 2>> none(firing.returns.size());
            const std::vector<std::array<DecodedReturn, 2>> of_sequence[] = {
                firing.returns, has_next ? scan_columns[c + 1].returns : none};
            firing.returns.clear();
            for (const PacketBeam& beam : beams_)
                firing.returns.push_back(of_sequence[beam.sequence][beam.line]);
            if (!has_next) continue;
            if (scan_columns[c + 1].has_returns) firing.has_returns = true;
            ++c;
        }
        return firings;
    }

protected:
    const PacketLayout& layout() const { return layout_; }
    bool is_dual() const { return returns_ == 2; }
    /// Returns the manufacturer's number, from 0, of the laser of a ring.
    std::size_t laser_of_ring(std::size_t ring) const { return laser_of_[ring]; }

    /// Returns the firing sequence of a block, which is one of `n_here` in its packet.
    std::size_t sequence_of_block(std::size_t block_index, std::uint32_t packet_number) const {
        const auto n_packets = std::size_t(packets_per_firing()), n_here = layout_.n_sequences() / n_packets;
        return packet_number % n_packets * n_here +
               block_index / (layout_.banks * std::size_t(returns_)) % n_here;
    }

    /// Appends all blocks of a packet. A block has a flag (for some products), the
    /// azimuth in 0.01 degrees, and the returns of its firings.
    void append_blocks(std::string& bytes, std::span<const FiringColumn> firings, std::uint32_t packet_number,
                       double range_unit_m) const {
        const std::size_t n_returns = std::size_t(returns_);
        const std::size_t n_joined = count_blocks() / std::size_t(packets_per_firing());  // of equal firings
        for (std::size_t block = 0; block < layout_.n_blocks; ++block) {
            const auto block_firings = firings.subspan(block / n_joined * layout_.firings, layout_.firings);
            const BlockIndex block_index{sequence_of_block(block, packet_number),
                                         block / n_returns % layout_.banks, block % n_returns};
            // The flag names the group of lasers: FF EE, FF DD, FF CC or FF BB.
            if (layout_.flagged) append_raw(bytes, std::uint16_t(0xEEFF - 0x1100 * block_index.bank));
            const double azimuth_deg =
                block_firings.front().azimuth_deg + double(block_index.sequence) * sequence_deg_;
            append_raw(bytes,
                       std::uint16_t(std::lround(100.0 * (azimuth_deg + layout_.forward_deg)) % 36000));
            for (const FiringColumn& firing : block_firings)
                append_returns(bytes, firing, block_index, range_unit_m);
        }
    }

    /// Returns the time of a packet in nanoseconds since 1970.
    /// @param firing_time_member  FiringColumn::time_s or FiringColumn::clock_s
    std::int64_t packet_time_ns(std::span<const FiringColumn> firings, std::uint32_t packet_number,
                                double FiringColumn::*firing_time_member) const {
        const double shift_s = 1e-6 * layout_.shift_us;
        if (!layout_.at_end) return to_unix_ns(firings.front().*firing_time_member - shift_s, start_ns_);
        const double sequence_s =
            1e-6 * layout_.cycle_us * double(sequence_of_block(layout_.n_blocks - 1, packet_number));
        return to_unix_ns(firings.back().*firing_time_member + sequence_s - shift_s, start_ns_);
    }

private:
    /// Indices of the firing sequence, of the group of lasers, and of the return.
    struct BlockIndex {
        std::size_t sequence, bank, number;
    };

    const PacketLayout& layout_;
    int returns_;             ///< returns per ray, 1 or 2
    int columns_per_firing_;  ///< see PacketFormat
    int unit_;                ///< number of the sensor in its rig, which selects the UDP port
    std::int64_t start_ns_;
    double sequence_deg_;            ///< rotation of the head between two firing sequences
    std::vector<PacketBeam> beams_;  ///< beams of a firing
    /// [rings] delay of each laser
    std::vector<double> offsets_us_;
    std::vector<std::size_t> laser_of_;
    /// [firing sequences, lasers] index in FiringColumn::returns
    std::vector<std::vector<std::size_t>> ring_of_;

    /// Returns the mean delay of a laser after the start of a firing sequence, over all
    /// sequences in which the laser fires.
    double mean_delay_us(std::size_t laser) const {
        double sum_us = 0.0, n = 0.0;
        for (const PacketBeam& beam : beams_) {
            if (beam.laser != laser) continue;
            sum_us += beam.offset_us - layout_.cycle_us * double(beam.sequence);
            n += 1.0;
        }
        return sum_us / n;
    }

    std::size_t count_blocks() const { return layout_.banks * std::size_t(returns_) * layout_.n_sequences(); }

    /// Appends range and reflectivity of each laser of a block, 0 without a return.
    void append_returns(std::string& bytes, const FiringColumn& firing, const BlockIndex& block_position,
                        double range_unit_m) const {
        for (std::size_t k = 0; k < layout_.block_lasers; ++k) {
            const std::size_t ring =
                ring_of_[block_position.sequence][block_position.bank * layout_.block_lasers + k];
            DecodedReturn echo;
            if (!firing.returns.empty() && ring != kNoBeam) {
                const auto& [first, second] = firing.returns[ring];
                // With two returns, block 0 of a pair holds the last (farther) return,
                // block 1 the other.
                const bool is_second_far = second.range_m > first.range_m,
                           wants_far = block_position.number == 0;
                const bool has_second = is_dual() && second.range_m > 0.0f;
                echo = has_second && is_second_far == wants_far ? second : first;
            }
            const double range = std::round(double(echo.range_m) / range_unit_m);
            // Range numbers up to last_marker mean that the laser has no return.
            const bool is_valid = range > layout_.last_marker && range <= kMostRange;
            append_raw(bytes, is_valid ? std::uint16_t(range) : std::uint16_t(0));
            append_raw(bytes, is_valid ? to_reflectivity(echo) : std::uint8_t(0));
            bytes.append(layout_.unit_bytes - 3, '\0');
        }
    }
};

/// Packets of Velodyne: the blocks, time, return mode and product number.
class VelodyneFormat : public BlockWriter {
public:
    VelodyneFormat(const VelodyneProduct& product, const SpinningSensor& sensor, const PacketOptions& options)
        : BlockWriter(find_layout(product.sensor), sensor, options), code_(product.code) {}

    SensorPacket encode_packet(std::span<const FiringColumn> columns, std::uint32_t number) const override {
        SensorPacket packet{packet_time_ns(columns, number, &FiringColumn::time_s), {}};
        const std::int64_t clock_ns = packet_time_ns(columns, number, &FiringColumn::clock_s);
        append_blocks(packet.bytes, columns, number, layout().range_unit_m);
        append_raw(packet.bytes, std::uint32_t((clock_ns + 500) % kNsPerHour / 1000));
        append_raw(packet.bytes, is_dual() ? kTwoReturns : kSingleReturn);
        append_raw(packet.bytes, code_);
        return packet;
    }

private:
    std::uint8_t code_;
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

/// Packets of Hesai: a header, the blocks, and fields of the product.
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
        bytes.append(product_.header);
        if (product_.header.size() == 12 && is_dual()) {
            bytes[8] = 1;   // block that contains the last return (1: first block)
            bytes[10] = 2;  // number of returns
        }
        append_blocks(bytes, columns, number, 1e-3 * kRangeUnit_mm);
        if (product_.has_checksums) {
            append_crc32(bytes, product_.header.size());
            // safety field of a sensor without faults
            const std::size_t field_offset = bytes.size();
            append_raw(bytes, std::uint8_t(1));  // version
            bytes.append(12, '\0');
            append_crc32(bytes, field_offset + 1);
        }
        const std::size_t tail_offset = bytes.size();
        bytes.append(product_.reserved, '\0');
        write_mode(bytes, number);
        const std::uint8_t mode = is_dual() ? kTwoReturns : kSingleReturn;
        const auto speed_rpm = std::uint16_t(std::lround(60.0 / sensor_.period_s));
        const std::int64_t time_us = (clock_ns + 500) / 1000, us_per_second = kNsPerSecond / 1000;
        if (product_.is_mode_first) append_raw(bytes, mode);
        append_raw(bytes, speed_rpm);
        if (product_.is_mode_first) append_utc(bytes, time_us / us_per_second);
        append_raw(bytes, std::uint32_t(time_us % us_per_second));
        if (!product_.is_mode_first) append_raw(bytes, mode);
        append_raw(bytes, kFactory);
        if (!product_.is_mode_first) append_utc(bytes, time_us / us_per_second);
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
        if (layout.sequence_rule == FiringSequenceRule::mode_flag)
            bytes[layout.sequence_at] = char(1 - sequence_of_block(0, packet_number));
        if (layout.sequence_rule != FiringSequenceRule::azimuth_state) return;
        for (std::size_t block = 0; block < layout.n_blocks; ++block)
            bytes[layout.sequence_at + 1] |= char(sequence_of_block(block, packet_number) << (6 - 2 * block));
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

std::int64_t to_unix_ns(double log_time_s, std::int64_t log_start_unix_ns) {
    return log_start_unix_ns + std::llround(1e9 * log_time_s);
}

std::uint8_t to_reflectivity(const DecodedReturn& laser_return) {
    return std::uint8_t(std::lround(255.0 * std::clamp(double(laser_return.intensity), 0.0, 1.0)));
}

std::vector<BlockSensor> block_sensors() {
    std::vector<BlockSensor> sensors;
    for (const VelodyneProduct& product : kVelodyneProducts) sensors.push_back({product.sensor, "Velodyne"});
    for (const HesaiProduct& product : kHesaiProducts)  // a sensor in another mode has another layout
        if (find_layout(product.layout).sensor == std::string(product.layout))
            sensors.push_back({product.layout, "Hesai"});
    return sensors;
}

std::unique_ptr<PacketFormat> make_velodyne(const SpinningSensor& sensor, const PacketOptions& options) {
    for (const VelodyneProduct& product : kVelodyneProducts)
        if (sensor.name == product.sensor) return std::make_unique<VelodyneFormat>(product, sensor, options);
    return nullptr;
}

/// Several products can have the same sensor, for example in two modes. Chooses the one
/// whose number of beams and time between two scan columns match best.
std::unique_ptr<PacketFormat> make_hesai(const SpinningSensor& sensor, const PacketOptions& options) {
    // relative error of the time between columns, plus 1 if the number of beams differs
    const auto mismatch = [&](const HesaiProduct& product) -> double {
        const PacketLayout& layout = find_layout(product.layout);
        if (sensor.name != layout.sensor) return INFINITY;
        const double step_us = 1e6 * sensor.period_s / sensor.columns;
        const double expected_us =
            layout.cycle_us * double(layout.n_sequences()) / count_columns(layout, sensor);
        const bool has_its_beams =
            sensor.beams.size() == layout.n_lasers() || sensor.beams.size() == list_beams(layout).size();
        return std::abs(step_us / expected_us - 1.0) + (has_its_beams ? 0.0 : 1.0);
    };
    const HesaiProduct& best = *std::ranges::min_element(kHesaiProducts, {}, mismatch);
    if (sensor.name != find_layout(best.layout).sensor) return nullptr;
    return std::make_unique<HesaiFormat>(best, sensor, options);
}

}  // namespace relidar::packets
