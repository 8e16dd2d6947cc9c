// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/choose.hpp"

namespace relidar::bag {
namespace {

// The heading is uncertain if the antenna stays this close to its mean position.
constexpr double kMinSpread_m = 2.0;
constexpr double kMaxResidualShare = 0.2;  // of the spread

/// A possible source of vehicle poses: a pose topic, or a chain of transforms.
struct PoseSource {
    /// name of the frame in which the poses are given, for example "map"
    std::string world;
    const PoseTopic* topic = nullptr;  ///< pose topic; null if the poses come from the transforms in /tf
    std::string vehicle;               ///< frame whose poses are given
    std::string description;           ///< text for the user
};

/// Follows the parent frames from the sensor to `ancestor_frame`. Returns the first frame
/// that moves relative to its parent, which is the vehicle.
std::optional<std::string> find_moving_frame(const FrameTree& frame_tree,
                                             const std::vector<std::string>& frame_path_to_root,
                                             const std::string& ancestor_frame) {
    for (const std::string& frame : frame_path_to_root) {
        if (frame == ancestor_frame) break;
        if (frame_tree.is_frame_moving(frame)) return frame;
    }
    return std::nullopt;
}

/// Returns the transforms from an ancestor frame down to the vehicle as source of the
/// vehicle poses. If no transform moves, the LiDAR itself is the vehicle.
/// @param frame_path_to_root  the frame of the LiDAR and all its ancestors
PoseSource make_tf_source(const FrameTree& frame_tree, const std::vector<std::string>& frame_path_to_root,
                          const std::string& ancestor_frame) {
    const auto moving_frame = find_moving_frame(frame_tree, frame_path_to_root, ancestor_frame);
    PoseSource source;
    source.world = ancestor_frame;
    source.vehicle = moving_frame.value_or(frame_path_to_root.front());
    source.description =
        fmt::format("poses of the frame '{}' in the frame '{}' are read from /tf (path {}){}", source.vehicle,
                    ancestor_frame, fmt::join(frame_path_to_root, " < "),
                    moving_frame ? "" : "; these poses are constant, so the LiDAR does not move");
    return source;
}

/// Returns a pose topic as source of the vehicle poses. If the mounting of the LiDAR on
/// the vehicle is unknown, uses the poses as poses of the LiDAR, with a note.
PoseSource make_topic_source(const BagRecording& bag, const FrameTree& frame_tree,
                             const PoseTopic& pose_topic, const std::string& lidar_frame,
                             std::vector<std::string>& notes) {
    PoseSource source{.world = pose_topic.parent,
                      .topic = &pose_topic,
                      .vehicle = pose_topic.child.empty() ? "base_link" : pose_topic.child,
                      .description = {}};
    const std::string& name = bag.topics()[pose_topic.topic].name;
    if (!frame_tree.find_constant(source.vehicle, lidar_frame)) {
        notes.push_back(
            fmt::format("/tf_static has no transform between '{}' and '{}', so the poses of {} are used as "
                        "poses of the LiDAR",
                        lidar_frame, source.vehicle, name));
        source.vehicle = lidar_frame;
    }
    source.description = fmt::format("poses of the frame '{}' in the frame '{}' are read from the topic {}",
                                     source.vehicle, pose_topic.parent, name);
    return source;
}

/// Returns the source that the user requests: a parent frame of the sensor, or a pose
/// topic. Returns nothing if the user requests none.
std::optional<PoseSource> find_source(const BagRecording& bag, const BagIndex& index,
                                      const std::vector<std::string>& frame_path_to_root,
                                      const std::string& requested_frame_or_topic,
                                      std::vector<std::string>& notes) {
    if (requested_frame_or_topic.empty()) return std::nullopt;
    std::vector<std::string> available(frame_path_to_root.begin() + 1, frame_path_to_root.end());
    if (std::ranges::find(available, requested_frame_or_topic) != available.end())
        return make_tf_source(index.frames, frame_path_to_root, requested_frame_or_topic);
    for (const PoseTopic& topic : index.poses) {
        if (bag.topics()[topic.topic].name == requested_frame_or_topic)
            return make_topic_source(bag, index.frames, topic, frame_path_to_root.front(), notes);
        available.push_back(bag.topics()[topic.topic].name);
    }
    fail<UsageError>(
        "dataset.poses_from: found '{}', expected a parent frame of '{}' or a topic of poses: {}",
        quote(requested_frame_or_topic), frame_path_to_root.front(),
        available.empty() ? "none" : fmt::format("{}", fmt::join(available, ", ")));
}

/// Selects a source automatically: moving transforms, then a pose topic, then constant
/// transforms to a world frame. Prefers the frame "map", because it has no drift.
std::optional<PoseSource> select_source(const BagRecording& bag, const BagIndex& index,
                                        const std::vector<std::string>& frame_path_to_root,
                                        std::vector<std::string>& notes) {
    const bool has_map = std::ranges::find(frame_path_to_root, "map") != frame_path_to_root.end();
    const std::string world = has_map ? "map" : frame_path_to_root.back();
    if (find_moving_frame(index.frames, frame_path_to_root, world))
        return make_tf_source(index.frames, frame_path_to_root, world);

    // Uses the pose topic with the most messages. Prefers odometry topics.
    const auto best = std::ranges::max_element(index.poses, {}, [&](const PoseTopic& poses) {
        const bool is_odometry = bag.topics()[poses.topic].type == "nav_msgs/Odometry";
        return std::pair(is_odometry, poses.samples.size());
    });
    if (best != index.poses.end() && best->samples.size() >= 2)
        return make_topic_source(bag, index.frames, *best, frame_path_to_root.front(), notes);
    if (is_world_frame(world) && frame_path_to_root.size() > 1)
        return make_tf_source(index.frames, frame_path_to_root, world);
    return std::nullopt;
}

/// Returns the poses of a source on a clock.
/// @param time_origin_ns  time on this clock that is 0 s in the log
TransformChain make_pose_chain(const BagIndex& index, const PoseSource& pose_source, LogClock log_clock,
                               std::int64_t time_origin_ns) {
    if (!pose_source.topic)
        return index.frames.make_chain(pose_source.world, pose_source.vehicle, log_clock, time_origin_ns);
    TransformChain path;
    path.append_samples(pose_source.topic->samples, log_clock, time_origin_ns);
    return path;
}

/// Returns the number of clouds at whose times the pose of the vehicle is known.
std::size_t count_posed(const CloudTopic& clouds, const TransformChain& vehicle_pose_function, LogClock clock,
                        std::int64_t time_origin_ns) {
    return std::size_t(std::ranges::count_if(clouds.clouds, [&](const CloudEntry& cloud) {
        return vehicle_pose_function.covers_time(1e-9 * double(cloud.time_ns(clock) - time_origin_ns));
    }));
}

/// Returns the samples of the poses. Returns null if the source does not move.
const std::vector<StampedPose>* find_samples(const BagIndex& index, const PoseSource& source) {
    return source.topic ? &source.topic->samples : index.frames.fastest_samples(source.world, source.vehicle);
}

/// Sets the pose path of a source. The time of the first cloud becomes 0 s. If the clocks
/// of clouds and poses differ, the poses get another zero, but only if the offset is
/// certain, and if more clouds then have a pose. Otherwise adds a warning.
void set_poses(ChosenPoses& choice, const BagIndex& index, const CloudTopic& clouds,
               const PoseSource& source) {
    choice.poses_zero_ns = choice.zero_ns;
    choice.path = make_pose_chain(index, source, choice.clock, choice.zero_ns);
    const std::vector<StampedPose>* poses = find_samples(index, source);
    if (choice.clock == LogClock::recorder || !poses) return;
    const ClockOffset offset = estimate_offset(list_times(clouds.clouds), list_times(*poses));
    if (offset.offset_ns == 0) return;

    const std::int64_t corrected_zero_ns = choice.zero_ns - offset.offset_ns;
    TransformChain corrected_path = make_pose_chain(index, source, choice.clock, corrected_zero_ns);
    const std::size_t n = count_posed(clouds, *choice.path, choice.clock, choice.zero_ns);
    const std::size_t n_corrected = count_posed(clouds, corrected_path, choice.clock, choice.zero_ns);
    // If poses are only late, the correction cannot give a pose to more clouds.
    constexpr std::size_t kMinExtraClouds = 2;
    const bool is_better = n_corrected > n + kMinExtraClouds || n_corrected == clouds.clouds.size();
    const std::string text = "compared with the recording times, the time stamps of the clouds are " +
                             offset.describe("the time stamps of the poses");
    if (offset.is_clear && is_better) {
        choice.clock_note = text + ", so their clocks differ; the poses are shifted by this time";
        choice.path = std::move(corrected_path);
        choice.poses_zero_ns = corrected_zero_ns;
    } else {
        choice.clock_note =
            text + "; the clocks differ or messages are late; nothing is corrected, so check the poses";
    }
}

std::int64_t first_cloud_ns(const CloudTopic& clouds, LogClock clock) {
    std::int64_t first = clouds.clouds.front().time_ns(clock);
    for (const CloudEntry& cloud : clouds.clouds) first = std::min(first, cloud.time_ns(clock));
    return first;
}

/// Changes to the recording times if fewer than half of the clouds have a pose at their
/// stamp, and if more clouds then have one.
void try_recorder_clock(ChosenPoses& choice, const BagIndex& index, const CloudTopic& clouds,
                        const PoseSource& source) {
    if (choice.clock == LogClock::recorder) return;
    const std::size_t n_posed = count_posed(clouds, *choice.path, choice.clock, choice.zero_ns);
    if (2 * n_posed >= clouds.clouds.size()) return;
    const std::int64_t zero_ns = first_cloud_ns(clouds, LogClock::recorder);
    TransformChain path = make_pose_chain(index, source, LogClock::recorder, zero_ns);
    if (count_posed(clouds, path, LogClock::recorder, zero_ns) <= n_posed) return;
    choice.notes.push_back(
        fmt::format("the stamps of clouds and poses come from different clocks (only {} of {} clouds have a "
                    "pose at their stamp), so the recording times of messages are used",
                    n_posed, clouds.clouds.size()));
    choice.clock = LogClock::recorder;
    choice.zero_ns = choice.poses_zero_ns = zero_ns;
    choice.path = std::move(path);
}

/// The same places in the world frame of the log and in a plane that touches the earth.
struct PlacePairs {
    std::vector<glm::dvec3> world_m, plane_m;  // of the same length
    glm::dvec3 world_mean_m{0.0}, plane_mean_m{0.0};
};

/// Pairs the positions of the antenna by the vehicle's poses with its fixes. Leaves out
/// fixes outside the time of the poses.
/// @param earth  converts to the plane
PlacePairs pair_places(const FixTopic& fixes, const ChosenPoses& poses, const FrameTree& frames,
                       const GeoConverter& earth) {
    const Pose antenna = frames.find_constant(poses.vehicle, fixes.frame).value_or(Pose{});
    PlacePairs pairs;
    for (const FixTopic::Sample& fix : fixes.samples) {
        const double time_s = 1e-9 * double(fix.time_ns(poses.clock) - poses.poses_zero_ns);
        if (!poses.path->covers_time(time_s)) continue;
        pairs.world_m.push_back(poses.path->compute_pose_at(time_s) * antenna.translation);
        pairs.plane_m.push_back(earth.to_dataset(fix.position));
        pairs.world_mean_m += pairs.world_m.back();
        pairs.plane_mean_m += pairs.plane_m.back();
    }
    pairs.world_mean_m /= std::max(1.0, double(pairs.world_m.size()));
    pairs.plane_mean_m /= std::max(1.0, double(pairs.world_m.size()));
    return pairs;
}

/// Rotation about the vertical axis from the world to the plane.
struct FittedHeading {
    glm::dquat plane_from_world;
    double spread_m;    ///< horizontal standard deviation of the places
    double residual_m;  ///< root of the mean square of the horizontal error
};

/// Fits the heading, the angle h that minimises the sum of |p - exp(i h) w|^2. p in the
/// plane and w in the world are horizontal positions minus their mean, as complex
/// numbers. h is the angle of the sum of p * conj(w), whose parts are `dot` and `cross`.
FittedHeading fit_heading(const PlacePairs& pairs) {
    const std::size_t n = pairs.world_m.size();
    double cross = 0.0, dot = 0.0, spread = 0.0, residual = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        const glm::dvec2 w(pairs.world_m[i] - pairs.world_mean_m), p(pairs.plane_m[i] - pairs.plane_mean_m);
        cross += w.x * p.y - w.y * p.x;
        dot += glm::dot(w, p);
        spread += glm::dot(w, w);
    }
    const glm::dquat rotation = glm::angleAxis(std::atan2(cross, dot), glm::dvec3(0.0, 0.0, 1.0));
    for (std::size_t i = 0; i < n; ++i) {
        const glm::dvec2 error(pairs.plane_m[i] - pairs.plane_mean_m -
                               rotation * (pairs.world_m[i] - pairs.world_mean_m));
        residual += glm::dot(error, error);
    }
    const double divisor = std::max(1.0, double(n));
    return {rotation, std::sqrt(spread / divisor), std::sqrt(residual / divisor)};
}

}  // namespace

