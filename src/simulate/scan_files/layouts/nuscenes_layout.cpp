// SPDX-License-Identifier: Apache-2.0
// Writes the 13 tables of nuScenes v1.0 and the LiDAR files. Every frame is a keyframe.
#include "simulate/scan_files/layouts/layout.hpp"

#include <array>
#include <cctype>
#include <fstream>
#include <map>
#include <set>

#include <fmt/format.h>

#include <relidar/base/files.hpp>
#include <relidar/base/images.hpp>
#include "base/bytes.hpp"
#include "base/fail.hpp"

namespace relidar::layouts {
namespace {

namespace fs = std::filesystem;

constexpr const char* kVersion = "v1.0-trainval";
constexpr const char* kTables[] = {
    "attribute", "calibrated_sensor", "category",    "ego_pose",  "instance", "log", "map", "sample", "scene",
    "sensor",    "sample_annotation", "sample_data", "visibility"};

/// Levels of visibility and their lower limits.
struct VisibilityLevel {
    const char *token, *level;
    double min_share;
};
constexpr VisibilityLevel kVisibilityLevels[] = {
    {"4", "v80-100", 0.8}, {"3", "v60-80", 0.6}, {"2", "v40-60", 0.4}, {"1", "v0-40", 0.0}};

struct SceneNumbers {
    int first, last;
};
/// Official scenes of the splits, without short intervals.
constexpr SceneNumbers kTrainScenes[] = {
    {19, 34},   {41, 76},   {120, 135}, {157, 168}, {170, 185},  {224, 264},   {283, 306},
    {347, 386}, {388, 403}, {410, 459}, {504, 515}, {525, 539},  {582, 600},   {639, 679},
    {703, 719}, {847, 856}, {882, 903}, {975, 984}, {994, 1025}, {1044, 1058}, {1074, 1102}};
constexpr SceneNumbers kValScenes[] = {{12, 18},   {92, 110},  {268, 278}, {519, 524}, {552, 565},
                                       {632, 638}, {794, 800}, {904, 917}, {919, 931}, {1059, 1073}};
constexpr std::size_t kMaxSequence = 560;  // needs 449 and 113 scenes

/// Channels of cameras, turned to the left against the camera of the data set. mmdet3d
/// reads records of all of them.
struct CameraChannel {
    const char* name;
    double yaw_deg;
};
constexpr CameraChannel kCameraChannels[] = {{"CAM_FRONT", 0.0},         {"CAM_FRONT_LEFT", 55.0},
                                             {"CAM_FRONT_RIGHT", -55.0}, {"CAM_BACK", 180.0},
                                             {"CAM_BACK_LEFT", 110.0},   {"CAM_BACK_RIGHT", -110.0}};

/// Returns the name of the n-th scene of a split.
std::string name_scene(std::span<const SceneNumbers> split, std::size_t n) {
    auto numbers = split.begin();
    for (; n >= std::size_t(numbers->last - numbers->first + 1); ++numbers)
        n -= std::size_t(numbers->last - numbers->first + 1);
    return fmt::format("scene-{:04}", numbers->first + int(n));
}

/// LiDAR axes of nuScenes: x right, y forward.
const Pose kSensorFromFile{glm::angleAxis(-0.5 * kPi, glm::dvec3(0, 0, 1)), glm::dvec3(0.0)};

void add_pose(Json& record, const Pose& pose) {
    const glm::dvec3& t = pose.translation;
    const glm::dquat& q = pose.rotation;
    record["translation"] = {t.x, t.y, t.z};
    record["rotation"] = {q.w, q.x, q.y, q.z};
}

/// Returns the channel of each sensor: its name in upper case after LIDAR_. The first
/// sensor becomes LIDAR_TOP if none has this name, because many programs read only this
/// channel.
/// @throws UsageError if two sensors have the same channel
std::vector<std::string> name_channels(const std::vector<DatasetSensor>& sensors) {
    constexpr std::string_view kPrefix = "LIDAR_", kTop = "LIDAR_TOP";
    std::vector<std::string> channels;
    for (const DatasetSensor& sensor : sensors) {
        std::string name = to_topic_name(sensor.options.frame_id);
        std::ranges::transform(name, name.begin(), [](unsigned char c) { return char(std::toupper(c)); });
        channels.push_back(name.starts_with(kPrefix) ? name : fmt::format("{}{}", kPrefix, name));
    }
    if (std::ranges::find(channels, kTop) == channels.end()) channels.front() = kTop;
    for (const std::string& channel : channels)
        if (std::ranges::count(channels, channel) > 1)
            fail<UsageError>(
                "--layout nuscenes: found two sensors with the channel {}, expected names that "
                "differ in more than upper case",
                channel);
    return channels;
}

std::string visibility_of(const LabelledObject& object) {
    if (!object.visible_share) return "";
    return std::ranges::find_if(
               kVisibilityLevels,
               [&](const VisibilityLevel& level) { return *object.visible_share >= level.min_share; })
        ->token;
}

/// Returns the day of a time after 1970 as YYYY-MM-DD.
std::string format_day(std::int64_t stamp_ns) {
    const auto days = std::chrono::floor<std::chrono::days>(
        std::chrono::sys_time<std::chrono::nanoseconds>(std::chrono::nanoseconds(stamp_ns)));
    const std::chrono::year_month_day day(days);
    return fmt::format("{:04}-{:02}-{:02}", int(day.year()), unsigned(day.month()), unsigned(day.day()));
}

class NuscenesWriter : public LayoutWriter {
public:
    NuscenesWriter(SequencePlace place, const std::vector<DatasetSensor>& sensors, const DatasetView& view)
        : LayoutWriter(std::move(place), sensors, view),
          channels_(name_channels(sensors)),
          scenes_(list_scenes(place_.number, place_.n_frames)),
          scene_prefix_(make_token("scene " + place_.key, kPrefixDigits)) {
        for (std::size_t s = 0; s < sensors_.size(); ++s) {
            Json mount = {{"token", token("mount", channels_[s])},
                          {"sensor_token", shared("sensor", channels_[s])}};
            // The file's axes are rotated against the sensor's axes (kSensorFromFile).
            add_pose(mount, ego_from_sensor(s) * kSensorFromFile);
            mount["camera_intrinsic"] = Json::array();
            records_["calibrated_sensor"].push_back(mount);
            add_shared("sensor", channels_[s], {{"channel", channels_[s]}, {"modality", "lidar"}});
        }
        const Pose ego_from_rig = ego_from_sensor(0) * inverse(sensors_[0].rig_from_sensor);
        for (const CameraChannel& channel : kCameraChannels) {
            Json mount = {{"token", token("mount", channel.name)},
                          {"sensor_token", shared("sensor", channel.name)}};
            const Pose turn{glm::angleAxis(glm::radians(channel.yaw_deg), glm::dvec3(0, 0, 1)),
                            glm::dvec3(0.0)};
            add_pose(mount, ego_from_rig * turn * camera().rig_from_camera);
            mount["camera_intrinsic"] = {{camera().focal_x_px, 0.0, camera().centre_x_px},
                                         {0.0, camera().focal_y_px, camera().centre_y_px},
                                         {0.0, 0.0, 1.0}};
            records_["calibrated_sensor"].push_back(mount);
            add_shared("sensor", channel.name, {{"channel", channel.name}, {"modality", "camera"}});
        }
    }

