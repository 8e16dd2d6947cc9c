// SPDX-License-Identifier: Apache-2.0
#include "read/bag/bag_scans.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "read/bag/packet_messages.hpp"
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

/// Reads the points of a frame. Joins the clouds of a revolution that has several.
LidarPoints BagScans::read_points(std::size_t frame) const {
    const CloudEntry& revolution = clouds_[frame].entry;
    if (revolution.parts.empty()) return read_cloud_points(frame, revolution);
    LidarPoints all;
    for (const CloudEntry& part : revolution.parts) {
        const LidarPoints points = read_cloud_points(frame, part);
        if (points.time_offset_s.empty())
            fail("{}: the points have no usable times, expected a time for each point, because {}",
                 frame_name(frame), lidars_[clouds_[frame].lidar].clouds->parts_note);
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

/// Returns the points of a cloud of a frame, with values as in the message.
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

/// Reads the points of a cloud, which is the cloud of a frame or a part of it. Point
/// times become relative to the frame. If the points were motion-compensated, moves each
/// point back to the sensor frame at its own time.
LidarPoints BagScans::read_cloud_points(std::size_t frame, const CloudEntry& cloud) const {
    const FrameCloud& frame_cloud = clouds_[frame];
    const read::PointCloudUnits& units = lidars_[frame_cloud.lidar].units;
    read::PointTable table = read_table(frame, cloud.message_position);
    if (units.time_reference == read::PointTimeReference::none)
        table.remove_fields(read::PointAttribute::time);

    // Times of the frame and the cloud in the log. They differ for a part of a revolution
    // (by the time between their stamps), and for LiDARs other than the main LiDAR.
    const double after_revolution_s =
        1e-9 * double(cloud.time_ns(clock_) - frame_cloud.entry.time_ns(clock_));
    const double cloud_s = frame_cloud.cloud_s + after_revolution_s, frame_s = frame_cloud.time_s;
    // The same two times on the clock of the point times, where the cloud has its stamp.
    // convert_table() subtracts the time of the frame: from offsets as `time_zero`, from
    // absolute times as its third argument.
    const double frame_on_point_clock_s = frame_s - cloud_s + stamp_on_point_clock_s(units, cloud, table);
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

    if (!deskewed_by_) return points;
    // The driver has moved the points to the pose of the LiDAR at the time of the cloud.
    const auto world_from_lidar = [&](double time_s) { return deskewed_by_(frame_cloud.lidar, time_s); };
    const Pose world_from_cloud = world_from_lidar(cloud_s);
    for (std::size_t i = 0; i < points.time_offset_s.size(); ++i) {
        const Pose world_from_firing = world_from_lidar(frame_s + double(points.time_offset_s[i]));
        points.position_m[i] =
            glm::vec3(inverse(world_from_firing) * (world_from_cloud * glm::dvec3(points.position_m[i])));
    }
    return points;
}

/// Decodes the packets of a revolution to rays with times relative to the frame.
Scan BagScans::read_rays(std::size_t frame) const {
    const FrameCloud& frame_cloud = clouds_[frame];
    const LidarTopic& lidar = lidars_[frame_cloud.lidar];
    const CloudTopic& clouds = *lidar.clouds;
    const BagTopic& topic = bag_.topics()[clouds.topic];
    const packets::PacketRevolution& revolution =
        clouds.packets.revolutions()[frame_cloud.entry.revolution_index];  // one for each cloud
    std::vector<SharedBytes> messages;  // must stay in memory, because packets are views of them
    std::vector<std::vector<packets::ReceivedPacket>> packets_of_message;
    for (const auto& source : clouds.packets.messages_of(revolution)) {
        messages.push_back(bag_.read_message(topic, source.message_position));
        packets_of_message.push_back(read_packets(topic, messages.back().bytes, source.log_ns).packets);
    }
    // The time of the revolution is that at which the head faces forward. The time of the
    // frame differs if it is that of another LiDAR.
    const auto frame_after_cloud_ns = std::llround(1e9 * (frame_cloud.time_s - frame_cloud.cloud_s));
    const std::int64_t frame_ns = revolution.forward_ns + frame_after_cloud_ns;
    return clouds.packets.decode(revolution, packets_of_message, lidar.sensor, frame_ns);
}

LidarTopic estimate_units(const BagRecording& bag, const CloudTopic& cloud_topic, double cloud_period_s,
                          const Conventions& set) {
    LidarTopic topic{&cloud_topic};
    const bool are_units_known = !cloud_topic.packets.empty();
    if (are_units_known) return topic;
    std::vector<read::PointTable> samples;
    std::vector<double> stamps_s;
    read::read_samples(cloud_topic.clouds.size(), [&](std::size_t i) {
        const CloudEntry& entry = cloud_topic.clouds[i];
        samples.push_back(read_point_table(bag, cloud_topic, entry.message_position));
        stamps_s.push_back(1e-9 * double(entry.stamp_ns + entry.correction_ns));
        topic.samples.emplace(entry.message_position, samples.back());
    });
    topic.units = read::estimate_cloud_units(samples, stamps_s, cloud_period_s, set);
    topic.units.fields.scale = read::choose_scale(topic.units.fields.scale, set);
    return topic;
}

}  // namespace relidar::bag
