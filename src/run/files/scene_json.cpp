// SPDX-License-Identifier: Apache-2.0
// Reads and writes scene.json, format version 3. A pose has seven numbers: the
// translation x y z, then the unit quaternion w x y z. A point transforms as p_world =
// R(q) p + t in the recentred world.
#include "run/files/run_files.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/log/sensor_pattern.hpp>
#include "base/json_field.hpp"
#include "log/frames/labelled_azimuth.hpp"
#include "log/georeference/georeference_json.hpp"
#include "log/sensor_files/camera_json.hpp"

namespace relidar::files {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSceneFormat = "relidar scene";
constexpr int kSceneVersion = 3;
// a file with a larger length or time is damaged
constexpr double kMaxValue = 1e12;
// relative to the sensor in the middle frame
constexpr double kMaxCoordinate_m = 1e6;
// between the origins of the scene and of the dataset's world
constexpr double kMaxWorldOffset_m = 1e9;
constexpr std::int64_t kMaxInt = 2147483647, kMaxFrame = 99999999;
constexpr const char* kUnitsText = "metres, seconds, radians";
constexpr const char* kConventionsText =
    "Sensor and vehicle frames: x forward, y left, z up. World: the dataset's world minus world_offset_m. A "
    "pose a_from_b is translation x y z and unit quaternion w x y z: p_a = R(q) p_b + t. Box frame: x along "
    "the length, y along the width, z up, origin at the centre. Image row 0 is the highest beam, column 0 "
    "azimuth +180 degrees, falling. frames[].time_s: the head faces forward. beams: highest first.";

Json to_json(const glm::dvec3& vector) { return {vector.x, vector.y, vector.z}; }
Json to_json(const Pose& pose) {
    return {pose.translation.x, pose.translation.y, pose.translation.z, pose.rotation.w,
            pose.rotation.x,    pose.rotation.y,    pose.rotation.z};
}

/// Converts a box and its poses to JSON. `beside_labels` has the numbers of poses before
/// the first and after the last label, which were added without a label.
Json to_json(const BoxTrack& box) {
    Json json = {{"id", box.id},
                 {"category", box.category},
                 {"size_m", to_json(box.size_m)},
                 {"time_s", box.world_from_box.time_s},
                 {"world_from_box", Json::array()}};
    for (const Pose& pose : box.world_from_box.pose) json["world_from_box"].push_back(to_json(pose));
    if (!box.size_guess.empty()) json["size_guess"] = box.size_guess;
    if (box.n_before + box.n_after > 0) json["beside_labels"] = {box.n_before, box.n_after};
    return json;
}

Json to_json(const RangeNoiseTable& noise) {
    return {{"range_m", noise.range_m}, {"cosine", noise.cosine}, {"sigma_m", noise.sigma_m}};
}

/// Converts the LiDARs to JSON: pose on the vehicle, sensor, and noise of the ranges.
Json lidars_json(const Log& log) {
    Json json = Json::array();
    for (const Lidar& lidar : log.lidars) {
        json.push_back({{"name", lidar.name},
                        {"vehicle_from_sensor", to_json(lidar.vehicle_from_sensor)},
                        {"sensor", Json::parse(format_sensor_json(sensor_of(lidar)))}});
        if (!lidar.range_noise.sigma_m.empty()) json.back()["range_noise"] = to_json(lidar.range_noise);
    }
    return json;
}

/// Converts the frames to JSON: index, time, LiDAR, part of the split (train, test or
/// unused), and vehicle pose.
Json frames_json(const Log& log, const Split& split) {
    std::vector<const char*> parts(log.frames.size(), "unused");
    for (const int i : split.test) parts.at(std::size_t(i)) = "test";
    for (const int i : split.train) parts.at(std::size_t(i)) = "train";
    Json frames = Json::array();
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        const Frame& frame = log.frames[i];
        const Pose& pose = log.world_from_vehicle.pose[log.find_pose_index(frame)];
        frames.push_back({{"index", frame.index},
                          {"time_s", frame.time_s},
                          {"lidar", frame.lidar},
                          {"split", parts[i]},
                          {"world_from_vehicle", to_json(pose)}});
    }
    return frames;
}

