// SPDX-License-Identifier: Apache-2.0
#include "dataset/packets/packet_log.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/math.hpp>

#include "dataset/arrange_firings.hpp"

namespace relidar::packets {
namespace {

constexpr int kMostFirings = 40000;  // of a turn: one of two seconds
constexpr std::int64_t kLongestTurn_us = 2000000;
constexpr std::size_t kMostInMessage = 0xFFFF;
constexpr double kBehind_deg = 180.0;
constexpr double kBackward_deg = 1.0;  // by which an encoder may seem to go back

double degrees_on(double from_deg, double to_deg) {  // clockwise, less than a turn
    const double step = std::remainder(to_deg - from_deg, 360.0);
    return step < -kBackward_deg ? step + 360.0 : step;
}

/// A point in the making.
struct Place {
    double azimuth_deg, time_s;
    int number;           ///< of the firing
    double ahead_deg_us;  ///< how much faster the head turns there than it does on average
};

/// Adds what the beams saw, both returns of a ray with the brighter one first.
void add_firing(ScanPoints& points, std::vector<int>& numbers, const Place& place, const std::array<Echo, 2>* echoes,
                const SpinningSensor& sensor, const std::vector<double>& offset_us) {
    for (std::size_t ring = 0; ring < sensor.beams.size(); ++ring) {
        const double head_deg = place.azimuth_deg + place.ahead_deg_us * offset_us[ring];
        const BeamRay ray = beam_ray(sensor.beams[ring], -head_deg * kPi / 180.0);
        const auto add = [&](const Echo& echo, std::uint8_t number) {
            points.point_m.emplace_back(ray.origin_m + ray.direction * double(echo.range_m));
            points.intensity.push_back(echo.intensity);
            points.ring.push_back(std::uint16_t(ring));
            points.time_offset_s.push_back(float(place.time_s + 1e-6 * offset_us[ring]));
            points.return_number.push_back(number);
            numbers.push_back(place.number);
        };
        Echo first = echoes[ring][0], other = echoes[ring][1];  // two returns may be the same one
        if (other.range_m == first.range_m) other.range_m = 0.0f;
        if (first.range_m == 0.0f || (other.range_m != 0.0f && other.intensity > first.intensity)) std::swap(first, other);
        if (first.range_m != 0.0f) add(first, 0);
        if (other.range_m != 0.0f) add(other, 1);
    }
}

}  // namespace

void PacketLog::add(const std::vector<PacketView>& packets, std::int64_t log_ns, const bag::Place& place, const std::string& calibration) {
    messages_.push_back({place, log_ns});
    if (packets.size() > kMostInMessage)
        throw DataError(fmt::format("{} packets in a message, expected at most {}", packets.size(), kMostInMessage));
    for (std::size_t i = 0; i < packets.size(); ++i) {
        check_product(packets[i], calibration);
        add_packet(packets[i], std::uint16_t(i));
    }
}

void PacketLog::check_product(const PacketView& packet, const std::string& calibration) {
    const Product* product = find_product(packet.bytes);
    if (product && product == product_) return;
    if (product_)
        throw DataError(fmt::format("a packet of {} bytes of {}, expected those of a {} as before", packet.bytes.size(),
                                    product ? product->name : "no known product", product_->name));
    if (!product || !product->make) throw DataError(unknown_text(product, packet.bytes));
    decoder_ = product->make(product->name, calibration);
    product_ = product;
}

void PacketLog::add_packet(const PacketView& view, std::uint16_t in_message) {
    const Packet packet = decoder_->decode(view.bytes);
    if (packet.firings.empty()) return;
    n_slots_ = packet.n_slots;
    const Timing& timing = decoder_->timing();
    const Firing& begin = packet.firings.front();
    Entry entry{view.stamp_ns + std::llround(1e3 * begin.after_us), std::llround(packet.clock_us + begin.after_us), begin.azimuth_deg,
                0.0f, std::uint32_t(messages_.size() - 1), in_message, std::int16_t(begin.slot)};
    for (std::size_t f = 1; f < packet.firings.size(); ++f)
        entry.turned_deg += float(degrees_on(packet.firings[f - 1].azimuth_deg, packet.firings[f].azimuth_deg));
    if (!packets_.empty()) {
        const Entry& before = packets_.back();
        const double passed_stamp_us = 1e-3 * double(entry.stamp_ns - before.stamp_ns);
        if (timing.wrap_us > 0.0)
            entry.clock_us +=
                std::llround(timing.wrap_us * std::round((passed_stamp_us - double(entry.clock_us - before.clock_us)) / timing.wrap_us));
        entry.azimuth_deg = before.azimuth_deg + degrees_on(std::fmod(before.azimuth_deg, 360.0), begin.azimuth_deg);
        // packets that were lost for more than a turn: by the rate of the one before
        const double own_us = timing.cycle_us * double(std::max(n_slots_ - 1, 1));
        const double turned = double(before.turned_deg) / own_us * double(entry.clock_us - before.clock_us);
        entry.azimuth_deg += 360.0 * std::max(0.0, std::round((before.azimuth_deg + turned - entry.azimuth_deg) / 360.0));
    }
    packets_.push_back(entry);
}

/// Packets that are not there between one and the one before.
std::size_t PacketLog::missing_before(std::size_t packet) const {
    const Timing& timing = decoder_->timing();
    const Entry &entry = packets_[packet], &before = packets_[packet - 1];
    const double passed_us = double(entry.clock_us - before.clock_us);
    const double n = std::round(passed_us / (timing.cycle_us * double(n_slots_))) - 1.0;
    return std::size_t(std::clamp(n, 0.0, 1e9));
}

std::vector<PacketTurn> PacketLog::turns() const {
    std::vector<PacketTurn> turns;
    if (packets_.size() < 2) return turns;
    double begin = kBehind_deg + 360.0 * std::ceil((packets_.front().azimuth_deg - kBehind_deg) / 360.0);
    for (std::size_t p = 0; p < packets_.size() && begin + 360.0 <= packets_.back().azimuth_deg; begin += 360.0) {
        PacketTurn turn{0, 0, 0, 0, begin, 0};
        const auto first_behind = [&](double azimuth) {  // the first packet that begins behind it
            return std::size_t(std::ranges::upper_bound(packets_, azimuth, {}, &Entry::azimuth_deg) - packets_.begin());
        };
        turn.first = std::max(first_behind(begin), std::size_t(1)) - 1;
        turn.last = std::min(first_behind(begin + 360.0), packets_.size()) - 1;
        p = turn.last;
        if (turn.first == turn.last) {  // none of its packets is there: on to the next one's turn
            const double next = packets_[std::min(p + 1, packets_.size() - 1)].azimuth_deg;
            begin = std::max(begin, kBehind_deg + 360.0 * (std::floor((next - kBehind_deg) / 360.0) - 1.0));
            continue;
        }
        const double forward = begin + 180.0;
        const std::size_t k = std::clamp(first_behind(forward), std::size_t(1), packets_.size() - 1);
        const Entry &before = packets_[k - 1], &after = packets_[k];
        const double s = (forward - before.azimuth_deg) / std::max(after.azimuth_deg - before.azimuth_deg, 1e-6);
        turn.forward_ns = before.stamp_ns + std::int64_t(s * 1e3 * double(after.clock_us - before.clock_us));
        turn.log_ns = messages_[before.message].log_ns;
        for (std::size_t i = turn.first + 1; i <= turn.last; ++i) turn.n_missing += missing_before(i);
        if (2 * turn.n_missing < turn.last - turn.first && is_even(turn)) turns.push_back(turn);
    }
    return turns;
}

/// Whether the sensor's clock rises within a turn, and the turn lasts as long as one may.
bool PacketLog::is_even(const PacketTurn& turn) const {
    for (std::size_t i = turn.first + 1; i <= turn.last; ++i)
        if (packets_[i].clock_us <= packets_[i - 1].clock_us) return false;
    return packets_[turn.last].clock_us - packets_[turn.first].clock_us <= kLongestTurn_us;
}

std::vector<PacketLog::Source> PacketLog::messages(const PacketTurn& turn) const {
    return {messages_.begin() + packets_[turn.first].message, messages_.begin() + packets_[turn.last].message + 1};
}

/// From firing to firing.
double PacketLog::slot_deg(const PacketTurn& turn) const {
    const std::size_t n = (turn.last - turn.first + turn.n_missing) * std::size_t(n_slots_);
    const double all_deg = packets_[turn.last].azimuth_deg - packets_[turn.first].azimuth_deg;
    return std::max(all_deg, 1.0) / double(std::max<std::size_t>(n, 1));
}

SpinningSensor PacketLog::sensor() const {
    const Entry &first = packets_.front(), &last = packets_.back();
    const double period_us = 360.0 * double(last.clock_us - first.clock_us) / std::max(last.azimuth_deg - first.azimuth_deg, 1.0);
    const double period_s = std::clamp(1e-6 * period_us, 0.02, 1.0);
    const Timing& timing = decoder_->timing();
    double most = 1e6 * period_s / timing.cycle_us;  // firings of a turn: none may be left over
    for (const PacketTurn& turn : turns()) most = std::max(most, 360.0 / slot_deg(turn));
    return decoder_->sensor(std::min(int(std::ceil(most)) + 1, kMostFirings), 1.0 / period_s);
}

Scan PacketLog::scan(const PacketTurn& turn, const std::vector<std::vector<PacketView>>& packets, const SpinningSensor& sensor,
                     std::int64_t zero_ns) const {
    ScanPoints points;
    std::vector<int> numbers;
    const Timing& timing = decoder_->timing();
    const double mean_deg_us = 360e-6 / sensor.period_s;
    std::size_t before = 0;  // packets of the turn, the missing ones too
    for (std::size_t p = turn.first; p <= turn.last; ++p, ++before) {
        const Entry& entry = packets_[p];
        if (p > turn.first) before += missing_before(p);
        const std::size_t m = entry.message - packets_[turn.first].message;
        if (m >= packets.size() || entry.in_message >= packets[m].size())
            throw DataError("a message of packets has fewer of them than when it was first read");
        const PacketView& view = packets[m][entry.in_message];
        if (find_product(view.bytes) != product_) throw DataError("a packet is another one than when it was first read");
        const Packet packet = decoder_->decode(view.bytes);
        double azimuth = entry.azimuth_deg, step = 0.0;
        for (std::size_t f = 0; f < packet.firings.size(); ++f) {
            const Firing& firing = packet.firings[f];
            azimuth += f > 0 ? step : 0.0;
            if (f + 1 < packet.firings.size()) step = degrees_on(firing.azimuth_deg, packet.firings[f + 1].azimuth_deg);
            if (azimuth < turn.begin_deg || azimuth >= turn.begin_deg + 360.0) continue;
            const double time_s = 1e-9 * double(view.stamp_ns - zero_ns) + 1e-6 * firing.after_us;
            const double ahead_deg_us = timing.interpolates ? step / timing.cycle_us - mean_deg_us : 0.0;
            add_firing(points, numbers, {azimuth, time_s, int(before) * n_slots_ + firing.slot, ahead_deg_us},
                       &packet.echoes[f * sensor.beams.size()], sensor, timing.offset_us);
        }
    }
    if (points.size() == 0) return unordered_scan(points);
    const Sweep sweep = arrange_firings(points, numbers, sensor, -slot_deg(turn) * kPi / 180.0);
    return spinning_scan(points, sensor, sweep);
}

}  // namespace relidar::packets
