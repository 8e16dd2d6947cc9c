// SPDX-License-Identifier: Apache-2.0
// Decodes packets of blocks. A block has an azimuth, then the range and reflectivity of
// each laser. One table row per product:
//   Velodyne VLP-16 (manual 63-9243, chapters 6 and 9), VLP-32C (63-9325) and HDL-32E
//     (63-9113): 12 blocks of FF EE, azimuth in 0.01 degrees, 32 x (range,
//     reflectivity). Then microseconds of the hour at the first firing, return mode,
//     product. A block of the VLP-16 has two firings. With two returns, two consecutive
//     blocks have the same firings. The first block has the last return, the second block
//     the strongest (or second strongest) return.
//   Velodyne VLS-128 (63-9483): as above, but four blocks, marked FF EE, FF DD, FF CC and
//     FF BB, contain the 128 lasers of a firing.
//   RoboSense RS-LiDAR-16 (user manual, "MSOP"): a header of 42 bytes, then the 12 blocks
//     of a VLP-16, with the highest byte of each number first. With two returns, a block
//     has both returns of one firing instead of two firings.
//   Hesai Pandar40P, Pandar64, PandarXT-16 and 32, XT32M2X, PandarQT, QT128C2X and OT128
//     (user manuals, "Point cloud data packet" and the appendix on absolute time): the
//     packet's time, in microseconds of its second, follows the firings. The last block
//     starts at a fixed time from the packet's time (PandarQT: the first block). Azimuth
//     0 is the y axis.
//
// The head turns while the lasers of a block fire in sequence. The azimuth of a laser is
// therefore the azimuth of its block, plus the laser's angle, plus the rotation until it
// fires (manuals, "Analyze the horizontal angle of a data point").
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/ranges.h>

#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "read/packets/block_layouts.hpp"
#include "read/packets/decoder.hpp"

namespace relidar::packets {
namespace {

// Values of the return mode: two returns per firing (a range of values), or three.
constexpr std::uint8_t kFirstDual = 0x39, kLastDual = 0x3E, kTriple = 0x3D;
constexpr int kNoRing = -1;
constexpr double kRadPerDegree = kPi / 180.0;
constexpr double kLargestStep_deg = 5.0;  // maximum rotation between two blocks

/// Stores a return of a ray, which keeps at most two. A third return replaces the darker
/// of the two, if it is brighter and differs in range from both.
/// @param index  number of the return in the packet, from 0
void keep_brightest(std::array<DecodedReturn, 2>& returns, std::size_t index, const DecodedReturn& added) {
    if (index < 2) {
        returns[index] = added;
        return;
    }
    // an empty return is darker than any other
    const auto brightness = [](const DecodedReturn& echo) {
        return echo.range_m == 0.0f ? -1.0f : echo.intensity;
    };
    auto& [first, second] = returns;
    if (added.range_m == first.range_m || added.range_m == second.range_m) return;
    const bool is_first = first.range_m == 0.0f || brightness(first) < brightness(second);
    DecodedReturn& darker = is_first ? first : second;
    if (brightness(darker) < added.intensity) darker = added;
}

/// Decodes the packets of a product in the table kLayouts.
class BlockDecoder : public PacketDecoder {
public:
    BlockDecoder(const PacketLayout& layout, const std::vector<AngleCorrection>& corrections)
        : layout_(layout) {
        if (layout.has_correction_file) set_laser_angles(corrections);
        timing_.cycle_us = layout.cycle_us;
        timing_.wrap_us = layout.wrap_us;
        timing_.interpolates = layout.firings > 1;  // as in the VLP-16's manual
        timing_.n_sequences = int(layout.n_sequences());
        table_ = read_firings(layout.sensor);
        beams_ = list_beams(layout);
        // Measured elevations can change the order of the rings (highest first).
        if (!angles_.empty()) {
            for (PacketBeam& beam : beams_) beam.elevation_deg = angles_[beam.laser].elevation_deg;
            std::ranges::stable_sort(beams_, std::greater(), &PacketBeam::elevation_deg);
        }
        ring_of_.assign(layout.n_sequences(), std::vector<int>(layout.n_lasers(), kNoRing));
        for (std::size_t ring = 0; ring < beams_.size(); ++ring) {
            ring_of_[beams_[ring].sequence][beams_[ring].laser] = int(ring);
            timing_.offset_us.push_back(beams_[ring].offset_us);
        }
    }