/// @throws DataError for the first number whose absolute value is above `limit`
void check_magnitude(const JsonField& field, const std::vector<double>& values, double limit) {
    for (const double v : values)
        if (std::abs(v) > limit)
            field.reject(fmt::format("found {}", v),
                         fmt::format("expected an absolute value of at most {:.15g}", limit));
}

/// Reads a pose: the translation x y z in metres and the unit quaternion w x y z.
Pose read_pose(const JsonField& field) {
    constexpr double kMaxLengthError = 1e-6;
    const auto v = field.numbers<7>();
    const glm::dquat q(v[3], v[4], v[5], v[6]);
    const double length = glm::length(q);
    if (std::abs(length - 1.0) > kMaxLengthError)
        field.reject(fmt::format("found a quaternion of length {}", length),
                     "expected a quaternion of length 1");
    check_magnitude(field, {v[0], v[1], v[2]}, kMaxCoordinate_m);
    // Does not normalise the quaternion again, which would change its last digits.
    return {q, {v[0], v[1], v[2]}};
}

/// Reads the noise of a LiDAR: a table with the standard deviation of the range for each
/// range and each cosine of the angle of incidence.
RangeNoiseTable parse_range_noise(const JsonField& field) {
    const RangeNoiseTable noise{field.at("range_m").numbers(), field.at("cosine").numbers(),
                                field.at("sigma_m").numbers()};
    if (noise.sigma_m.size() != noise.range_m.size() * noise.cosine.size() || noise.sigma_m.empty())
        field.at("sigma_m").reject(
            fmt::format("found {} numbers", noise.sigma_m.size()),
            fmt::format("expected {} x {} numbers", noise.range_m.size(), noise.cosine.size()));
    if (!std::ranges::all_of(noise.sigma_m, [](double sigma) { return sigma >= 0.0 && sigma < 1e3; }))
        field.at("sigma_m").reject("found a value outside 0 to 1000",
                                   "expected standard deviations in metres");
    return noise;
}

/// Reads a LiDAR with its sensor and its pose on the vehicle.
Lidar read_lidar(const JsonField& entry) {
    Lidar lidar{entry.at("name").text(), {}, read_pose(entry.at("vehicle_from_sensor"))};
    set_sensor(lidar, read_sensor_json(entry.at("sensor"), ""));
    if (entry.has_member("range_noise")) lidar.range_noise = parse_range_noise(entry.at("range_noise"));
    return lidar;
}

/// Reads how measured intensities depend on range and on the angle of incidence.
IntensityResponse parse_response(const JsonField& field) {
    const IntensityResponse response{field.at("range_m").numbers(), field.at("factor").numbers(),
                                     field.at("incidence").number_in(0.0, 1.0)};
    if (response.factor.size() != response.range_m.size())
        field.at("factor").reject(
            fmt::format("found {} factors", response.factor.size()),
            fmt::format("expected {}, one for each range in range_m", response.range_m.size()));
    if (!std::ranges::is_sorted(response.range_m))
        field.at("range_m").reject("found decreasing ranges", "expected increasing ranges");
    if (!std::ranges::all_of(response.factor, [](double f) { return f > 0.0 && f < kMaxValue; }))
        field.at("factor").reject("found a factor that is 0 or less, or too large",
                                  fmt::format("expected factors above 0 and below {:g}", kMaxValue));
    return response;
}

