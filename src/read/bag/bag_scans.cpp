// SPDX-License-Identifier: Apache-2.0
#include "read/bag/bag_scans.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "read/packets/packet_messages.hpp"
#include "read/scans/point_times.hpp"

namespace relidar::bag {
namespace {

read::PointTable read_point_table(const BagRecording& bag, const CloudTopic& cloud_topic,
                                  const MessagePosition& location) {
    const BagTopic& topic = bag.topics()[cloud_topic.topic];
    const SharedBytes message = bag.read_message(topic, location);
    return to_point_table(read_cloud(topic, message.bytes), message);
}

}  // namespace

std::string BagScans::frame_name(std::size_t frame) const {
    const FrameCloud& cloud = clouds_[frame];
    return fmt::format("{}: topic {}, cloud of frame {}",
                       bag_.file_paths().at(cloud.entry.message_position.file).string(),
                       bag_.topics()[lidars_[cloud.lidar].clouds->topic].name, cloud.number);
}

/// Reads the points of a frame. If a revolution was recorded as several clouds, reads and
/// joins all of them.
LidarPoints BagScans::read_points(std::size_t frame) const {
    const FrameCloud& at = clouds_[frame];
    if (at.entry.parts.empty()) return read_points(frame, at.entry, at.cloud_s);
    LidarPoints all;
    for (const RevolutionPart& part : at.entry.parts) {
        const std::int64_t correction_ns = at.entry.correction_ns;
        const CloudEntry cloud{{part.stamp_ns - correction_ns, part.log_ns},
                               part.n_points,
                               part.message_position,
                               0,
                               {},
                               correction_ns};
        LidarPoints points = read_points(
            frame, cloud, at.cloud_s + 1e-9 * double(cloud.time_ns(clock_) - at.entry.time_ns(clock_)));
        if (points.time_offset_s.empty())
            fail("{}: the points have no usable times, expected a time for each point, because {}",
                 frame_name(frame), lidars_[at.lidar].clouds->parts_about);
        const auto append = [](auto& to, const auto& from) { to.insert(to.end(), from.begin(), from.end()); };
        append(all.position_m, points.position_m);
        append(all.intensity, points.intensity);
        append(all.ring, points.ring);
        append(all.time_offset_s, points.time_offset_s);
        append(all.return_number, points.return_number);
    }
    if ((!all.ring.empty() && all.ring.size() != all.size()) ||
        (!all.return_number.empty() && all.return_number.size() != all.size()))
        fail(
            "{}: only some clouds of the revolution have rings or return numbers, expected the same fields "
            "in all clouds",
            frame_name(frame));
    return all;
}

read::PointTable BagScans::read_table(std::size_t frame, const MessagePosition& position) const {
    const LidarTopic& lidar = lidars_[clouds_[frame].lidar];
    // estimate_units() has already read a few clouds.
    if (const auto sample_entry = lidar.samples.find(position); sample_entry != lidar.samples.end())
        return sample_entry->second;
    try {
        return read_point_table(bag_, *lidar.clouds, position);
    } catch (const DataError& error) {
        fail("{}: {}", frame_name(frame), error.what());
    }
}

/// Reads the points of one cloud, with point times relative to the frame. If the points
/// were motion-compensated, moves each point back to the sensor frame at its own time.
LidarPoints BagScans::read_points(std::size_t frame, const CloudEntry& cloud, double time_s) const {
    const FrameCloud& at = clouds_[frame];
    const read::PointCloudUnits& units = lidars_[at.lidar].units;
    read::PointTable table = read_table(frame, cloud.message_position);
    if (units.zero == read::PointTimeReference::none) table.remove_fields(read::PointAttribute::time);
    // zero_s: time of the frame in seconds, on the clock that the point times use. It is
    // (time of the frame - time of the cloud) + time of the cloud on that clock.
    double zero_s = at.time_s - time_s;
    if (units.zero == read::PointTimeReference::epoch)
        zero_s += 1e-9 * double(cloud.stamp_ns + cloud.correction_ns);
    // The sensor's clock is unrelated to the stamp, so the first point gets the stamp.
    if (units.zero == read::PointTimeReference::sensor_clock) {
        read::unwrap_times(table, false);
        zero_s += units.time_unit_s * read::find_time_range(table).value_or(std::array{0.0, 0.0})[0];
    }
    const bool are_offsets = units.zero == read::PointTimeReference::stamp;
    const read::PointFileUnits point_units{.columns = {},
                                           .intensity_max = units.meaning.scale.max,
                                           .time_unit_s = units.time_unit_s,
                                           .absolute_times = !are_offsets,
                                           .intensity_field = units.meaning.intensity_field,
                                           .no_return = units.meaning.no_return,
                                           .returns = units.meaning.returns,
                                           .skip_wrong_times = true,
                                           .time_zero = are_offsets ? zero_s / units.time_unit_s : 0.0};
    LidarPoints points = read::convert_table(table, point_units, zero_s, frame_name(frame));
    if (!deskewed_by_) return points;
    const Pose world_from_cloud = deskewed_by_(at.lidar, time_s);
    for (std::size_t i = 0; i < points.time_offset_s.size(); ++i) {
        const Pose world_from_firing = deskewed_by_(at.lidar, at.time_s + double(points.time_offset_s[i]));
        points.position_m[i] =
            glm::vec3(inverse(world_from_firing) * (world_from_cloud * glm::dvec3(points.position_m[i])));
    }
    return points;
}

/// Decodes the packets of a revolution. Shifts their times like the time of the frame.
Scan BagScans::read_rays(std::size_t frame) const {
    const FrameCloud& at = clouds_[frame];
    const CloudTopic& clouds = *lidars_[at.lidar].clouds;
    const packets::PacketRevolution& revolution = clouds.revolutions[at.entry.revolution_index];
    const std::vector<packets::PacketIndex::MessageSource> sources = clouds.packets.messages_of(revolution);
    std::vector<SharedBytes> messages;
    const BagTopic& topic = bag_.topics()[clouds.topic];
    for (const auto& source : sources) messages.push_back(bag_.read_message(topic, source.message_position));
    std::vector<std::vector<packets::ReceivedPacket>> packets;
    MessageHeader header;
    for (std::size_t m = 0; m < messages.size(); ++m)
        packets.push_back(
            relidar::packets::read_packets(topic, messages[m].bytes, sources[m].log_ns, header));
    const auto shift_ns = std::int64_t(std::llround(1e9 * (at.time_s - at.cloud_s)));
    return clouds.packets.decode(revolution, packets, lidars_[at.lidar].sensor,
                                 revolution.forward_ns + shift_ns);
}

LidarTopic estimate_units(const BagRecording& bag, const CloudTopic& cloud_topic, double cloud_period_s) {
    LidarTopic topic{&cloud_topic};
    // The units of packets are known.
    if (!cloud_topic.packets.empty()) return topic;
    std::vector<read::PointTable> samples;
    std::vector<double> stamps_s;
    read::read_samples(cloud_topic.clouds.size(), [&](std::size_t i) {
        const CloudEntry& entry = cloud_topic.clouds[i];
        samples.push_back(read_point_table(bag, cloud_topic, entry.message_position));
        stamps_s.push_back(1e-9 * double(entry.stamp_ns + entry.correction_ns));
        topic.samples.emplace(entry.message_position, samples.back());
    });
    topic.units = read::estimate_cloud_units(samples, stamps_s, cloud_period_s);
    return topic;
}

}  // namespace relidar::bag
