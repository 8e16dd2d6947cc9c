// SPDX-License-Identifier: Apache-2.0
// Decodes packets of blocks. A block has an azimuth, then the range and reflectivity of
// each laser. One table row per product:
//   Velodyne VLP-16 (manual 63-9243, chapters 6 and 9), VLP-32C (63-9325) and HDL-32E (63-9113):
//     12 blocks of FF EE, azimuth in 0.01 degrees, 32 x (range, reflectivity). Then microseconds of
//     the hour at the first firing, return mode, product. A block of the VLP-16 has two firings.
//     With two returns, two consecutive blocks have the same firings, the last return before the
//     strongest (or second strongest) one.
//   Hesai Pandar40P, Pandar64 and PandarXT-32 (user manuals, "Point cloud data packet" and the
//     appendix on absolute time): the packet's time, in microseconds of its second, follows the
//     firings. The last block begins at a fixed time from it. Azimuth 0 is the y axis. A file
//     "Laser id,Elevation,Azimuth" in degrees, azimuth clockwise, corrects the angles of one unit.
#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/codecs/byte_reader.hpp"
#include "base/csv.hpp"
#include "base/files.hpp"
#include "log/readers/bag/packets/decoder.hpp"

namespace relidar::packets {
namespace {

struct Layout {
    const char* sensor;
    std::size_t blocks_at, n_blocks;
    bool flagged;  ///< true: the bytes FF EE precede the azimuth of a block
    /// number of lasers per firing; number of bytes for the range and reflectivity of one
    /// laser
    std::size_t lasers, unit_bytes;
    std::size_t firings;  ///< firings per block
    /// unit of ranges; 0: the packet states the unit in millimetres in byte `unit_at`
    double range_unit_m;
    std::size_t unit_at, time_at, mode_at;
    double wrap_us, cycle_us;
    /// true: the packet's time is that of its last firing plus `shift_us`; false: it is
    /// the time of its first firing
    bool at_end;
    double shift_us;     ///< from the packet's time to the first laser of that firing
    double forward_deg;  ///< azimuth of the sensor's x axis
    int first_channel;   ///< first channel in the beam table
};
// Hesai's manuals give the time of each laser relative to the time of its block. The
// first laser fires at -54.67 us (Pandar40P, Pandar64) or at 0.368 us (XT32).
constexpr Layout kLayouts[] = {
    {"VLP-16", 0, 12, true, 16, 3, 2, 0.002, 0, 1200, 1204, 3.6e9, 55.296, false, 0.0, 0.0, 0},
    {"VLP-32C", 0, 12, true, 32, 3, 1, 0.004, 0, 1200, 1204, 3.6e9, 55.296, false, 0.0, 0.0, 0},
    {"HDL-32E", 0, 12, true, 32, 3, 1, 0.002, 0, 1200, 1204, 3.6e9, 46.08, false, 0.0, 0.0, 0},
    {"Pandar40P", 0, 10, true, 40, 3, 1, 0.004, 0, 1250, 1254, 1e6, 55.56, true, -28.58 - 54.67, 90.0, 1},
    {"Pandar64", 8, 6, false, 64, 3, 1, 0.0, 5, 1182, 1186, 1e6, 55.56, true, -42.58 - 54.668, 90.0, 1},
    {"XT32", 12, 8, false, 32, 4, 1, 0.0, 9, 1071, 1062, 1e6, 50.0, true, 5.632 + 0.368, 90.0, 1},
};
constexpr std::uint8_t kFirstDual = 0x39, kLastDual = 0x3C, kTriple = 0x3D;
constexpr double kDegree = kPi / 180.0;

/// Calibrated angles of one channel of the sensor, in degrees.
struct Angles {
    bool is_known = false;
    double elevation_deg = 0.0, azimuth_deg = 0.0;
};

std::vector<Angles> read_correction(const std::string& text, std::size_t lasers) {
    std::vector<Angles> angles(lasers);
    for (const std::string& line : split_lines(text)) {
        const std::vector<std::string_view> cells = csv_cells(line);
        const auto channel = parse_number(cells[0]);
        if (!channel || cells.size() < 3) continue;  // the header, or a checksum line
        const auto elevation = parse_number(cells[1]), azimuth = parse_number(cells[2]);
        if (!(*channel >= 1.0 && *channel <= double(lasers)) || !elevation || !azimuth ||
            !(std::abs(*elevation) <= 90.0) || !(std::abs(*azimuth) <= 180.0))
            throw DataError(
                fmt::format("the angle correction: line '{}', expected laser 1 to {}, elevation and azimuth",
                            excerpt(line), lasers));
        angles[std::size_t(*channel) - 1] = {true, *elevation, *azimuth};
    }
    const auto n = std::size_t(std::ranges::count(angles, true, &Angles::is_known));
    if (n != lasers)
        throw DataError(fmt::format("the angle correction: angles of {} lasers, expected {}", n, lasers));
    return angles;
}

class BlockDecoder : public Decoder {
public:
    BlockDecoder(const Layout& layout, const std::string& calibration)
        : layout_(layout), ring_of_(layout.lasers) {
        if (!calibration.empty() && layout.at_end) angles_ = read_correction(calibration, layout.lasers);
        timing_.cycle_us = layout.cycle_us;
        timing_.wrap_us = layout.wrap_us;
        timing_.interpolates = layout.firings > 1;  // as in the VLP-16's manual
        table_ = known_firings(layout.sensor);
        for (std::size_t k = 0; k < table_.size(); ++k) order_.push_back(k);
        if (!angles_.empty())
            std::ranges::stable_sort(order_, std::greater(),
                                     [&](std::size_t k) { return angles_[laser_of(k)].elevation_deg; });
        for (std::size_t ring = 0; ring < order_.size(); ++ring) {
            ring_of_[laser_of(order_[ring])] = ring;
            timing_.offset_us.push_back(table_[order_[ring]].offset_us);
        }
    }

