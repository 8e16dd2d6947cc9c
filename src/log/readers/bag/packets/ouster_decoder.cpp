// SPDX-License-Identifier: Apache-2.0
// Decodes Ouster packets. A packet has columns. All beams of a column fire
// simultaneously. The column's number defines the azimuth of the head, because the sensor
// fires at fixed azimuths (firmware user manual, "Lidar Data"):
//   LEGACY: a column is [timestamp u64 ns, number u16, frame u16, encoder u32],
//     12 bytes per pixel, status u32 (all bits set: it was measured).
//   Others: a header and a footer of 32 bytes. A column is [timestamp u64 ns, number u16,
//     status u8 (bit 0: it was measured), 1 byte], then its pixels.
// In a packet, ranges start at the spin axis. The decoder subtracts
// lidar_origin_to_beam_origin_mm, so that ranges start at the beam's origin.
#include <array>
#include <cmath>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "log/readers/bag/packets/decoder.hpp"
#include "log/readers/bag/packets/ouster.hpp"

namespace relidar::packets {
namespace {

using bag::ByteReader;

constexpr std::size_t kHeadBytes = 32;
constexpr std::uint8_t kLidarData = 1;
constexpr std::uint64_t kLatestClock_ns = std::uint64_t(1) << 62;

struct OusterColumnHeader {
    std::int64_t time_ns = 0;
    int number = 0;
    bool was_measured = false;
};

class OusterDecoder : public PacketDecoder {
public:
    explicit OusterDecoder(std::shared_ptr<const OusterMetadata> format) : format_(std::move(format)) {
        const SpinningSensor& sensor = format_->sensor;
        timing_.cycle_us = 1e6 * sensor.period_s / sensor.columns;
        timing_.offset_us.assign(sensor.beams.size(), 0.0);
        timing_.fires = format_->fires;
        timing_.is_wide = format_->profile->is_wide;
    }

    const FiringTiming& get_laser_timing() const override { return timing_; }

    std::string describe_lidar_product() const override {
        return fmt::format("{}-beam Ouster, {}, profile {}, beam angles from {}",
                           format_->sensor.beams.size(), format_->product, format_->profile->name,
                           format_->where);
    }

    SpinningSensor make_spinning_sensor_model(int, double rotation_rate_hz) const override {
        SpinningSensor sensor = format_->sensor;
        sensor.period_s = 1.0 / rotation_rate_hz;
        return sensor;
    }

    DecodedPacket decode_packet(std::string_view packet_bytes) const override {
        const OusterProfile& profile = *format_->profile;
        const std::size_t rings = format_->ring_of.size();
        ByteReader reader(packet_bytes);
        if (!profile.is_legacy)
            if (const auto kind =
                    ByteReader(reader.read_bytes(kHeadBytes)).read_little_endian_number<std::uint8_t>();
                kind != kLidarData)
                fail("found a packet of type {}, expected {} (LiDAR data of an Ouster)", kind, kLidarData);
        DecodedPacket packet;
        packet.n_slots = format_->columns_per_packet;
        std::vector<std::int64_t> times_ns;
        for (int slot = 0; slot < packet.n_slots; ++slot) {
            const OusterColumnHeader column = read_column_header(reader);
            ByteReader pixels(reader.read_bytes(rings * profile.pixel_bytes));
            const bool was_measured = profile.is_legacy
                                          ? reader.read_little_endian_number<std::uint32_t>() == 0xFFFFFFFF
                                          : column.was_measured;
            if (!was_measured) continue;
            packet.firings.push_back({slot, 0.0, compute_column_azimuth_deg(column, packet.firings, slot)});
            times_ns.push_back(column.time_ns);
            packet.echoes.resize(packet.echoes.size() + rings);
            read_pixels_of_column(pixels, &packet.echoes[packet.echoes.size() - rings]);
        }
        // The packet is sent after its last column.
        if (!times_ns.empty()) packet.clock_ns = times_ns.back();
        for (std::size_t f = 0; f < times_ns.size(); ++f)
            packet.firings[f].after_us = 1e-3 * double(times_ns[f] - packet.clock_ns);
        return packet;
    }

private:
    const std::shared_ptr<const OusterMetadata> format_;
    FiringTiming timing_;

    OusterColumnHeader read_column_header(ByteReader& reader) const {
        OusterColumnHeader column;
        const auto time_ns = reader.read_little_endian_number<std::uint64_t>();
        column.number = reader.read_little_endian_number<std::uint16_t>();
        if (format_->profile->is_legacy)
            reader.read_bytes(6);  // skips the frame number and the encoder angle
        else column.was_measured = (reader.read_little_endian_number<std::uint16_t>() & 1) != 0;
        column.time_ns = std::int64_t(std::min(time_ns, kLatestClock_ns));
        return column;
    }

    double compute_column_azimuth_deg(const OusterColumnHeader& column,
                                      const std::vector<LaserFiring>& previous_firings,
                                      int slot_in_packet) const {
        const int columns = format_->sensor.columns;
        if (column.number >= columns)
            fail("a packet has column {}, expected a number below {} (lidar_mode in {})", column.number,
                 columns, format_->where);
        const double azimuth_deg = std::fmod(180.0 + 360.0 * column.number / columns, 360.0),
                     step_deg = 360.0 / columns;
        if (!previous_firings.empty() &&
            std::abs(std::remainder(azimuth_deg - previous_firings.back().azimuth_deg -
                                        step_deg * (slot_in_packet - previous_firings.back().slot),
                                    360.0)) > 0.1 * step_deg)
            fail("column {} at position {} of a packet does not follow the previous column", column.number,
                 slot_in_packet);
        return azimuth_deg;
    }

    void read_pixels_of_column(ByteReader& reader, std::array<DecodedReturn, 2>* returns_of_each_ring) const {
        const OusterProfile& profile = *format_->profile;
        for (const std::size_t ring : format_->ring_of) {
            const std::string_view pixel = reader.read_bytes(profile.pixel_bytes);
            const double start_m = format_->sensor.beams[ring].origin_offset_m;
            for (int k = 0; k < profile.returns; ++k) {
                const std::string_view bytes = pixel.substr(4 * std::size_t(k));
                const auto range =
                    ByteReader(bytes).read_little_endian_number<std::uint32_t>() & profile.range_bits;
                ByteReader bright(bytes.substr(profile.reflectivity_at));
                const double reflectivity = profile.is_wide
                                                ? bright.read_little_endian_number<std::uint16_t>()
                                                : bright.read_little_endian_number<std::uint8_t>();
                const double range_m = profile.range_unit_m * range - start_m;
                if (range > 0 && range_m > 0.0)
                    returns_of_each_ring[ring][std::size_t(k)] = {float(range_m),
                                                                  float(reflectivity / 255.0)};
            }
        }
    }
};

}  // namespace

std::unique_ptr<PacketDecoder> make_ouster_packet_decoder(const char*,
                                                          const DecoderCalibration& calibration) {
    return std::make_unique<OusterDecoder>(calibration.ouster);
}

}  // namespace relidar::packets
