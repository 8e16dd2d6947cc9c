// SPDX-License-Identifier: Apache-2.0
// Writes the blocks of Velodyne's and Hesai's packets. With two returns, a pair of blocks
// holds the same firings. The first block holds the last return. The second block holds
// the strongest return, or the second strongest if the last return is the strongest.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/bytes.hpp"
#include "log/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

// maximum angle between a beam and its nominal elevation
constexpr double kMostAngle_rad = 1.0 * kPi / 180.0;
constexpr double kMostRange = 65535.0;
constexpr std::size_t kNoRing = std::size_t(-1);  ///< for a laser that does not fire

/// Throws if the beams of a sensor differ from the beams of the product. Drivers compute
/// points with the angles of the product, so other angles would give wrong points.
/// @param beams  beams of the product
void check_beams(const Layout& layout, const std::vector<BlockBeam>& beams, const SpinningSensor& sensor) {
    const auto nominal = std::get<SpinningSensor>(find_built_in_sensor(layout.sensor)->pattern);
    const bool fits =
        beams.size() == sensor.beams.size() &&
        std::ranges::equal(beams, sensor.beams, [&](const BlockBeam& first, const Beam& second) {
            return std::abs(nominal.beams[first.line].elevation_rad - second.elevation_rad) < kMostAngle_rad;
        });
    if (!fits)
        throw UsageError(fmt::format(
            "cannot write packets of {}: found {} beams whose elevations differ from the data sheet, "
            "expected the {} beams of this sensor",
            layout.sensor, sensor.beams.size(), nominal.beams.size()));
    if (!sensor.clockwise)
        throw UsageError(
            fmt::format("cannot write packets of {}: the sensor turns counter-clockwise, expected a sensor "
                        "that turns clockwise",
                        layout.sensor));
}

}  // namespace

const Layout& find_layout_of_product(const std::string& product) {
    return *std::ranges::find_if(kLayouts, [&](const Layout& row) { return product == row.name; });
}

std::int64_t to_unix_ns(double time_s, std::int64_t start_ns) {
    return start_ns + std::llround(1e9 * time_s);
}

std::uint8_t to_reflectivity(const LaserReturn& echo) {
    return std::uint8_t(std::lround(255.0 * std::clamp(double(echo.intensity), 0.0, 1.0)));
}

int count_columns_per_firing(const Layout& layout, const SpinningSensor& sensor) {
    return sensor.beams.size() == layout.lasers() ? int(layout.parts()) : 1;
}

BlockWriter::BlockWriter(const Layout& layout, const SpinningSensor& sensor, const PacketOptions& options)
    : layout_(layout),
      returns_(std::max(options.returns, 1)),
      columns_per_firing_(count_columns_per_firing(layout, sensor)),
      start_ns_(options.start_ns),
      sequence_deg_(360e-6 * layout.cycle_us / sensor.period_s),
      beams_(list_block_beams(layout)) {
    // A firing of a scan without firing sequences has all beams.
    std::vector<BlockBeam> fired = beams_;
    const auto is_repeat = [](const BlockBeam& one, const BlockBeam& other) {
        return one.line == other.line;
    };
    if (columns_per_firing_ > 1) fired.erase(std::ranges::unique(fired, is_repeat).begin(), fired.end());
    check_beams(layout, fired, sensor);
    if (layout.n_blocks % (layout.banks * std::size_t(returns_)) != 0)
        throw UsageError(fmt::format("cannot write packets of {}: found {} returns per ray, expected 1",
                                     layout.sensor, options.returns));
    ring_of_.assign(layout.parts(), std::vector<std::size_t>(layout.lasers(), kNoRing));
    for (std::size_t ring = 0; ring < beams_.size(); ++ring)
        ring_of_[beams_[ring].part][beams_[ring].laser] = ring;
    for (const BlockBeam& beam : fired) {
        laser_of_.push_back(beam.laser);
        offsets_us_.push_back(columns_per_firing_ > 1 ? compute_mean_offset_us(beam.laser) : beam.offset_us);
    }
}

/// Computes the mean time from the start of a firing sequence to a laser, over the
/// sequences in which the laser fires.
double BlockWriter::compute_mean_offset_us(std::size_t laser) const {
    double sum_us = 0.0, n = 0.0;
    for (const BlockBeam& beam : beams_) {
        if (beam.laser != laser) continue;
        sum_us += beam.offset_us - layout_.cycle_us * double(beam.part);
        n += 1.0;
    }
    return sum_us / n;
}