    const FiringTiming& timing() const override { return timing_; }

    std::string describe_product() const override {
        return fmt::format("{}, {}", layout_.name, angles_note_);
    }

    SpinningSensor make_sensor(int columns_per_revolution, double rotation_rate_hz) const override {
        auto sensor = std::get<SpinningSensor>(
            find_built_in(layout_.sensor, columns_per_revolution, rotation_rate_hz)->pattern);
        const double turned_rad_us = 2e-6 * kPi * rotation_rate_hz;
        // Beams of the data sheet. Replaces their angles if a correction file was read.
        // Azimuth offsets include the rotation of the head until the laser fires.
        const std::vector<Beam> nominal = sensor.beams;
        sensor.beams.clear();
        for (const PacketBeam& row : beams_) {
            Beam& beam = sensor.beams.emplace_back(nominal[row.line]);
            beam.azimuth_offset_rad += turned_rad_us * (table_[row.line].offset_us - row.offset_us);
            if (angles_.empty()) continue;
            const LaserAngles& angles = angles_[row.laser];
            beam.elevation_rad = angles.elevation_deg * kRadPerDegree;
            beam.azimuth_offset_rad = -angles.azimuth_deg * kRadPerDegree - turned_rad_us * row.offset_us;
        }
        return sensor;
    }

    DecodedPacket decode_packet(std::string_view packet_bytes) const override {
        DecodedPacket packet;
        packet.clock_ns = read_clock_ns(packet_bytes);
        const std::size_t n_returns = count_returns(packet_bytes);  // per firing
        const double unit_m = layout_.range_unit_m > 0.0 ? layout_.range_unit_m
                                                         : 1e-3 * std::uint8_t(packet_bytes[layout_.unit_at]);
        const std::size_t n_joined = layout_.banks * n_returns;  // blocks of the same firing
        packet.n_slots = int(layout_.n_blocks / n_joined * layout_.firings);
        packet.firings.resize(std::size_t(packet.n_slots));
        packet.echoes.resize(packet.firings.size() * beams_.size());
        codecs::ByteReader reader(packet_bytes.substr(layout_.blocks_at));
        // Order of the blocks: groups with the same firings, banks of lasers, returns.
        // An echo row of a block has one return of one firing for all lasers of a bank.
        for (std::size_t block = 0; block < layout_.n_blocks / n_joined * n_joined; ++block) {
            const std::size_t group = block / n_joined, bank = block % n_joined / n_returns;
            const double azimuth_deg = read_azimuth_deg(reader, bank);
            for (std::size_t echo_row = 0; echo_row < layout_.firings * layout_.block_returns; ++echo_row) {
                const std::size_t slot = group * layout_.firings + echo_row / layout_.block_returns;
                const std::size_t return_index = block % n_returns + echo_row % layout_.block_returns;
                LaserFiring& firing = packet.firings[slot];
                firing.azimuth_deg = azimuth_deg;
                firing.sequence = read_sequence(packet_bytes, group, n_returns);
                const int* rings = &ring_of_[std::size_t(firing.sequence)][bank * layout_.block_lasers];
                read_echoes(reader, unit_m, return_index, rings, &packet.echoes[slot * beams_.size()]);
            }
        }
        set_firings(packet);
        return packet;
    }

private:
    const PacketLayout& layout_;
    FiringTiming timing_;
    std::vector<BeamFiring> table_;
    std::vector<LaserAngles> angles_;  ///< [lasers] from the angle correction file; may be empty
    std::string angles_note_ = "beam angles from the data sheet";
    std::vector<PacketBeam> beams_;  ///< [rings]
    /// [firing sequences, lasers] row in the range image, or kNoRing if the laser does
    /// not fire in this sequence
    std::vector<std::vector<int>> ring_of_;

