// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "log/readers/bag/choose.hpp"

namespace relidar::bag {
namespace {

/// A possible source of vehicle poses: a pose topic, or a path in the tree of transforms.
struct PoseSource {
    /// reference frame of the poses: the frame of the topic, or an ancestor of the
    /// LiDAR's frame
    std::string outer;
    const PoseTopic* topic = nullptr;  ///< pose topic; null if the poses come from the transforms in /tf
    std::string vehicle;
    std::string about;
};

/// Returns the frame of the vehicle. It is the first frame on the path from the sensor to
/// the frame `outer` that moves relative to its parent. If no frame moves, returns the
/// sensor's frame.
std::string find_vehicle_frame(const FrameTree& frames, const std::vector<std::string>& chain,
                               const std::string& outer) {
    for (const std::string& frame : chain) {
        if (frame == outer) break;
        if (frames.is_moving(frame)) return frame;
    }
    return chain.front();
}

bool has_moving_transform_between(const FrameTree& frames, const std::vector<std::string>& chain,
                                  const std::string& outer) {
    const auto end = std::ranges::find(chain, outer);
    return std::any_of(chain.begin(), end, [&](const std::string& frame) { return frames.is_moving(frame); });
}

PoseSource make_frame_source(const FrameTree& frames, const std::vector<std::string>& chain,
                             const std::string& outer) {
    PoseSource source{outer, nullptr, find_vehicle_frame(frames, chain, outer), {}};
    source.about = fmt::format("poses are those of the frame '{}' in the frame '{}' from /tf (path {}){}",
                               source.vehicle, outer, fmt::join(chain, " < "),
                               has_moving_transform_between(frames, chain, outer)
                                   ? ""
                                   : "; they are constant, so the LiDAR does not move");
    return source;
}

PoseSource make_topic_source(const Bag& bag, const FrameTree& frames, const PoseTopic& topic,
                             const std::string& lidar, std::vector<std::string>& notes) {
    PoseSource source{topic.parent, &topic, topic.child.empty() ? "base_link" : topic.child, {}};
    const std::string& name = bag.topics()[topic.topic].name;
    if (!frames.find_constant_pose(source.vehicle, lidar)) {
        notes.push_back(
            fmt::format("/tf_static has no transform between '{}' and '{}', so the poses of {} are used as "
                        "poses of the LiDAR",
                        lidar, source.vehicle, name));
        source.vehicle = lidar;
    }
    source.about = fmt::format("poses are those of the frame '{}' in the frame '{}' from topic {}",
                               source.vehicle, topic.parent, name);
    return source;
}

/// Returns the pose topic with the most messages. Odometry topics are preferred.
const PoseTopic* find_densest_topic(const Bag& bag, const Survey& survey) {
    const auto best = std::ranges::max_element(survey.poses, {}, [&](const PoseTopic& p) {
        return std::pair(bag.topics()[p.topic].type == "nav_msgs/Odometry", p.samples.size());
    });
    return best == survey.poses.end() || best->samples.size() < 2 ? nullptr : &*best;
}

std::optional<PoseSource> find_named_source(const Bag& bag, const Survey& survey,
                                            const std::vector<std::string>& chain,
                                            const std::string& pose_topic, std::vector<std::string>& notes) {
    if (pose_topic.empty()) return std::nullopt;
    if (std::find(chain.begin() + 1, chain.end(), pose_topic) != chain.end())
        return make_frame_source(survey.frames, chain, pose_topic);
    std::vector<std::string> known(chain.begin() + 1, chain.end());
    for (const PoseTopic& topic : survey.poses) {
        if (bag.topics()[topic.topic].name == pose_topic)
            return make_topic_source(bag, survey.frames, topic, chain.front(), notes);
        known.push_back(bag.topics()[topic.topic].name);
    }
    throw UsageError(fmt::format(
        "dataset.poses_from: found '{}', expected a parent frame of '{}' or a topic of poses: "
        "{}",
        make_excerpt(pose_topic), chain.front(),
        known.empty() ? "the recording has no poses" : fmt::format("{}", fmt::join(known, ", "))));
}

std::optional<PoseSource> select_pose_source(const Bag& bag, const Survey& survey,
                                             const std::vector<std::string>& chain,
                                             std::vector<std::string>& notes) {
    const std::string outer = std::ranges::find(chain, "map") != chain.end() ? "map" : chain.back();
    if (has_moving_transform_between(survey.frames, chain, outer))
        return make_frame_source(survey.frames, chain, outer);
    if (const PoseTopic* topic = find_densest_topic(bag, survey))
        return make_topic_source(bag, survey.frames, *topic, chain.front(), notes);
    for (const char* world : {"map", "odom", "world", "earth"})
        if (outer == world && chain.size() > 1) return make_frame_source(survey.frames, chain, outer);
    return std::nullopt;
}

PosePath make_path(const Survey& survey, const PoseSource& source, Clock clock, std::int64_t zero_ns) {
    if (!source.topic) return survey.frames.path(source.outer, source.vehicle, clock, zero_ns);
    PosePath path;
    path.add(source.topic->samples, clock, zero_ns);
    return path;
}

std::size_t count_clouds_with_pose(const CloudTopic& clouds, const PosePath& path, Clock clock,
                                   std::int64_t zero_ns) {
    return std::size_t(std::ranges::count_if(clouds.clouds, [&](const CloudEntry& cloud) {
        return path.covers(1e-9 * double(cloud.time_ns(clock) - zero_ns));
    }));
}

std::int64_t get_first_time(const CloudTopic& clouds, Clock clock) {
    std::int64_t first = clouds.clouds.front().time_ns(clock);
    for (const CloudEntry& cloud : clouds.clouds) first = std::min(first, cloud.time_ns(clock));
    return first;
}

}  // namespace

PoseChoice choose_poses(const Bag& bag, const Survey& survey, const CloudTopic& main,
                        const std::string& pose_topic) {
    PoseChoice choice;
    const std::vector<std::string> way = survey.frames.find_path_to_root(main.frame);
    std::optional<PoseSource> source = find_named_source(bag, survey, way, pose_topic, choice.notes);
    if (!source) source = select_pose_source(bag, survey, way, choice.notes);
    const bool has_stamps =
        std::ranges::any_of(main.clouds, [](const CloudEntry& cloud) { return cloud.stamp_ns != 0; });
    if (!has_stamps) {
        choice.clock = Clock::recorder;
        choice.notes.push_back("the clouds have no stamps, so their recording times are used");
    }
    choice.zero_ns = get_first_time(main, choice.clock);
    choice.vehicle = main.frame;
    if (!source) return choice;
    choice.path = make_path(survey, *source, choice.clock, choice.zero_ns);
    choice.world = source->outer;
    choice.vehicle = source->vehicle;
    choice.about = source->about;
    const std::size_t n = count_clouds_with_pose(main, *choice.path, choice.clock, choice.zero_ns);
    if (choice.clock == Clock::recorder || 2 * n >= main.clouds.size()) return choice;
    const std::int64_t zero_ns = get_first_time(main, Clock::recorder);
    PosePath recorded = make_path(survey, *source, Clock::recorder, zero_ns);
    const std::size_t n_recorded = count_clouds_with_pose(main, recorded, Clock::recorder, zero_ns);
    if (n_recorded <= n) return choice;
    choice.notes.push_back(
        fmt::format("the stamps of clouds and poses come from different clocks (only {} of {} clouds have "
                    "a pose at their stamp), so the recording times of messages are used",
                    n, main.clouds.size()));
    choice.clock = Clock::recorder;
    choice.zero_ns = zero_ns;
    choice.path = std::move(recorded);
    return choice;
}

}  // namespace relidar::bag