/// Reads the frames, their vehicle poses, and the split into training and test frames
/// (indices in the list of frames).
void parse_frames(const JsonField& field, SceneJsonContents& scene) {
    const auto last_lidar = static_cast<std::int64_t>(scene.log.lidars.size()) - 1;
    for (std::size_t i = 0; i < field.size(); ++i) {
        const JsonField entry = field.at(i);
        Frame frame;
        frame.index = static_cast<int>(entry.at("index").integer_in(0, kMaxFrame));
        frame.time_s = entry.at("time_s").number_in(-kMaxValue, kMaxValue);
        frame.lidar = static_cast<int>(entry.at("lidar").integer_in(0, last_lidar));
        const auto order = [](const Frame& f) { return std::pair(f.time_s, f.lidar); };
        if (i > 0 && order(frame) <= order(scene.log.frames.back()))
            entry.at("time_s").reject(fmt::format("found {}", frame.time_s),
                                      "expected frames in the order of their times, and at equal times in "
                                      "the order of their LiDARs, without duplicates");
        const std::string part = entry.at("split").text();
        if (part == "train") scene.split.train.push_back(static_cast<int>(i));
        else if (part == "test") scene.split.test.push_back(static_cast<int>(i));
        else if (part != "unused")
            entry.at("split").reject("found \"" + part + "\"", "expected train, test or unused");
        const Pose pose = read_pose(entry.at("world_from_vehicle"));
        PoseTrack& track = scene.log.world_from_vehicle;
        // Frames of several LiDARs at the same time share one pose.
        if (track.time_s.empty() || track.time_s.back() != frame.time_s) track.append(frame.time_s, pose);
        scene.log.frames.push_back(std::move(frame));
    }
    if (scene.log.frames.empty()) field.reject("found no frame", "expected at least one frame");
}

/// Checks that a box has one pose for each time, in the order of time.
void check_poses(const JsonField& field, const PoseTrack& track) {
    check_magnitude(field.at("time_s"), track.time_s, kMaxValue);
    if (track.pose.size() != track.time_s.size())
        field.at("world_from_box")
            .reject(fmt::format("found {} poses", track.pose.size()),
                    fmt::format("expected {} poses, one for each time", track.time_s.size()));
    if (!std::ranges::is_sorted(track.time_s))
        field.at("time_s").reject("found decreasing times", "expected increasing times");
}

/// Reads a box with its poses, as to_json() writes it.
BoxTrack read_box_track(const JsonField& field) {
    BoxTrack box;
    box.id = field.at("id").text();
    box.category = field.at("category").text();
    box.size_m = field.at("size_m").vector_in(-kMaxCoordinate_m, kMaxCoordinate_m);
    if (!(std::min({box.size_m.x, box.size_m.y, box.size_m.z}) > 0.0))
        field.at("size_m").reject(
            fmt::format("found {} x {} x {} m", box.size_m.x, box.size_m.y, box.size_m.z),
            "expected three lengths above 0");
    box.world_from_box.time_s = field.at("time_s").numbers();
    box.world_from_box.pose = field.at("world_from_box").list(read_pose);
    check_poses(field, box.world_from_box);
    if (field.has_member("size_guess")) box.size_guess = field.at("size_guess").text();
    if (field.has_member("beside_labels")) {  // numbers of poses before and after the labels
        const JsonField beside = field.at("beside_labels");
        const std::int64_t n_poses = std::ssize(box.world_from_box.pose);
        const std::int64_t n_before = beside.at(0).integer_in(0, n_poses);
        box.n_before = static_cast<std::size_t>(n_before);
        box.n_after = static_cast<std::size_t>(beside.at(1).integer_in(0, n_poses - n_before));
    }
    return box;
}

/// Compares each count in the file with the length of its list, to detect entries that a
/// manual edit or a wrong merge has removed.
void check_counts(const JsonField& root, const SceneJsonContents& scene) {
    const auto check = [&](const char* name, std::size_t n_listed) {
        const JsonField count = root.at("counts").at(name);
        const std::int64_t found = count.integer_in(0, kMaxInt);
        if (found != static_cast<std::int64_t>(n_listed))
            count.reject(fmt::format("found {}", found),
                         fmt::format("expected {}, the number of listed entries", n_listed));
    };
    check("frames", scene.log.frames.size());
    check("boxes", scene.log.boxes.size());
}

/// Throws if the file has another format or version.
void check_format(const JsonField& root) {
    if (const std::string format = root.at("format").text(); format != kSceneFormat)
        root.at("format").reject("found \"" + format + "\"", fmt::format("expected \"{}\"", kSceneFormat));
    if (const std::int64_t version = root.at("version").integer_in(0, kMaxInt); version != kSceneVersion)
        root.at("version").reject(fmt::format("found {}", version),
                                  fmt::format("relidar {} reads only version {}; train the run again",
                                              RELIDAR_VERSION, kSceneVersion));
}

}  // namespace

