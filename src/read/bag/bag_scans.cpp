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

/// Reads the message of a cloud and describes its points as a table.
read::PointTable read_point_table(const BagRecording& bag, const CloudTopic& cloud_topic,
                                  const MessagePosition& location) {
    const BagTopic& topic = bag.topics()[cloud_topic.topic];
    const SharedBytes message = bag.read_message(topic, location);
    return to_point_table(read_cloud(topic, message.bytes), message);
}

/// Returns the time of a cloud's stamp on the clock of its point times.
/// @param table  points of the cloud. The times of a sensor clock become continuous
double stamp_on_point_clock_s(const read::PointCloudUnits& units, const CloudEntry& cloud,
                              read::PointTable& table) {
    if (units.time_reference == read::PointTimeReference::epoch)
        return 1e-9 * double(cloud.stamp_ns + cloud.correction_ns);
    if (units.time_reference != read::PointTimeReference::sensor_clock) return 0.0;
    // The sensor's clock is unrelated to the stamp, so the first point gets the stamp.
    read::unwrap_times(table, false);
    return units.time_unit_s * read::find_time_range(table).value_or(std::array{0.0, 0.0})[0];
}

void append_points(LidarPoints& all, const LidarPoints& points) {
    const auto append = [](auto& to, const auto& from) { to.insert(to.end(), from.begin(), from.end()); };
    append(all.position_m, points.position_m);
    append(all.intensity, points.intensity);
    append(all.ring, points.ring);
    append(all.time_offset_s, points.time_offset_s);
    append(all.return_number, points.return_number);
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
    const FrameCloud& frame_cloud = clouds_[frame];
    const CloudEntry& revolution = frame_cloud.entry;
    if (revolution.parts.empty()) return read_cloud_points(frame, revolution, frame_cloud.cloud_s);
    LidarPoints all;
    for (const RevolutionPart& part : revolution.parts) {
        // A part has the time stamp of its message, which the correction changes.
        CloudEntry cloud;
        cloud.stamp_ns = part.stamp_ns - revolution.correction_ns;
        cloud.log_ns = part.log_ns;
        cloud.message_position = part.message_position;
        cloud.correction_ns = revolution.correction_ns;
        const double after_revolution_s = 1e-9 * double(cloud.time_ns(clock_) - revolution.time_ns(clock_));
        const LidarPoints points = read_cloud_points(frame, cloud, frame_cloud.cloud_s + after_revolution_s);
        if (points.time_offset_s.empty())
            fail("{}: the points have no usable times, expected a time for each point, because {}",
                 frame_name(frame), lidars_[frame_cloud.lidar].clouds->parts_note);
        append_points(all, points);
    }
    const auto is_partial = [&](const auto& values) {
        return !values.empty() && values.size() != all.size();
    };
    if (is_partial(all.ring) || is_partial(all.return_number))
        fail(
            "{}: only some clouds of the revolution have rings or return numbers, expected the same fields "
            "in all clouds",
            frame_name(frame));
    return all;
}

/// Returns the points of a cloud of a frame in the units of the message.
read::PointTable BagScans::read_table(std::size_t frame, const MessagePosition& position) const {
    const LidarTopic& lidar = lidars_[clouds_[frame].lidar];
    // estimate_units() has already read a few clouds.
    const auto sample = lidar.samples.find(position);
    if (sample != lidar.samples.end()) return sample->second;
    try {
        return read_point_table(bag_, *lidar.clouds, position);
    } catch (const DataError& error) {
        fail("{}: {}", frame_name(frame), error.what());
    }
}

/// Reads the points of one cloud, with point times relative to the frame. If the points
/// were motion-compensated, moves each point back to the sensor frame at its own time.
/// @param cloud_s  time of the cloud on the clock of the log
LidarPoints BagScans::read_cloud_points(std::size_t frame, const CloudEntry& cloud, double cloud_s) const {
    const FrameCloud& frame_cloud = clouds_[frame];
    const read::PointCloudUnits& units = lidars_[frame_cloud.lidar].units;
    read::PointTable table = read_table(frame, cloud.message_position);
    if (units.time_reference == read::PointTimeReference::none)
        table.remove_fields(read::PointAttribute::time);

    // The point times of the table at the time of the frame. It differs from the time of
    // the cloud for LiDARs other than the main LiDAR.
    const double frame_on_point_clock_s =
        frame_cloud.time_s - cloud_s + stamp_on_point_clock_s(units, cloud, table);
    const bool are_offsets = units.time_reference == read::PointTimeReference::stamp;
    const read::PointFileUnits point_units{
        .columns = {},
        .intensity_max = units.fields.scale.max,
        .time_unit_s = units.time_unit_s,
        .absolute_times = !are_offsets,
        .intensity_field = units.fields.intensity_field,
        .no_return = units.fields.no_return,
        .returns = units.fields.returns,
        .skip_wrong_times = true,
        .time_zero = are_offsets ? frame_on_point_clock_s / units.time_unit_s : 0.0};
    LidarPoints points = read::convert_table(table, point_units, frame_on_point_clock_s, frame_name(frame));

    // deskewed_by_ returns the LiDAR poses with which the driver compensated the motion.
    if (!deskewed_by_) return points;
    const Pose world_from_cloud = deskewed_by_(frame_cloud.lidar, cloud_s);
    for (std::size_t i = 0; i < points.time_offset_s.size(); ++i) {
        const Pose world_from_firing =
            deskewed_by_(frame_cloud.lidar, frame_cloud.time_s + double(points.time_offset_s[i]));
        points.position_m[i] =
            glm::vec3(inverse(world_from_firing) * (world_from_cloud * glm::dvec3(points.position_m[i])));
    }
    return points;
}

/// Decodes the packets of a revolution. Shifts their times like the time of the frame.
Scan BagScans::read_rays(std::size_t frame) const {
    const FrameCloud& frame_cloud = clouds_[frame];
    const CloudTopic& clouds = *lidars_[frame_cloud.lidar].clouds;
    const BagTopic& topic = bag_.topics()[clouds.topic];
    const packets::PacketRevolution& revolution = clouds.revolutions[frame_cloud.entry.revolution_index];
    const std::vector<packets::PacketIndex::MessageSource> sources = clouds.packets.messages_of(revolution);
    // The packets are views of the messages, so the messages must stay in memory.
    std::vector<SharedBytes> messages;
    for (const auto& source : sources) messages.push_back(bag_.read_message(topic, source.message_position));
    std::vector<std::vector<packets::ReceivedPacket>> packets;
    MessageHeader header;
    for (std::size_t m = 0; m < messages.size(); ++m)
        packets.push_back(
            relidar::packets::read_packets(topic, messages[m].bytes, sources[m].log_ns, header));
    const auto shift_ns = std::int64_t(std::llround(1e9 * (frame_cloud.time_s - frame_cloud.cloud_s)));
    return clouds.packets.decode(revolution, packets, lidars_[frame_cloud.lidar].sensor,
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
