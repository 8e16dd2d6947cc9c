// SPDX-License-Identifier: Apache-2.0
// Distributes the firings of scans to packets. A firing is all lasers at one azimuth; its
// position is the number of earlier firings of the sensor. A packet holds firings at
// consecutive positions. If the scans have no firing for a position, the packet stores a
// firing without returns there.
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "base/fail.hpp"
#include "read/packets/packet_format.hpp"

namespace relidar {
namespace {

using packets::FiringColumn;
using packets::PacketFormat;

// Maximum relative difference of the time per column from that of the real product.
constexpr double kMostStepError = 0.02;
// Some sensors fire only at fixed azimuths. Limit for |azimuth of a firing - nearest
// fixed azimuth| / step between two fixed azimuths.
constexpr double kMostColumnError = 0.1;
// If firing times deviate by more from even steps, a new packet begins in the recording.
constexpr double kMinPacketJump_us = 1.0;
constexpr double kBehindSensor_deg = 180.0;

}  // namespace

std::string packet_sensors() {
    std::string names;
    for (const packets::BlockSensor& sensor : packets::block_sensors()) names += sensor.name + ", ";
    return names + "an Ouster (OS0-32, OS1-64 and so on, or its metadata)";
}

std::string packet_maker(const std::string& sensor_name) {
    for (const packets::BlockSensor& sensor : packets::block_sensors())
        if (sensor.name == sensor_name) return sensor.maker;
    return "Ouster";
}

struct PacketEncoder::Impl {
    SpinningSensor sensor;
    PacketOptions options;
    std::unique_ptr<PacketFormat> format;
    std::vector<double> offsets_us;  ///< [rings] delay of each beam, see PacketFormat

    /// A firing with known time and azimuth, from which others are computed.
    struct FiringClockAnchor {
        std::int64_t position;
        double time_s, azimuth_deg;
        double clock_less_time_s = 0.0;  ///< time on the sensor's clock minus `time_s`
    };
    std::optional<FiringClockAnchor> last;         ///< last firing of all scans
    std::optional<FiringClockAnchor> clock_start;  ///< firing at which the sensor's clock starts
    /// index of the packet that is filled now, counted from the first firing
    std::int64_t packet = 0;
    std::vector<FiringColumn> pending;  ///< [firings] firings of the pending packet
    std::vector<bool> fired;            ///< [columns] columns of all scans
    std::uint32_t n_written = 0;
    std::vector<SensorPacket> complete;

    double firing_period_s() const { return 1e-6 * format->firing_period_us(); }
    double firing_step_deg() const { return 360.0 * firing_period_s() / sensor.period_s; }
    std::int64_t per_packet() const { return format->firings_per_packet(); }
    int n_fixed() const { return format->fixed_columns(); }
    bool has_fixed_columns() const { return n_fixed() > 0; }

    /// Returns the column of a firing. Throws if its azimuth is between two columns. Only
    /// for a sensor that fires at fixed azimuths; its column 0 faces backward.
    std::int64_t find_column(const FiringColumn& firing) const {
        const double fractional_column = (firing.azimuth_deg - kBehindSensor_deg) / 360.0 * n_fixed();
        if (std::abs(fractional_column - std::round(fractional_column)) > kMostColumnError)
            fail<UsageError>(
                "cannot write packets of {}: found a column at {:.3f} degrees, expected a multiple of {:.3f}",
                sensor.name, firing.azimuth_deg, 360.0 / n_fixed());
        return (std::llround(fractional_column) + n_fixed()) % n_fixed();
    }

    /// Returns the rounded number of firing periods from `anchor` to `firing`; 0 or
    /// negative if `firing` is not in a later period. If possible, uses azimuths, which
    /// are more exact than times. The time then only counts full turns.
    double count_steps(const FiringClockAnchor& anchor, const FiringColumn& firing) const {
        const double steps_by_time = (firing.time_s - anchor.time_s) / firing_period_s();
        if (has_fixed_columns()) {
            const double n = n_fixed();
            // Positions increase over all turns; n * 1e6 keeps the remainder positive.
            const double turned_columns =
                std::fmod(double(find_column(firing) - anchor.position) + n * 1e6, n);
            return turned_columns + n * std::round((steps_by_time - turned_columns) / n);
        }
        if (!options.times_jitter) return std::round(steps_by_time);
        const double turned_deg = std::remainder(firing.azimuth_deg - anchor.azimuth_deg, 360.0);
        const double turns = std::round(steps_by_time * firing_step_deg() / 360.0 - turned_deg / 360.0);
        return std::round((turned_deg + 360.0 * turns) / firing_step_deg());
    }

    /// Returns the number of firing periods from the last firing to `firing`, or 0 if
    /// `firing` is not later and has no returns, so that the caller can skip it.
    /// @throws UsageError if a firing with returns is not later than the last firing
    std::int64_t steps_from_last(const FiringColumn& firing) const {
        const double steps = count_steps(*last, firing);
        if (steps < 1.0 && !firing.has_returns) return 0;
        if (steps < 1.0)
            fail<UsageError>(
                "cannot write packets of {}: a scan starts {:.3g} s before the end of the previous scan, "
                "expected scans that do not overlap",
                sensor.name, last->time_s - firing.time_s);
        return std::int64_t(steps);
    }

