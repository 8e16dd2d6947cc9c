// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "log/readers/bag/choose.hpp"
#include "log/readers/bag/packets/packet_messages.hpp"

namespace relidar::bag {
namespace {

// The sweep rate of a further LiDAR, divided by the rate of the main LiDAR, must be in
// this interval.
constexpr double kLeastRate = 0.5, kMostRate = 2.0;

std::string format_topics(const Bag& bag) {
    std::vector<std::string> texts;
    for (const Topic& topic : bag.topics())
        if (texts.size() < 20)
            texts.push_back(fmt::format("{} ({})", make_excerpt(topic.name), make_excerpt(topic.type)));
    return texts.empty() ? "none" : fmt::format("{}", fmt::join(texts, ", "));
}

/// A ROS package with packets that relidar cannot decode, and the driver that converts
/// them to point clouds.
struct PacketDriver {
    const char* package;
    const char* driver;
};
constexpr PacketDriver kDrivers[] = {
    {"hesai_ros_driver/", "hesai_ros_driver"},
    {"rslidar_msg/", "rslidar_sdk"},
    {"robosense_msgs/", "nebula"},
    {"seyond/", "seyond_ros_driver"},
};

/// Returns the end of an error message for a bag without clouds. It explains why topics
/// that may contain clouds could not be read.
std::string format_broken_topics(const Bag& bag, const Survey& survey) {
    std::string text;
    for (const std::string& note : bag.notes()) text += fmt::format(" ({})", note);
    for (const Topic& topic : bag.topics())
        for (const PacketDriver& known : kDrivers)
            if (topic.type.starts_with(known.package))
                text += fmt::format(
                    " ({}: relidar cannot decode these packets; play the recording with {}, and record its "
                    "point clouds)",
                    make_excerpt(topic.name), known.driver);
    for (std::size_t t = 0; t < survey.facts.size(); ++t) {
        const Topic& topic = bag.topics()[t];
        const auto clouds = std::ranges::find(survey.clouds, t, &CloudTopic::topic);
        const bool is_empty = clouds != survey.clouds.end() && clouds->clouds.empty();
        if (is_empty && !clouds->packets.empty())
            text += fmt::format(" ({}: {} packets of a {}; {})", make_excerpt(topic.name),
                                clouds->packets.size(), clouds->packets.about(), clouds->packets.problems());
        else if (is_empty)
            text += fmt::format(" ({}: {} clouds without points)", make_excerpt(topic.name), clouds->n_empty);
        if (survey.facts[t].n_broken > 0)
            text += fmt::format(" ({}: {})", make_excerpt(topic.name), survey.facts[t].broken);
        if (topic.type == packets::kOtherDatagrams)
            text += fmt::format(" ({}: {} datagrams that relidar cannot decode as LiDAR packets)",
                                make_excerpt(topic.name), survey.facts[t].n);
    }
    if (bag.topics().empty()) text += " (the recording has no messages)";
    return text;
}

/// Returns a score that is higher for raw measurements of a LiDAR: highest for packets,
/// then for clouds with times, rings and return numbers, then for clouds with many
/// points.
double score_raw_topic(const CloudTopic& clouds) {
    if (!clouds.packets.empty()) return 200.0;
    const bool timed = clouds.has_field(folder::PointValue::time);
    const bool ringed = clouds.has_field(folder::PointValue::ring);
    const bool numbered = clouds.has_field(folder::PointValue::return_number) ||
                          clouds.has_field(folder::PointValue::return_type);
    return 100.0 * timed + 50.0 * ringed + 20.0 * numbered +
           std::log10(1.0 + double(clouds.compute_median_points()));
}

constexpr std::array kOfWorld = {"map", "odom", "world", "earth"},
                     kOfVehicle = {"base_link", "base_footprint", "vehicle", "ego"};

template <std::size_t N>
bool is_in(const CloudTopic& clouds, const std::array<const char*, N>& frames) {
    return std::ranges::find(frames, clouds.frame) != frames.end();
}

/// Returns true if the clouds are in the frame of a single sensor. Clouds in the vehicle
/// frame are usually merged from several sensors, and clouds in a world frame are maps.
bool is_in_sensor_frame(const CloudTopic& clouds) {
    return !is_in(clouds, kOfWorld) && !is_in(clouds, kOfVehicle);
}

/// Throws if the frame of a topic shows that it does not contain LiDAR scans. If this is
/// only probable, adds a note for the user.
void check_frame(const std::string& name, const CloudTopic& clouds, CloudChoice& choice) {
    if (is_in(clouds, kOfWorld))
        throw DataError(
            fmt::format("{}: the clouds are in the world-fixed frame '{}', so the positions of the LiDAR are "
                        "unknown; expected clouds in the frame of the LiDAR (select another topic with "
                        "dataset.lidars)",
                        name, clouds.frame));
    if (is_in(clouds, kOfVehicle))
        choice.notes.push_back(fmt::format(
            "{}: the clouds are in the frame '{}' of the vehicle, so clouds of several LiDARs were "
            "probably merged; all rays start at the origin of this frame, which is wrong near the vehicle",
            name, clouds.frame));
}

/// Returns the number of sweeps per second. It is below the message rate if a sweep
/// consists of several messages.
double estimate_rate(const Survey& survey, const CloudTopic& clouds) {
    const TopicFacts& facts = survey.facts[clouds.topic];
    return facts.rate_hz() * double(clouds.clouds.size()) /
           double(std::max<std::size_t>(facts.n - clouds.n_empty, 1));
}

std::vector<std::size_t> find_clouds_of_topics(const Bag& bag, const Survey& survey,
                                               const std::vector<std::string>& topics) {
    std::vector<std::size_t> lidars;
    for (const std::string& name : topics) {
        const auto found = std::ranges::find_if(
            survey.clouds, [&](const CloudTopic& c) { return bag.topics()[c.topic].name == name; });
        if (found == survey.clouds.end() || found->clouds.empty())
            throw UsageError(fmt::format(
                "dataset.lidars: found '{}', expected a topic of point clouds; the recording contains {}",
                make_excerpt(name), format_topics(bag)));
        lidars.push_back(std::size_t(found - survey.clouds.begin()));
    }
    std::ranges::sort(lidars);
    lidars.erase(std::unique(lidars.begin(), lidars.end()), lidars.end());
    return lidars;
}

/// Returns the frame that identifies the LiDAR of a topic: the frame of its clouds. If a
/// driver computed the clouds from packets in the same bag, returns the frame of the
/// packets instead.
const std::string& get_sensor(const Survey& survey, const CloudTopic& clouds) {
    for (const CloudTopic& other : survey.clouds)
        if (!other.turns.empty() &&
            std::ranges::find(other.driver_frames, clouds.frame) != other.driver_frames.end())
            return other.frame;
    return clouds.frame;
}

/// Selects one topic for each LiDAR: the one with the highest score for raw measurements.
std::vector<std::size_t> select_lidar_topics(const Survey& survey) {
    const auto has_clouds = [](const CloudTopic& c) { return !c.clouds.empty(); };
    const bool any_of_sensor = std::ranges::any_of(
        survey.clouds, [&](const CloudTopic& c) { return has_clouds(c) && is_in_sensor_frame(c); });
    std::map<std::string, std::size_t> best;
    for (std::size_t c = 0; c < survey.clouds.size(); ++c) {
        const CloudTopic& clouds = survey.clouds[c];
        if (!has_clouds(clouds) || (any_of_sensor && !is_in_sensor_frame(clouds))) continue;
        const auto [at, is_new] = best.try_emplace(get_sensor(survey, clouds), c);
        if (!is_new && score_raw_topic(clouds) > score_raw_topic(survey.clouds[at->second])) at->second = c;
    }
    std::vector<std::size_t> lidars;
    for (const auto& [frame, c] : best) lidars.push_back(c);
    std::ranges::sort(lidars);
    return lidars;
}

std::size_t choose_main_lidar(const Survey& survey, const std::vector<std::size_t>& lidars) {
    const auto most = std::ranges::max_element(lidars, {}, [&](std::size_t c) {
        const CloudTopic& clouds = survey.clouds[c];
        return std::pair(score_raw_topic(clouds) >= 100.0,
                         double(clouds.compute_median_points()) * double(clouds.clouds.size()));
    });
    return std::size_t(most - lidars.begin());
}

}  // namespace

CloudChoice choose_clouds(const Bag& bag, const Survey& survey, const std::vector<std::string>& topics) {
    CloudChoice choice;
    choice.lidars = topics.empty() ? select_lidar_topics(survey) : find_clouds_of_topics(bag, survey, topics);
    if (choice.lidars.empty())
        throw DataError(
            fmt::format("{}: the recording has no point clouds{}, expected a topic of "
                        "sensor_msgs/PointCloud2 or livox_ros_driver2/CustomMsg; it contains {}",
                        bag.files().front().string(), format_broken_topics(bag, survey), format_topics(bag)));
    choice.main = choose_main_lidar(survey, choice.lidars);
    const CloudTopic& main = survey.clouds[choice.lidars[choice.main]];
    std::vector<std::size_t> kept;
    for (const std::size_t c : choice.lidars) {
        const CloudTopic& clouds = survey.clouds[c];
        const std::string& name = bag.topics()[clouds.topic].name;
        const double rate = estimate_rate(survey, clouds) / std::max(estimate_rate(survey, main), 1e-9);
        std::string why;
        if (&clouds != &main && !survey.frames.find_constant_pose(main.frame, clouds.frame))
            why = fmt::format("/tf_static has no transform between its frame '{}' and the frame '{}'",
                              clouds.frame, main.frame);
        else if (&clouds != &main && !(rate >= kLeastRate && rate <= kMostRate))
            why =
                fmt::format("it has {:.3g} times as many clouds as {}", rate, bag.topics()[main.topic].name);
        if (why.empty()) {
            check_frame(name, clouds, choice);
            kept.push_back(c);
        } else if (topics.empty()) {
            choice.notes.push_back(fmt::format(
                "topic {} is ignored: {}; use dataset.lidars={} to read only this topic", name, why, name));
        } else {
            throw DataError(
                fmt::format("topic {} cannot be read together with the others: {}; select other topics "
                            "with dataset.lidars",
                            name, why));
        }
    }
    choice.main = std::size_t(std::ranges::find(kept, choice.lidars[choice.main]) - kept.begin());
    choice.lidars = std::move(kept);
    return choice;
}

}  // namespace relidar::bag
