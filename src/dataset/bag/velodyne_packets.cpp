// SPDX-License-Identifier: Apache-2.0
#include "dataset/bag/velodyne_packets.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "dataset/bag/byte_reader.hpp"
#include "dataset/bag/message_reader.hpp"
#include "dataset/told_firings.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kPacketBytes = 1206, kBlocks = 12, kLasersOfBlock = 32, kLasers16 = 16, kTailAt = 1200;
constexpr std::size_t kFirings = 2;  // of a block
constexpr double kFiring_us = 55.296, kLaser_us = 2.304, kRangeUnit_m = 0.002;
constexpr int kMostFirings = 40000;  // of a turn: one of two seconds
constexpr std::int64_t kHour_us = 3600000000, kLongestTurn_us = 2000000;
constexpr std::uint8_t kDual = 0x39, kVlp16 = 0x22;
constexpr double kBehind_deg = 180.0;

struct Block {
    double azimuth_deg;
    std::array<std::uint16_t, kLasersOfBlock> range;
    std::array<std::uint8_t, kLasersOfBlock> reflectivity;
};

std::array<Block, kBlocks> blocks_of(std::string_view packet) {
    ByteReader reader(packet);
    std::array<Block, kBlocks> blocks{};
    for (Block& block : blocks) {
        if (reader.number<std::uint16_t>() != 0xEEFF)
            throw DataError("a block of a packet that does not begin with FF EE, expected Velodyne's");
        block.azimuth_deg = 0.01 * reader.number<std::uint16_t>();
        if (block.azimuth_deg >= 360.0)
            throw DataError(fmt::format("an azimuth of {} degrees in a packet, expected less than 360", block.azimuth_deg));
        for (std::size_t l = 0; l < kLasersOfBlock; ++l) {
            block.range[l] = reader.number<std::uint16_t>();
            block.reflectivity[l] = reader.number<std::uint8_t>();
        }
    }
    return blocks;
}

const char* product_name(std::uint8_t product) {
    switch (product) {
        case 0x21:
            return "an HDL-32E";
        case 0x24:
            return "a Puck LITE or another VLP-16 of its own timing";
        case 0x28:
            return "a VLP-32C";
        case 0x63:
            return "a Velarray";
        case 0xA1:
            return "a VLS-128";
        default:
            return "a sensor that relidar does not know";
    }
}

/// Rings of the lasers, 0 the highest: 0, 2, ... 14 point to -15, -13, ... -1 degrees, 1, 3, ... 15 to 1, 3, ... 15.
std::uint16_t ring_of(std::size_t laser) {
    return std::uint16_t(laser % 2 == 1 ? (15 - laser) / 2 : 15 - laser / 2);
}

double degrees_on(double from_deg, double to_deg) {  // clockwise, less than a turn
    const double step = std::fmod(to_deg - from_deg, 360.0);
    return step < 0.0 ? step + 360.0 : step;
}

/// Points of one firing at a head's angle, and where they go.
struct Firing {
    double azimuth_deg, step_deg;  ///< of the first laser, unwrapped; to the next firing
    double time_s;
    int number;
    const Block* second;  ///< the only one where there is one return
    const Block* last;    ///< of two returns; nullptr
    std::size_t first;    ///< entry of laser 0 in its block
};

void add_return(ScanPoints& points, const Block& block, std::size_t entry, std::uint16_t ring, glm::dvec3 direction) {
    points.point_m.emplace_back(direction * (kRangeUnit_m * double(block.range[entry])));
    points.intensity.push_back(float(block.reflectivity[entry]) / 255.0f);
    points.ring.push_back(ring);
}

void add_firing(ScanPoints& points, std::vector<int>& numbers, const Firing& firing, const SpinningSensor& sensor) {
    for (std::size_t laser = 0; laser < kLasers16; ++laser) {
        const std::size_t entry = firing.first + laser;
        const std::uint16_t ring = ring_of(laser);
        const double azimuth = -(firing.azimuth_deg + firing.step_deg * kLaser_us * double(laser) / kFiring_us) * kPi / 180.0;
        const double elevation = sensor.beams[ring].elevation_rad;
        const glm::dvec3 direction(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        const auto add = [&](const Block& block, std::uint8_t number) {
            add_return(points, block, entry, ring, direction);
            points.time_offset_s.push_back(float(firing.time_s + 1e-6 * kLaser_us * double(laser)));
            points.return_number.push_back(number);
            numbers.push_back(firing.number);
        };
        const Block *first = firing.second, *other = firing.last;  // two returns: the last, and the strongest or else the next one
        if (!other || other->range[entry] == first->range[entry]) {
            if (first->range[entry] != 0) add(*first, 0);
            continue;
        }
        if (first->range[entry] == 0 || (other->range[entry] != 0 && other->reflectivity[entry] >= first->reflectivity[entry]))
            std::swap(first, other);
        add(*first, 0);
        if (other->range[entry] != 0) add(*other, 1);
    }
}

}  // namespace