    void write_frame(const LabelledFrame& frame) override {
        const std::size_t i = frame.index;
        const std::int64_t time_us = frame.stamp_ns / 1000;
        if (i == 0) first_stamp_ns_ = frame.stamp_ns;
        if (starts_scene(int(i))) {
            scene_ = std::ranges::find(scenes_, int(i), &SceneStart::first_frame)->name;
            records_of_.clear();
        }
        add_linked("sample", "sample", i, {{"timestamp", time_us}, {"scene_token", token("scene", scene_)}});
        // The rig and the vehicle can differ. The first sensor links both.
        const Pose world_from_ego =
            frame.world_from_rig * sensors_[0].rig_from_sensor * inverse(ego_from_sensor(0));
        for (std::size_t s = 0; s < sensors_.size(); ++s) {
            const std::string& channel = channels_[s];
            const std::string file =
                fmt::format("samples/{0}/{1}__{0}__{2}.pcd.bin", channel, scene_, time_us);
            write_bytes(place_.folder / file, pack_points(frame.clouds[s], frame.n_rings[s]));
            add_data(channel, frame, file, "pcd", 0, 0);
        }
        Json pose = {{"token", token("pose", std::to_string(i))}, {"timestamp", time_us}};
        add_pose(pose, world_from_ego);
        records_["ego_pose"].push_back(pose);
        write_pictures(frame);
        for (const LabelledObject& object : frame.objects) add_annotation(object, i);
    }