    const Timing& timing() const override { return timing_; }

    std::string about() const override {
        return layout_.sensor + std::string(angles_.empty() ? ", nominal angles of the beams"
                                                            : ", angles of the beams from its file");
    }

    SpinningSensor sensor(int columns, double rate_hz) const override {
        auto sensor = std::get<SpinningSensor>(known_sensor(layout_.sensor, columns, rate_hz)->pattern);
        if (angles_.empty()) return sensor;
        for (std::size_t ring = 0; ring < order_.size(); ++ring) {
            const Angles& angles = angles_[laser_of(order_[ring])];
            sensor.beams[ring].elevation_rad = angles.elevation_deg * kDegree;
            sensor.beams[ring].azimuth_offset_rad =
                -angles.azimuth_deg * kDegree - 2e-6 * kPi * rate_hz * timing_.offset_us[ring];
        }
        return sensor;
    }

    Packet decode(std::string_view bytes) const override {
        Packet packet;
        packet.clock_ns =
            std::int64_t(1000) * bag::ByteReader(bytes.substr(layout_.time_at)).number<std::uint32_t>();
        const auto mode = std::uint8_t(bytes[layout_.mode_at]);
        if (mode == kTriple) throw DataError("a packet of three returns, expected one or two");
        const std::size_t n_returns = mode >= kFirstDual && mode <= kLastDual ? 2 : 1;
        const double unit_m =
            layout_.range_unit_m > 0.0 ? layout_.range_unit_m : 1e-3 * std::uint8_t(bytes[layout_.unit_at]);
        packet.n_slots = int(layout_.n_blocks / n_returns * layout_.firings);
        packet.firings.resize(std::size_t(packet.n_slots));
        packet.echoes.resize(packet.firings.size() * layout_.lasers);
        bag::ByteReader reader(bytes.substr(layout_.blocks_at));
        for (std::size_t b = 0; b < layout_.n_blocks; ++b) {
            const double azimuth_deg = read_azimuth(reader);
            for (std::size_t f = 0; f < layout_.firings; ++f) {
                const std::size_t slot = b / n_returns * layout_.firings + f;
                packet.firings[slot].azimuth_deg = azimuth_deg;
                read_echoes(reader, unit_m, b % n_returns, &packet.echoes[slot * layout_.lasers]);
            }
        }
        add_times(packet);
        return packet;
    }

private:
    const Layout& layout_;
    Timing timing_;
    std::vector<BeamFiring> table_;
    std::vector<Angles> angles_;        ///< [lasers] calibrated angles of this sensor; empty if unknown
    std::vector<std::size_t> order_;    ///< [rings] rows of the table
    std::vector<std::size_t> ring_of_;  ///< [lasers] ring of each laser

    std::size_t laser_of(std::size_t line) const {
        return std::size_t(table_[line].channel - layout_.first_channel);
    }

    double read_azimuth(bag::ByteReader& reader) const {
        if (layout_.flagged && reader.number<std::uint16_t>() != 0xEEFF)
            throw DataError(fmt::format("a block of a packet that does not begin with FF EE, expected a {}'s",
                                        layout_.sensor));
        const double azimuth_deg = 0.01 * reader.number<std::uint16_t>();
        if (azimuth_deg > 360.0)
            throw DataError(
                fmt::format("an azimuth of {} degrees in a packet, expected less than 360", azimuth_deg));
        return std::fmod(azimuth_deg - layout_.forward_deg + 360.0, 360.0);
    }

    void read_echoes(bag::ByteReader& reader, double unit_m, std::size_t number,
                     std::array<Echo, 2>* rings) const {
        for (std::size_t laser = 0; laser < layout_.lasers; ++laser) {
            bag::ByteReader unit(reader.take(layout_.unit_bytes));
            const auto range = unit.number<std::uint16_t>();
            const auto reflectivity = unit.number<std::uint8_t>();
            rings[ring_of_[laser]][number] = {float(unit_m * double(range)), float(reflectivity) / 255.0f};
        }
    }

    /// Computes the time of each firing in a packet. Firings that share a block also
    /// share its azimuth, so their azimuths are interpolated.
    void add_times(Packet& packet) const {
        const int n = packet.n_slots, per_block = int(layout_.firings);
        double step_deg = 0.0;  // rotation between two blocks
        for (int slot = 0; slot < n; ++slot) {
            Firing& firing = packet.firings[std::size_t(slot)];
            firing.slot = slot;
            firing.after_us =
                layout_.shift_us + layout_.cycle_us * double(layout_.at_end ? slot - (n - 1) : slot);
            if (per_block == 1) continue;
            const std::size_t next = std::size_t(slot - slot % per_block + per_block);
            if (slot % per_block == 0 && next < packet.firings.size())
                step_deg = std::remainder(packet.firings[next].azimuth_deg - firing.azimuth_deg, 360.0);
            firing.azimuth_deg = std::fmod(
                firing.azimuth_deg + step_deg * double(slot % per_block) / double(per_block) + 360.0, 360.0);
        }
    }
};

}  // namespace

std::unique_ptr<Decoder> make_block_decoder(const char* name, const Calibration& calibration) {
    const auto* layout = std::ranges::find_if(
        kLayouts, [&](const Layout& row) { return std::string_view(name) == row.sensor; });
    return std::make_unique<BlockDecoder>(*layout, calibration.correction);
}

}  // namespace relidar::packets
