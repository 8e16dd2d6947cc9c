// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <ranges>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/choose.hpp"
#include "read/scans/pose_conventions.hpp"

namespace relidar::bag {
namespace {

/// A possible source of vehicle poses: a pose topic, or a chain of transforms.
struct PoseSource {
    /// name of the frame in which the poses are given, for example "map"
    std::string world;
    const PoseTopic* topic = nullptr;  ///< pose topic; null if the poses come from the transforms in /tf
    std::string posed_frame;           ///< frame in /tf whose poses are given
    /// Frame of the vehicle. Differs from `posed_frame` if the mounting of the LiDAR is
    /// unknown. The poses then count for the LiDAR.
    std::string vehicle;
    std::string description;  ///< text for the user
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

/// Returns the transforms in /tf as source of the vehicle poses. The vehicle is the first
/// frame that moves, seen from the LiDAR. If none moves, it is the LiDAR itself.
/// @param frame_path_to_root  the frame of the LiDAR and all its ancestors
PoseSource make_tf_source(const FrameTree& frame_tree, const std::vector<std::string>& frame_path_to_root,
                          const std::string& ancestor_frame) {
    const auto moving_frame = find_moving_frame(frame_tree, frame_path_to_root, ancestor_frame);
    PoseSource source;
    source.world = ancestor_frame;
    source.vehicle = source.posed_frame = moving_frame.value_or(frame_path_to_root.front());
    source.description =
        fmt::format("poses of the frame '{}' in the frame '{}' are read from /tf (path {}){}", source.vehicle,
                    ancestor_frame, fmt::join(frame_path_to_root, " < "),
                    moving_frame ? "" : "; these poses are constant, so the LiDAR does not move");
    return source;
}

/// Returns the moving frame of /tf with a usual name of a vehicle. Otherwise returns the
/// lowest moving frame that carries all moving frames which do not carry it, such as
/// wheels.
std::optional<std::string> find_vehicle(const FrameTree& frame_tree) {
    const std::vector<std::string> moving = frame_tree.moving_frames();
    const auto named = std::ranges::find_if(moving, is_vehicle_frame);
    if (named != moving.end()) return *named;
    const auto is_below = [&](const std::string& frame, const std::string& ancestor) {
        const std::vector<std::string> chain = frame_tree.path_to_root(frame);
        return std::ranges::find(chain, ancestor) != chain.end();
    };
    std::optional<std::string> vehicle;
    for (const std::string& frame : moving) {
        const bool is_common = std::ranges::all_of(moving, [&](const std::string& other) {
            return is_below(other, frame) || is_below(frame, other);
        });
        if (is_common && (!vehicle || is_below(frame, *vehicle))) vehicle = frame;
    }
    return vehicle;
}

/// Returns a note that no transform connects a LiDAR with the frame of the poses.
std::string describe_missing_link(const std::string& lidar_frame, const std::string& posed_frame,
                                  const std::string& source_name) {
    return fmt::format(
        "no transform connects the frame '{}' of the LiDAR with the frame '{}' of the poses in {} (it is "
        "usually in /tf_static, in the first part of a split recording); the poses are used as poses of the "
        "LiDAR",
        quote(lidar_frame), quote(posed_frame), source_name);
}

/// Returns the frame of the vehicle in /tf and its ancestors if no transforms connect it
/// with the LiDAR. Otherwise returns an empty list.
std::vector<std::string> loose_chain(const FrameTree& frame_tree,
                                     const std::vector<std::string>& frame_path_to_root) {
    const std::optional<std::string> vehicle = find_vehicle(frame_tree);
    if (!vehicle) return {};
    std::vector<std::string> chain = frame_tree.path_to_root(*vehicle);
    return chain.back() == frame_path_to_root.back() ? std::vector<std::string>{} : chain;
}

/// Uses the poses in /tf of a frame that is not connected with the LiDAR as poses of the
/// LiDAR, with a note.
PoseSource make_loose_source(const FrameTree& frame_tree, const std::vector<std::string>& vehicle_chain,
                             const std::string& world, const std::string& lidar_frame,
                             std::vector<std::string>& notes) {
    PoseSource source = make_tf_source(frame_tree, vehicle_chain, world);
    notes.push_back(describe_missing_link(lidar_frame, source.posed_frame, "/tf"));
    source.vehicle = lidar_frame;
    return source;
}

/// Returns a pose topic as source of the vehicle poses. If the mounting of the LiDAR on
/// the vehicle is unknown, uses the poses as poses of the LiDAR, with a note.
PoseSource make_topic_source(const BagRecording& bag, const FrameTree& frame_tree,
                             const PoseTopic& pose_topic, const std::string& lidar_frame,
                             std::vector<std::string>& notes) {
    PoseSource source{.world = pose_topic.parent,
                      .topic = &pose_topic,
                      .posed_frame = {},
                      .vehicle = pose_topic.child.empty() ? "base_link" : pose_topic.child,
                      .description = {}};
    const std::string& name = bag.topics()[pose_topic.topic].name;
    if (!frame_tree.find_constant(source.vehicle, lidar_frame)) {
        notes.push_back(describe_missing_link(lidar_frame, source.vehicle, name));
        source.vehicle = lidar_frame;
    }
    source.description = fmt::format("poses of the frame '{}' in the frame '{}' are read from the topic {}",
                                     source.vehicle, pose_topic.parent, name);
    return source;
}

/// Returns the source that the user requests: a parent of the sensor, or a pose topic.
PoseSource find_source(const BagRecording& bag, const BagIndex& index,
                       const std::vector<std::string>& frame_path_to_root,
                       const std::string& requested_frame_or_topic, std::vector<std::string>& notes) {
    std::vector<std::string> available(frame_path_to_root.begin() + 1, frame_path_to_root.end());
    const auto is_available = [&] {
        return std::ranges::find(available, requested_frame_or_topic) != available.end();
    };
    if (is_available()) return make_tf_source(index.frames, frame_path_to_root, requested_frame_or_topic);
    if (const std::vector<std::string> chain = loose_chain(index.frames, frame_path_to_root);
        !chain.empty()) {
        available.insert(available.end(), chain.begin() + 1, chain.end());
        if (is_available())
            return make_loose_source(index.frames, chain, requested_frame_or_topic,
                                     frame_path_to_root.front(), notes);
    }
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

/// Returns the frame "map" if it is an ancestor, because it has no drift, or else the
/// outermost frame.
std::string select_world(const std::vector<std::string>& frame_path_to_root) {
    const bool has_map = std::ranges::find(frame_path_to_root, "map") != frame_path_to_root.end();
    return has_map ? "map" : frame_path_to_root.back();
}

/// Returns the pose topic of the first kind: odometry, poses, or paths. Paths are last,
/// because they can be plans. Returns null if no topic has two poses.
/// @throws UsageError if there are several of one kind and `must_be_one`
const PoseTopic* select_topic(const BagRecording& bag, const BagIndex& index, bool must_be_one) {
    const auto rank = [&](const PoseTopic& poses) {
        const std::string& type = bag.topics()[poses.topic].type;
        return type == "nav_msgs/Odometry" ? 0 : type == kPathType ? 2 : 1;
    };
    const PoseTopic* best = nullptr;
    std::vector<std::string> names;  // of the topics with the rank of `best`
    for (const PoseTopic& poses : index.poses) {
        if (poses.samples.size() < 2 || (best && rank(poses) > rank(*best))) continue;
        if (!best || rank(poses) < rank(*best)) {
            best = &poses;
            names.clear();
        }
        names.push_back(bag.topics()[poses.topic].name);
    }
    if (names.size() > 1 && must_be_one)
        fail<UsageError>(
            "the topics {} contain poses, expected one topic; select one with dataset.poses_from={}",
            fmt::join(names, ", "), names[0]);
    return best;
}

/// Selects a source automatically: moving transforms, then a pose topic, then constant
/// transforms to a world frame, then moving transforms that are not connected with the
/// LiDAR.
std::optional<PoseSource> select_source(const BagRecording& bag, const BagIndex& index,
                                        const std::vector<std::string>& frame_path_to_root, bool must_be_one,
                                        std::vector<std::string>& notes) {
    const std::string world = select_world(frame_path_to_root);
    if (find_moving_frame(index.frames, frame_path_to_root, world))
        return make_tf_source(index.frames, frame_path_to_root, world);

    if (const PoseTopic* topic = select_topic(bag, index, must_be_one))
        return make_topic_source(bag, index.frames, *topic, frame_path_to_root.front(), notes);
    if (is_world_frame(world) && frame_path_to_root.size() > 1)
        return make_tf_source(index.frames, frame_path_to_root, world);
    const std::vector<std::string> chain = loose_chain(index.frames, frame_path_to_root);
    if (chain.empty()) {
        const std::vector<std::string> moving = index.frames.moving_frames();
        if (!moving.empty() && !find_vehicle(index.frames))
            notes.push_back(
                fmt::format("the poses of the frames {} in /tf are not used, because no transform "
                            "connects one of them with the frame '{}' of the LiDAR",
                            fmt::join(moving, ", "), quote(frame_path_to_root.front())));
        return std::nullopt;
    }
    return make_loose_source(index.frames, chain, select_world(chain), frame_path_to_root.front(), notes);
}

/// Sets the poses of a source on the clock of the log.
/// @param poses_zero_ns  time of the poses at which the time of the log is 0 s
void set_path(ChosenPoses& choice, const BagIndex& index, const PoseSource& source,
              std::int64_t poses_zero_ns) {
    choice.poses_zero_ns = poses_zero_ns;
    if (source.topic)
        choice.path.emplace().append_samples(source.topic->samples, choice.clock, poses_zero_ns);
    else choice.path = index.frames.make_chain(source.world, source.posed_frame, choice.clock, poses_zero_ns);
    if (choice.is_inverse) choice.path->invert();
}

/// Returns the number of clouds at whose times the pose of the vehicle is known.
std::size_t count_posed(const CloudTopic& clouds, const ChosenPoses& choice) {
    return std::size_t(std::ranges::count_if(clouds.clouds, [&](const CloudEntry& cloud) {
        return choice.path->covers_time(1e-9 * double(cloud.time_ns(choice.clock) - choice.zero_ns));
    }));
}

/// Returns the samples of the poses. Returns null if the source does not move.
const std::vector<StampedPose>* find_samples(const BagIndex& index, const PoseSource& source) {
    return source.topic ? &source.topic->samples
                        : index.frames.densest_samples(source.world, source.posed_frame);
}

/// Shifts the poses in time if their stamps come from another clock than those of the
/// clouds. The offset must be certain, and more clouds must then have a pose. Otherwise
/// only warns of the offset.
/// @param known_s  offset that the user has set
void correct_pose_clock(ChosenPoses& choice, const BagIndex& index, const CloudTopic& clouds,
                        const PoseSource& source, std::optional<double> known_s) {
    const auto list = [&](const std::string& value, const char* from) {
        choice.conventions.push_back({"clock", value, from, "conventions.clock_offset_s"});
    };
    if (known_s) {
        set_path(choice, index, source, choice.zero_ns - std::llround(1e9 * *known_s));
        return list(read::describe_clock("clouds", *known_s), kFromSetting);
    }
    const std::vector<StampedPose>* poses = find_samples(index, source);
    if (choice.clock == LogClock::recorder || !poses) return;
    const ClockOffset offset = estimate_offset(list_times(clouds.clouds), list_times(*poses));
    if (offset.offset_ns == 0) return;
    ChosenPoses corrected = choice;
    // The clouds' clock is ahead by the offset, so the stamps of poses are smaller.
    set_path(corrected, index, source, choice.zero_ns - offset.offset_ns);
    const std::size_t n_posed = count_posed(clouds, choice), n_corrected = count_posed(clouds, corrected);
    // If poses are only late, the correction cannot give a pose to more clouds.
    constexpr std::size_t kMinExtraClouds = 2;
    const bool is_better = n_corrected > n_posed + kMinExtraClouds || n_corrected == clouds.clouds.size();
    const bool is_corrected = offset.is_clear && is_better;
    const std::string difference = offset.describe("the time stamps of the poses");
    if (is_corrected) {
        choice = std::move(corrected);
        return list("clouds " + difference, "guess: stamps and recording times");
    }
    choice.clock_note = fmt::format(
        "compared with the recording times, the time stamps of the clouds are {}; the clocks "
        "differ or messages are late; nothing is corrected; check the poses, or set "
        "conventions.clock_offset_s",
        difference);
}

std::int64_t first_cloud_ns(const CloudTopic& clouds, LogClock clock) {
    const auto time_ns = [&](const CloudEntry& cloud) { return cloud.time_ns(clock); };
    return std::ranges::min(clouds.clouds | std::views::transform(time_ns));
}

/// Changes to the recording times if fewer than half of the clouds have a pose at their
/// stamp, and if more clouds then have one.
void try_recorder_clock(ChosenPoses& choice, const BagIndex& index, const CloudTopic& clouds,
                        const PoseSource& source) {
    if (choice.clock == LogClock::recorder) return;
    const std::size_t n_posed = count_posed(clouds, choice);
    if (2 * n_posed >= clouds.clouds.size()) return;
    ChosenPoses recorded = choice;
    recorded.clock = LogClock::recorder;
    recorded.zero_ns = first_cloud_ns(clouds, LogClock::recorder);
    set_path(recorded, index, source, recorded.zero_ns);
    if (count_posed(clouds, recorded) <= n_posed) return;
    recorded.notes.push_back(
        fmt::format("the stamps of clouds and poses come from different clocks (only {} of {} clouds have a "
                    "pose at their stamp), so the recording times of messages are used",
                    n_posed, clouds.clouds.size()));
    choice = std::move(recorded);
}

/// Changes to the recording times, with a note, if the clouds or the poses have no time
/// stamps, because they can then only be compared by these.
void select_clock(ChosenPoses& choice, bool has_cloud_stamps, bool lacks_pose_stamps) {
    if (has_cloud_stamps && !lacks_pose_stamps) return;
    choice.clock = LogClock::recorder;
    choice.notes.push_back(
        fmt::format("the {} have no time stamps, so the times at which they were recorded are used",
                    has_cloud_stamps ? "poses" : "clouds"));
}

}  // namespace

ChosenPoses choose_poses(const BagRecording& bag, const BagIndex& index, CloudTopic& main_lidar_clouds,
                         const DatasetOptions& options) {
    const std::string& requested = options.bag.poses_from;
    ChosenPoses choice;
    const std::vector<std::string> frame_chain = index.frames.path_to_root(main_lidar_clouds.frame);
    std::optional<PoseSource> source;
    // Several topics of one kind are an error, unless a file has the poses.
    const bool must_be_one = options.poses_file.empty();
    if (requested.empty()) source = select_source(bag, index, frame_chain, must_be_one, choice.notes);
    else source = find_source(bag, index, frame_chain, requested, choice.notes);

    // Selects the clock, then corrects damaged times, because the first becomes 0 s.
    const std::vector<StampedPose>* poses = source ? find_samples(index, *source) : nullptr;
    const std::vector<MessageTimes> pose_times = poses ? list_times(*poses) : std::vector<MessageTimes>{};
    const bool has_cloud_stamps = !list_times(main_lidar_clouds.clouds).empty();
    select_clock(choice, has_cloud_stamps, /*lacks_pose_stamps=*/poses && pose_times.empty());
    const std::string jumps_note = fix_clock_jumps(main_lidar_clouds.clouds, choice.clock, pose_times);
    if (!jumps_note.empty()) choice.notes.push_back(jumps_note);

    choice.zero_ns = choice.poses_zero_ns = first_cloud_ns(main_lidar_clouds, choice.clock);
    choice.vehicle = main_lidar_clouds.frame;
    if (!source) return choice;
    choice.world = source->world;
    choice.vehicle = source->vehicle;
    choice.description = source->description;
    // Sets the poses on this clock. If theirs differs, shifts them or changes the clock.
    if (options.conventions.poses != Conventions::Poses::automatic && options.poses_file.empty()) {
        choice.is_inverse = options.conventions.poses == Conventions::Poses::sensor_from_world;
        choice.conventions.push_back({"poses", choice.is_inverse ? "sensor from world" : "world from sensor",
                                      kFromSetting, "conventions.poses"});
    }
    set_path(choice, index, *source, choice.zero_ns);
    if (options.poses_file.empty()) {
        const Conventions& set = options.conventions;
        const std::string& topic = source->topic ? bag.topics()[source->topic->topic].name : "/tf";
        choice.conventions.push_back(
            {"vehicle poses", fmt::format("'{}' in '{}', {}", source->vehicle, source->world, topic),
             requested.empty() ? "guess: the usual topics" : kFromSetting, "dataset.poses_from"});
        const bool is_wxyz = set.quaternions == Conventions::Quaternions::wxyz;
        if (source->topic)
            choice.conventions.push_back(
                {"quaternions", is_wxyz ? "w x y z" : "x y z w",
                 set.quaternions == Conventions::Quaternions::automatic ? read::kFromMessages : kFromSetting,
                 "conventions.quaternions"});
        correct_pose_clock(choice, index, main_lidar_clouds, *source, read::read_clock_offset_s(set));
    }
    if (!read::read_clock_offset_s(options.conventions))
        try_recorder_clock(choice, index, main_lidar_clouds, *source);
    return choice;
}

GeoreferenceFit find_place(const FixTopic& fixes, const ChosenPoses& poses, const FrameTree& frames) {
    if (!has_proj())
        return {{}, "positions on the earth are not read, because relidar was built without PROJ"};
    const Pose antenna = frames.find_constant(poses.vehicle, fixes.frame).value_or(Pose{});
    std::vector<glm::dvec3> antenna_m;
    std::vector<GeodeticPosition> positions;
    for (const FixTopic::Sample& fix : fixes.samples) {
        const double time_s = 1e-9 * double(fix.time_ns(poses.clock) - poses.poses_zero_ns);
        if (!poses.path->covers_time(time_s)) continue;
        antenna_m.push_back(poses.path->compute_pose_at(time_s) * antenna.translation);
        positions.push_back(fix.position);
    }
    return fit_georeference(antenna_m, positions);
}

}  // namespace relidar::bag