    /// Returns the position of the first firing within its packet. In a recorded log,
    /// firing times jump at the border between two packets. This function finds the
    /// jumps, so that new packets begin at the same firings as the recorded packets.
    std::int64_t find_first_slot(const std::vector<FiringColumn>& firings_of_scan) const {
        if (has_fixed_columns()) return find_column(firings_of_scan.front());
        // Drivers need a firing before the first revolution, so position 0 stays empty.
        if (!options.times_jitter) return 1;
        std::vector<int> n_jumps(std::size_t(per_packet()), 0);
        std::int64_t firing_index = 0;
        for (std::size_t i = 1; i < firings_of_scan.size(); ++i) {
            const FiringColumn &firing = firings_of_scan[i], &before = firings_of_scan[i - 1];
            const double steps = count_steps({firing_index, before.time_s, before.azimuth_deg}, firing);
            firing_index += std::max<std::int64_t>(std::llround(steps), 1);
            if (1e6 * std::abs(firing.time_s - before.time_s - steps * firing_period_s()) > kMinPacketJump_us)
                ++n_jumps[std::size_t(firing_index % per_packet())];
        }
        const auto start = std::ranges::max_element(n_jumps) - n_jumps.begin();
        return per_packet() - start;
    }

    /// Sets the time of a firing on the sensor's clock, which has even steps. The times
    /// in the log are uneven, because they depend on when packets were received.
    void set_clock(FiringColumn& firing, std::int64_t firing_index) {
        firing.clock_s = firing.time_s;
        if (!options.times_jitter || has_fixed_columns()) return;
        const double even_s =
            clock_start
                ? clock_start->time_s + double(firing_index - clock_start->position) * firing_period_s()
                : 0.0;
        // Starts a new even clock if it has drifted by more than a revolution.
        if (!clock_start || std::abs(even_s - firing.time_s) > sensor.period_s)
            clock_start = {firing_index, firing.time_s, firing.azimuth_deg};
        else firing.clock_s = even_s;
    }

    /// Stores a firing in its packet. First writes all earlier packets.
    void store_firing(FiringColumn firing, std::int64_t firing_index) {
        // Drivers need a firing before the first revolution. If a packet holds only one
        // firing, first writes a packet without returns.
        const bool needs_packet = per_packet() == 1 && !has_fixed_columns();
        if (pending.empty()) start_packet(needs_packet ? firing_index - 1 : firing_index / per_packet());
        while (packet < firing_index / per_packet()) {
            write_packet();
            // A sensor with fixed azimuths sends no packets outside its azimuth window.
            // So packet numbers are skipped. Any other sensor sends all packets.
            start_packet(has_fixed_columns() ? firing_index / per_packet() : packet + 1);
        }
        pending[std::size_t(firing_index % per_packet())] = std::move(firing);
    }

    /// Adds firings without returns between the last firing and `next_firing`. Assumes
    /// even rotation between them. Only for sensors that fire at any azimuth.
    void fill_gap(const FiringColumn& next_firing, std::int64_t next_firing_index) {
        const double turned_deg = std::remainder(next_firing.azimuth_deg - last->azimuth_deg, 360.0);
        const double n_steps = double(next_firing_index - last->position);
        const double nominal_deg = n_steps * firing_step_deg();
        const double total_deg = turned_deg + 360.0 * std::round((nominal_deg - turned_deg) / 360.0);
        for (std::int64_t position = last->position + 1; position < next_firing_index; ++position) {
            const double share = double(position - last->position) / n_steps;
            FiringColumn firing{.time_s = last->time_s + share * (next_firing.time_s - last->time_s)};
            firing.azimuth_deg = std::fmod(last->azimuth_deg + share * total_deg + 360.0, 360.0);
            firing.is_filled = true;
            set_clock(firing, position);
            store_firing(std::move(firing), position);
        }
    }

    /// Adds a firing to its packet, after it fills the gap since the last firing.
    /// @param first_firing_index  position of the firing if it is the first of all scans
    void add_firing(FiringColumn firing, std::int64_t first_firing_index) {
        std::int64_t position = last ? last->position + steps_from_last(firing) : first_firing_index;
        if (last && position == last->position) return;
        if (has_fixed_columns()) {
            fired[std::size_t(position % n_fixed())] = true;
        } else if (last) {
            // Fills gaps at the end of a revolution, where a log can omit firings without
            // returns. A longer gap is a pause between scans and is not filled, nor is a
            // gap outside the field of view, where a sensor does not fire.
            std::int64_t max_missing_firings =
                std::llround((options.times_jitter ? 1.0 : 0.5) * sensor.period_s / firing_period_s());
            if (sensor.azimuth_rad)
                max_missing_firings = std::min<std::int64_t>(max_missing_firings, 3 * per_packet());
            if (position - last->position > max_missing_firings) {
                finish_packets();
                position = (packet + 1) * per_packet() + 1;  // slot 1, see find_first_slot()
            } else fill_gap(firing, position);
        }
        set_clock(firing, position);
        last = {position, firing.time_s, firing.azimuth_deg, firing.clock_s - firing.time_s};
        store_firing(std::move(firing), position);
    }

