// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/choose.hpp"
#include "read/packets/packet_messages.hpp"

namespace relidar::bag {
namespace {

// Sweep rate of a further LiDAR, divided by the rate of the main LiDAR.
constexpr double kLeastRate = 0.5, kMostRate = 2.0;
// Limits of the lists of topics and of reasons in an error message.
constexpr std::size_t kMostTopics = 10, kMostReasons = 3;

void shorten_list(std::vector<std::string>& texts, std::size_t max_count) {
    if (texts.size() <= max_count) return;
    const std::string more = fmt::format("and {} more", texts.size() - max_count);
    texts.resize(max_count);
    texts.push_back(more);
}

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

/// Returns the end of the error message for a bag without clouds. The text explains why
/// topics that may contain clouds could not be read.
/// @param requested_topic  topic to explain; empty: all topics
std::string explain_no_clouds(const BagRecording& bag, const BagIndex& index,
                              const std::string& requested_topic = "") {
    std::vector<std::string> reasons = bag.file_problems();
    for (std::size_t t = 0; t < index.facts.size(); ++t) {
        const BagTopic& topic = bag.topics()[t];
        if (!requested_topic.empty() && topic.name != requested_topic) continue;
        const std::string name = quote(topic.name);
        for (const PacketDriver& packet_driver : kPacketDrivers)
            if (topic.type.starts_with(packet_driver.package))
                reasons.push_back(fmt::format(
                    "{}: found packets that relidar cannot decode; convert them to point clouds with {}",
                    name, packet_driver.driver));
        const auto clouds = std::ranges::find(index.clouds, t, &CloudTopic::topic);
        const bool is_empty = clouds != index.clouds.end() && clouds->clouds.empty();
        if (is_empty && !clouds->packets.empty())
            reasons.push_back(fmt::format("topic {} contains {} packets of a {}: {}", name,
                                          clouds->packets.size(), clouds->packets.describe_product(),
                                          clouds->packets.describe_faults()));
        else if (is_empty && clouds->n_empty > 0)
            reasons.push_back(
                fmt::format("topic {} contains {} clouds without points", name, clouds->n_empty));
        if (index.facts[t].n == 0 && find_purpose(topic) == MessagePurpose::cloud)
            reasons.push_back(fmt::format("topic {} contains no messages", name));
        if (index.facts[t].n_broken > 0)
            reasons.push_back(fmt::format("{}: {}", name, index.facts[t].broken));
        if (topic.type == packets::kOtherDatagrams)
            reasons.push_back(
                fmt::format("{} contains {} datagrams that relidar cannot decode as LiDAR packets", name,
                            index.facts[t].n));
    }
    if (bag.topics().empty()) reasons.push_back("the recording has no messages");
    shorten_list(reasons, kMostReasons);
    std::string text;
    for (const std::string& reason : reasons) text += fmt::format(" ({})", reason);
    return text;
}

/// Returns a score that is higher if a topic has raw measurements. Packets have the
/// highest score, then clouds with times, rings and return numbers, then clouds with many
/// points.
double score_raw_data(const CloudTopic& cloud_topic) {
    if (!cloud_topic.packets.empty()) return 200.0;
    const bool timed = cloud_topic.has_field(read::PointAttribute::time);
    const bool ringed = cloud_topic.has_field(read::PointAttribute::ring);
    const bool numbered = cloud_topic.has_field(read::PointAttribute::return_number) ||
                          cloud_topic.has_field(read::PointAttribute::return_type);
    return 100.0 * timed + 50.0 * ringed + 20.0 * numbered +
           std::log10(1.0 + double(cloud_topic.median_points()));
}

/// Returns true for usual names of the vehicle frame. Clouds in this frame are usually
/// merged from several sensors.
bool is_vehicle_frame(std::string_view frame) {
    return frame == "base_link" || frame == "base_footprint" || frame == "vehicle" || frame == "ego";
}

bool is_in_sensor_frame(const CloudTopic& cloud_topic) {
    return !is_world_frame(cloud_topic.frame) && !is_vehicle_frame(cloud_topic.frame);
}

/// Throws if clouds are in a world-fixed frame. Adds a note if they are in the vehicle
/// frame.
void check_cloud_frame(const std::string& topic_name, const CloudTopic& clouds, ChosenClouds& selected) {
    if (is_world_frame(clouds.frame))
        fail(
            "{}: the clouds are in the world-fixed frame '{}', expected the frame of the LiDAR (select "
            "another topic with dataset.lidars)",
            topic_name, clouds.frame);
    if (is_vehicle_frame(clouds.frame))
        selected.notes.push_back(fmt::format(
            "{}: the clouds are in the vehicle frame '{}', probably because clouds of several LiDARs were "
            "merged. All rays start at the origin of this frame, which is inaccurate near the vehicle",
            topic_name, clouds.frame));
}

/// Returns the number of sweeps per second. The message rate is higher if a sweep
/// consists of several messages.
double sweep_rate_hz(const BagIndex& index, const CloudTopic& cloud_topic) {
    const TopicStatistics& facts = index.facts[cloud_topic.topic];
    return facts.rate_hz() * double(cloud_topic.clouds.size()) /
           double(std::max<std::size_t>(facts.n - cloud_topic.n_empty, 1));
}

/// Returns the indices of the requested clouds in `index.clouds`, ascending. If several
/// LiDARs share a topic, the name of the topic selects all of them.
std::vector<std::size_t> find_topics(const BagRecording& bag, const BagIndex& index,
                                     const std::vector<std::string>& topic_names) {
    std::vector<std::size_t> lidars;
    for (const std::string& name : topic_names) {
        const std::size_t n_before = lidars.size();
        for (std::size_t c = 0; c < index.clouds.size(); ++c)
            if (const CloudTopic& clouds = index.clouds[c];
                !clouds.clouds.empty() &&
                (bag.topics()[clouds.topic].name == name || clouds.make_name(bag) == name))
                lidars.push_back(c);
        if (lidars.size() == n_before)
            fail<UsageError>(
                "dataset.lidars: found '{}', expected a topic with point clouds{}; the recording contains {}",
                quote(name), explain_no_clouds(bag, index, name), format_topics(bag));
    }
    std::ranges::sort(lidars);
    lidars.erase(std::unique(lidars.begin(), lidars.end()), lidars.end());
    return lidars;
}

/// Returns the frame_id that identifies the LiDAR of a topic. If a driver computed the
/// clouds from packets in the same bag, this is the frame_id of the packets.
const std::string& lidar_frame(const BagIndex& index, const CloudTopic& cloud_topic) {
    for (const CloudTopic& other : index.clouds)
        if (!other.revolutions.empty() &&
            std::ranges::find(other.driver_frames, cloud_topic.frame) != other.driver_frames.end())
            return other.frame;
    return cloud_topic.frame;
}

/// If several topics have the same frame, selects the one with the least processed data,
/// because the others are usually copies. Adds a note about the other topics.
std::vector<std::size_t> select_raw_topics(const BagRecording& bag, const BagIndex& index,
                                           std::vector<std::string>& notes) {
    const auto has_clouds = [](const CloudTopic& c) { return !c.clouds.empty(); };
    const bool any_of_sensor = std::ranges::any_of(
        index.clouds, [&](const CloudTopic& c) { return has_clouds(c) && is_in_sensor_frame(c); });
    std::map<std::string, std::vector<std::size_t>> of_frame;
    for (std::size_t c = 0; c < index.clouds.size(); ++c) {
        const CloudTopic& clouds = index.clouds[c];
        if (!has_clouds(clouds) || (any_of_sensor && !is_in_sensor_frame(clouds))) continue;
        of_frame[lidar_frame(index, clouds)].push_back(c);
    }
    std::vector<std::size_t> lidars;
    for (const auto& [frame, candidates] : of_frame) {
        const CloudTopic& best = index.clouds[*std::ranges::max_element(
            candidates, {}, [&](std::size_t c) { return score_raw_data(index.clouds[c]); })];
        std::vector<std::string> others;
        for (const std::size_t c : candidates) {
            const CloudTopic& clouds = index.clouds[c];
            if (clouds.topic == best.topic) lidars.push_back(c);
            else if (best.packets.empty()) others.push_back(clouds.make_name(bag));
        }
        if (others.empty()) continue;
        const std::string names = fmt::format("{}", fmt::join(others, ", ")),
                          used = bag.topics()[best.topic].name;
        notes.push_back(
            fmt::format("{} not read, because the clouds have the frame '{}' like {}, so they count as "
                        "copies; to read another LiDAR there, use dataset.lidars={},{}",
                        others.size() == 1 ? "topic " + names + " is" : "topics " + names + " are",
                        quote(frame), used, used, fmt::join(others, ",")));
    }
    std::ranges::sort(lidars);
    return lidars;
}

/// Returns the index of the main LiDAR, whose clouds define the frames of the log.
/// Prefers packets and clouds with times, then the LiDAR with the most points.
std::size_t choose_main(const BagIndex& index, const std::vector<std::size_t>& cloud_topic_indices) {
    const auto most = std::ranges::max_element(cloud_topic_indices, {}, [&](std::size_t c) {
        const CloudTopic& clouds = index.clouds[c];
        return std::pair(score_raw_data(clouds) >= 100.0,
                         double(clouds.median_points()) * double(clouds.clouds.size()));
    });
    return std::size_t(most - cloud_topic_indices.begin());
}

}  // namespace

ChosenClouds choose_clouds(const BagRecording& bag, const BagIndex& index,
                           const std::vector<std::string>& requested_topics) {
    ChosenClouds choice;
    choice.lidars = requested_topics.empty() ? select_raw_topics(bag, index, choice.notes)
                                             : find_topics(bag, index, requested_topics);
    if (choice.lidars.empty())
        fail(
            "{}: the recording has no point clouds{}, expected a topic of sensor_msgs/PointCloud2 or "
            "livox_ros_driver2/CustomMsg; it contains {}",
            bag.file_paths().front().string(), explain_no_clouds(bag, index), format_topics(bag));
    choice.main = choose_main(index, choice.lidars);
    const CloudTopic& main = index.clouds[choice.lidars[choice.main]];
    std::vector<std::size_t> accepted_lidars;
    for (const std::size_t c : choice.lidars) {
        const CloudTopic& clouds = index.clouds[c];
        const std::string name = clouds.make_name(bag);
        const double rate = sweep_rate_hz(index, clouds) / std::max(sweep_rate_hz(index, main), 1e-9);
        // Reason to leave out the topic. Its mounting must be rigid, its rate similar.
        std::string why;
        if (&clouds != &main && !index.frames.find_constant(main.frame, clouds.frame))
            why = fmt::format("/tf_static has no transform between its frame '{}' and the frame '{}'",
                              clouds.frame, main.frame);
        else if (&clouds != &main && !(rate >= kLeastRate && rate <= kMostRate))
            why = fmt::format("it contains {:.3g} times as many clouds as topic {}", rate,
                              bag.topics()[main.topic].name);
        if (why.empty()) {
            check_cloud_frame(name, clouds, choice);
            accepted_lidars.push_back(c);
        } else if (requested_topics.empty()) {
            choice.notes.push_back(fmt::format(
                "topic {} is ignored: {}; use dataset.lidars={} to read only this topic", name, why, name));
        } else {
            fail("topic {} cannot be read together with the other topics of dataset.lidars: {}", name, why);
        }
    }
    choice.main =
        std::size_t(std::ranges::find(accepted_lidars, choice.lidars[choice.main]) - accepted_lidars.begin());
    choice.lidars = std::move(accepted_lidars);
    return choice;
}

}  // namespace relidar::bag