std::string format_scene(const Run& run) {
    const Log& s = run.log;
    Json boxes = Json::array();
    for (const BoxTrack& box : s.boxes) boxes.push_back(to_json(box));
    Json json = {
        {"format", kSceneFormat},
        {"version", kSceneVersion},
        {"relidar", RELIDAR_VERSION},
        {"units", kUnitsText},
        {"conventions", kConventionsText},
        {"name", s.name},
        {"source", s.source},
        {"source_conventions", s.conventions},
        {"start_unix_ns", s.start_unix_ns},
        {"notes", s.notes},
        {"counts",
         {{"frames", s.frames.size()}, {"boxes", s.boxes.size()}, {"surfels", run.scene.surfels.size()}}},
        {"world_offset_m", to_json(s.world_offset_m)},
        {"rolling_shutter", s.rolling_shutter},
        {"lidars", lidars_json(s)},
        {"frames", frames_json(s, run.split)},
        {"boxes", boxes}};
    if (const IntensityResponse& r = s.intensity_response; !r.factor.empty())
        json["intensity_response"] = {
            {"range_m", r.range_m}, {"factor", r.factor}, {"incidence", r.incidence}};
    for (const Camera& camera : s.cameras) json["cameras"].push_back(camera_json(camera));
    if (s.georeference) json["georeference"] = georeference_json(*s.georeference);
    if (s.labelled_azimuth) json["labelled_azimuth_rad"] = azimuths_json(*s.labelled_azimuth);
    if (run.held_out_placed) json["held_out_placed"] = true;
    if (!run.refined_poses.empty()) json["refined_poses"] = run.refined_poses;
    for (const EditHistoryEntry& e : run.edits) json["edits"].push_back({{"run", e.run}, {"edit", e.edit}});
    const std::string text = json.dump(1, ' ', false, Json::error_handler_t::replace);
    // Rejects values that could not be read again, for example NaN in a pose.
    parse_scene(text, "writing scene.json");
    return text + "\n";
}

SceneJsonContents parse_scene(const std::string& json_text, const std::string& file_name) {
    const nlohmann::json json = parse_json(json_text, file_name);
    const JsonField root(json, file_name, "");
    check_format(root);
    SceneJsonContents scene;
    Log& log = scene.log;
    log.name = root.at("name").text();
    log.source = root.at("source").text();
    log.conventions = root.at("source_conventions").text();
    if (root.has_member("start_unix_ns"))
        log.start_unix_ns = root.at("start_unix_ns").integer_in(0, kLatestLogStart_ns);
    log.notes = root.at("notes").list([](const JsonField& note) { return Note(note.text()); });
    log.world_offset_m = root.at("world_offset_m").vector_in(-kMaxWorldOffset_m, kMaxWorldOffset_m);
    const auto read_whole_camera = [](const JsonField& camera) {
        for (const char* key : {"name", "translation_m", "quaternion"}) (void)camera.at(key);
        return read_camera(camera);
    };
    if (root.has_member("cameras")) log.cameras = root.at("cameras").list(read_whole_camera);
    if (root.has_member("georeference")) log.georeference = read_georeference(root.at("georeference"));
    if (root.has_member("labelled_azimuth_rad"))
        log.labelled_azimuth = read_azimuths(root.at("labelled_azimuth_rad"));
    log.rolling_shutter = root.at("rolling_shutter").boolean();
    log.lidars = root.at("lidars").list(read_lidar);
    if (log.lidars.empty()) root.at("lidars").reject("found no LiDAR", "expected at least one LiDAR");
    parse_frames(root.at("frames"), scene);
    log.boxes = root.at("boxes").list(read_box_track);
    if (root.has_member("intensity_response"))
        log.intensity_response = parse_response(root.at("intensity_response"));
    if (root.has_member("edits"))
        scene.edits = root.at("edits").list([](const JsonField& entry) {
            return EditHistoryEntry{entry.at("run").text(), entry.at("edit").text()};
        });
    scene.held_out_placed = root.has_member("held_out_placed") && root.at("held_out_placed").boolean();
    if (root.has_member("refined_poses")) scene.refined_poses = root.at("refined_poses").text();
    check_counts(root, scene);
    scene.n_surfels = static_cast<std::size_t>(root.at("counts").at("surfels").integer_in(0, 4294967295));
    return scene;
}

}  // namespace relidar::files
