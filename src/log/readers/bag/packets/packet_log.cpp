// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/packets/packet_log.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "log/clouds/arrange_firings.hpp"
#include "log/sensor/beam_geometry.hpp"

namespace relidar::packets {
namespace {

// maximum number of firings per revolution, enough for revolutions of two seconds
constexpr int kMostFirings = 40000;
constexpr std::int64_t kLongestTurn_ns = 2000000000;
constexpr std::size_t kMostInMessage = 0xFFFF;
constexpr double kBehind_deg = 180.0;
constexpr double kBackward_deg = 1.0;  // maximum decrease of the encoder angle that is accepted as noise
constexpr double kMostBright = 65535.0;

double degrees_on(double from_deg, double to_deg) {  // clockwise, less than one revolution
    const double step = std::remainder(to_deg - from_deg, 360.0);
    return step < -kBackward_deg ? step + 360.0 : step;
}

/// Azimuth, time and number of a firing, from which its points are computed.
struct Place {
    double azimuth_deg, time_s;
    int number;  ///< number of the firing
    /// current rotation rate minus the average rotation rate, in degrees per microsecond
    double ahead_deg_us;
    double brightness;  ///< intensity value that is scaled to 1
};

// `column` may be outside one revolution
bool fires_at(const std::vector<bool>& fires, std::int64_t column) {
    const auto n = std::int64_t(fires.size());
    return fires[std::size_t((column % n + n) % n)];
}

/// Points of a revolution, and the number of the firing that measured each point.
struct FiredPoints {
    Points points;
    std::vector<int> numbers;
};

/// Adds the returns of all beams of a firing as points. If a ray has two returns, the
/// brighter return is added first.
void add_firing(FiredPoints& fired, const Place& place, const std::array<Echo, 2>* echoes,
                const std::vector<BeamGeometry>& beams, const std::vector<double>& offset_us) {
    Points& points = fired.points;
    for (std::size_t ring = 0; ring < beams.size(); ++ring) {
        const double head_deg = place.azimuth_deg + place.ahead_deg_us * offset_us[ring];
        const BeamRay ray = beams[ring].ray(-head_deg * kPi / 180.0);
        const auto add = [&](const Echo& echo, std::uint8_t number) {
            points.position_m.emplace_back(ray.origin_m + ray.direction * double(echo.range_m));
            points.intensity.push_back(float(double(echo.intensity) / place.brightness));
            points.ring.push_back(std::uint16_t(ring));
            points.time_offset_s.push_back(float(place.time_s + 1e-6 * offset_us[ring]));
            points.return_number.push_back(number);
            fired.numbers.push_back(place.number);
        };
        Echo first = echoes[ring][0], other = echoes[ring][1];  // two returns may be identical
        if (other.range_m == first.range_m) other.range_m = 0.0f;
        if (first.range_m == 0.0f || (other.range_m != 0.0f && other.intensity > first.intensity))
            std::swap(first, other);
        if (first.range_m != 0.0f) add(first, 1);
        if (other.range_m != 0.0f) add(other, 2);
    }
}

/// Creates the scan of a sensor that fires at fixed azimuths.
/// @param has_fired  [columns per revolution] true if the column was fired
/// @param n_columns  minimum number of columns of the scan
Scan scan_of_columns(FiredPoints& fired, const std::vector<bool>& has_fired, SpinningSensor sensor,
                     std::size_t n_columns) {
    Sweep sweep{{int(has_fired.size()), kPi}, {}};
    std::vector<std::uint32_t> place(has_fired.size());
    for (std::size_t c = 0; c < has_fired.size(); ++c) {
        place[c] = std::uint32_t(sweep.firings.size());
        if (has_fired[c]) sweep.firings.push_back(int((has_fired.size() - c) % has_fired.size()));
    }
    for (const int column : fired.numbers) fired.points.firing.push_back(place[std::size_t(column)]);
    sensor.columns = int(std::max(n_columns, sweep.firings.size()));
    return spinning_scan(fired.points, sensor, sweep);
}

}  // namespace

void PacketLog::add(const std::vector<PacketView>& packets, std::int64_t log_ns, const bag::Place& place,
                    const Calibration& calibration) {
    messages_.push_back({place, log_ns});
    if (packets.size() > kMostInMessage)
        throw DataError(
            fmt::format("{} packets in a message, expected at most {}", packets.size(), kMostInMessage));
    for (std::size_t i = 0; i < packets.size(); ++i) {
        check_product(packets[i], calibration);
        add_packet(packets[i], std::uint16_t(i));
    }
}

void PacketLog::check_product(const PacketView& packet, const Calibration& calibration) {
    if (product_ && product_ == find_product(packet.bytes, calibration_)) return;
    const Product* product = find_product(packet.bytes, calibration);
    if (product_)
        throw DataError(fmt::format("a packet of {} bytes of {}, expected those of a {} as before",
                                    packet.bytes.size(), product ? product->name : "no known product",
                                    product_->name));
    if (!product || !product->make) throw DataError(unknown_text(product, packet.bytes));
    decoder_ = product->make(product->name, calibration);
    product_ = product;
    calibration_ = calibration;
}

/// Returns the angle between two columns of a sensor that fires at fixed azimuths.
double PacketLog::step_deg() const { return 360.0 / double(decoder_->timing().fires.size()); }

void PacketLog::add_packet(const PacketView& view, std::uint16_t in_message) {
    const Packet packet = decoder_->decode(view.bytes);
    if (packet.firings.empty()) return;
    n_slots_ = packet.n_slots;
    const Timing& timing = decoder_->timing();
    const Firing& begin = packet.firings.front();
    const std::int64_t after_ns = std::llround(1e3 * begin.after_us);
    Entry entry{view.stamp_ns + after_ns,
                packet.clock_ns + after_ns,
                begin.azimuth_deg,
                0.0f,
                std::uint32_t(messages_.size() - 1),
                in_message,
                std::int16_t(begin.slot)};
    for (std::size_t f = 1; f < packet.firings.size(); ++f)
        entry.turned_deg +=
            float(degrees_on(packet.firings[f - 1].azimuth_deg, packet.firings[f].azimuth_deg));
    if (!packets_.empty()) {
        const Entry& before = packets_.back();
        const double passed_stamp_us = 1e-3 * double(entry.stamp_ns - before.stamp_ns);
        if (timing.wrap_us > 0.0) {
            const double passed_us = 1e-3 * double(entry.clock_ns - before.clock_ns);
            entry.clock_ns += std::llround(1e3 * timing.wrap_us *
                                           std::round((passed_stamp_us - passed_us) / timing.wrap_us));
        }
        entry.azimuth_deg =
            before.azimuth_deg + degrees_on(std::fmod(before.azimuth_deg, 360.0), begin.azimuth_deg);
        // If packets of more than one revolution were lost, the encoder angle alone is
        // ambiguous. The number of lost revolutions is then estimated from the previous
        // rotation rate.
        const double own_us = timing.cycle_us * double(std::max(n_slots_ - 1, 1));
        const double deg_us =
            timing.fires.empty() ? double(before.turned_deg) / own_us : step_deg() / timing.cycle_us;
        const double turned = 1e-3 * deg_us * double(entry.clock_ns - before.clock_ns);
        entry.azimuth_deg +=
            360.0 * std::max(0.0, std::round((before.azimuth_deg + turned - entry.azimuth_deg) / 360.0));
    }
    packets_.push_back(entry);
    if (!timing.is_wide) return;
    n_bright_.resize(kMostBright + 1);
    for (const auto& returns : packet.echoes)
        for (const Echo& echo : returns)
            if (echo.range_m > 0.0f)
                ++n_bright_[std::size_t(
                    std::clamp(std::round(255.0 * double(echo.intensity)), 0.0, kMostBright))];
}

/// Computes by how many packets a packet follows the previous one. The result is 1 if no
/// packet was lost in between.
std::size_t PacketLog::steps_to(std::size_t packet) const {
    const Timing& timing = decoder_->timing();
    const Entry &entry = packets_[packet], &before = packets_[packet - 1];
    double n = 1e-3 * double(entry.clock_ns - before.clock_ns) / (timing.cycle_us * double(n_slots_));
    if (!timing.fires.empty())
        n = ((entry.azimuth_deg - before.azimuth_deg) / step_deg() - entry.first_slot + before.first_slot) /
            double(n_slots_);
    return std::size_t(std::clamp(std::round(n), 1.0, 1e9));
}

/// Returns the number of packets that were lost before a packet. Packets in which the
/// sensor does not fire are not counted.
std::size_t PacketLog::count_missing_before(std::size_t packet) const {
    const std::size_t n = steps_to(packet) - 1;
    const std::vector<bool>& fires = decoder_->timing().fires;
    if (fires.empty() || n * std::size_t(n_slots_) > 2 * fires.size()) return n;
    const Entry& before = packets_[packet - 1];
    std::int64_t column = std::llround((before.azimuth_deg - kBehind_deg) / step_deg()) - before.first_slot;
    std::size_t missing = 0;  // does not count packets in which nothing fires
    for (std::size_t k = 0; k < n; ++k) {
        column += n_slots_;
        bool any = false;
        for (int slot = 0; slot < n_slots_; ++slot) any = any || fires_at(fires, column + slot);
        missing += any;
    }
    return missing;
}

/// Returns the range of head angles that the packets cover. If the sensor fires at fixed
/// azimuths, the range also includes the adjacent azimuths at which it does not fire.
std::pair<double, double> PacketLog::reach_deg() const {
    const Entry &first = packets_.front(), &last = packets_.back();
    const std::vector<bool>& fires = decoder_->timing().fires;
    if (fires.empty()) return {first.azimuth_deg, last.azimuth_deg};
    std::int64_t begin = std::llround((first.azimuth_deg - kBehind_deg) / step_deg());
    std::int64_t end =
        std::llround((last.azimuth_deg + double(last.turned_deg) - kBehind_deg) / step_deg()) + 1;
    for (std::size_t k = 0; k < fires.size() && !fires_at(fires, begin - 1); ++k) --begin;
    for (std::size_t k = 0; k < fires.size() && !fires_at(fires, end); ++k) ++end;
    return {kBehind_deg + step_deg() * double(begin), kBehind_deg + step_deg() * double(end)};
}

std::vector<PacketTurn> PacketLog::turns() const {
    std::vector<PacketTurn> turns;
    if (packets_.size() < 2) return turns;
    const auto [first_deg, end] = reach_deg();
    double begin = kBehind_deg + 360.0 * std::ceil((first_deg - kBehind_deg) / 360.0);
    for (std::size_t p = 0; p < packets_.size() && begin + 360.0 <= end; begin += 360.0) {
        PacketTurn turn{0, 0, 0, 0, begin, 0};
        const auto first_behind = [&](double azimuth) {  // first packet that begins behind the azimuth
            return std::size_t(std::ranges::upper_bound(packets_, azimuth, {}, &Entry::azimuth_deg) -
                               packets_.begin());
        };
        turn.first = std::max(first_behind(begin), std::size_t(1)) - 1;
        turn.last = std::min(first_behind(begin + 360.0), packets_.size()) - 1;
        p = turn.last;
        // the next packet may contain the second part of the last column
        if (decoder_->timing().parts > 1) turn.last = std::min(turn.last + 1, packets_.size() - 1);
        // all packets of this revolution were lost; continue at the next packet
        if (turn.first == turn.last) {
            const double next = packets_[std::min(p + 1, packets_.size() - 1)].azimuth_deg;
            begin = std::max(begin, kBehind_deg + 360.0 * (std::floor((next - kBehind_deg) / 360.0) - 1.0));
            continue;
        }
        for (std::size_t i = turn.first + 1; i <= turn.last; ++i) turn.n_missing += count_missing_before(i);
        find_times(turn);
        if (2 * turn.n_missing < turn.last - turn.first && is_even(turn)) turns.push_back(turn);
    }
    return turns;
}

/// Computes the time at which the head faces forward. If the sensor's clock determines
/// the times, also computes the offset from this clock to the stamps.
void PacketLog::find_times(PacketTurn& turn) const {
    const double forward = turn.begin_deg + 180.0;
    const auto behind =
        std::ranges::upper_bound(packets_, forward, {}, &Entry::azimuth_deg) - packets_.begin();
    const std::size_t k = std::clamp(std::size_t(behind), std::size_t(1), packets_.size() - 1);
    const Entry &before = packets_[k - 1], &after = packets_[k];
    const double s = (forward - before.azimuth_deg) / std::max(after.azimuth_deg - before.azimuth_deg, 1e-6);
    turn.forward_ns = before.stamp_ns + std::int64_t(s * double(after.clock_ns - before.clock_ns));
    turn.log_ns = messages_[before.message].log_ns;
    if (decoder_->timing().fires.empty()) return;
    turn.stamp_less_clock_ns = before.stamp_ns - before.clock_ns;
    for (std::size_t i = turn.first; i <= turn.last; ++i)
        turn.stamp_less_clock_ns =
            std::min(turn.stamp_less_clock_ns, packets_[i].stamp_ns - packets_[i].clock_ns);
    turn.forward_ns += before.clock_ns + turn.stamp_less_clock_ns - before.stamp_ns;
}

/// Returns true if the sensor's clock increases from packet to packet and the duration of
/// the revolution is plausible.
bool PacketLog::is_even(const PacketTurn& turn) const {
    for (std::size_t i = turn.first + 1; i <= turn.last; ++i)
        if (packets_[i].clock_ns <= packets_[i - 1].clock_ns) return false;
    return packets_[turn.last].clock_ns - packets_[turn.first].clock_ns <= kLongestTurn_ns;
}

std::vector<PacketLog::Source> PacketLog::messages(const PacketTurn& turn) const {
    return {messages_.begin() + packets_[turn.first].message,
            messages_.begin() + packets_[turn.last].message + 1};
}

/// Returns the average azimuth step between two firings of a revolution.
double PacketLog::slot_deg(const PacketTurn& turn) const {
    const std::size_t n = (turn.last - turn.first + turn.n_missing) * std::size_t(n_slots_);
    const double all_deg = packets_[turn.last].azimuth_deg - packets_[turn.first].azimuth_deg;
    return std::max(all_deg, 1.0) / double(std::max<std::size_t>(n, 1));
}

SpinningSensor PacketLog::sensor() const {
    const Entry &first = packets_.front(), &last = packets_.back();
    const double period_ns =
        360.0 * double(last.clock_ns - first.clock_ns) / std::max(last.azimuth_deg - first.azimuth_deg, 1.0);
    const double period_s = std::clamp(1e-9 * period_ns, 0.02, 1.0);
    const Timing& timing = decoder_->timing();
    if (!timing.fires.empty()) return decoder_->sensor(int(timing.fires.size()), 1.0 / period_s);
    // number of columns: the maximum number of firings in any revolution
    double most = 1e6 * period_s / timing.cycle_us;
    for (const PacketTurn& turn : turns()) most = std::max(most, 360.0 / slot_deg(turn));
    most /= double(timing.parts);
    return decoder_->sensor(std::min(int(std::ceil(most)) + 1, kMostFirings), 1.0 / period_s);
}

/// Returns the maximum intensity of all returns on a scale where 255 corresponds to
/// intensity 1.
double PacketLog::brightest() const {
    std::size_t most = n_bright_.size();
    while (most > 0 && n_bright_[most - 1] == 0) --most;
    return most > 0 ? double(most - 1) : 0.0;
}

/// Returns the intensity that is scaled to 1. Uses the same rule as for point clouds
/// (cloud_units.cpp).
double PacketLog::intensity_max() const {
    if (brightest() <= 255.0) return 1.0;
    std::uint64_t n = 0, left = 0;
    for (const std::uint32_t count : n_bright_) n += count;
    left = std::uint64_t(0.995 * double(n - 1));
    std::size_t at = 0;
    while (n_bright_[at] <= left) left -= n_bright_[at++];
    return std::max(double(at), 1.0) / 255.0;
}

std::string PacketLog::about() const {
    if (brightest() <= 255.0) return decoder_->about();
    return fmt::format(
        "{}, reflectivities up to {:.4g} ({:.4g}, above which 0.5 % of the points are, counts as 1)",
        decoder_->about(), brightest(), 255.0 * intensity_max());
}

/// Decodes a packet again when the scan of its revolution is read.
Packet PacketLog::reread_packet(const PacketTurn& turn, const Entry& entry,
                                const std::vector<std::vector<PacketView>>& packets) const {
    const std::size_t m = entry.message - packets_[turn.first].message;
    if (m >= packets.size() || entry.in_message >= packets[m].size())
        throw DataError("a message of packets has fewer of them than when it was first read");
    const PacketView& view = packets[m][entry.in_message];
    if (find_product(view.bytes, calibration_) != product_)
        throw DataError("a packet is another one than when it was first read");
    return decoder_->decode(view.bytes);
}

/// Converts an azimuth to a column of a revolution. The result is outside the valid range
/// if the azimuth is outside the revolution.
int PacketLog::column_in(const PacketTurn& turn, double azimuth_deg) const {
    const double n = double(decoder_->timing().fires.size());
    return int(std::clamp(std::round((azimuth_deg - turn.begin_deg) / step_deg()), -n, 2.0 * n));
}

/// Marks the columns of lost packets as fired. These packets were lost directly before
/// `packet`.
void PacketLog::mark_missing(const PacketTurn& turn, std::size_t packet, std::vector<bool>& has_fired) const {
    const Entry &entry = packets_[packet], &before = packets_[packet - 1];
    const int begin = column_in(turn, before.azimuth_deg) - before.first_slot + n_slots_;
    const int end = std::min(column_in(turn, entry.azimuth_deg) - entry.first_slot, int(has_fired.size()));
    for (int c = std::max(begin, 0); c < end; ++c)
        has_fired[std::size_t(c)] = decoder_->timing().fires[std::size_t(c)];
}

Scan PacketLog::scan(const PacketTurn& turn, const std::vector<std::vector<PacketView>>& packets,
                     const SpinningSensor& sensor, std::int64_t zero_ns) const {
    FiredPoints fired;
    const std::vector<BeamGeometry> beams = geometries_of(sensor.beams);
    const Timing& timing = decoder_->timing();
    const double mean_deg_us = 360e-6 / sensor.period_s, brightness = intensity_max();
    const int n_columns = int(timing.fires.size());
    std::vector<bool> has_fired(timing.fires.size(), false);
    // number of packets of the revolution before this packet, including lost packets
    std::size_t before = 0;
    int previous_number = -1;
    bool is_inside = false;
    for (std::size_t p = turn.first; p <= turn.last; ++p) {
        const Entry& entry = packets_[p];
        if (p > turn.first) before += steps_to(p);
        Packet packet = reread_packet(turn, entry, packets);
        if (packet.firings.empty()) continue;
        if (p > turn.first && n_columns > 0) mark_missing(turn, p, has_fired);
        const std::int64_t begin_ns =
            timing.fires.empty() ? entry.stamp_ns : entry.clock_ns + turn.stamp_less_clock_ns;
        const double begin_s = 1e-9 * double(begin_ns - zero_ns), first_us = packet.firings.front().after_us;
        double azimuth = entry.azimuth_deg, step = 0.0;
        for (std::size_t f = 0; f < packet.firings.size(); ++f) {
            const Firing& firing = packet.firings[f];
            azimuth += f > 0 ? step : 0.0;
            if (f + 1 < packet.firings.size())
                step = degrees_on(firing.azimuth_deg, packet.firings[f + 1].azimuth_deg);
            // time and rotation since the first firing sequence of this column
            const double late_us = timing.cycle_us * double(firing.part);
            const double start_deg = azimuth - late_us * mean_deg_us;
            const int number =
                n_columns > 0
                    ? column_in(turn, azimuth)
                    : (int(before) * n_slots_ + firing.slot - firing.part + timing.parts) / timing.parts;
            // all firing sequences of a column belong to the same revolution
            if (number != previous_number)
                is_inside = n_columns > 0 ? number >= 0 && number < n_columns
                                          : start_deg >= turn.begin_deg && start_deg < turn.begin_deg + 360.0;
            previous_number = number;
            if (!is_inside) continue;
            if (n_columns > 0) has_fired[std::size_t(number)] = true;
            const double time_s = begin_s + 1e-6 * (firing.after_us - first_us - late_us);
            const double ahead_deg_us = timing.interpolates ? step / timing.cycle_us - mean_deg_us : 0.0;
            std::array<Echo, 2>* echoes = &packet.echoes[f * sensor.beams.size()];
            add_firing(fired, {start_deg, time_s, number, ahead_deg_us, brightness}, echoes, beams,
                       timing.offset_us);
        }
    }
    if (fired.points.size() == 0) return unordered_scan(fired.points);
    if (n_columns > 0)
        return scan_of_columns(fired, has_fired, sensor, std::size_t(std::ranges::count(timing.fires, true)));
    const Sweep sweep = arrange_firings(fired.points, fired.numbers, sensor,
                                        -slot_deg(turn) * double(timing.parts) * kPi / 180.0);
    return spinning_scan(fired.points, sensor, sweep);
}

}  // namespace relidar::packets
