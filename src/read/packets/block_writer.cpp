// SPDX-License-Identifier: Apache-2.0
// Writes the blocks of Velodyne's and Hesai's packets. With two returns per ray, a pair
// of blocks holds the same firings. The first block holds the last return. The second
// block holds the strongest return, or the second strongest if the last return is the
// strongest.
#include <algorithm>
#include <cmath>

#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/bytes.hpp"
#include "base/fail.hpp"
#include "read/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

// maximum angle between a beam and its nominal elevation
constexpr double kMostAngle_rad = 1.0 * kPi / 180.0;
constexpr double kMostRange = 65535.0;
constexpr std::size_t kNoBeam = std::size_t(-1);  // for a laser that does not fire

/// Throws if the beam angles of a sensor differ from those of the product. Drivers
/// compute points with the angles of the product, so other angles would give wrong
/// points.
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

}  // namespace

const PacketLayout& find_layout(const std::string& product_name) {
    return *std::ranges::find_if(kLayouts, [&](const PacketLayout& row) { return product_name == row.name; });
}

std::int64_t to_unix_ns(double log_time_s, std::int64_t log_start_unix_ns) {
    return log_start_unix_ns + std::llround(1e9 * log_time_s);
}

std::uint8_t to_reflectivity(const LaserReturn& laser_return) {
    return std::uint8_t(std::lround(255.0 * std::clamp(double(laser_return.intensity), 0.0, 1.0)));
}

int count_columns(const PacketLayout& layout, const SpinningSensor& sensor) {
    return sensor.beams.size() == layout.n_lasers() ? int(layout.n_sequences()) : 1;
}

BlockWriter::BlockWriter(const PacketLayout& layout, const SpinningSensor& sensor,
                         const PacketOptions& options)
    : layout_(layout),
      returns_(std::max(options.returns, 1)),
      columns_per_firing_(count_columns(layout, sensor)),
      unit_(options.unit),
      start_ns_(options.start_ns),
      sequence_deg_(360e-6 * layout.cycle_us / sensor.period_s),
      beams_(list_beams(layout)) {
    // Beams (rows) that the scan must have. A laser that fires in both firing sequences
    // is twice in `beams_`. It has one row if the scan stores each sequence in a column.
    std::vector<PacketBeam> fired = beams_;
    if (columns_per_firing_ > 1) {
        const auto repeats = std::ranges::unique(fired, {}, &PacketBeam::line);
        fired.erase(repeats.begin(), repeats.end());
    }
    check_beams(layout, fired, sensor);
    if (layout.n_blocks % (layout.banks * std::size_t(returns_)) != 0)
        fail<UsageError>("cannot write packets of {}: found {} returns per ray, expected 1", layout.sensor,
                         options.returns);
    ring_of_.assign(layout.n_sequences(), std::vector<std::size_t>(layout.n_lasers(), kNoBeam));
    for (std::size_t ring = 0; ring < beams_.size(); ++ring)
        ring_of_[beams_[ring].part][beams_[ring].laser] = ring;
    for (const PacketBeam& beam : fired) {
        laser_of_.push_back(beam.laser);
        offsets_us_.push_back(columns_per_firing_ > 1 ? mean_delay_us(beam.laser) : beam.offset_us);
    }
}

/// Returns the mean delay of a laser after the start of a firing sequence, over all
/// sequences in which the laser fires.
double BlockWriter::mean_delay_us(std::size_t laser) const {
    double sum_us = 0.0, n = 0.0;
    for (const PacketBeam& beam : beams_) {
        if (beam.laser != laser) continue;
        sum_us += beam.offset_us - layout_.cycle_us * double(beam.part);
        n += 1.0;
    }
    return sum_us / n;
}

int BlockWriter::packets_per_firing() const {
    return int(std::max<std::size_t>(count_blocks() / layout_.n_blocks, 1));
}

int BlockWriter::firings_per_packet() const {
    return int(layout_.n_blocks * std::size_t(packets_per_firing()) * layout_.firings / count_blocks());
}