    void finish(const DatasetIndex& index) override {
        const std::string log = token("log");
        records_["log"].push_back({{"token", log},
                                   {"logfile", sensors_[0].options.run},
                                   {"vehicle", "relidar"},
                                   {"date_captured", format_day(first_stamp_ns_)},
                                   {"location", "unknown"}});
        for (auto scene = scenes_.begin(); scene != scenes_.end(); ++scene) {
            const int end =
                std::next(scene) == scenes_.end() ? place_.n_frames : std::next(scene)->first_frame;
            records_["scene"].push_back(
                {{"token", token("scene", scene->name)},
                 {"name", scene->name},
                 {"description", file_name_of(sensors_[0].options.config.dataset.path)},
                 {"log_token", log},
                 {"nbr_samples", end - scene->first_frame},
                 {"first_sample_token", token("sample", std::to_string(scene->first_frame))},
                 {"last_sample_token", token("sample", std::to_string(end - 1))}});
        }
        for (const VisibilityLevel& level : kVisibilityLevels)
            records_["visibility"].push_back(
                {{"token", level.token},
                 {"level", level.level},
                 {"description", "share of the rays that no other object blocks"}});
        Json splits = {{"train", Json::array()}, {"val", Json::array()}};
        for (std::size_t s = 0; s < index.sequences.size(); ++s)
            for (const SceneStart& scene : list_scenes(s, index.sequences[s].n_frames)) {
                splits[index.is_validation(s, scene.first_frame) ? "val" : "train"].push_back(scene.name);
                scene_order_.push_back(scene.name);
            }
        const StagedFolder staged(place_.folder / kVersion);
        for (const char* table : kTables) write_table(staged.path(), table);
        write_bytes(staged.path() / "splits.json", splits.dump(1));
        staged.replace_folder();
    }

private:
    static constexpr std::size_t kPrefixDigits = 12;
    const std::vector<std::string> channels_;
    const std::vector<SceneStart> scenes_;
    const std::string scene_prefix_;        ///< first digits of all tokens of the sequence
    std::string scene_;                     ///< scene of the current frame
    std::vector<std::string> scene_order_;  ///< names of all scenes, by sequence
    std::int64_t first_stamp_ns_ = 0;
    /// Indices of the records of a track in their tables.
    struct TrackRecords {
        std::size_t instance, last_annotation, n_annotations = 0;
    };
    std::map<std::string, std::vector<Json>> records_;  ///< by table
    std::map<std::string, TrackRecords> records_of_;    ///< by track, of the current scene

