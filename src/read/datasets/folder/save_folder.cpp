// SPDX-License-Identifier: Apache-2.0
// Writes a log as a plain folder.
#include <relidar/read/dataset.hpp>

#include <algorithm>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/base/files.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/number_text.hpp"
#include "base/progress_blocks.hpp"
#include "log/frames/labelled_azimuth.hpp"
#include "log/georeference/georeference_json.hpp"
#include "read/files/scan_npz.hpp"
#include "read/scans/folder_head.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

Json make_json(const glm::dvec3& vector) { return {vector.x, vector.y, vector.z}; }
Json make_json(const glm::dquat& quaternion) {
    return {quaternion.w, quaternion.x, quaternion.y, quaternion.z};
}

/// Name of the file with the pattern of a LiDAR, which is too large for sequence.json.
std::string sensor_file_name(std::size_t lidar_index) { return fmt::format("sensor_{}.json", lidar_index); }

/// Returns the entry of a LiDAR in sequence.json: its pose on the vehicle, and its beams
/// or the name of the file with its scanning pattern.
Json make_json(const Lidar& lidar, std::size_t lidar_index) {
    const Pose& mounting = lidar.vehicle_from_sensor;
    return {
        {"name", lidar.name},
        {"vehicle_from_sensor",
         {{"translation", make_json(mounting.translation)}, {"quaternion", make_json(mounting.rotation)}}},
        {"spins", !lidar.sensor.beams.empty()},
        {"sensor", lidar.pattern ? Json(sensor_file_name(lidar_index))
                                 : Json::parse(format_sensor_json(sensor_of(lidar)))}};
}

std::string scan_file_name(const Log& log, const Frame& frame) {
    if (log.lidars.size() == 1) return fmt::format("scans/{:06}.npz", frame.index);
    return fmt::format("scans/{:06}_{}.npz", frame.index, frame.lidar);
}

/// Returns the text of sequence.json: LiDARs, frames and conventions of the log. Omits
/// notes with an id, because loading the folder finds these faults again.
std::string sequence_json(const Log& log) {
    Notes notes = log.notes;
    std::erase_if(notes, [](const Note& note) { return !note.id.empty(); });
    Json json = {{"format", read::kLogFormat},
                 {"version", read::kLogVersion},
                 {"relidar", RELIDAR_VERSION},
                 {"name", log.name},
                 {"conventions", log.conventions},
                 {"start_unix_ns", log.start_unix_ns},
                 {"notes", notes},
                 {"motion_compensated", !log.rolling_shutter},
                 {"world_offset_m", make_json(log.world_offset_m)},
                 {"lidars", Json::array()},
                 {"frames", Json::array()}};
    if (log.georeference) json["georeference"] = georeference_json(*log.georeference);
    if (log.labelled_azimuth) json["labelled_azimuth_rad"] = azimuths_json(*log.labelled_azimuth);
    for (std::size_t l = 0; l < log.lidars.size(); ++l) json["lidars"].push_back(make_json(log.lidars[l], l));
    for (const Frame& frame : log.frames)
        json["frames"].push_back({{"number", frame.index},
                                  {"time_s", frame.time_s},
                                  {"lidar", log.lidar_of(frame).name},
                                  {"scan", scan_file_name(log, frame)}});
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

/// Returns the text of poses.txt: a line per pose in the world of the dataset. Writes all
/// digits of a double, so that loading gives equal poses.
std::string poses_text(const Log& log) {
    const PoseTrack track = shift_track(log.world_from_vehicle, log.world_offset_m);
    std::string text = "# time_s x y z qw qx qy qz\n";
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        const glm::dquat& q = track.pose[i].rotation;
        const glm::dvec3& t = track.pose[i].translation;
        text += number_text(track.time_s[i]);
        for (const double v : {t.x, t.y, t.z, q.w, q.x, q.y, q.z}) text += " " + number_text(v);
        text += "\n";
    }
    return text;
}

/// Returns the text of boxes.json: an entry per box and time, in the dataset's world.
std::string boxes_json(const Log& log) {
    Json json = {{"boxes", Json::array()}};
    for (const BoxTrack& box : log.boxes) {
        const PoseTrack track = shift_track(box.world_from_box, log.world_offset_m);
        for (std::size_t k = 0; k < track.pose.size(); ++k)
            json["boxes"].push_back({{"track", box.id},
                                     {"category", box.category},
                                     {"time_s", track.time_s[k]},
                                     {"size", make_json(box.size_m)},
                                     {"position", make_json(track.pose[k].translation)},
                                     {"quaternion", make_json(track.pose[k].rotation)}});
    }
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

/// Returns true if save_folder() could have written this file or folder of a log.
bool is_log_entry(const fs::path& entry) {
    const std::string name = entry.filename().string();
    if (name == read::kHeadFile || name == read::kPosesFile || name == read::kBoxesFile) return true;
    if (name.starts_with("sensor_") && entry.extension() == ".json") return true;
    return name == "scans" && std::ranges::all_of(list_folder(entry), [](const fs::path& scan) {
               return scan.extension() == ".npz";
           });
}

/// Throws unless the folder is missing or empty, or is a log that may be replaced. This
/// protects files of the user: with `overwrite`, relidar must have written all files.
void require_target(const fs::path& folder, bool overwrite) {
    if (!does_path_exist(folder)) return;
    if (fs::is_directory(folder)) {
        const std::vector<fs::path> entries = list_folder(folder);
        if (entries.empty()) return;
        const bool is_log =
            does_path_exist(folder / read::kHeadFile) && std::ranges::all_of(entries, is_log_entry);
        if (overwrite && is_log) return;
    }
    fail<UsageError>(
        "{}: this path exists, expected a new name or an empty folder; --force replaces a log if the folder "
        "contains only files that relidar writes",
        folder.string());
}

}  // namespace

void save_folder(const Log& log, const fs::path& target_folder, const LogFolderOptions& options) {
    // Removes a slash at the end, so that the path has a name and a parent.
    const fs::path normalized_target = (fs::absolute(target_folder) / "").lexically_normal().parent_path();
    require_target(normalized_target, options.overwrite);
    const StagedFolder staged(normalized_target);
    fs::create_directory(staged.path() / "scans");
    progress_for(log.frames.size(), options.progress, "writing scans", [&](std::size_t index) {
        const Frame& frame = log.frames[index];
        read::write_scan_npz(staged.path() / scan_file_name(log, frame), frame.scan, !log.rolling_shutter);
    });
    for (std::size_t l = 0; l < log.lidars.size(); ++l)
        if (log.lidars[l].pattern)
            write_text_file(staged.path() / sensor_file_name(l),
                            format_sensor_json(sensor_of(log.lidars[l])) + "\n");
    if (options.poses) write_text_file(staged.path() / read::kPosesFile, poses_text(log));
    if (!log.boxes.empty()) write_text_file(staged.path() / read::kBoxesFile, boxes_json(log));
    write_text_file(staged.path() / read::kHeadFile, sequence_json(log));
    staged.replace_folder();
}

}  // namespace relidar