std::vector<PacketView> read_packets(const Topic& topic, std::string_view bytes, Header& header) {
    MessageReader reader(bytes, topic.encoding == "ros1");
    header = read_header(reader);
    std::vector<PacketView> packets;
    const std::size_t n = reader.length(kPacketBytes);
    for (std::size_t i = 0; i < n; ++i) {
        const std::int64_t stamp_ns = read_time(reader);
        packets.push_back({stamp_ns, reader.take(kPacketBytes)});
    }
    return packets;
}

void PacketLog::add(const std::vector<PacketView>& packets, std::int64_t log_ns, const Place& place) {
    messages_.push_back({place, log_ns});
    for (std::size_t i = 0; i < packets.size(); ++i) {
        add_packet(packets[i]);
        packets_.back().message = std::uint32_t(messages_.size() - 1);
        packets_.back().in_message = std::uint32_t(i);
    }
}

void PacketLog::add_packet(const PacketView& view) {
    const std::array<Block, kBlocks> blocks = blocks_of(view.bytes);
    ByteReader tail(view.bytes.substr(kTailAt));
    const auto hour_us = tail.number<std::uint32_t>();
    const auto mode = tail.number<std::uint8_t>(), product = tail.number<std::uint8_t>();
    if (product != kVlp16)
        throw DataError(
            fmt::format("packets of {} (product 0x{:02x}), expected those of a VLP-16, or point clouds: let velodyne_pointcloud or nebula "
                        "make them of this topic, and record those",
                        product_name(product), product));
    Packet packet{view.stamp_ns, std::int64_t(hour_us), blocks[0].azimuth_deg, 0.0, 0, 0, mode == kDual};
    for (std::size_t b = 1; b < kBlocks; ++b) packet.turned_deg += degrees_on(blocks[b - 1].azimuth_deg, blocks[b].azimuth_deg);
    if (!packets_.empty()) {
        const Packet& before = packets_.back();
        packet.device_us += before.device_us - before.device_us % kHour_us;
        if (packet.device_us < before.device_us - kHour_us / 2) packet.device_us += kHour_us;
        packet.azimuth_deg = before.azimuth_deg + degrees_on(std::fmod(before.azimuth_deg, 360.0), blocks[0].azimuth_deg);
        // packets that were lost for more than a turn: by the rate of the one before
        const double passed_us = double(packet.device_us - before.device_us),
                     own_us = before.two_returns ? 10.0 * kFiring_us : 22.0 * kFiring_us;
        const double turned = before.turned_deg / own_us * passed_us;
        packet.azimuth_deg += 360.0 * std::max(0.0, std::round((before.azimuth_deg + turned - packet.azimuth_deg) / 360.0));
    }
    packets_.push_back(packet);
}

std::vector<PacketTurn> PacketLog::turns() const {
    std::vector<PacketTurn> turns;
    if (packets_.size() < 2) return turns;
    double begin = kBehind_deg + 360.0 * std::ceil((packets_.front().azimuth_deg - kBehind_deg) / 360.0);
    for (std::size_t p = 0; p < packets_.size() && begin + 360.0 <= packets_.back().azimuth_deg; begin += 360.0) {
        PacketTurn turn{0, 0, 0, 0, begin, 0};
        const auto first_behind = [&](double azimuth) {  // the first packet that begins behind it
            return std::size_t(std::ranges::upper_bound(packets_, azimuth, {}, &Packet::azimuth_deg) - packets_.begin());
        };
        turn.first = first_behind(begin) - 1;
        turn.last = std::min(first_behind(begin + 360.0), packets_.size()) - 1;
        p = turn.last;
        if (turn.first == turn.last) {  // none of its packets is there: on to the next one's turn
            const double next = packets_[std::min(p + 1, packets_.size() - 1)].azimuth_deg;
            begin = std::max(begin, kBehind_deg + 360.0 * (std::floor((next - kBehind_deg) / 360.0) - 1.0));
            continue;
        }
        const std::size_t k = std::min(first_behind(begin + 180.0), packets_.size() - 1);
        const Packet &before = packets_[k - 1], &after = packets_[k];
        const double s = (begin + 180.0 - before.azimuth_deg) / std::max(after.azimuth_deg - before.azimuth_deg, 1e-6);
        turn.forward_ns = before.stamp_ns + std::int64_t(s * 1e3 * double(after.device_us - before.device_us));
        turn.log_ns = messages_[before.message].log_ns;
        const double own_us = (before.two_returns ? 12.0 : 24.0) * kFiring_us;
        for (std::size_t i = turn.first + 1; i <= turn.last; ++i)
            turn.n_missing +=
                std::size_t(std::max(0.0, std::round(double(packets_[i].device_us - packets_[i - 1].device_us) / own_us) - 1.0));
        if (2 * turn.n_missing < turn.last - turn.first && is_even(turn)) turns.push_back(turn);
    }
    return turns;
}

