// SPDX-License-Identifier: Apache-2.0
// Reads ONCE. In the frame of the LiDAR, x points left, y back and z up. A pose has 7
// numbers: a quaternion and a position. Documents disagree whether w is the first or the
// last number of the quaternion. The reader uses the order with which the vehicle drives
// forward.
#include "read/readers.hpp"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "read/scans/stamped_log.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr const char* kSensorName = "Pandar40P";
constexpr double kMillisecond = 1e-3;
// The dataset contains only every fifth revolution.
constexpr double kRevolution_s = 0.1;
// from ONCE (x left, y back) to relidar (x forward, y left)
constexpr double kAxesTurn_rad = kPi / 2.0;
constexpr double kUnitLength = 1e-3;  // tolerance of a quaternion's length

/// Content of the JSON file of a log.
struct OnceFile {
    std::vector<read::StampedScanFile> scans;  ///< scans that exist
    std::vector<read::PoseRow> poses;
    std::size_t n_missing = 0;  ///< frames without a file
    std::size_t n_boxes = 0, n_labelled = 0;
};

/// Reads the quaternion and the position of a frame. make_lidar_track() decides whether w
/// is the first or the last number of the quaternion.
read::PoseRow read_once_pose(const JsonField& pose_field, std::int64_t stamp_ms) {
    const auto n = pose_field.numbers<7>();
    const double length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] + n[3] * n[3]);
    if (!(std::abs(length - 1.0) <= kUnitLength))
        pose_field.reject(fmt::format("found a quaternion of length {:.4g}", length),
                          "expected a quaternion of length 1");
    return {stamp_ms, {n.begin(), n.end()}, pose_field.location()};
}

/// Reads the JSON file of a log: times, poses and box labels of its frames. Boxes have no
/// track ids and cannot be used, so they are only counted for a note.
/// @param needs_poses  if true, each frame must have a pose
OnceFile read_once_json(const fs::path& json_file, const fs::path& scan_folder, bool needs_poses) {
    const std::string where = json_file.string();
    const nlohmann::json json = parse_json(read_text_file(json_file), where);
    const JsonField frames = JsonField(json, where, "").at("frames");
    OnceFile content;
    for (std::size_t i = 0; i < frames.size(); ++i) {
        // The id of a frame is its time, and the name of its scan file.
        const JsonField frame = frames.at(i), id = frame.at("frame_id");
        const std::string name = id.short_text(20);
        const auto stamp = read::parse_stamp(name);
        if (!stamp) id.reject(fmt::format("'{}'", quote(name)), "expected a time in milliseconds");
        if (!content.scans.empty() && *stamp <= content.scans.back().stamp)
            id.reject(fmt::format("found {} after {}", *stamp, content.scans.back().stamp),
                      "expected increasing times");
        content.scans.push_back({int(i), *stamp, scan_folder / (name + ".bin")});
        if (needs_poses || frame.has_member("pose"))
            content.poses.push_back(read_once_pose(frame.at("pose"), *stamp));
        if (frame.has_member("annos") && frame.at("annos").has_member("boxes_3d")) {
            content.n_boxes += frame.at("annos").at("boxes_3d").size();
            ++content.n_labelled;
        }
    }
    content.n_missing = std::erase_if(
        content.scans, [](const read::StampedScanFile& scan) { return !does_path_exist(scan.file); });
    if (content.scans.empty())
        fail("{} lists {} frames, but none of their scans is in {}, expected files MILLISECONDS.bin", where,
             frames.size(), scan_folder.string());
    return content;
}

/// Returns the LiDAR poses over time in ONCE's axes (x left, y back), as they are stored.
PoseTrack make_dataset_track(const std::vector<read::PoseRow>& poses, const read::StampedLog& stamped,
                             bool w_first) {
    PoseTrack track;
    for (const read::PoseRow& pose : poses) {
        const auto& n = pose.values;
        const glm::dquat q =
            w_first ? glm::dquat(n[0], n[1], n[2], n[3]) : glm::dquat(n[3], n[0], n[1], n[2]);
        track.append(stamped.seconds_of(pose.stamp), {glm::normalize(q), {n[4], n[5], n[6]}});
    }
    return track;
}

