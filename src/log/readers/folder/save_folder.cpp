// SPDX-License-Identifier: Apache-2.0
// Writes a log as a plain folder.
#include <relidar/log/dataset.hpp>

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/files.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/files.hpp"
#include "base/number_text.hpp"
#include "base/progress_blocks.hpp"
#include "log/clouds/folder_head.hpp"
#include "log/clouds/scan_npz.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

Json json_of(const glm::dvec3& vector) { return {vector.x, vector.y, vector.z}; }
Json json_of(const glm::dquat& quaternion) {
    return {quaternion.w, quaternion.x, quaternion.y, quaternion.z};
}

std::string make_pattern_name(std::size_t lidar) { return fmt::format("sensor_{}.json", lidar); }

/// Returns the JSON object of a LiDAR for sequence.json.
/// @param number  index of the LiDAR in the log
Json json_of(const Lidar& lidar, std::size_t number) {
    const Pose& mounting = lidar.vehicle_from_sensor;
    return {{"name", lidar.name},
            {"vehicle_from_sensor",
             {{"translation", json_of(mounting.translation)}, {"quaternion", json_of(mounting.rotation)}}},
            {"spins", !lidar.sensor.beams.empty()},
            {"sensor", lidar.pattern ? Json(make_pattern_name(number))
                                     : Json::parse(write_sensor_json(get_sensor(lidar)))}};
}

std::string make_scan_name(const Sequence& sequence, const Frame& frame) {
    if (sequence.lidars.size() == 1) return fmt::format("scans/{:06}.npz", frame.index);
    return fmt::format("scans/{:06}_{}.npz", frame.index, frame.lidar);
}

std::string make_head_text(const Sequence& sequence) {
    Json json = {{"format", folder::kFormat},
                 {"version", folder::kVersion},
                 {"relidar", RELIDAR_VERSION},
                 {"name", sequence.name},
                 {"conventions", sequence.conventions},
                 {"notes", sequence.notes},
                 {"motion_compensated", !sequence.rolling_shutter},
                 {"world_offset_m", json_of(sequence.world_offset_m)},
                 {"lidars", Json::array()},
                 {"frames", Json::array()}};
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l)
        json["lidars"].push_back(json_of(sequence.lidars[l], l));
    for (const Frame& frame : sequence.frames)
        json["frames"].push_back({{"number", frame.index},
                                  {"time_s", frame.time_s},
                                  {"lidar", sequence.get_lidar(frame).name},
                                  {"scan", make_scan_name(sequence, frame)}});
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string format_poses(const Sequence& sequence) {
    const PoseTrack track = shift_track(sequence.world_from_vehicle, sequence.world_offset_m);
    std::string text = "# time_s x y z qw qx qy qz\n";
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        const auto& [q, t] = track.pose[i];
        text += format_number_text(track.time_s[i]);
        for (const double v : {t.x, t.y, t.z, q.w, q.x, q.y, q.z}) text += " " + format_number_text(v);
        text += "\n";
    }
    return text;
}

std::string format_boxes(const Sequence& sequence) {
    Json json = {{"boxes", Json::array()}};
    for (const BoxTrack& box : sequence.boxes) {
        const PoseTrack track = shift_track(box.world_from_box, sequence.world_offset_m);
        for (std::size_t k = 0; k < track.pose.size(); ++k)
            json["boxes"].push_back({{"track", box.id},
                                     {"category", box.category},
                                     {"time_s", track.time_s[k]},
                                     {"size", json_of(box.size_m)},
                                     {"position", json_of(track.pose[k].translation)},
                                     {"quaternion", json_of(track.pose[k].rotation)}});
    }
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

void check_target_folder(const fs::path& folder, bool overwrite) {
    if (!does_path_exist(folder) || (fs::is_directory(folder) && list_folder(folder).empty())) return;
    if (!fs::is_directory(folder) || !does_path_exist(folder / folder::kHeadFile))
        throw UsageError(fmt::format("{}: this path exists and is not a plain folder, expected a new name",
                                     folder.string()));
    if (!overwrite)
        throw UsageError(
            fmt::format("{}: this plain folder exists, expected a new name; use --force to "
                        "replace it",
                        folder.string()));
}

}  // namespace

void save_folder(const Sequence& sequence, const fs::path& target_folder, const FolderOptions& options) {
    const fs::path wanted = (fs::absolute(target_folder) / "").lexically_normal().parent_path();
    check_target_folder(wanted, options.overwrite);
    const StagedFolder staged(wanted);
    fs::create_directory(staged.path() / "scans");
    for_each_with_progress(sequence.frames.size(), options.progress, "writing scans", [&](std::size_t index) {
        const Frame& frame = sequence.frames[index];
        folder::write_scan_npz(staged.path() / make_scan_name(sequence, frame), frame.scan,
                               !sequence.rolling_shutter);
    });
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l)
        if (const Lidar& lidar = sequence.lidars[l]; lidar.pattern)
            write_text(staged.path() / make_pattern_name(l), write_sensor_json(get_sensor(lidar)) + "\n");
    if (options.poses) write_text(staged.path() / folder::kPosesFile, format_poses(sequence));
    if (!sequence.boxes.empty()) write_text(staged.path() / folder::kBoxesFile, format_boxes(sequence));
    write_text(staged.path() / folder::kHeadFile, make_head_text(sequence));
    staged.finish();
}

}  // namespace relidar
