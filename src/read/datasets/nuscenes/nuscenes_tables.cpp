// SPDX-License-Identifier: Apache-2.0
// Reads the tables of a dataset. Records refer to other records by tokens (ids). To find
// the LiDAR of a file, the reader uses the tables sample_data, calibrated_sensor and
// sensor.
#include "read/datasets/nuscenes/nuscenes_tables.hpp"

#include <algorithm>
#include <map>
#include <string_view>
#include <unordered_map>
#include <unordered_set>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/classes/dataset_classes.hpp"
#include "read/datasets/nuscenes/json_records.hpp"

namespace relidar::nuscenes {
namespace {

namespace fs = std::filesystem;
using Tokens = std::unordered_set<std::string>;
template <class T>
using TokenMap = std::unordered_map<std::string, T>;

constexpr std::string_view kLidarPrefix = "LIDAR_";  // prefix of LiDAR channels
constexpr std::string_view kCameraPrefix = "CAM_";
constexpr const char* kFirstChannel = "LIDAR_TOP";

/// Returns the times of a scene's keyframes in microseconds, by token (id). The dataset
/// calls a keyframe a sample. Only keyframes have labels.
TokenMap<std::int64_t> read_keyframes(const fs::path& table_folder, const std::string& scene_token) {
    TokenMap<std::int64_t> samples;
    for_each_record(table_folder / "sample.json", [&](const JsonRecord& record) {
        if (record.read_text("scene_token") == scene_token)
            samples[record.read_text("token")] = record.rounded_integer("timestamp");
    });
    return samples;
}

struct LidarMount {
    std::string channel;
    Pose ego_from_lidar;
};

/// Mountings by the token (id) of the calibration, to which the files refer.
struct SensorMounts {
    TokenMap<LidarMount> lidars;
    TokenMap<Camera> cameras;  ///< rows and columns are 0
};

/// Returns the channel (table sensor) and the pose (table calibrated_sensor) of each
/// LiDAR, and the cameras.
SensorMounts read_mounts(const fs::path& table_folder) {
    TokenMap<std::string> channels;
    bool has_lidar = false;
    for_each_record(table_folder / "sensor.json", [&](const JsonRecord& record) {
        const std::string channel = record.read_text("channel");
        has_lidar = has_lidar || channel.starts_with(kLidarPrefix);
        if (channel.starts_with(kLidarPrefix) || channel.starts_with(kCameraPrefix))
            channels[record.read_text("token")] = channel;
    });
    if (!has_lidar)
        fail("{}, key 'channel': found no channel that begins with {}, expected at least one LiDAR",
             (table_folder / "sensor.json").string(), kLidarPrefix);
    SensorMounts mounted;
    for_each_record(table_folder / "calibrated_sensor.json", [&](const JsonRecord& record) {
        const auto channel = channels.find(record.read_text("sensor_token"));
        if (channel == channels.end()) return;
        const std::string token = record.read_text("token");
        if (channel->second.starts_with(kLidarPrefix))
            mounted.lidars[token] = {channel->second, record.read_pose()};
        else if (const auto k = record.matrix_or_empty("camera_intrinsic");
                 !k.empty() && k[0] > 0.0 && k[4] > 0.0)
            mounted.cameras[token] = {channel->second, k[0], k[4], k[2], k[5], 0, 0, record.read_pose()};
    });
    return mounted;
}

using SweepsByChannel = std::map<std::string, TokenMap<SweepRecord>>;  // files by channel name, then by token

/// Returns the LiDAR files of a scene, by channel (name of the LiDAR). A file belongs to
/// the scene if the keyframe that it refers to does.
/// Also sets the sizes of the pictures of cameras in the scene.
/// @param keyframe_times_us  keyframes of the scene, by token
SweepsByChannel list_lidar_files(const fs::path& table_folder,
                                 const TokenMap<std::int64_t>& keyframe_times_us, SensorMounts& mounted) {
    SweepsByChannel files;
    for_each_record(table_folder / "sample_data.json", [&](const JsonRecord& record) {
        SweepRecord file;
        file.calibration = record.read_text("calibrated_sensor_token");
        // The table also lists files of radars and other scenes.
        const auto lidar = mounted.lidars.find(file.calibration);
        const auto camera = mounted.cameras.find(file.calibration);
        if (lidar == mounted.lidars.end() && camera == mounted.cameras.end()) return;
        file.sample = record.read_text("sample_token");
        if (!keyframe_times_us.contains(file.sample)) return;
        if (camera != mounted.cameras.end()) {
            constexpr std::int64_t kMaxSide_px = 16384;
            camera->second.columns =
                int(std::clamp<std::int64_t>(record.rounded_integer("width"), 0, kMaxSide_px));
            camera->second.rows =
                int(std::clamp<std::int64_t>(record.rounded_integer("height"), 0, kMaxSide_px));
            return;
        }
        file.token = record.read_text("token");
        file.next = record.read_text("next");
        file.ego_pose = record.read_text("ego_pose_token");
        file.file = record.read_text("filename");
        file.time_us = record.rounded_integer("timestamp");
        file.is_keyframe = record.boolean("is_key_frame");
        files[lidar->second.channel][file.token] = file;
    });
    return files;
}

/// Sorts the files of a LiDAR by time. Starts at its first keyframe and follows the key
/// "next" of each record. Leaves out earlier files, which can belong to another scene.
/// @param files  files by token (id)
/// @return empty without a keyframe
std::vector<SweepRecord> sort_sweeps(const fs::path& table_folder, const TokenMap<SweepRecord>& files) {
    const std::string where = (table_folder / "sample_data.json").string();
    const SweepRecord* first = nullptr;
    for (const auto& [name, file] : files)
        if (file.is_keyframe && (!first || file.time_us < first->time_us)) first = &file;
    std::vector<SweepRecord> sweeps;
    for (std::string token = first ? first->token : ""; !token.empty(); token = sweeps.back().next) {
        const auto file = files.find(token);
        const bool is_cycle = sweeps.size() == files.size();
        if (file == files.end() || is_cycle)
            fail(
                "{}, key 'next': found '{}' after {} files of a LiDAR, expected the token of the LiDAR's "
                "next file in the scene, or an empty text after the last file",
                where, quote(token), sweeps.size());
        sweeps.push_back(file->second);
    }
    return sweeps;
}

/// Reads the LiDARs with at least one keyframe in the scene, and its cameras. LIDAR_TOP
/// is first. The pose on the vehicle is that of the first sweep.
void read_scene_sensors(const fs::path& folder, const TokenMap<std::int64_t>& times_us, SceneTables& scene) {
    SensorMounts mounted = read_mounts(folder);
    std::vector<SceneLidar>& lidars = scene.lidars;
    for (const auto& [channel, files] : list_lidar_files(folder, times_us, mounted)) {
        SceneLidar lidar{.channel = channel, .ego_from_lidar = {}, .sweeps = sort_sweeps(folder, files)};
        if (lidar.sweeps.empty()) continue;
        lidar.ego_from_lidar = mounted.lidars.at(lidar.sweeps[0].calibration).ego_from_lidar;
        lidars.push_back(std::move(lidar));
    }
    if (lidars.empty())
        fail("{}: found no LiDAR file of the scene with \"is_key_frame\": true, expected at least one",
             (folder / "sample_data.json").string());
    std::stable_partition(lidars.begin(), lidars.end(),
                          [](const SceneLidar& lidar) { return lidar.channel == kFirstChannel; });
    for (const auto& [token, camera] : mounted.cameras)
        if (camera.columns > 0 && camera.rows > 0) scene.cameras.push_back(camera);
    std::ranges::sort(scene.cameras, {}, &Camera::name);
}

/// Reads the poses that the sweeps refer to, by time.
std::map<std::int64_t, Pose> read_sweep_poses(const fs::path& pose_file,
                                              const std::vector<SweepRecord>& sweeps) {
    Tokens missing;
    for (const SweepRecord& sweep : sweeps) missing.insert(sweep.ego_pose);
    std::map<std::int64_t, Pose> poses;
    for_each_record(pose_file, [&](const JsonRecord& record) {
        if (missing.erase(record.read_text("token")) > 0)
            poses[record.rounded_integer("timestamp")] = record.read_pose();
    });
    for (const SweepRecord& sweep : sweeps)
        if (missing.contains(sweep.ego_pose))
            fail("{}, key 'token': the pose '{}' is missing, but the file {} refers to it",
                 pose_file.string(), quote(sweep.ego_pose), quote(sweep.file));
    return poses;
}

/// Returns the vehicle poses at the times of the sweeps. Interpolates, because a sweep of
/// TruckScenes refers to the nearest stored pose, which has another time.
std::vector<Pose> read_ego_poses(const fs::path& table_folder, const std::vector<SweepRecord>& sweeps) {
    const auto seconds = [&](std::int64_t time_us) { return double(time_us - sweeps[0].time_us) * 1e-6; };
    PoseTrack track;
    for (const auto& [time_us, pose] : read_sweep_poses(table_folder / "ego_pose.json", sweeps))
        track.append(seconds(time_us), pose);
    std::vector<Pose> world_from_ego;
    for (const SweepRecord& sweep : sweeps) world_from_ego.push_back(track.pose_at(seconds(sweep.time_us)));
    return world_from_ego;
}

/// Reads one text of each record in a table. Returns the texts by the token (id) of the
/// record.
/// @param tokens  tokens of the records to read, or null for all records
TokenMap<std::string> read_text_column(const fs::path& table_file, const char* key, const Tokens* tokens) {
    TokenMap<std::string> values;
    for_each_record(table_file, [&](const JsonRecord& record) {
        const std::string token = record.read_text("token");
        if (!tokens || tokens->contains(token)) values[token] = record.read_text(key);
    });
    return values;
}

/// Sets the category names of labels, whose ids are tokens of instances (objects). An
/// instance refers to a category, and the category has a name.
void set_categories(const fs::path& table_folder, std::vector<BoxLabel>& labels) {
    Tokens instances;
    for (const BoxLabel& label : labels) instances.insert(label.id);
    const TokenMap<std::string> category_of =
        read_text_column(table_folder / "instance.json", "category_token", &instances);
    const TokenMap<std::string> names = read_text_column(table_folder / "category.json", "name", nullptr);
    for (BoxLabel& label : labels) {
        const auto category = category_of.find(label.id);
        const auto name = category == category_of.end() ? names.end() : names.find(category->second);
        if (name == names.end())
            fail("{}: the instance '{}' has no category, expected one in category.json",
                 (table_folder / "instance.json").string(), quote(label.id));
        label.category = name->second;
    }
}

/// Reads the box labels of a scene, sorted by time. Scenes of test splits have no label
/// table, so they have no labels.
/// @param keyframe_times_us  keyframes of the scene, by token (id)
std::vector<BoxLabel> read_scene_labels(const fs::path& table_folder, const SceneTables& scene,
                                        const TokenMap<std::int64_t>& keyframe_times_us) {
    std::vector<BoxLabel> labels;
    const fs::path file = table_folder / "sample_annotation.json";
    if (!does_path_exist(file)) return labels;
    for_each_record(file, [&](const JsonRecord& record) {
        const auto keyframe = keyframe_times_us.find(record.read_text("sample_token"));
        if (keyframe == keyframe_times_us.end()) return;
        const glm::dvec3 width_length_height = record.vec3("size");
        BoxLabel label;
        label.id = record.read_text("instance_token");
        label.size_m = {width_length_height.y, width_length_height.x, width_length_height.z};
        label.time_s = scene.seconds_at(keyframe->second);
        label.world_from_box = record.read_pose();
        labels.push_back(std::move(label));
    });
    set_categories(table_folder, labels);
    std::ranges::stable_sort(labels, {}, &BoxLabel::time_s);
    return labels;
}

/// Sets the class of each category, by the index that files of point categories contain.
void read_category_classes(const fs::path& table_folder, SceneTables& scene) {
    const fs::path file = table_folder / "category.json";
    for_each_record(file, [&](const JsonRecord& record) {
        const std::int64_t index = record.rounded_integer("index");
        if (index < 0 || index >= std::int64_t(scene.classes.size()))
            fail("{}, key 'index': found {} for the category '{}', expected 0 to {}", file.string(), index,
                 quote(record.read_text("name")), scene.classes.size() - 1);
        scene.classes[std::size_t(index)] = from_nuscenes(record.read_text("name"));
    });
}

/// Reads which files contain the categories of points, and the class of each category.
/// Does nothing without the table lidarseg, which is a separate download.
void read_lidarseg(const fs::path& table_folder, SceneTables& scene) {
    const fs::path file = table_folder / "lidarseg.json";
    if (!does_path_exist(file)) return;
    TokenMap<SweepRecord*> sweeps;
    for (SceneLidar& lidar : scene.lidars)
        for (SweepRecord& sweep : lidar.sweeps) sweeps[sweep.token] = &sweep;
    bool has_files = false;
    for_each_record(file, [&](const JsonRecord& record) {
        const auto sweep = sweeps.find(record.read_text("sample_data_token"));
        if (sweep == sweeps.end()) return;
        sweep->second->categories_file = record.read_text("filename");
        has_files = true;
    });
    if (has_files) read_category_classes(table_folder, scene);
}

}  // namespace

std::vector<std::string> list_scenes(const fs::path& table_folder) {
    std::vector<std::string> names;
    for_each_record(table_folder / "scene.json",
                    [&](const JsonRecord& record) { names.push_back(record.read_text("name")); });
    return names;
}

SceneTables read_scene(const fs::path& table_folder, const std::string& scene_name) {
    SceneTables scene;
    scene.name = scene_name;
    std::string scene_token, log_token;
    for_each_record(table_folder / "scene.json", [&](const JsonRecord& record) {
        if (record.read_text("name") != scene_name) return;
        scene_token = record.read_text("token");
        log_token = record.text_or_empty("log_token");
    });
    if (!log_token.empty() && does_path_exist(table_folder / "log.json"))
        for_each_record(table_folder / "log.json", [&](const JsonRecord& record) {
            if (record.text_or_empty("token") == log_token) scene.location = record.text_or_empty("location");
        });
    // The keyframes select the LiDAR files and labels that belong to the scene.
    const TokenMap<std::int64_t> samples = read_keyframes(table_folder, scene_token);
    read_scene_sensors(table_folder, samples, scene);
    scene.world_from_ego = read_ego_poses(table_folder, scene.lidars[0].sweeps);
    scene.labels = read_scene_labels(table_folder, scene, samples);
    read_lidarseg(table_folder, scene);
    return scene;
}

}  // namespace relidar::nuscenes