std::vector<FiringColumn> BlockWriter::merge_columns(std::vector<FiringColumn> scan_columns) const {
    if (columns_per_firing_ == 1) return scan_columns;
    std::vector<FiringColumn> firings;
    for (std::size_t c = 0; c < scan_columns.size(); ++c) {
        FiringColumn& firing = firings.emplace_back(std::move(scan_columns[c]));
        // The scan stores the two sequences of a firing in neighbouring columns. If the
        // second column is missing, the second sequence has no returns.
        const bool has_next = c + 1 < scan_columns.size() &&
                              scan_columns[c + 1].time_s - firing.time_s < 1.5e-6 * layout_.cycle_us;
        const std::vector<std::array<LaserReturn, 2>> none(firing.returns.size());
        const std::vector<std::array<LaserReturn, 2>> of_part[] = {
            firing.returns, has_next ? scan_columns[c + 1].returns : none};
        firing.returns.clear();
        for (const PacketBeam& beam : beams_) firing.returns.push_back(of_part[beam.part][beam.line]);
        if (!has_next) continue;
        firing.has_returns |= scan_columns[c + 1].has_returns;
        ++c;
    }
    return firings;
}

/// Appends the range and the reflectivity of each laser of a block. A laser without a
/// return gets zeros.
void BlockWriter::append_returns(std::string& bytes, const FiringColumn& firing,
                                 const BlockIndex& block_position, double range_unit_m) const {
    for (std::size_t k = 0; k < layout_.block_lasers; ++k) {
        const std::size_t ring =
            ring_of_[block_position.part][block_position.bank * layout_.block_lasers + k];
        LaserReturn echo;
        if (!firing.returns.empty() && ring != kNoBeam) {
            const auto& [first, second] = firing.returns[ring];
            // With two returns, block 0 of a pair holds the last (farther) return, block
            // 1 the other.
            const bool is_far = second.range_m > first.range_m;
            echo =
                is_dual() && second.range_m > 0.0f && is_far == (block_position.number == 0) ? second : first;
        }
        const double range = std::round(double(echo.range_m) / range_unit_m);
        // Range numbers up to last_marker mean that the laser has no return.
        const bool is_valid = range > layout_.last_marker && range <= kMostRange;
        append_raw(bytes, is_valid ? std::uint16_t(range) : std::uint16_t(0));
        append_raw(bytes, is_valid ? to_reflectivity(echo) : std::uint8_t(0));
        bytes.append(layout_.unit_bytes - 3, '\0');
    }
}

std::size_t BlockWriter::sequence_of_block(std::size_t block_index, std::uint32_t packet_number) const {
    const auto n_packets = std::size_t(packets_per_firing()), n_here = layout_.n_sequences() / n_packets;
    return packet_number % n_packets * n_here +
           block_index / (layout_.banks * std::size_t(returns_)) % n_here;
}

/// Appends all blocks of a packet. A block has a flag (for some products), the azimuth in
/// 0.01 degrees, and the returns of its firings.
void BlockWriter::append_blocks(std::string& bytes, std::span<const FiringColumn> firings,
                                std::uint32_t packet_number, double range_unit_m) const {
    const std::size_t n_returns = std::size_t(returns_);
    const std::size_t n_joined = count_blocks() / std::size_t(packets_per_firing());
    for (std::size_t block = 0; block < layout_.n_blocks; ++block) {
        const auto block_firings = firings.subspan(block / n_joined * layout_.firings, layout_.firings);
        const BlockIndex block_index{sequence_of_block(block, packet_number),
                                     block / n_returns % layout_.banks, block % n_returns};
        // The flag names the group of lasers: FF EE, FF DD, FF CC or FF BB.
        if (layout_.flagged) append_raw(bytes, std::uint16_t(0xEEFF - 0x1100 * block_index.bank));
        const double azimuth_deg =
            block_firings.front().azimuth_deg + double(block_index.part) * sequence_deg_;
        append_raw(bytes, std::uint16_t(std::lround(100.0 * (azimuth_deg + layout_.forward_deg)) % 36000));
        for (const FiringColumn& firing : block_firings)
            append_returns(bytes, firing, block_index, range_unit_m);
    }
}

std::int64_t BlockWriter::packet_time_ns(std::span<const FiringColumn> firings, std::uint32_t packet_number,
                                         double FiringColumn::*firing_time_member) const {
    const double shift_s = 1e-6 * layout_.shift_us;
    if (!layout_.at_end) return to_unix_ns(firings.front().*firing_time_member - shift_s, start_ns_);
    const double sequence_s =
        1e-6 * layout_.cycle_us * double(sequence_of_block(layout_.n_blocks - 1, packet_number));
    return to_unix_ns(firings.back().*firing_time_member + sequence_s - shift_s, start_ns_);
}

}  // namespace relidar::packets