    /// Selects the angle correction file with the right number of lasers. Uses no file if
    /// several match, because nothing shows which file belongs to the sensor.
    void set_laser_angles(const std::vector<AngleCorrection>& corrections) {
        const std::size_t n = layout_.n_lasers();
        std::vector<const AngleCorrection*> matches;
        std::vector<std::string> problems;  // why other files are not used
        for (const AngleCorrection& correction : corrections) {
            const std::string mismatch = fmt::format("{} has angles of {} lasers, expected {}",
                                                     correction.where, correction.lasers.size(), n);
            if (correction.lasers.size() == n) matches.push_back(&correction);
            else if (correction.is_named) fail("{} for a {}", mismatch, layout_.name);
            else problems.push_back(correction.problem.empty() ? mismatch : correction.problem);
        }
        if (matches.size() > 1) {
            angles_note_ += fmt::format(
                ", because {} and {} both have angles of {} lasers; the file of this sensor needs the name "
                "of the recording",
                matches[0]->where, matches[1]->where, n);
        } else if (matches.size() == 1) {
            angles_ = matches[0]->lasers;
            angles_note_ = "beam angles from " + matches[0]->where;
        } else if (!problems.empty()) {
            angles_note_ += fmt::format(", because {}", fmt::join(problems, "; "));
        }
    }

    /// Returns the number of returns per firing. Packets without a return mode have one.
    std::size_t count_returns(std::string_view packet_bytes) const {
        const auto mode = layout_.mode_at > 0 ? std::uint8_t(packet_bytes[layout_.mode_at]) : std::uint8_t(0);
        if (mode == kTriple) return 3;
        return mode >= kFirstDual && mode <= kLastDual ? 2 : 1;
    }

    /// Returns which of two alternating sets of lasers fires, 0 or 1.
    /// @param firing_index  index of the firing in the packet
    int read_sequence(std::string_view packet_bytes, std::size_t firing_index, std::size_t n_returns) const {
        if (layout_.sequence_rule == FiringSequenceRule::none) return 0;
        codecs::ByteReader reader(packet_bytes.substr(layout_.sequence_at));
        if (layout_.sequence_rule == FiringSequenceRule::azimuth_state) {
            // two bits for each block, starting with the highest
            const std::size_t shift = 14 - 2 * firing_index * n_returns;
            return reader.read_number<std::uint16_t>() >> shift & 1;
        }
        // With one return, a packet has both sequences. With two, a bit is 1 for the
        // first.
        return n_returns == 1 ? int(firing_index) : 1 - (reader.read_number<std::uint8_t>() & 1);
    }

    std::uint16_t read_u16(codecs::ByteReader& reader) const {
        const auto value = reader.read_number<std::uint16_t>();
        return layout_.is_big_endian ? std::uint16_t(value << 8 | value >> 8) : value;
    }

    /// Reads the time of a packet on the sensor's clock in nanoseconds. Packets in
    /// big-endian order store milliseconds and microseconds separately.
    std::int64_t read_clock_ns(std::string_view packet_bytes) const {
        codecs::ByteReader reader(packet_bytes.substr(layout_.time_at));
        if (!layout_.is_big_endian) return std::int64_t(1000) * reader.read_number<std::uint32_t>();
        const std::int64_t passed_ms = read_u16(reader), passed_us = read_u16(reader);
        return 1'000'000 * passed_ms + 1000 * passed_us;
    }

    /// Reads the flag and the azimuth of a block. Returns the azimuth in degrees from the
    /// sensor's x axis, 0 to 360.
    double read_azimuth_deg(codecs::ByteReader& reader, std::size_t block_in_firing) const {
        const unsigned flag = 0xEEFF - 0x1100 * unsigned(block_in_firing);
        if (layout_.flagged && reader.read_number<std::uint16_t>() != flag)
            fail("a block of a packet does not begin with FF {:X}, expected a packet of a {}", flag >> 8,
                 layout_.name);
        const double azimuth_deg = 0.01 * read_u16(reader);
        if (azimuth_deg > 360.0)
            fail("a packet has an azimuth of {} degrees, expected less than 360", azimuth_deg);
        return std::fmod(azimuth_deg - layout_.forward_deg + 360.0, 360.0);
    }