    void start_packet(std::int64_t packet_number) {
        packet = packet_number;
        pending.assign(std::size_t(per_packet()), FiringColumn{});
    }

    /// Computes times and azimuths of firings that no scan contains, from an anchor and
    /// the nominal rotation rate. The anchor is the previous known firing of the packet,
    /// else its first known firing, else the last firing of all scans.
    void fill_packet() {
        const auto first_known = std::ranges::find_if(pending, &FiringColumn::is_known) - pending.begin();
        const std::int64_t begin = packet * per_packet();
        const auto anchor_at = [&](std::int64_t slot) {
            const FiringColumn& firing = pending[std::size_t(slot)];
            return FiringClockAnchor{begin + slot, firing.time_s, firing.azimuth_deg,
                                     firing.clock_s - firing.time_s};
        };
        FiringClockAnchor anchor = first_known < per_packet() ? anchor_at(first_known) : *last;
        for (std::int64_t slot = 0; slot < per_packet(); ++slot) {
            FiringColumn& firing = pending[std::size_t(slot)];
            if (firing.is_known()) anchor = anchor_at(slot);
            const auto steps = double(begin + slot - anchor.position);
            firing.time_s = anchor.time_s + steps * firing_period_s();
            firing.clock_s = firing.time_s + anchor.clock_less_time_s;
            firing.azimuth_deg = std::fmod(anchor.azimuth_deg + steps * firing_step_deg() + 720.0, 360.0);
        }
    }

    /// Encodes the pending packet, or several packets if each firing sequence has a
    /// packet. With fixed azimuths, packet numbers also count packets that are not sent.
    void write_packet() {
        fill_packet();
        for (int k = 0; k < format->packets_per_firing(); ++k, ++n_written)
            complete.push_back(
                format->encode_packet(pending, has_fixed_columns() ? std::uint32_t(packet) : n_written));
    }

    /// Writes the pending packet, then an extra packet without returns, from which
    /// drivers detect the end of the scan. Not for sensors with fixed azimuths.
    void finish_packets() {
        if (pending.empty()) return;
        write_packet();
        if (has_fixed_columns()) return;
        start_packet(packet + 1);
        write_packet();
        pending.clear();
    }
};

PacketEncoder::PacketEncoder(const SpinningSensor& sensor, const PacketOptions& options)
    : impl_(std::make_unique<Impl>()) {
    impl_->sensor = sensor;
    impl_->options = options;
    // A maker returns null if it does not produce the sensor.
    for (auto* make : {packets::make_velodyne, packets::make_hesai, packets::make_ouster})
        if (!impl_->format) impl_->format = make(sensor, options);
    if (!impl_->format)
        fail<UsageError>("cannot write packets of the sensor \"{}\", expected one of {}", sensor.name,
                         packet_sensors());
    impl_->offsets_us = impl_->format->beam_delays();
    impl_->fired.resize(std::size_t(impl_->n_fixed()));
    // A product that fires at any azimuth has a fixed firing period, so the columns of
    // the sensor must match it.
    const double step_us = 1e6 * sensor.period_s / sensor.columns;
    const double expected_us = impl_->format->firing_period_us() / impl_->format->columns_per_firing();
    if (!impl_->has_fixed_columns() && !(std::abs(step_us / expected_us - 1.0) < kMostStepError))
        fail<UsageError>(
            "cannot write packets of {}: found {} columns in {} s, expected {:.0f}, one every {} us",
            sensor.name, sensor.columns, sensor.period_s, 1e6 * sensor.period_s / expected_us, expected_us);
}

PacketEncoder::~PacketEncoder() = default;

std::vector<SensorPacket> PacketEncoder::add_scan(const Scan& scan, double time_s) {
    std::vector<FiringColumn> firings = impl_->format->merge_columns(
        packets::extract_firings(scan, time_s, impl_->sensor, impl_->offsets_us));
    const std::int64_t start = impl_->last ? 0 : impl_->find_first_slot(firings);
    for (FiringColumn& firing : firings) impl_->add_firing(std::move(firing), start);
    return std::exchange(impl_->complete, {});
}

std::vector<SensorPacket> PacketEncoder::flush() {
    impl_->finish_packets();
    impl_->pending.clear();
    return std::exchange(impl_->complete, {});
}

PacketCalibrationFile PacketEncoder::calibration_file() const {
    return impl_->format->make_calibration(impl_->fired);
}
int PacketEncoder::udp_port() const { return impl_->format->udp_port(); }

}  // namespace relidar