    bool starts_scene(int frame) const {
        return std::ranges::find(scenes_, frame, &SceneStart::first_frame) != scenes_.end();
    }
    std::string token(const std::string& kind, const std::string& name = "") const {
        return scene_prefix_ + make_token(kind + " " + name + " " + place_.key, 32 - kPrefixDigits);
    }
    /// Returns the token of a record that scenes share.
    static std::string shared(const std::string& table, const std::string& name) {
        return make_token(table + " " + name);
    }
    Pose ego_from_sensor(std::size_t sensor) const {
        return sensors_[sensor].options.vehicle_from_lidar * sensors_[sensor].options.offset;
    }
    void add_shared(const std::string& table, const std::string& name, Json record) {
        record["token"] = shared(table, name);
        records_[table].push_back(std::move(record));
    }
    /// Adds a record of a frame, with links to the same kind of record of the frames
    /// before and after in its scene.
    void add_linked(const char* table, const std::string& kind, std::size_t frame, Json record) {
        record["token"] = token(kind, std::to_string(frame));
        const int next = int(frame) + 1;
        record["prev"] = starts_scene(int(frame)) ? "" : token(kind, std::to_string(frame - 1));
        record["next"] =
            next == place_.n_frames || starts_scene(next) ? "" : token(kind, std::to_string(next));
        records_[table].push_back(std::move(record));
    }

    void add_data(const std::string& channel, const LabelledFrame& frame, const std::string& file,
                  const char* format, int columns, int rows) {
        add_linked("sample_data", "data " + channel, frame.index,
                   {{"sample_token", token("sample", std::to_string(frame.index))},
                    {"ego_pose_token", token("pose", std::to_string(frame.index))},
                    {"calibrated_sensor_token", token("mount", channel)},
                    {"filename", file},
                    {"fileformat", format},
                    {"width", columns},
                    {"height", rows},
                    {"timestamp", frame.stamp_ns / 1000},
                    {"is_key_frame", true}});
    }

    /// Writes the picture of CAM_FRONT. All other pictures are one black file per channel
    /// and sequence.
    void write_pictures(const LabelledFrame& frame) {
        for (const CameraChannel& channel : kCameraChannels) {
            const RenderedScan* picture = channel.yaw_deg == 0.0 ? frame.picture : nullptr;
            const std::string name =
                picture ? fmt::format("{}__{}__{}", scene_, channel.name, frame.stamp_ns / 1000)
                        : fmt::format("black_{}", place_.number);
            const std::string file = fmt::format("samples/{}/{}.png", channel.name, name);
            if (picture || frame.index == 0) write_picture(place_.folder / file, camera(), picture);
            add_data(channel.name, frame, file, "png", camera().columns, camera().rows);
        }
    }

    /// Returns five floats for each point: x, y, z, intensity up to 255, ring (0 lowest).
    static std::string pack_points(const LidarPoints& cloud, int n_rings) {
        std::string bytes;
        for (std::size_t i = 0; i < cloud.size(); ++i) {
            append_raw(bytes, glm::vec3(inverse(kSensorFromFile) * glm::dvec3(cloud.position_m[i])));
            append_raw(bytes, 255.0f * cloud.intensity[i]);
            append_raw(bytes, float(n_rings - 1 - cloud.ring[i]));
        }
        return bytes;
    }

    void add_annotation(const LabelledObject& object, std::size_t frame) {
        const std::string& track = object.track;
        Json record = {{"token", token("box " + track, std::to_string(frame))},
                       {"sample_token", token("sample", std::to_string(frame))},
                       {"instance_token", token("track " + scene_, track)},
                       {"attribute_tokens", Json::array()},
                       {"visibility_token", visibility_of(object)}};
        add_pose(record, object.world_from_box);
        // nuScenes orders sizes as width, length, height.
        record["size"] = {object.size_m.y, object.size_m.x, object.size_m.z};
        record["num_lidar_pts"] = object.n_points;
        record["num_radar_pts"] = 0;
        record["prev"] = record["next"] = "";
        std::vector<Json>& all = records_["sample_annotation"];
        TrackRecords& of_track = records_of_[track];
        if (of_track.n_annotations == 0) {
            const std::string& category = object.name;
            add_shared("category", category, {{"name", category}, {"description", ""}});
            of_track.instance = records_["instance"].size();
            records_["instance"].push_back({{"token", record["instance_token"]},
                                            {"category_token", shared("category", category)},
                                            {"first_annotation_token", record["token"]}});
        } else {
            // The annotations of a track form a linked list.
            record["prev"] = all[of_track.last_annotation]["token"];
            all[of_track.last_annotation]["next"] = record["token"];
        }
        Json& instance = records_["instance"][of_track.instance];
        instance["nbr_annotations"] = ++of_track.n_annotations;
        instance["last_annotation_token"] = record["token"];
        of_track.last_annotation = all.size();
        all.push_back(std::move(record));
    }