    /// Reads the ranges and reflectivities of all lasers of a block.
    /// @param ring_of_laser  [lasers of the block]
    /// @param returns_of_each_ring  [rings] output
    void read_echoes(codecs::ByteReader& reader, double range_unit_m, std::size_t return_index,
                     const int* ring_of_laser, std::array<DecodedReturn, 2>* returns_of_each_ring) const {
        for (std::size_t laser = 0; laser < layout_.block_lasers; ++laser) {
            codecs::ByteReader unit(reader.read_bytes(layout_.unit_bytes));
            const auto range = read_u16(unit);
            const auto reflectivity = unit.read_number<std::uint8_t>();
            if (ring_of_laser[laser] == kNoRing || range <= layout_.last_marker) continue;
            keep_brightest(returns_of_each_ring[ring_of_laser[laser]], return_index,
                           {float(range_unit_m * double(range)), float(reflectivity) / 255.0f});
        }
    }

    /// Computes the time of each firing in a packet. If a block contains several firings,
    /// it stores only one azimuth, so the other azimuths are interpolated.
    void set_firings(DecodedPacket& packet) const {
        const int n = packet.n_slots, per_block = int(layout_.firings);
        double step_deg = 0.0;  // rotation between two blocks
        for (int slot = 0; slot < n; ++slot) {
            LaserFiring& firing = packet.firings[std::size_t(slot)];
            firing.slot = slot;
            firing.after_us =
                layout_.shift_us + layout_.cycle_us * double(layout_.at_end ? slot - (n - 1) : slot);
            if (per_block == 1) continue;
            const std::size_t next =
                std::size_t(slot) - std::size_t(slot % per_block) + std::size_t(per_block);
            if (slot % per_block == 0 && next < packet.firings.size()) {
                const double to_next_deg =
                    std::remainder(packet.firings[next].azimuth_deg - firing.azimuth_deg, 360.0);
                // A larger step spans a sector in which the sensor does not fire.
                if (std::abs(to_next_deg) < kLargestStep_deg) step_deg = to_next_deg;
            }
            firing.azimuth_deg = std::fmod(
                firing.azimuth_deg + step_deg * double(slot % per_block) / double(per_block) + 360.0, 360.0);
        }
    }
};

}  // namespace

std::vector<PacketBeam> list_beams(const PacketLayout& layout) {
    // A layout can state the time of each laser in each firing sequence, -1 if it does
    // not fire in it. These times then count from the first laser of all sequences.
    std::int32_t first_ns = std::numeric_limits<std::int32_t>::max();
    for (const LaserFiringTimes& times : layout.sequences)
        for (const std::int32_t time_ns : times)
            if (time_ns >= 0) first_ns = std::min(first_ns, time_ns);
    const std::vector<BeamFiring> table = read_firings(layout.sensor);
    std::vector<PacketBeam> beams;
    for (std::size_t line = 0; line < table.size(); ++line) {
        const auto laser = std::size_t(table[line].channel - layout.first_channel);
        for (std::size_t sequence = 0; sequence < layout.n_sequences(); ++sequence) {
            PacketBeam beam{
                .laser = laser, .sequence = sequence, .line = line, .offset_us = table[line].offset_us};
            if (!layout.sequences.empty()) {
                const std::int32_t time_ns = layout.sequences[sequence][laser];
                if (time_ns < 0) continue;
                beam.offset_us = 1e-3 * double(time_ns - first_ns) + layout.cycle_us * double(sequence);
            }
            beams.push_back(beam);
        }
    }
    return beams;
}

std::unique_ptr<PacketDecoder> make_block_decoder(const char* name, const DecoderCalibration& calibration) {
    const PacketLayout* layout = nullptr;
    for (const PacketLayout& row : kLayouts)
        if (row.name == std::string(name) ||
            (calibration.has_two_returns && row.name == name + std::string(" with two returns")))
            layout = &row;  // the row for two returns follows the usual one
    return std::make_unique<BlockDecoder>(*layout, calibration.corrections);
}

}  // namespace relidar::packets
