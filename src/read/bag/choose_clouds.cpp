// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <map>
#include <set>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/choose.hpp"
#include "read/bag/packet_messages.hpp"

namespace relidar::bag {
namespace {

// Limits of the lists of topics and of reasons in an error message.
constexpr std::size_t kMostTopics = 10, kMostReasons = 3;

/// Keeps the first texts of a list and replaces the others by their number.
void shorten_list(std::vector<std::string>& texts, std::size_t max_count) {
    if (texts.size() <= max_count) return;
    const std::string more = fmt::format("and {} more", texts.size() - max_count);
    texts.resize(max_count);
    texts.push_back(more);
}

/// Returns names and types of the topics of a recording, for an error message.
std::string format_topics(const BagRecording& bag) {
    std::vector<std::string> texts;
    for (const BagTopic& topic : bag.topics())
        texts.push_back(fmt::format("{} ({})", quote(topic.name), quote(topic.type)));
    shorten_list(texts, kMostTopics);
    return texts.empty() ? "none" : fmt::format("{}", fmt::join(texts, ", "));
}

/// A ROS package whose packets relidar cannot decode, and the driver that converts them.
struct PacketDriver {
    const char* package;
    const char* driver;
};
constexpr PacketDriver kPacketDrivers[] = {
    {"hesai_ros_driver/", "hesai_ros_driver"},
    {"rslidar_msg/", "rslidar_sdk"},
    {"robosense_msgs/", "nebula"},
    {"seyond/", "seyond_ros_driver"},
};

/// Appends the reasons why a topic gave no clouds to `reasons`.
/// @param topic_index  index in `bag.topics()`
void explain_topic(const BagRecording& bag, const BagIndex& index, std::size_t topic_index,
                   std::vector<std::string>& reasons) {
    const BagTopic& topic = bag.topics()[topic_index];
    const TopicStatistics& counts = index.facts[topic_index];
    const std::string name = quote(topic.name);
    for (const PacketDriver& packet_driver : kPacketDrivers)
        if (topic.type.starts_with(packet_driver.package))
            reasons.push_back(fmt::format(
                "{}: found packets that relidar cannot decode; convert them to point clouds with {}", name,
                packet_driver.driver));
    // The messages were read, but gave no revolution of packets, or only empty clouds.
    const auto clouds = std::ranges::find(index.clouds, topic_index, &CloudTopic::topic);
    const bool has_no_clouds = clouds != index.clouds.end() && clouds->clouds.empty();
    if (has_no_clouds && !clouds->packets.empty())
        reasons.push_back(fmt::format("topic {} contains {} packets of a {}: {}", name,
                                      clouds->packets.size(), clouds->packets.describe_product(),
                                      clouds->packets.describe_faults()));
    else if (has_no_clouds && clouds->n_empty > 0)
        reasons.push_back(fmt::format("topic {} contains {} clouds without points", name, clouds->n_empty));
    if (counts.n == 0 && find_purpose(topic) == MessagePurpose::cloud)
        reasons.push_back(fmt::format("topic {} contains no messages", name));
    if (counts.n_broken > 0) reasons.push_back(fmt::format("{}: {}", name, counts.broken));
    if (topic.type == kOtherDatagrams)
        reasons.push_back(fmt::format("{} contains {} datagrams that relidar cannot decode as LiDAR packets",
                                      name, counts.n));
}

/// Returns the end of the error message for a bag without clouds. The text explains why
/// topics that may contain clouds could not be read.
/// @param requested_topic  topic to explain; empty: all topics
std::string explain_no_clouds(const BagRecording& bag, const BagIndex& index,
                              const std::string& requested_topic = "") {
    std::vector<std::string> reasons = bag.file_problems();
    for (std::size_t t = 0; t < index.facts.size(); ++t)
        if (requested_topic.empty() || bag.topics()[t].name == requested_topic)
            explain_topic(bag, index, t, reasons);
    if (bag.topics().empty()) reasons.push_back("the recording has no messages");
    shorten_list(reasons, kMostReasons);
    std::string text;
    for (const std::string& reason : reasons) text += fmt::format(" ({})", reason);
    return text;
}

/// Returns the rank of the kind of clouds: packets, then clouds with times of points,
/// with rings, and others. Of each kind, clouds whose intensities are rounded to a byte
/// are second. The first kinds contain more of the sensor's data.
int rank_kind(const CloudTopic& clouds) {
    if (!clouds.packets.empty()) return 0;
    const bool is_rounded = std::ranges::any_of(clouds.fields, [](const CloudMessage::CloudField& field) {
        return read::find_attribute(field.name) == read::PointAttribute::intensity && field.size == 1;
    });
    const int kind = clouds.has_field(read::PointAttribute::time)   ? 1
                     : clouds.has_field(read::PointAttribute::ring) ? 3
                                                                    : 5;
    return kind + int(is_rounded);
}

bool is_in_sensor_frame(const CloudTopic& cloud_topic) {
    return !is_world_frame(cloud_topic.frame) && !is_vehicle_frame(cloud_topic.frame);
}

/// Throws if clouds are in a world-fixed frame. Adds a note for the vehicle frame.
void check_cloud_frame(const std::string& topic_name, const CloudTopic& clouds,
                       std::vector<std::string>& notes) {
    if (is_world_frame(clouds.frame))
        fail(
            "{}: the clouds are in the world-fixed frame '{}', expected the frame of the LiDAR (select "
            "another topic with dataset.lidars)",
            topic_name, clouds.frame);
    if (is_vehicle_frame(clouds.frame))
        notes.push_back(fmt::format(
            "{}: the clouds are in the vehicle frame '{}', probably because clouds of several LiDARs were "
            "merged. All rays start at the origin of this frame, which is inaccurate near the vehicle",
            topic_name, clouds.frame));
}

/// Returns the indices of the requested clouds in `index.clouds`, ascending. If several
/// LiDARs share a topic, the name of the topic selects all of them.
std::vector<std::size_t> find_requested(const BagRecording& bag, const BagIndex& index,
                                        const std::vector<std::string>& requested_names) {
    std::vector<std::size_t> lidars;
    for (const std::string& name : requested_names) {
        const auto is_requested = [&](const CloudTopic& clouds) {
            const bool has_name = bag.topics()[clouds.topic].name == name || clouds.make_name(bag) == name;
            return has_name && !clouds.clouds.empty();
        };
        if (std::ranges::none_of(index.clouds, is_requested))
            fail<UsageError>(
                "dataset.lidars: found '{}', expected a topic with point clouds{}; the recording contains {}",
                quote(name), explain_no_clouds(bag, index, name), format_topics(bag));
        for (std::size_t c = 0; c < index.clouds.size(); ++c)
            if (is_requested(index.clouds[c])) lidars.push_back(c);
    }
    std::ranges::sort(lidars);
    lidars.erase(std::unique(lidars.begin(), lidars.end()), lidars.end());  // a name can occur twice
    return lidars;
}

/// Returns the frame_id that identifies the LiDAR of a topic. If a driver computed the
/// clouds from packets in the same bag, this is the frame_id of the packets.
const std::string& lidar_frame(const BagIndex& index, const CloudTopic& cloud_topic) {
    for (const CloudTopic& other : index.clouds)
        if (!other.packets.revolutions().empty() &&
            std::ranges::find(other.driver_frames, cloud_topic.frame) != other.driver_frames.end())
            return other.frame;
    return cloud_topic.frame;
}

/// Selects the topic of each frame whose kind has the lowest rank, with a note about
/// other topics. Ignores clouds in the frame of the vehicle or the world if some are in a
/// sensor's frame.
/// @throws UsageError if a frame has several topics of one kind
std::vector<std::size_t> select_topics(const BagRecording& bag, const BagIndex& index,
                                       std::vector<std::string>& notes) {
    const bool has_sensor_frame = std::ranges::any_of(index.clouds, [&](const CloudTopic& clouds) {
        return !clouds.clouds.empty() && is_in_sensor_frame(clouds);
    });
    std::map<std::string, std::vector<std::size_t>> clouds_of_frame;  // indices in index.clouds
    for (std::size_t c = 0; c < index.clouds.size(); ++c) {
        const CloudTopic& clouds = index.clouds[c];
        if (clouds.clouds.empty() || (has_sensor_frame && !is_in_sensor_frame(clouds))) continue;
        clouds_of_frame[lidar_frame(index, clouds)].push_back(c);
    }
    std::vector<std::size_t> lidars;
    for (const auto& [frame, candidates] : clouds_of_frame) {
        const auto rank = [&](std::size_t c) { return rank_kind(index.clouds[c]); };
        const std::size_t best = *std::ranges::min_element(candidates, {}, rank);
        std::set<std::string> used, unused;  // names of topics
        for (const std::size_t c : candidates) {
            const std::string& name = bag.topics()[index.clouds[c].topic].name;
            (rank(c) == rank(best) ? used : unused).insert(name);
            if (rank(c) == rank(best)) lidars.push_back(c);
        }
        if (used.size() > 1)
            fail<UsageError>(
                "the topics {} contain clouds in the frame '{}', expected one topic for each frame; select "
                "topics with dataset.lidars, for example dataset.lidars={}",
                fmt::join(used, ", "), quote(frame), *used.begin());
        // Drivers usually publish the clouds of packets in the same frame.
        if (!unused.empty() && rank(best) > 0)
            notes.push_back(
                fmt::format("not read: {}, because {} has the same frame '{}' and more data of the sensor; "
                            "dataset.lidars selects other topics",
                            fmt::join(unused, ", "), *used.begin(), quote(frame)));
    }
    std::ranges::sort(lidars);
    return lidars;
}

}  // namespace

ChosenClouds choose_clouds(const BagRecording& bag, const BagIndex& index,
                           const std::vector<std::string>& requested_topics) {
    ChosenClouds choice;
    const std::vector<std::size_t> candidates = requested_topics.empty()
                                                    ? select_topics(bag, index, choice.notes)
                                                    : find_requested(bag, index, requested_topics);
    if (candidates.empty())
        fail(
            "{}: the recording has no point clouds{}, expected a topic of sensor_msgs/PointCloud2 or "
            "livox_ros_driver2/CustomMsg; it contains {}",
            bag.file_paths().front().string(), explain_no_clouds(bag, index), format_topics(bag));
    // The clouds of the main LiDAR define the frames of the log.
    const std::size_t main =
        *std::ranges::min_element(candidates, {}, [&](std::size_t c) { return rank_kind(index.clouds[c]); });
    const std::string& main_frame = index.clouds[main].frame;
    for (const std::size_t c : candidates) {
        const CloudTopic& clouds = index.clouds[c];
        const std::string name = clouds.make_name(bag);
        if (c == main || index.frames.find_constant(main_frame, clouds.frame)) {
            check_cloud_frame(name, clouds, choice.notes);
            if (c == main) choice.main = choice.lidars.size();
            choice.lidars.push_back(c);
            continue;
        }
        const std::string obstacle =
            fmt::format("/tf_static has no transform between its frame '{}' and the frame '{}'", clouds.frame,
                        main_frame);
        if (!requested_topics.empty())
            fail("topic {} cannot be read together with the other topics of dataset.lidars: {}", name,
                 obstacle);
        choice.notes.push_back(fmt::format(
            "topic {} is ignored: {}; use dataset.lidars={} to read only this topic", name, obstacle, name));
    }
    return choice;
}

}  // namespace relidar::bag