/// Whether the sensor's clock rises within a turn, and the turn lasts as long as one may.
bool PacketLog::is_even(const PacketTurn& turn) const {
    for (std::size_t i = turn.first + 1; i <= turn.last; ++i)
        if (packets_[i].device_us <= packets_[i - 1].device_us) return false;
    return packets_[turn.last].device_us - packets_[turn.first].device_us <= kLongestTurn_us;
}

std::vector<Place> PacketLog::places(const PacketTurn& turn) const {
    std::vector<Place> places;
    for (std::uint32_t m = packets_[turn.first].message; m <= packets_[turn.last].message; ++m) places.push_back(messages_[m].place);
    return places;
}

SpinningSensor PacketLog::sensor() const {
    const Packet &first = packets_.front(), &last = packets_.back();
    const double period_us = 360.0 * double(last.device_us - first.device_us) / std::max(last.azimuth_deg - first.azimuth_deg, 1.0);
    const double period_s = std::clamp(1e-6 * period_us, 0.02, 1.0);
    double most = 1e6 * period_s / kFiring_us;  // firings of a turn: none may be left over
    for (const PacketTurn& turn : turns()) {
        const double all_us = double(packets_[turn.last].device_us - packets_[turn.first].device_us);
        const double all_deg = packets_[turn.last].azimuth_deg - packets_[turn.first].azimuth_deg;
        most = std::max(most, 360.0 / std::max(all_deg, 1.0) * all_us / kFiring_us);
    }
    const auto model = known_sensor("VLP-16", std::min(int(std::ceil(most)) + 1, kMostFirings), 1.0 / period_s);
    return std::get<SpinningSensor>(model->pattern);
}

Scan PacketLog::scan(const PacketTurn& turn, const std::vector<PacketView>& packets, const SpinningSensor& sensor,
                     std::int64_t zero_ns) const {
    ScanPoints points;
    std::vector<int> numbers;
    const std::size_t skipped = packets_[turn.first].in_message;
    for (std::size_t p = turn.first; p <= turn.last; ++p) {
        const Packet& packet = packets_[p];
        if (skipped + p - turn.first >= packets.size())
            throw DataError("a message of packets has fewer of them than when it was first read");
        const std::array<Block, kBlocks> blocks = blocks_of(packets[skipped + p - turn.first].bytes);
        const double passed_us = double(packet.device_us - packets_[turn.first].device_us);
        double azimuth = packet.azimuth_deg;
        const std::size_t n = packet.two_returns ? 2 : 1;  // blocks of the same firings
        double turned = 0.0;
        for (std::size_t b = 0; b < kBlocks; b += n, azimuth += turned) {
            if (b + n < kBlocks) turned = degrees_on(blocks[b].azimuth_deg, blocks[b + n].azimuth_deg);
            for (std::size_t f = 0; f < kFirings; ++f) {
                const double fired = azimuth + turned * double(f) / double(kFirings), after_us = kFiring_us * double(b / n * kFirings + f);
                if (fired < turn.begin_deg || fired >= turn.begin_deg + 360.0) continue;
                const Block& second = blocks[b + n - 1];
                add_firing(points, numbers,
                           {fired, turned / double(kFirings), 1e-9 * double(packet.stamp_ns - zero_ns) + 1e-6 * after_us,
                            int(std::lround((passed_us + after_us) / kFiring_us)), &second, packet.two_returns ? &blocks[b] : nullptr,
                            f * kLasers16},
                           sensor);
            }
        }
    }
    if (points.size() == 0) return unordered_scan(points);
    const double step_rad = -2.0 * kPi * 1e-6 * kFiring_us / sensor.period_s;
    const Sweep sweep = arrange_firings(points, numbers, sensor, step_rad);
    return spinning_scan(points, sensor, sweep);
}

}  // namespace relidar::bag