    /// Returns the records of earlier scenes. Empty if the table does not exist.
    Json read_table(const std::string& table) const {
        const fs::path path = place_.folder / kVersion / (table + ".json");
        std::ifstream file(path);
        if (!file) return Json::array();
        const Json records = Json::parse(file, nullptr, false);
        const auto is_record = [](const Json& record) {
            return record.is_object() && record.contains("token") && record["token"].is_string();
        };
        if (!records.is_array() || !std::ranges::all_of(records, is_record))
            fail("{}: found no list of records, expected a table of nuScenes", path.string());
        return records;
    }

    /// Writes a table with the records of all scenes.
    void write_table(const fs::path& folder, const std::string& table) {
        std::vector<Json> all;
        std::set<std::string> tokens;
        const auto add = [&](const Json& record) {
            if (tokens.insert(record.at("token")).second) all.push_back(record);
        };
        for (const Json& record : read_table(table))
            if (!record.at("token").get<std::string>().starts_with(scene_prefix_)) add(record);
        std::ranges::for_each(records_[table], add);
        if (table == "map") all = {make_map()};
        if (table == "scene")  // a replaced scene keeps its place
            std::ranges::sort(all, {}, [&](const Json& scene) {
                return std::ranges::find(scene_order_, scene.at("name").get<std::string>());
            });
        write_bytes(folder / (table + ".json"), Json(all).dump(0) + "\n");
    }

    /// Returns the map of all logs: an empty mask, because relidar has no map. The
    /// development kit expects a file.
    Json make_map() {
        const std::string file = "maps/empty.png";
        std::error_code failed;
        fs::create_directories(place_.folder / "maps", failed);
        write_png(place_.folder / file, Image{1, 1, {0, 0, 0}});
        std::set<std::string> tokens{token("log")};
        for (const Json& log : read_table("log")) tokens.insert(log.at("token"));
        return {{"token", shared("map", "")},
                {"log_tokens", tokens},
                {"category", "semantic_prior"},
                {"filename", file}};
    }
};

}  // namespace

std::vector<SceneStart> list_scenes(std::size_t sequence, int n_frames) {
    if (sequence > kMaxSequence)
        fail<UsageError>(
            "--layout nuscenes: found sequence {}, expected at most {}, because nuScenes has no more scenes",
            sequence, kMaxSequence);
    const int first_val = first_val_frame(sequence, n_frames);
    // Sequence 0 has the first scenes of both splits. See first_val_frame().
    std::vector<SceneStart> scenes;
    if (first_val > 0) scenes.push_back({name_scene(kTrainScenes, sequence - (sequence + 3) / 5), 0});
    if (first_val < n_frames)
        scenes.push_back({name_scene(kValScenes, sequence / 5 + (sequence > 0 ? 1 : 0)), first_val});
    return scenes;
}

std::unique_ptr<LayoutWriter> make_nuscenes_writer(SequencePlace place,
                                                   const std::vector<DatasetSensor>& sensors,
                                                   const DatasetView& view) {
    return std::make_unique<NuscenesWriter>(std::move(place), sensors, view);
}

}  // namespace relidar::layouts
