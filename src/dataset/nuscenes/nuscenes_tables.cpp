// SPDX-License-Identifier: Apache-2.0
// Records refer to each other by tokens. The channel of a file stands two tables away: sample_data, calibrated_sensor, sensor.
#include "dataset/nuscenes/nuscenes_tables.hpp"

#include <algorithm>
#include <unordered_map>
#include <unordered_set>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include "core/files.hpp"
#include "dataset/nuscenes/json_records.hpp"

namespace relidar::nuscenes {
namespace {

namespace fs = std::filesystem;
using Tokens = std::unordered_set<std::string>;
template <class T>
using ByToken = std::unordered_map<std::string, T>;

constexpr const char* kChannel = "LIDAR_TOP";

struct SceneRecord {
    std::string token, first_sample;
};
SceneRecord find_scene(const fs::path& tables, const std::string& name) {
    SceneRecord found;
    for_each_record(tables / "scene.json", [&](const JsonRecord& record) {
        if (record.text("name") == name) found = {record.text("token"), record.text("first_sample_token")};
    });
    return found;
}

Tokens samples_of(const fs::path& tables, const std::string& scene) {
    Tokens samples;
    for_each_record(tables / "sample.json", [&](const JsonRecord& record) {
        if (record.text("scene_token") == scene) samples.insert(record.text("token"));
    });
    return samples;
}

/// Where LIDAR_TOP is mounted, by token of the calibration.
ByToken<Pose> calibrations(const fs::path& tables) {
    std::string sensor;
    for_each_record(tables / "sensor.json", [&](const JsonRecord& record) {
        if (record.text("channel") == kChannel) sensor = record.text("token");
    });
    if (sensor.empty()) throw DataError(fmt::format("{}, key 'channel': no {}", (tables / "sensor.json").string(), kChannel));
    ByToken<Pose> mounted;
    for_each_record(tables / "calibrated_sensor.json", [&](const JsonRecord& record) {
        if (record.text("sensor_token") == sensor) mounted[record.text("token")] = record.pose();
    });
    return mounted;
}

/// Files of the LiDAR in a scene, by token.
ByToken<SweepRecord> files_of(const fs::path& tables, const Tokens& samples, const ByToken<Pose>& mounted) {
    ByToken<SweepRecord> files;
    for_each_record(tables / "sample_data.json", [&](const JsonRecord& record) {
        SweepRecord file;
        file.calibration = record.text("calibrated_sensor_token");
        if (!mounted.contains(file.calibration)) return;
        file.sample = record.text("sample_token");
        if (!samples.contains(file.sample)) return;
        file.token = record.text("token"), file.next = record.text("next");
        file.ego_pose = record.text("ego_pose_token"), file.file = record.text("filename");
        file.time_us = record.integer("timestamp");
        file.is_keyframe = record.boolean("is_key_frame");
        files[file.token] = file;
    });
    return files;
}

/// The chain of files from the keyframe of the scene's first sample.
std::vector<SweepRecord> in_order(const fs::path& tables, const ByToken<SweepRecord>& files, const std::string& first_sample) {
    const std::string where = (tables / "sample_data.json").string();
    std::string token;
    for (const auto& [name, file] : files)
        if (file.sample == first_sample && file.is_keyframe) token = name;
    if (token.empty()) throw DataError(fmt::format("{}: no keyframe of {} in the scene's first sample", where, kChannel));
    std::vector<SweepRecord> sweeps;
    while (!token.empty()) {
        const auto file = files.find(token);
        if (file == files.end() || sweeps.size() == files.size())
            throw DataError(fmt::format("{}, key 'next': '{}' after {} files, expected the next file of the scene or an empty text", where,
                                        excerpt(token), sweeps.size()));
        if (!sweeps.empty() && file->second.time_us <= sweeps.back().time_us)
            throw DataError(fmt::format("{}, key 'timestamp': {} after {}, expected times that rise", where, file->second.time_us,
                                        sweeps.back().time_us));
        sweeps.push_back(file->second);
        token = file->second.next;
    }
    return sweeps;
}

void read_poses(const fs::path& tables, std::vector<SweepRecord>& sweeps) {
    Tokens wanted;
    for (const SweepRecord& sweep : sweeps) wanted.insert(sweep.ego_pose);
    ByToken<Pose> poses;
    for_each_record(tables / "ego_pose.json", [&](const JsonRecord& record) {
        const std::string token = record.text("token");
        if (wanted.contains(token)) poses[token] = record.pose();
    });
    for (SweepRecord& sweep : sweeps) {
        const auto pose = poses.find(sweep.ego_pose);
        if (pose == poses.end())
            throw DataError(fmt::format("{}, key 'token': no '{}', the pose of {}", (tables / "ego_pose.json").string(),
                                        excerpt(sweep.ego_pose), excerpt(sweep.file)));
        sweep.world_from_ego = pose->second;
    }
}

/// Token of a record to the text of one of its keys, for the tokens that are asked for; all where none are.
ByToken<std::string> column(const fs::path& file, const char* key, const Tokens* wanted) {
    ByToken<std::string> values;
    for_each_record(file, [&](const JsonRecord& record) {
        const std::string token = record.text("token");
        if (!wanted || wanted->contains(token)) values[token] = record.text(key);
    });
    return values;
}

std::vector<BoxLabel> read_labels(const fs::path& tables, const std::vector<SweepRecord>& sweeps) {
    ByToken<double> time_of_sample;
    for (const SweepRecord& sweep : sweeps)
        if (sweep.is_keyframe) time_of_sample[sweep.sample] = double(sweep.time_us - sweeps[0].time_us) * 1e-6;
    std::vector<BoxLabel> labels;
    Tokens instances;
    const fs::path file = tables / "sample_annotation.json";
    for_each_record(file, [&](const JsonRecord& record) {
        const auto sample = time_of_sample.find(record.text("sample_token"));
        if (sample == time_of_sample.end()) return;
        const glm::dvec3 size = record.vector("size");  // width, length, height
        if (!(std::min({size.x, size.y, size.z}) > 0.0))
            throw DataError(fmt::format("{}, key 'size': {} x {} x {}, expected all above 0", file.string(), size.x, size.y, size.z));
        labels.push_back({record.text("instance_token"), "", {size.y, size.x, size.z}, sample->second, record.pose()});
        instances.insert(labels.back().id);
    });
    const ByToken<std::string> category_of = column(tables / "instance.json", "category_token", &instances);
    const ByToken<std::string> names = column(tables / "category.json", "name", nullptr);
    for (BoxLabel& label : labels) {
        const auto category = category_of.find(label.id);
        const auto name = category == category_of.end() ? names.end() : names.find(category->second);
        if (name == names.end())
            throw DataError(fmt::format("{}: no category of instance '{}'", (tables / "instance.json").string(), excerpt(label.id)));
        label.category = name->second;
    }
    std::stable_sort(labels.begin(), labels.end(), [](const BoxLabel& a, const BoxLabel& b) { return a.time_s < b.time_s; });
    return labels;
}

}  // namespace

std::vector<std::string> list_scenes(const fs::path& tables) {
    std::vector<std::string> names;
    for_each_record(tables / "scene.json", [&](const JsonRecord& record) { names.push_back(record.text("name")); });
    return names;
}

SceneTables read_scene(const fs::path& tables, const std::string& name) {
    SceneTables scene;
    scene.name = name;
    const SceneRecord record = find_scene(tables, name);
    const ByToken<Pose> mounted = calibrations(tables);
    scene.sweeps = in_order(tables, files_of(tables, samples_of(tables, record.token), mounted), record.first_sample);
    scene.ego_from_lidar = mounted.at(scene.sweeps[0].calibration);
    for (const SweepRecord& sweep : scene.sweeps)
        if (sweep.calibration != scene.sweeps[0].calibration)
            throw DataError(fmt::format("{}, key 'calibrated_sensor_token': {} of {} is mounted twice in a scene, expected once",
                                        (tables / "sample_data.json").string(), kChannel, excerpt(sweep.file)));
    read_poses(tables, scene.sweeps);
    scene.labels = read_labels(tables, scene.sweeps);
    return scene;
}

}  // namespace relidar::nuscenes
