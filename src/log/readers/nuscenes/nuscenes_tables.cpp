// SPDX-License-Identifier: Apache-2.0
// Reads the tables of a dataset. Records refer to other records by tokens. To find the
// channel of a file, the reader uses the tables sample_data, calibrated_sensor and
// sensor.
#include "log/readers/nuscenes/nuscenes_tables.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <string_view>
#include <unordered_map>
#include <unordered_set>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "base/files.hpp"
#include "log/classes/dataset_classes.hpp"
#include "log/readers/nuscenes/json_records.hpp"

namespace relidar::nuscenes {
namespace {

namespace fs = std::filesystem;
using Tokens = std::unordered_set<std::string>;
template <class T>
using ByToken = std::unordered_map<std::string, T>;

constexpr std::string_view kLidar = "LIDAR_";  // prefix of LiDAR channels
constexpr const char* kFirstChannel = "LIDAR_TOP";
// maximum time difference between a sweep and the vehicle pose to which it refers
constexpr double kFarthestPose_s = 0.1;

std::string find_scene(const fs::path& tables, const std::string& name) {
    std::string found;
    for_each_record(tables / "scene.json", [&](const JsonRecord& record) {
        if (record.text("name") == name) found = record.text("token");
    });
    return found;
}

/// Returns the times of the samples (keyframes) of the scene in microseconds.
ByToken<std::int64_t> read_samples(const fs::path& tables, const std::string& scene) {
    ByToken<std::int64_t> samples;
    for_each_record(tables / "sample.json", [&](const JsonRecord& record) {
        if (record.text("scene_token") == scene) samples[record.text("token")] = record.rounded("timestamp");
    });
    return samples;
}

/// Channel name of a LiDAR, and its pose on the vehicle.
struct Mounted {
    std::string channel;
    Pose ego_from_lidar;
};

/// Returns all LiDARs by the token of their calibration.
ByToken<Mounted> read_calibrations(const fs::path& tables) {
    ByToken<std::string> channels;
    for_each_record(tables / "sensor.json", [&](const JsonRecord& record) {
        const std::string channel = record.text("channel");
        if (channel.starts_with(kLidar)) channels[record.text("token")] = channel;
    });
    if (channels.empty())
        throw DataError(fmt::format("{}, key 'channel': no channel begins with {}",
                                    (tables / "sensor.json").string(), kLidar));
    ByToken<Mounted> mounted;
    for_each_record(tables / "calibrated_sensor.json", [&](const JsonRecord& record) {
        const auto channel = channels.find(record.text("sensor_token"));
        if (channel != channels.end()) mounted[record.text("token")] = {channel->second, record.pose()};
    });
    return mounted;
}

using Channels = std::map<std::string, ByToken<SweepRecord>>;  // files by channel name, then by token

/// Returns the LiDAR files of a scene, by channel.
Channels list_lidar_files(const fs::path& tables, const ByToken<std::int64_t>& samples,
                          const ByToken<Mounted>& mounted) {
    Channels files;
    for_each_record(tables / "sample_data.json", [&](const JsonRecord& record) {
        SweepRecord file;
        file.calibration = record.text("calibrated_sensor_token");
        const auto lidar = mounted.find(file.calibration);
        if (lidar == mounted.end()) return;
        file.sample = record.text("sample_token");
        if (!samples.contains(file.sample)) return;
        file.token = record.text("token"), file.next = record.text("next");
        file.ego_pose = record.text("ego_pose_token"), file.file = record.text("filename");
        file.time_us = record.rounded("timestamp");
        file.is_keyframe = record.boolean("is_key_frame");
        files[lidar->second.channel][file.token] = file;
    });
    return files;
}

/// Sorts the files of a LiDAR channel by time, starting with its first keyframe.
/// @return an empty list if the channel has no keyframe
std::vector<SweepRecord> sort_sweeps(const fs::path& tables, const ByToken<SweepRecord>& files) {
    const std::string where = (tables / "sample_data.json").string();
    const SweepRecord* first = nullptr;
    for (const auto& [name, file] : files)
        if (file.is_keyframe && (!first || file.time_us < first->time_us)) first = &file;
    std::vector<SweepRecord> sweeps;
    for (std::string token = first ? first->token : ""; !token.empty(); token = sweeps.back().next) {
        const auto file = files.find(token);
        if (file == files.end() || sweeps.size() == files.size())
            throw DataError(fmt::format(
                "{}, key 'next': found '{}' after {} files, expected the token of the next file of the "
                "scene or an empty text",
                where, make_excerpt(token), sweeps.size()));
        if (!sweeps.empty() && file->second.time_us <= sweeps.back().time_us)
            throw DataError(fmt::format("{}, key 'timestamp': found {} after {}, expected increasing times",
                                        where, file->second.time_us, sweeps.back().time_us));
        sweeps.push_back(file->second);
    }
    return sweeps;
}

/// Returns the LiDARs with at least one keyframe in the scene.
std::vector<SceneLidar> read_lidars(const fs::path& tables, const ByToken<std::int64_t>& samples) {
    const ByToken<Mounted> mounted = read_calibrations(tables);
    std::vector<SceneLidar> lidars;
    for (const auto& [channel, files] : list_lidar_files(tables, samples, mounted)) {
        SceneLidar lidar{channel, {}, sort_sweeps(tables, files)};
        if (lidar.sweeps.empty()) continue;
        lidar.ego_from_lidar = mounted.at(lidar.sweeps[0].calibration).ego_from_lidar;
        for (const SweepRecord& sweep : lidar.sweeps)
            if (sweep.calibration != lidar.sweeps[0].calibration)
                throw DataError(
                    fmt::format("{}, key 'calibrated_sensor_token': {} of {} has two mountings in one scene, "
                                "expected one",
                                (tables / "sample_data.json").string(), channel, make_excerpt(sweep.file)));
        lidars.push_back(std::move(lidar));
    }
    if (lidars.empty())
        throw DataError(
            fmt::format("{}: the scene has no keyframe of a LiDAR", (tables / "sample_data.json").string()));
    std::stable_partition(lidars.begin(), lidars.end(),
                          [](const SceneLidar& lidar) { return lidar.channel == kFirstChannel; });
    return lidars;
}

/// Returns the vehicle poses at the times of the sweeps. Interpolates, because sweeps of
/// TruckScenes refer only to the nearest pose.
std::vector<Pose> read_poses(const fs::path& tables, const std::vector<SweepRecord>& sweeps) {
    const fs::path file = tables / "ego_pose.json";
    struct TimedPose {
        std::int64_t time_us = 0;
        Pose pose;
    };
    ByToken<TimedPose> poses;
    for (const SweepRecord& sweep : sweeps) poses[sweep.ego_pose];
    Tokens missing;
    for (const auto& [token, pose] : poses) missing.insert(token);
    for_each_record(file, [&](const JsonRecord& record) {
        const std::string token = record.text("token");
        if (missing.erase(token) > 0) poses[token] = {record.rounded("timestamp"), record.pose()};
    });
    std::map<std::int64_t, Pose> by_time;
    for (const SweepRecord& sweep : sweeps) {
        if (missing.contains(sweep.ego_pose))
            throw DataError(fmt::format("{}, key 'token': '{}' is missing, which is the pose of {}",
                                        file.string(), make_excerpt(sweep.ego_pose),
                                        make_excerpt(sweep.file)));
        const TimedPose& pose = poses[sweep.ego_pose];
        if (const double apart_s = double(pose.time_us - sweep.time_us) * 1e-6;
            !(std::abs(apart_s) <= kFarthestPose_s))
            throw DataError(fmt::format(
                "{}, key 'timestamp': the pose '{}' is {} s away from its file {}, expected at most {} s",
                file.string(), make_excerpt(sweep.ego_pose), apart_s, make_excerpt(sweep.file),
                kFarthestPose_s));
        by_time[pose.time_us] = pose.pose;
    }
    const auto seconds = [&](std::int64_t time_us) { return double(time_us - sweeps[0].time_us) * 1e-6; };
    PoseTrack track;
    for (const auto& [time_us, pose] : by_time)
        track.time_s.push_back(seconds(time_us)), track.pose.push_back(pose);
    std::vector<Pose> world_from_ego;
    for (const SweepRecord& sweep : sweeps) world_from_ego.push_back(track.at(seconds(sweep.time_us)));
    return world_from_ego;
}

/// Reads one text value of each record in a table. Returns the values by the token (id)
/// of the record.
/// @param tokens  tokens of the records to read, or null for all records
ByToken<std::string> read_column(const fs::path& file, const char* key, const Tokens* tokens) {
    ByToken<std::string> values;
    for_each_record(file, [&](const JsonRecord& record) {
        const std::string token = record.text("token");
        if (!tokens || tokens->contains(token)) values[token] = record.text(key);
    });
    return values;
}

/// Reads the box labels of a scene. Test splits have no label table, so their scenes have
/// no labels.
std::vector<BoxLabel> read_labels(const fs::path& tables, const SceneTables& scene,
                                  const ByToken<std::int64_t>& samples) {
    std::vector<BoxLabel> labels;
    Tokens instances;
    const fs::path file = tables / "sample_annotation.json";
    if (!does_path_exist(file)) return labels;
    for_each_record(file, [&](const JsonRecord& record) {
        const auto sample = samples.find(record.text("sample_token"));
        if (sample == samples.end()) return;
        const glm::dvec3 size = record.vector("size");  // width, length, height
        if (!(std::min({size.x, size.y, size.z}) > 0.0))
            throw DataError(fmt::format("{}, key 'size': found {} x {} x {}, expected all above 0",
                                        file.string(), size.x, size.y, size.z));
        labels.push_back({record.text("instance_token"),
                          "",
                          {size.y, size.x, size.z},
                          scene.seconds(sample->second),
                          record.pose()});
        instances.insert(labels.back().id);
    });
    const ByToken<std::string> category_of =
        read_column(tables / "instance.json", "category_token", &instances);
    const ByToken<std::string> names = read_column(tables / "category.json", "name", nullptr);
    for (BoxLabel& label : labels) {
        const auto category = category_of.find(label.id);
        const auto name = category == category_of.end() ? names.end() : names.find(category->second);
        if (name == names.end())
            throw DataError(fmt::format("{}: the instance '{}' has no category",
                                        (tables / "instance.json").string(), make_excerpt(label.id)));
        label.category = name->second;
    }
    std::stable_sort(labels.begin(), labels.end(), [](const BoxLabel& first, const BoxLabel& second) {
        return first.time_s < second.time_s;
    });
    return labels;
}

/// Reads which files contain the categories of points, and the class of each category.
/// Does nothing if the table lidarseg is missing, because it is a separate download.
void read_lidarseg(const fs::path& tables, SceneTables& scene) {
    const fs::path file = tables / "lidarseg.json";
    if (!does_path_exist(file)) return;
    ByToken<SweepRecord*> sweeps;
    for (SceneLidar& lidar : scene.lidars)
        for (SweepRecord& sweep : lidar.sweeps) sweeps[sweep.token] = &sweep;
    bool has_files = false;
    for_each_record(file, [&](const JsonRecord& record) {
        const auto sweep = sweeps.find(record.text("sample_data_token"));
        if (sweep == sweeps.end()) return;
        sweep->second->categories_file = record.text("filename");
        has_files = true;
    });
    if (!has_files) return;
    const fs::path categories = tables / "category.json";
    for_each_record(categories, [&](const JsonRecord& record) {
        const std::int64_t index = record.rounded("index");
        if (index < 0 || index >= std::int64_t(scene.classes.size()))
            throw DataError(fmt::format("{}, key 'index': found {} for '{}', expected 0 to {}",
                                        categories.string(), index, make_excerpt(record.text("name")),
                                        scene.classes.size() - 1));
        scene.classes[std::size_t(index)] = convert_nuscenes_class(record.text("name"));
    });
}

}  // namespace

std::vector<std::string> list_scenes(const fs::path& tables) {
    std::vector<std::string> names;
    for_each_record(tables / "scene.json",
                    [&](const JsonRecord& record) { names.push_back(record.text("name")); });
    return names;
}

SceneTables read_scene(const fs::path& tables, const std::string& name) {
    SceneTables scene;
    scene.name = name;
    const ByToken<std::int64_t> samples = read_samples(tables, find_scene(tables, name));
    scene.lidars = read_lidars(tables, samples);
    scene.world_from_ego = read_poses(tables, scene.lidars[0].sweeps);
    scene.labels = read_labels(tables, scene, samples);
    read_lidarseg(tables, scene);
    return scene;
}

}  // namespace relidar::nuscenes