ChosenPoses choose_poses(const BagRecording& bag, const BagIndex& index, CloudTopic& main_lidar_clouds,
                         const std::string& requested_frame_or_topic) {
    ChosenPoses choice;
    const std::vector<std::string> frame_chain = index.frames.path_to_root(main_lidar_clouds.frame);
    std::optional<PoseSource> source =
        find_source(bag, index, frame_chain, requested_frame_or_topic, choice.notes);
    if (!source) source = select_source(bag, index, frame_chain, choice.notes);

    const std::vector<StampedPose>* poses = source ? find_samples(index, *source) : nullptr;
    const std::vector<MessageTimes> pose_times = poses ? list_times(*poses) : std::vector<MessageTimes>{};
    const bool has_stamps = !list_times(main_lidar_clouds.clouds).empty();
    if (!has_stamps || (poses && pose_times.empty())) {
        choice.clock = LogClock::recorder;
        choice.notes.push_back(
            fmt::format("the {} have no time stamps, so the times at which they were recorded are used",
                        has_stamps ? "poses" : "clouds"));
    }
    const std::string jumps_note = fix_clock_jumps(main_lidar_clouds.clouds, choice.clock, pose_times);
    if (!jumps_note.empty()) choice.notes.push_back(jumps_note);
    choice.zero_ns = choice.poses_zero_ns = first_cloud_ns(main_lidar_clouds, choice.clock);
    choice.vehicle = main_lidar_clouds.frame;
    if (!source) return choice;
    set_poses(choice, index, main_lidar_clouds, *source);
    choice.world = source->world;
    choice.vehicle = source->vehicle;
    choice.description = source->description;
    try_recorder_clock(choice, index, main_lidar_clouds, *source);
    return choice;
}

FoundPlace find_place(const FixTopic& fixes, const ChosenPoses& poses, const FrameTree& frames) {
    if (!has_proj())
        return {{}, "positions on the earth are not read, because relidar was built without PROJ"};
    const Georeference plane{
        fixes.samples.front().position, {}, local_tangent_crs(fixes.samples.front().position)};
    const GeoConverter earth(plane);
    const PlacePairs pairs = pair_places(fixes, poses, frames, earth);
    const FittedHeading heading = fit_heading(pairs);
    const bool is_clear =
        heading.spread_m >= kMinSpread_m && heading.residual_m <= kMaxResidualShare * heading.spread_m;
    if (!is_clear)
        return {{},
                fmt::format("the place on the earth is unknown: {} positions extend over {:.2f} m and are "
                            "{:.2f} m from the path",
                            pairs.world_m.size(), heading.spread_m, heading.residual_m)};
    return {Georeference{earth.to_geodetic(pairs.plane_mean_m), pairs.world_mean_m, plane.crs,
                         heading.plane_from_world},
            fmt::format("the place on the earth is that of {} positions, which are {:.2f} m from the path",
                        pairs.world_m.size(), heading.residual_m)};
}

}  // namespace relidar::bag
