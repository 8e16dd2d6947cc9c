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
};

/// Returns the columns (fixed azimuths) that the scan of a revolution has: those with
/// received measurements, and long runs of columns at which the sensor fires but no ray
/// had a return. A short run is left out. The scan repeats the columns next to it.
/// @param received  azimuths of the head, by column
/// @param fires, is_lost  [columns per revolution] true if the sensor fires at the
/// column, and if its packet was lost
std::vector<bool> choose_columns(const std::map<int, double>& received, const std::vector<bool>& fires,
                                 const std::vector<bool>& is_lost) {
    constexpr std::size_t kShortRun = 8;
    const std::size_t n = fires.size();
    std::vector<bool> is_chosen(n, false);
    for (const auto& [column, head_rad] : received) is_chosen[std::size_t(column)] = true;
    std::size_t run = 0;  // length of the run of columns without returns that ends before c
    for (std::size_t c = 0; c <= n; ++c) {
        const bool has_no_returns = c < n && fires[c] && !is_lost[c] && !is_chosen[c];
        if (has_no_returns) {
            ++run;
            continue;
        }
        for (std::size_t k = 1; run > kShortRun && k <= run; ++k) is_chosen[c - k] = true;
        run = 0;
    }
    return is_chosen;
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
/// Angles of a packet count clockwise, angles of points counterclockwise.
/// @param returns_of_each_ring  [rings] first and second return in the order of the
/// packet
/// @param beam_offsets_us  [rings] time after the first beam of the firing
void add_points(RevolutionPoints& fired, const FiringInstant& firing,
                const std::array<DecodedReturn, 2>* returns_of_each_ring, const std::vector<BeamRays>& beams,
                const std::vector<double>& beam_offsets_us) {
    LidarPoints& points = fired.points;
    fired.head_rad.try_emplace(firing.number, -std::remainder(firing.azimuth_deg, 360.0) * kPi / 180.0);
    for (std::size_t ring = 0; ring < beams.size(); ++ring) {
        // The beam's angles contain the rotation at the mean rate until the beam fires.
        // So only the deviation from this rate is added.
        const double head_deg = firing.azimuth_deg + firing.ahead_deg_us * beam_offsets_us[ring];
        const BeamRay ray = beams[ring].compute_ray(-head_deg * kPi / 180.0);
        const auto add = [&](const DecodedReturn& echo, std::uint8_t return_number) {
            if (echo.range_m == 0.0f) return;
            points.position_m.emplace_back(ray.origin_m + ray.direction * double(echo.range_m));
            points.intensity.push_back(echo.intensity);
            points.ring.push_back(std::uint16_t(ring));
            points.time_offset_s.push_back(float(firing.time_s + 1e-6 * beam_offsets_us[ring]));
            points.return_number.push_back(return_number);
            fired.firing_numbers.push_back(firing.number);
        };
        const auto [brighter, darker] = sort_by_brightness(returns_of_each_ring[ring]);
        add(brighter, 1);
        add(darker, 2);
    }
}

/// Creates the scan of a sensor that fires at fixed azimuths (columns). The points know
/// the column that measured them.
/// @param fires, is_lost  [columns per revolution] true if the sensor fires at the
/// column, and if its packet was lost. Rays of lost packets are unknown and left out
Scan make_fixed_scan(RevolutionPoints& fired, const std::vector<bool>& fires,
                     const std::vector<bool>& is_lost, SpinningSensor sensor) {
    const std::vector<bool> is_in_scan = choose_columns(fired.head_rad, fires, is_lost);
    const std::size_t n = fires.size();
    // Columns and ticks (the steps of a sweep) are the same n azimuths from the rear.
    // Columns count clockwise, ticks counterclockwise.
    SweepFirings sweep{.lattice = {.n_ticks = int(n), .zero_rad = kPi}, .firings = {}};
    std::vector<std::uint32_t> firing_of_column(n);  // index in `sweep.firings`, for columns in the scan
    for (std::size_t column = 0; column < n; ++column) {
        if (!is_in_scan[column]) continue;
        firing_of_column[column] = std::uint32_t(sweep.firings.size());
        const std::size_t tick = (n - column) % n;
        sweep.firings.push_back(int(tick));
    }
    for (const int column : fired.firing_numbers)
        fired.points.firing.push_back(firing_of_column[std::size_t(column)]);
    const auto count = [](const std::vector<bool>& columns) {
        return int(std::ranges::count(columns, true));
    };
    // If no packet was lost, the scan is as wide as the sensor's. It repeats columns for
    // those that choose_columns() left out.
    sensor.columns = int(sweep.firings.size());
    if (count(is_lost) == 0) sensor.columns = std::max(sensor.columns, count(fires));
    return spinning_scan(fired.points, sensor, sweep);
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

/// Returns for each column of a revolution whether its packet was lost, for a sensor that
/// fires at fixed azimuths (columns). Columns at which it never fires are not lost.
std::vector<bool> PacketIndex::find_lost_columns(const PacketRevolution& revolution) const {
    const std::vector<bool>& fires = decoder_->timing().fires;
    std::vector<bool> is_lost(fires.size(), false);
    // Columns of packets count over all revolutions. This one has [begin, end).
    const std::int64_t begin = column_at(revolution.begin_deg), end = begin + std::ssize(fires);
    // The packet after the revolution shows the losses at the end.
    const std::size_t last_tested = std::min(revolution.last + 1, packets_.size() - 1);
    for (std::size_t i = revolution.first + 1; i <= last_tested; ++i) {
        if (packets_[i].n_lost_before == 0) continue;
        const std::int64_t end_of_before = first_column(packets_[i - 1]) + slots_per_packet_;
        const std::int64_t first_lost = std::max(end_of_before, begin);
        const std::int64_t end_of_lost = std::min(first_column(packets_[i]), end);
        for (std::int64_t column = first_lost - begin; column < end_of_lost - begin; ++column)
            is_lost[std::size_t(column)] = fires[std::size_t(column)];
    }
    return is_lost;
}

/// Returns the column of a revolution at an azimuth. Returns -1 or the number of columns
/// if the azimuth is before or after the revolution.
int PacketIndex::column_in(const PacketRevolution& revolution, double azimuth_deg) const {
    const std::int64_t column = column_at(azimuth_deg) - column_at(revolution.begin_deg);
    return int(std::clamp<std::int64_t>(column, -1, std::ssize(decoder_->timing().fires)));
}

Scan PacketIndex::decode(const PacketRevolution& revolution,
                         const std::vector<std::vector<ReceivedPacket>>& packets_of_message,
                         const SpinningSensor& sensor, std::int64_t time_origin_ns) const {
    RevolutionPoints fired;
    const std::vector<BeamRays> beams = make_generators(sensor.beams);
    const FiringTiming& timing = decoder_->timing();
    const bool has_columns = timing.has_fixed_columns();
    const double mean_deg_us = 360e-6 / sensor.period_s;
    const std::uint32_t first_message = message_range(revolution).first;
    // Number of firings of the revolution before this packet, including lost firings.
    std::size_t n_before = 0;
    int previous_number = -1;
    bool is_inside = false;
    for (std::size_t p = revolution.first; p <= revolution.last; ++p) {
        const Entry& entry = packets_[p];
        if (p > revolution.first && !has_columns)
            n_before +=
                std::size_t(packets_[p - 1].n_slots) + entry.n_lost_before * std::size_t(slots_per_packet_);
        DecodedPacket packet = decode_entry(entry.message - first_message, entry, packets_of_message);
        const std::size_t begin = entry.first_firing, end = begin + entry.n_firings;
        if (packet.firings.size() < end) continue;
        // Sensors with fixed azimuths are timed by their clock, others by receipt.
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
            // Number of the column. Its first firing has the slot `slot - sequence`,
            // negative if the first column lacks firings; + n_sequences prevents it.
            const int number = has_columns
                                   ? column_in(revolution, azimuth_deg)
                                   : (slot - firing.sequence + timing.n_sequences) / timing.n_sequences;
            // All firings of a column are in the revolution of the first one.
            if (number != previous_number)
                is_inside = has_columns ? number >= 0 && number < int(timing.fires.size())
                                        : column_deg >= revolution.begin_deg &&
                                              column_deg < revolution.begin_deg + 360.0;
            previous_number = number;
            if (!is_inside) continue;
            const FiringInstant instant{
                .azimuth_deg = column_deg,
                .time_s = begin_s + 1e-6 * (firing.after_us - begin_us - late_us),
                .number = number,
                .ahead_deg_us = timing.interpolates ? step_deg / timing.cycle_us - mean_deg_us : 0.0};
            add_points(fired, instant, &packet.echoes[f * sensor.beams.size()], beams, timing.offset_us);
        }
    }
    const double brightest = full_scale();
    for (float& intensity : fired.points.intensity) intensity = float(double(intensity) / brightest);
    return make_scan(revolution, fired, sensor);
}

/// Assigns the points of a revolution to rays.
/// @param fired  number of the firing (all lasers at one azimuth) that measured each
/// point, and azimuth of the head at each received firing. The points get their firings
Scan PacketIndex::make_scan(const PacketRevolution& revolution, RevolutionPoints& fired,
                            const SpinningSensor& sensor) const {
    if (fired.points.size() == 0) return scan_of_points(fired.points);
    const FiringTiming& timing = decoder_->timing();
    // The firing numbers of a sensor with fixed azimuths are columns.
    if (timing.has_fixed_columns())
        return make_fixed_scan(fired, timing.fires, find_lost_columns(revolution), sensor);
    const SweepFirings sweep = sort_firings(fired.points, fired.firing_numbers, fired.head_rad);
    // If packets were lost, the scan has only the received columns. Otherwise it has all
    // columns, except in the sector in which the sensor never fires.
    const double fired_share = 1.0 - skipped_sector_.width_deg / 360.0;  // of a revolution
    SpinningSensor scan_sensor = sensor;
    scan_sensor.columns =
        revolution.has_gaps ? int(sweep.firings.size()) : int(std::ceil(sensor.columns * fired_share));
    return spinning_scan(fired.points, scan_sensor, sweep);
}

}  // namespace relidar::packets