int BlockWriter::packets_per_firing() const {
    return int(std::max<std::size_t>(count_blocks_per_firing() / layout_.n_blocks, 1));
}

int BlockWriter::firings() const {
    return int(layout_.n_blocks * std::size_t(packets_per_firing()) * layout_.firings /
               count_blocks_per_firing());
}

std::vector<FiredColumn> BlockWriter::join_sequences(std::vector<FiredColumn> columns) const {
    if (columns_per_firing_ == 1) return columns;
    std::vector<FiredColumn> firings;
    for (std::size_t c = 0; c < columns.size(); ++c) {
        FiredColumn& firing = firings.emplace_back(std::move(columns[c]));
        // Without the column of the next firing sequence, this sequence has no returns.
        const bool has_next =
            c + 1 < columns.size() && columns[c + 1].time_s - firing.time_s < 1.5e-6 * layout_.cycle_us;
        const std::vector<std::array<LaserReturn, 2>> none(firing.returns.size());
        const std::vector<std::array<LaserReturn, 2>> of_part[] = {
            firing.returns, has_next ? std::move(columns[c + 1].returns) : none};
        firing.returns.clear();
        for (const BlockBeam& beam : beams_) firing.returns.push_back(of_part[beam.part][beam.line]);
        if (!has_next) continue;
        firing.has_returns |= columns[c + 1].has_returns;
        ++c;
    }
    return firings;
}

void BlockWriter::append_returns(std::string& bytes, const FiredColumn& column, const BlockPlace& place,
                                 double range_unit_m) const {
    for (std::size_t k = 0; k < layout_.block_lasers; ++k) {
        const std::size_t ring = ring_of_[place.part][place.bank * layout_.block_lasers + k];
        LaserReturn echo;
        if (!column.returns.empty() && ring != kNoRing) {
            const auto& [first, second] = column.returns[ring];
            const bool is_far = second.range_m > first.range_m;
            echo = is_dual() && second.range_m > 0.0f && is_far == (place.number == 0) ? second : first;
        }
        const double range = std::round(double(echo.range_m) / range_unit_m);
        const bool is_valid = range > layout_.last_marker && range <= kMostRange;
        append(bytes, is_valid ? std::uint16_t(range) : std::uint16_t(0));
        append(bytes, is_valid ? to_reflectivity(echo) : std::uint8_t(0));
        bytes.append(layout_.unit_bytes - 3, '\0');
    }
}

std::size_t BlockWriter::get_firing_sequence(std::size_t block, std::uint32_t number) const {
    const auto n_packets = std::size_t(packets_per_firing()), n_here = layout_.parts() / n_packets;
    return number % n_packets * n_here + block / (layout_.banks * std::size_t(returns_)) % n_here;
}

void BlockWriter::append_blocks(std::string& bytes, std::span<const FiredColumn> columns,
                                std::uint32_t number, double range_unit_m) const {
    const std::size_t n_returns = std::size_t(returns_);
    const std::size_t n_joined = count_blocks_per_firing() / std::size_t(packets_per_firing());
    for (std::size_t block = 0; block < layout_.n_blocks; ++block) {
        const auto firings = columns.subspan(block / n_joined * layout_.firings, layout_.firings);
        const BlockPlace place{get_firing_sequence(block, number), block / n_returns % layout_.banks,
                               block % n_returns};
        if (layout_.flagged) append(bytes, std::uint16_t(0xEEFF - 0x1100 * place.bank));
        const double azimuth_deg = firings.front().azimuth_deg + double(place.part) * sequence_deg_;
        append(bytes, std::uint16_t(std::lround(100.0 * (azimuth_deg + layout_.forward_deg)) % 36000));
        for (const FiredColumn& column : firings) append_returns(bytes, column, place, range_unit_m);
    }
}

std::int64_t BlockWriter::compute_packet_time_ns(std::span<const FiredColumn> columns, std::uint32_t number,
                                                 double FiredColumn::*time) const {
    const double shift_s = 1e-6 * layout_.shift_us;
    if (!layout_.at_end) return to_unix_ns(columns.front().*time - shift_s, start_ns_);
    const double sequence_s =
        1e-6 * layout_.cycle_us * double(get_firing_sequence(layout_.n_blocks - 1, number));
    return to_unix_ns(columns.back().*time + sequence_s - shift_s, start_ns_);
}

}  // namespace relidar::packets