/// Returns the LiDAR poses over time in relidar's axes (x forward, y left). ONCE's axes
/// are x left and y back. Uses the order of quaternion numbers with which the vehicle
/// drives forward.
PoseTrack make_lidar_track(const OnceFile& dataset_content, const read::StampedLog& stamped, Notes& notes) {
    const PoseTrack w_last = make_dataset_track(dataset_content.poses, stamped, false),
                    w_first = make_dataset_track(dataset_content.poses, stamped, true);
    // share of forward (-y) motion, at most 1
    const double forward_if_last = -read::driving_direction(w_last).mean.y,
                 forward_if_first = -read::driving_direction(w_first).mean.y;
    const bool is_w_first = forward_if_first > forward_if_last;
    const double best = std::max(forward_if_first, forward_if_last);
    if (best != 0.0) read::note_driving(notes, best);  // 0: the vehicle stands still
    if (is_w_first)
        notes.push_back(
            "the quaternions of poses are read with w first, unlike in the code of ONCE, because only then "
            "the vehicle drives forward");
    // turns relidar's x by -90 degrees about z, to ONCE's -y
    const Pose once_from_relidar{make_rotation(-kAxesTurn_rad, 0.0, 0.0), {}};
    return mount_track(is_w_first ? w_first : w_last, once_from_relidar);
}

/// Returns how to read the scan files of ONCE's LiDAR, a Pandar40P. The files have no
/// rings, so the format contains the beams of the data sheet. The maximum of the scale of
/// intensities, for example 255, is estimated from a few files. Adds a note about it.
read::FileFormat make_once_format(Log& log, const std::vector<fs::path>& scan_files) {
    read::FileFormat format;
    read::set_intensity_max(format, log, scan_files);
    format.sweep_duration_s = kRevolution_s;
    format.turned_rad = kAxesTurn_rad;  // about z, from ONCE's axes to relidar's
    format.beams = std::get<SpinningSensor>(find_built_in(kSensorName)->pattern).beams;
    return format;
}

}  // namespace

/// Loads a ONCE sequence: poses and scans. ONCE's LiDAR frame has x left and y back, so
/// points and poses are rotated by 90 degrees.
Log load_once(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "a ONCE sequence (lidar_roof/ and its JSON file)");
    const fs::path folder = fs::canonical(log_folder), json = folder / (folder.filename().string() + ".json");
    const OnceFile content = read_once_json(json, folder / "lidar_roof", options.poses_file.empty());
    Log log;
    log.name = "ONCE " + folder.filename().string();
    log.source = log_folder.string();
    log.conventions =
        "LiDAR coordinates: x forward, y left, z up, in metres. relidar rotates the points of ONCE's files, "
        "which have x left and y back. Point positions are otherwise unchanged. Times are seconds after the "
        "first scan. World coordinates are the LiDAR coordinates of the first scan in ONCE's files (x left, "
        "y back).";
    log.notes = {
        content.n_boxes == 0
            ? std::string("this log has no labels")
            : fmt::format("{} boxes in {} labelled frames are ignored, because they have no track ids",
                          content.n_boxes, content.n_labelled)};
    if (content.n_missing > 0 && !options.allow_missing_scans)
        fail("{}: {} frames have no scan in lidar_roof, expected one scan per frame", json.string(),
             content.n_missing);
    if (content.n_missing > 0)
        log.notes.push_back(fmt::format("{} frames have no scan and are skipped", content.n_missing));
    read::StampedLog stamped{
        .unit_s = kMillisecond, .scans = content.scans, .world_from_vehicle = {}, .poses_file = json};
    if (options.poses_file.empty())
        stamped.world_from_vehicle = make_lidar_track(content, stamped, log.notes);
    log.lidars[0].sensor.name = fmt::format("{} fitted to {}", kSensorName, log.name);
    log.lidars[0].sensor.max_range_m = options.max_range_m;
    const std::vector<fs::path> files = read::add_frames(log, stamped, options);
    read::read_frame_scans(log, files, make_once_format(log, files), options);
    return log;
}

}  // namespace relidar
