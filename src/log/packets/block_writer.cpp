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

/// Throws if the beam elevations of a sensor differ from the data sheet. Drivers compute
/// points with the angles in the data sheet, so the points would be wrong.
void check_beams(const Layout& layout, const SpinningSensor& sensor) {
    const auto nominal = std::get<SpinningSensor>(find_built_in_sensor(layout.sensor)->pattern);
    const bool fits =
        nominal.beams.size() == sensor.beams.size() &&
        std::ranges::equal(nominal.beams, sensor.beams, [](const Beam& first, const Beam& second) {
            return std::abs(first.elevation_rad - second.elevation_rad) < kMostAngle_rad;
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

BlockWriter::BlockWriter(const Layout& layout, const SpinningSensor& sensor, const PacketOptions& options)
    : layout_(layout),
      returns_(std::max(options.returns, 1)),
      start_ns_(options.start_ns),
      ring_of_(layout.lasers()) {
    check_beams(layout, sensor);
    if (layout.n_blocks % (layout.banks * std::size_t(returns_)) != 0)
        throw UsageError(fmt::format("cannot write packets of {}: found {} returns per ray, expected 1",
                                     layout.sensor, options.returns));
    for (const BeamFiring& beam : find_beam_firings(layout.sensor)) {
        offsets_us_.push_back(beam.offset_us);
        laser_of_.push_back(std::size_t(beam.channel - layout.first_channel));
        ring_of_[laser_of_.back()] = laser_of_.size() - 1;
    }
}

int BlockWriter::firings() const {
    return int(layout_.n_blocks * layout_.firings / (layout_.banks * std::size_t(returns_)));
}

void BlockWriter::append_returns(std::string& bytes, const FiredColumn& column, std::size_t number,
                                 std::size_t first_laser, double range_unit_m) const {
    for (std::size_t laser = first_laser; laser < first_laser + layout_.block_lasers; ++laser) {
        LaserReturn echo;
        if (!column.returns.empty()) {
            const auto& [first, second] = column.returns[ring_of_[laser]];
            const bool is_far = second.range_m > first.range_m;
            echo = is_dual() && second.range_m > 0.0f && is_far == (number == 0) ? second : first;
        }
        const double range = std::round(double(echo.range_m) / range_unit_m);
        const bool is_valid = range >= 1.0 && range <= kMostRange;
        append(bytes, is_valid ? std::uint16_t(range) : std::uint16_t(0));
        append(bytes, is_valid ? to_reflectivity(echo) : std::uint8_t(0));
        bytes.append(layout_.unit_bytes - 3, '\0');
    }
}

void BlockWriter::append_blocks(std::string& bytes, std::span<const FiredColumn> columns,
                                double range_unit_m) const {
    const std::size_t n_returns = std::size_t(returns_), n_joined = layout_.banks * n_returns;
    for (std::size_t block = 0; block < layout_.n_blocks; ++block) {
        const auto firings = columns.subspan(block / n_joined * layout_.firings, layout_.firings);
        const std::size_t bank = block % n_joined / n_returns;
        if (layout_.flagged) append(bytes, std::uint16_t(0xEEFF - 0x1100 * bank));
        const double azimuth = 100.0 * (firings.front().azimuth_deg + layout_.forward_deg);
        append(bytes, std::uint16_t(std::lround(azimuth) % 36000));
        for (const FiredColumn& column : firings)
            append_returns(bytes, column, block % n_returns, bank * layout_.block_lasers, range_unit_m);
    }
}

std::int64_t BlockWriter::compute_packet_time_ns(std::span<const FiredColumn> columns,
                                                 double FiredColumn::*time) const {
    if (layout_.at_end) return to_unix_ns(columns.back().*time - 1e-6 * layout_.shift_us, start_ns_);
    return to_unix_ns(columns.front().*time - 1e-6 * layout_.shift_us, start_ns_);
}

}  // namespace relidar::packets
