// SPDX-License-Identifier: Apache-2.0
// Builds the scan of a revolution from its packets.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "base/fail.hpp"
#include "log/sensor/beam_geometry.hpp"
#include "read/packets/packet_log.hpp"
#include "read/scans/sweep_firings.hpp"

namespace relidar::packets {
/// Points of a revolution, and the firings that measured them.
struct RevolutionPoints {
    LidarPoints points;
    std::vector<int> firing_numbers;  ///< [points] number of the firing that measured the point
    std::map<int, double> head_rad;   ///< azimuth of each received firing, by its number
};

namespace {

/// Azimuth, time and number of a firing (all lasers at one azimuth).
struct FiringInstant {
    double azimuth_deg, time_s;
    int number;  ///< number of the firing; for a sensor that fires at fixed azimuths, the column
    /// current minus mean rotation rate of the LiDAR's head, in degrees per microsecond
    double ahead_deg_us;
    double brightness;  ///< intensity value that becomes 1
};

// If more consecutive columns than this have no measurement, their rays become rays
// without a return. In a shorter gap, the scan repeats neighbouring columns.
constexpr std::size_t kMostUnmeasured = 8;

/// Sets `column_has_fired` of long runs of columns without measurements, so that their
/// rays become rays without a return. Skips columns whose packets were lost.
void fill_long_gaps(std::vector<bool>& column_has_fired, const std::vector<bool>& column_is_enabled,
                    const std::vector<bool>& column_is_lost) {
    const std::size_t n = column_is_enabled.size();
    std::size_t gap = 0;  // number of columns before c without a measurement
    for (std::size_t c = 0; c <= n; ++c) {
        const bool is_in_gap = c < n && column_is_enabled[c] && !column_has_fired[c] && !column_is_lost[c];
        if (is_in_gap) {
            ++gap;
            continue;
        }
        if (gap > kMostUnmeasured)
            for (std::size_t k = 1; k <= gap; ++k) column_has_fired[c - k] = true;
        gap = 0;
    }
}

/// Sorts the two returns of a ray, so that the brighter one is first. A missing second
/// return has the range 0.
std::array<DecodedReturn, 2> sort_by_brightness(std::array<DecodedReturn, 2> returns) {
    auto& [first, second] = returns;
    // A sensor repeats the only return of a ray.
    if (second.range_m == first.range_m) second.range_m = 0.0f;
    const bool is_second_brighter = second.range_m != 0.0f && second.intensity > first.intensity;
    if (first.range_m == 0.0f || is_second_brighter) std::swap(first, second);
    return returns;
}

/// Converts the returns of a firing (one shot of all lasers) to points of a revolution.
/// @param returns_of_each_ring  [rings] first and second return in the order of the
/// packet
/// @param beam_offsets_us  [rings] time after the first beam of the firing
void add_points(RevolutionPoints& revolution_points, const FiringInstant& firing,
                const std::array<DecodedReturn, 2>* returns_of_each_ring, const std::vector<BeamRays>& beams,
                const std::vector<double>& beam_offsets_us) {
    LidarPoints& points = revolution_points.points;
    revolution_points.head_rad.try_emplace(firing.number,
                                           -std::remainder(firing.azimuth_deg, 360.0) * kPi / 180.0);
    for (std::size_t ring = 0; ring < beams.size(); ++ring) {
        // The beam's angles contain the rotation at the mean rate until the beam fires.
        // So only the deviation from this rate is added.
        const double head_deg = firing.azimuth_deg + firing.ahead_deg_us * beam_offsets_us[ring];
        const BeamRay ray = beams[ring].compute_ray(-head_deg * kPi / 180.0);
        const auto add = [&](const DecodedReturn& echo, std::uint8_t return_number) {
            if (echo.range_m == 0.0f) return;
            points.position_m.emplace_back(ray.origin_m + ray.direction * double(echo.range_m));
            points.intensity.push_back(float(double(echo.intensity) / firing.brightness));
            points.ring.push_back(std::uint16_t(ring));
            points.time_offset_s.push_back(float(firing.time_s + 1e-6 * beam_offsets_us[ring]));
            points.return_number.push_back(return_number);
            revolution_points.firing_numbers.push_back(firing.number);
        };
        const auto [first, second] = sort_by_brightness(returns_of_each_ring[ring]);
        add(first, 1);
        add(second, 2);
    }
}

/// Creates the scan of a sensor that fires at fixed azimuths (columns).
/// @param column_is_enabled  [columns per revolution] true if the sensor fires at the
/// column
/// @param column_is_lost  [columns per revolution] true if the packet with the column
/// was lost. Its rays are unknown, so the scan does not contain them.
Scan make_fixed_scan(RevolutionPoints& revolution_points, const std::vector<bool>& column_is_enabled,
                     const std::vector<bool>& column_is_lost, SpinningSensor sensor) {
    std::vector<bool> has_fired(column_is_enabled.size(), false);
    for (const auto& [column, head_rad] : revolution_points.head_rad) has_fired[std::size_t(column)] = true;
    fill_long_gaps(has_fired, column_is_enabled, column_is_lost);
    // Column 0 is at the rear. Columns count clockwise, azimuth steps counterclockwise.
    SweepFirings sweep{.lattice = {.n_ticks = int(has_fired.size()), .zero_rad = kPi}, .firings = {}};
    std::vector<std::uint32_t> firing_index_of_column(has_fired.size());
    for (std::size_t c = 0; c < has_fired.size(); ++c) {
        firing_index_of_column[c] = std::uint32_t(sweep.firings.size());
        if (has_fired[c]) sweep.firings.push_back(int((has_fired.size() - c) % has_fired.size()));
    }
    for (const int column : revolution_points.firing_numbers)
        revolution_points.points.firing.push_back(firing_index_of_column[std::size_t(column)]);
    // If packets were lost, the scan has only the columns that were received.
    sensor.columns = int(sweep.firings.size());
    const bool is_complete = std::ranges::count(column_is_lost, true) == 0;
    if (is_complete)
        sensor.columns = std::max(sensor.columns, int(std::ranges::count(column_is_enabled, true)));
    return spinning_scan(revolution_points.points, sensor, sweep);
}

}  // namespace

/// Decodes a packet for the second time, to build the scan. The first time was when the
/// index was built.
/// @param message_index  index in `packets_of_message`
DecodedPacket PacketIndex::decode_entry(
    std::size_t message_index, const Entry& packet_entry,
    const std::vector<std::vector<ReceivedPacket>>& packets_of_message) const {
    if (message_index >= packets_of_message.size() ||
        packet_entry.in_message >= packets_of_message[message_index].size())
        fail("the file of the recording changed while it was read: a message has fewer packets than before");
    const ReceivedPacket& view = packets_of_message[message_index][packet_entry.in_message];
    if (find_product(view.bytes, calibration_) != product_)
        fail("the file of the recording changed while it was read: a packet differs from before");
    return decoder_->decode_packet(view.bytes);
}

/// Converts an azimuth to a column of a revolution. The result is an invalid column if
/// the azimuth is outside the revolution.
int PacketIndex::column_of(const PacketRevolution& revolution, double azimuth_deg) const {
    const double n = double(decoder_->timing().fires.size());
    return int(std::clamp(std::round((azimuth_deg - revolution.begin_deg) / column_step_deg()), -n, 2.0 * n));
}

/// Returns for each column of a revolution whether its packet was lost. Returns an empty
/// list if the sensor can fire at any azimuth.
std::vector<bool> PacketIndex::find_lost_columns(const PacketRevolution& revolution) const {
    const std::vector<bool>& fires = decoder_->timing().fires;
    std::vector<bool> is_lost(fires.size(), false);
    if (fires.empty()) return is_lost;
    // A packet stores n_slots_ consecutive columns. Its azimuth is that of its first
    // column with a firing, which is `first_slot` columns after its first column.
    const auto first_column_of = [&](const Entry& packet) {
        return column_of(revolution, packet.azimuth_deg) - packet.first_slot;
    };
    // The packet after the revolution shows the losses at the end.
    const std::size_t last_tested = std::min(revolution.last + 1, packets_.size() - 1);
    for (std::size_t i = revolution.first + 1; i <= last_tested; ++i) {
        if (count_lost_packets(i) == 0) continue;
        const int first_lost = std::max(first_column_of(packets_[i - 1]) + n_slots_, 0);
        const int end_of_lost = std::min(first_column_of(packets_[i]), int(fires.size()));
        for (int c = first_lost; c < end_of_lost; ++c) is_lost[std::size_t(c)] = fires[std::size_t(c)];
    }
    return is_lost;
}

/// Returns true if a firing belongs to a revolution.
/// @param number  column of the firing, for a sensor that fires at fixed azimuths
bool PacketIndex::is_inside(const PacketRevolution& revolution, int number, double azimuth_deg) const {
    const auto n_columns = int(decoder_->timing().fires.size());
    if (n_columns > 0) return number >= 0 && number < n_columns;
    return azimuth_deg >= revolution.begin_deg && azimuth_deg < revolution.begin_deg + 360.0;
}

Scan PacketIndex::decode(const PacketRevolution& revolution,
                         const std::vector<std::vector<ReceivedPacket>>& packets_of_message,
                         const SpinningSensor& sensor, std::int64_t time_origin_ns) const {
    RevolutionPoints fired;
    const std::vector<BeamRays> beams = make_generators(sensor.beams);
    const FiringTiming& timing = decoder_->timing();
    const bool has_columns = !timing.fires.empty();  // the sensor fires at fixed azimuths
    const double mean_deg_us = 360e-6 / sensor.period_s, brightness = full_scale();
    const std::uint32_t first_message = message_range(revolution).first;
    // Number of firings of the revolution before this packet, including lost firings.
    std::size_t n_before = 0;
    int previous_number = -1;
    bool is_firing_inside = false;
    for (std::size_t p = revolution.first; p <= revolution.last; ++p) {
        const Entry& entry = packets_[p];
        if (p > revolution.first && !has_columns)
            n_before += std::size_t(packets_[p - 1].n_slots) + count_lost_packets(p) * std::size_t(n_slots_);
        DecodedPacket packet = decode_entry(entry.message - first_message, entry, packets_of_message);
        const std::size_t begin = entry.first_firing, end = begin + entry.n_firings;
        if (packet.firings.size() < end) continue;
        // Sensors with fixed azimuths are timed by their clock, others by the time of
        // receipt.
        const std::int64_t begin_ns =
            has_columns ? entry.clock_ns + revolution.stamp_less_clock_ns : entry.stamp_ns;
        const double begin_s = 1e-9 * double(begin_ns - time_origin_ns);
        const double begin_us = packet.firings[begin].after_us;
        double azimuth_deg = entry.azimuth_deg, step_deg = 0.0;  // continuous, unlike those of the packet
        for (std::size_t f = begin; f < end; ++f) {
            const LaserFiring& firing = packet.firings[f];
            if (f > begin) azimuth_deg += step_deg;
            if (f + 1 < end) step_deg = rotation_deg(firing.azimuth_deg, packet.firings[f + 1].azimuth_deg);
            // Time since the first firing of the column. It is subtracted, because
            // `timing.offset_us` counts from the first firing.
            const double late_us = timing.cycle_us * double(firing.sequence);
            const double column_deg = azimuth_deg - late_us * mean_deg_us;
            const int slot = int(n_before) + firing.slot - entry.first_slot;
            // Number of the column. Its first firing has the slot `slot - part`, which is
            // negative if the first column lacks firings; + parts makes it positive.
            const int number = has_columns
                                   ? column_of(revolution, azimuth_deg)
                                   : (slot - firing.sequence + timing.n_sequences) / timing.n_sequences;
            // Tests only the first firing of a column, because all its firings belong to
            // the same revolution.
            if (number != previous_number) is_firing_inside = is_inside(revolution, number, column_deg);
            previous_number = number;
            if (!is_firing_inside) continue;
            const FiringInstant instant{
                .azimuth_deg = column_deg,
                .time_s = begin_s + 1e-6 * (firing.after_us - begin_us - late_us),
                .number = number,
                .ahead_deg_us = timing.interpolates ? step_deg / timing.cycle_us - mean_deg_us : 0.0,
                .brightness = brightness};
            add_points(fired, instant, &packet.echoes[f * sensor.beams.size()], beams, timing.offset_us);
        }
    }
    return make_scan(revolution, fired, sensor);
}

/// Assigns the points of a revolution to rays.
Scan PacketIndex::make_scan(const PacketRevolution& revolution, RevolutionPoints& fired,
                            const SpinningSensor& sensor) const {
    if (fired.points.size() == 0) return scan_of_points(fired.points);
    const std::vector<bool>& column_is_enabled = decoder_->timing().fires;
    if (!column_is_enabled.empty())  // the sensor fires at fixed azimuths
        return make_fixed_scan(fired, column_is_enabled, find_lost_columns(revolution), sensor);
    const SweepFirings sweep = sort_firings(fired.points, fired.firing_numbers, fired.head_rad);
    // A revolution has no columns in the sector in which the sensor never fires. If
    // packets were lost, the scan has only the received columns.
    SpinningSensor scan_sensor = sensor;
    scan_sensor.columns = int(std::ceil(double(sensor.columns) * (1.0 - skipped_.width_deg / 360.0)));
    if (revolution.has_gaps) scan_sensor.columns = int(sweep.firings.size());
    return spinning_scan(fired.points, scan_sensor, sweep);
}

}  // namespace relidar::packets
