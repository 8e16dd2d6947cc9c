// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/bag_scans.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "log/readers/bag/packets/packet_messages.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kSampleClouds = 6;

/// Returns the earliest point time of a cloud, in the time unit of the file.
double find_first_time_of_cloud(const folder::PointTable& table) {
    double first = INFINITY;
    if (const folder::FieldValues* times = table.find(folder::PointValue::time))
        times->visit([&](const auto& time_at) {
            for (std::size_t i = 0; i < table.n; ++i)
                if (const auto t = double(time_at(i)); std::isfinite(t)) first = std::min(first, t);
        });
    return std::isfinite(first) ? first : 0.0;
}

folder::PointTable read_table(const Bag& bag, const CloudTopic& clouds, const Place& place) {
    const SharedBytes message = bag.read(place);
    return make_point_table(read_cloud(bag.topics()[clouds.topic], message.bytes), message);
}

}  // namespace

std::string BagScans::name(std::size_t frame) const {
    const FrameCloud& cloud = clouds_[frame];
    return fmt::format("{}: topic {}, cloud of frame {}", bag_.files().at(cloud.entry.place.file).string(),
                       bag_.topics()[lidars_[cloud.lidar].clouds->topic].name, cloud.number);
}

Points BagScans::points(std::size_t frame) const {
    const FrameCloud& at = clouds_[frame];
    if (at.entry.parts.empty()) return read_points_of_cloud(frame, at.entry, at.cloud_s);
    Points all;
    for (const TurnPart& part : at.entry.parts) {
        const CloudEntry cloud{part.stamp_ns, part.log_ns, part.n_points, part.place};
        Points points = read_points_of_cloud(
            frame, cloud, at.cloud_s + 1e-9 * double(cloud.time_ns(clock_) - at.entry.time_ns(clock_)));
        if (points.time_offset_s.empty())
            throw DataError(fmt::format(
                "{}: {}, and the points have no usable times, expected clouds of full turns, or times of "
                "points",
                name(frame), lidars_[at.lidar].clouds->parts_about));
        const auto append = [](auto& to, const auto& from) { to.insert(to.end(), from.begin(), from.end()); };
        append(all.position_m, points.position_m), append(all.intensity, points.intensity),
            append(all.ring, points.ring);
        append(all.time_offset_s, points.time_offset_s), append(all.return_number, points.return_number);
    }
    if ((!all.ring.empty() && all.ring.size() != all.size()) ||
        (!all.return_number.empty() && all.return_number.size() != all.size()))
        throw DataError(
            fmt::format("{}: some clouds of the turn have rings or return numbers and some have none, "
                        "expected the same fields in all of them",
                        name(frame)));
    return all;
}

folder::PointTable BagScans::read_table_of_cloud(std::size_t frame, const Place& place) const {
    const LidarTopic& lidar = lidars_[clouds_[frame].lidar];
    if (const auto known = lidar.samples.find(place); known != lidar.samples.end()) return known->second;
    try {
        return read_table(bag_, *lidar.clouds, place);
    } catch (const DataError& error) {
        throw DataError(fmt::format("{}: {}", name(frame), error.what()));
    }
}

Points BagScans::read_points_of_cloud(std::size_t frame, const CloudEntry& cloud, double cloud_s) const {
    const FrameCloud& at = clouds_[frame];
    const CloudUnits& units = lidars_[at.lidar].units;
    folder::PointTable table = read_table_of_cloud(frame, cloud.place);
    if (units.zero == TimeZero::none) table.remove(folder::PointValue::time);
    // time on the clock of the points that corresponds to time 0 of the frame
    double zero_s = at.time_s - cloud_s;
    if (units.zero == TimeZero::epoch) zero_s += 1e-9 * double(cloud.stamp_ns);
    if (units.zero == TimeZero::sensor_clock) zero_s += units.time_unit_s * find_first_time_of_cloud(table);
    const folder::PointUnits point_units{.columns = {},
                                         .intensity_max = units.meaning.scale.max,
                                         .time_unit_s = units.time_unit_s,
                                         .absolute_times = true,
                                         .intensity_field = units.meaning.intensity_field,
                                         .no_return = units.meaning.no_return};
    Points points = folder::make_points(table, point_units, zero_s, name(frame));
    if (!deskewed_by_) return points;
    const Pose world_from_cloud = deskewed_by_(at.lidar, cloud_s);
    for (std::size_t i = 0; i < points.time_offset_s.size(); ++i) {
        const Pose world_from_firing = deskewed_by_(at.lidar, at.time_s + double(points.time_offset_s[i]));
        points.position_m[i] =
            glm::vec3(inverse(world_from_firing) * (world_from_cloud * glm::dvec3(points.position_m[i])));
    }
    return points;
}

Scan BagScans::rays(std::size_t frame) const {
    const FrameCloud& at = clouds_[frame];
    const CloudTopic& clouds = *lidars_[at.lidar].clouds;
    const packets::PacketTurn& turn = clouds.turns[at.entry.turn];
    const std::vector<packets::PacketLog::Source> sources = clouds.packets.messages(turn);
    std::vector<SharedBytes> messages;
    for (const auto& source : sources) messages.push_back(bag_.read(source.place));
    std::vector<std::vector<packets::PacketView>> packets;
    Header header;
    for (std::size_t m = 0; m < messages.size(); ++m)
        packets.push_back(relidar::packets::read_packets(bag_.topics()[clouds.topic], messages[m].bytes,
                                                         sources[m].log_ns, header));
    const auto shift_ns = std::int64_t(std::llround(1e9 * (at.time_s - at.cloud_s)));
    return clouds.packets.scan(turn, packets, lidars_[at.lidar].sensor, turn.forward_ns + shift_ns);
}

LidarTopic sample_cloud_topic(const Bag& bag, const CloudTopic& clouds, double step_s) {
    LidarTopic topic{&clouds};
    if (!clouds.packets.empty()) return topic;
    std::vector<folder::PointTable> samples;
    std::vector<double> stamps_s;
    const std::size_t n = std::min(kSampleClouds, clouds.clouds.size());
    for (std::size_t k = 0; k < n; ++k) {
        const CloudEntry& entry = clouds.clouds[k * clouds.clouds.size() / n];
        try {
            samples.push_back(read_table(bag, clouds, entry.place));
        } catch (const DataError&) {
            continue;  // the error is reported when the scan is read
        }
        stamps_s.push_back(1e-9 * double(entry.stamp_ns));
        topic.samples.emplace(entry.place, samples.back());
    }
    topic.units = find_units(samples, stamps_s, step_s);
    return topic;
}

}  // namespace relidar::bag
