// SPDX-License-Identifier: Apache-2.0
// Reads the layouts of KITTI's tracking and object benchmarks, which View-of-Delft and
// `relidar render --layout kitti` have, too. Labels are in the rectified camera, which
// has the axes right, down, forward. A label has the centre of the lower face of its box,
// and the angle of its forward axis about the axis down.
#include "read/readers.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <map>
#include <sstream>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/camera.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/frames/labelled_azimuth.hpp"
#include "read/datasets/kitti/kitti_sweeps.hpp"
#include "read/datasets/kitti/log_files.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace kitti;

constexpr double kFrameStep_s = 0.1;  // KITTI's LiDAR turns ten times per second

/// Returns the first folder with scans, so that users can give the folder of the dataset
/// or of a split.
fs::path find_split(const fs::path& folder, std::initializer_list<const char*> splits) {
    for (const char* split : splits)
        if (does_path_exist(folder / split / "velodyne")) return fs::canonical(folder / split);
    fail("{}: found no folder velodyne, expected it in this folder or in its folder training",
         folder.string());
}

/// Returns the text after the first key that a calibration file has. The keys of the
/// tracking benchmark have no colon.
std::pair<std::string, std::string> find_line(const fs::path& file, std::initializer_list<std::string> keys) {
    for (const std::string& line : split_lines(read_text_file(file)))
        for (const std::string& key : keys)
            if (line.starts_with(key + ":") || line.starts_with(key + " "))
                return {line.substr(key.size() + 1), fmt::format("{} key {}", file.string(), key)};
    fail("{}: the line '{}' is missing, expected this key and numbers", file.string(),
         fmt::join(keys, "' or '"));
}

Pose read_velo_to_camera(const fs::path& file) {
    const auto [text, where] = find_line(file, {"R_rect", "R0_rect"});
    const std::vector<double> r = read::parse_finite(text, 9, where);
    const auto [matrix, place] = find_line(file, {"Tr_velo_cam", "Tr_velo_to_cam"});
    // dmat3 expects columns, but the file contains rows.
    return make_pose(glm::dmat3(r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]), {}, where) *
           read::parse_pose(matrix, place);
}

/// Returns the azimuths that camera 2 sees, in whose view KITTI labels objects. Nothing
/// if the calibration has no such camera, so that labels are not known to end there.
std::optional<AzimuthInterval> read_labelled_azimuth(const fs::path& file) {
    constexpr double kMinFocal_px = 10.0;
    const std::string text = read_text_file(file);
    if (!text.starts_with("P2:") && text.find("\nP2:") == std::string::npos) return {};
    const auto [line, where] = find_line(file, {"P2"});
    std::array<double, 12> projection;
    std::ranges::copy(read::parse_finite(line, projection.size(), where), projection.begin());
    if (std::min(projection[0], projection[5]) < kMinFocal_px) return {};
    Camera camera = make_camera("image_2", projection, read_velo_to_camera(file));
    camera.columns = kitti_camera().columns;  // the calibration does not have the size
    camera.rows = kitti_camera().rows;
    const AzimuthInterval azimuths = view_azimuths(camera);
    return azimuths.right_rad < azimuths.left_rad ? std::optional(azimuths) : std::nullopt;
}

/// Parses a line of label_02: frame, track, type, truncation, occlusion, alpha, four
/// numbers of an image box, height, width, length, three numbers of the position, angle,
/// and perhaps a score. Adds a label if the log has the frame.
void add_track_label(const std::string& line, const std::string& where, const Log& log,
                     const Pose& velo_from_camera, std::vector<BoxLabel>& labels) {
    std::istringstream words(line);
    std::string frame, track, type, rest;
    words >> frame >> track >> type;
    std::getline(words, rest);
    if (type == "DontCare" || trim(line).empty()) return;
    const std::optional<int> number = parse_stem(frame);
    const auto v = parse_numbers(rest);
    if (!number || !v || v->size() < 14 || v->size() > 15 ||
        !std::ranges::all_of(*v, [](double value) { return std::isfinite(value); }))
        fail("{}: found '{}', expected a frame, a track, a type and 14 or 15 finite numbers", where,
             quote(line));
    const auto match = std::ranges::lower_bound(log.frames, *number, {}, &Frame::index);
    if (match == log.frames.end() || match->index != *number) return;
    BoxLabel label{track, type, {(*v)[9], (*v)[8], (*v)[7]}, match->time_s, {}};
    const double angle = (*v)[13];
    const glm::dvec3 forward = velo_from_camera.rotation * glm::dvec3(std::cos(angle), 0.0, -std::sin(angle)),
                     bottom = velo_from_camera * glm::dvec3((*v)[10], (*v)[11], (*v)[12]);
    const Pose velo_from_box{make_rotation(std::atan2(forward.y, forward.x), 0.0, 0.0),
                             bottom + glm::dvec3(0.0, 0.0, 0.5 * label.size_m.z)};
    label.world_from_box = log.world_from_vehicle.pose_at(match->time_s) * velo_from_box;
    labels.push_back(std::move(label));
}

std::vector<BoxTrack> read_track_labels(const fs::path& file, const fs::path& calibration, const Log& log) {
    const Pose velo_from_camera = inverse(read_velo_to_camera(calibration));
    std::vector<BoxLabel> labels;
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    for (std::size_t l = 0; l < lines.size(); ++l)
        add_track_label(lines[l], fmt::format("{} line {}", file.string(), l + 1), log, velo_from_camera,
                        labels);
    std::ranges::stable_sort(labels, {}, &BoxLabel::time_s);
    return build_tracks(labels);
}

/// Creates a log with the frames of a folder.
/// @param poses  [frames] of the LiDAR; empty if the dataset has none
/// @param times  file with a time in seconds for each frame; may not exist
Log make_log(const std::string& name, const fs::path& source, const std::vector<int>& frames,
             const std::vector<Pose>& poses, const DatasetOptions& options, const fs::path& times = {}) {
    Log log;
    log.name = name;
    log.source = source.string();
    const bool has_times = !times.empty() && does_path_exist(times);
    std::vector<double> time_s;
    for (const int frame : frames) time_s.push_back(kFrameStep_s * frame);
    if (has_times) time_s = read_times_s(times, frames);
    log.conventions = "Sensor frame: x forward, y left, z up, in metres. ";
    log.conventions += has_times
                           ? "Times are the seconds in " + times.filename().string() + "."
                           : fmt::format("The dataset has no times, so frames are {} s apart.", kFrameStep_s);
    log.has_poses = !poses.empty() || !options.poses_file.empty();
    if (!log.has_poses)
        log.notes.push_back(
            "the dataset has no poses; they must be estimated from the scans, like with dataset.poses=none");
    for (std::size_t i = 0; i < frames.size(); ++i)
        add_frame(log, frames[i], time_s[i], poses.empty() ? Pose{} : poses[i]);
    read::replace_poses(log, options);
    centre_log(log);
    return log;
}

/// Returns the name of the sequence that the user requests, or of the first.
std::string choose_sequence(const fs::path& points, const std::string& requested, Notes& notes) {
    std::vector<std::string> names;
    for (const fs::path& sequence : list_folder(points))
        if (fs::is_directory(sequence)) names.push_back(sequence.filename().string());
    if (names.empty()) fail("{}: found no folder of a sequence, expected folders like 0000", points.string());
    if (requested.empty() && names.size() > 1)
        notes.push_back(fmt::format("sequence {} of {} is read; dataset.sequence selects another", names[0],
                                    names.size()));
    if (requested.empty()) return names[0];
    for (const std::string& name : names)
        if (name == requested || (parse_stem(name) && parse_stem(name) == parse_stem(requested))) return name;
    fail<UsageError>("dataset.sequence: found '{}', expected the name of a sequence in {} ({})",
                     quote(requested), points.string(), quote(fmt::format("{}", fmt::join(names, ", "))));
}

/// Reads a pose of View-of-Delft: lines of JSON with matrices that place the camera.
Pose read_camera_pose(const fs::path& file) {
    const std::string text = read_text_file(file), key = "\"odomToCamera\"";
    const std::size_t at = text.find(key), begin = text.find('[', at), end = text.find(']', begin);
    if (at == std::string::npos || end == std::string::npos)
        fail("{}: {} is missing, expected this key with 16 numbers", file.string(), key);
    std::string numbers = text.substr(begin + 1, end - begin - 1);
    std::ranges::replace(numbers, ',', ' ');
    return make_pose(read::parse_finite(numbers, 16, file.string() + " " + key), file.string());
}

}  // namespace

Log load_kitti_tracking(const fs::path& folder, const DatasetOptions& options) {
    const fs::path split = find_split(folder, {"tracking/training", "", "training", "testing"});
    Notes notes;
    const std::string sequence = choose_sequence(split / "velodyne", options.sequence, notes);
    const fs::path points = split / "velodyne" / sequence, oxts = split / "oxts" / (sequence + ".txt"),
                   labels = split / "label_02" / (sequence + ".txt"),
                   calibration = split / "calib" / (sequence + ".txt");
    const std::vector<int> frames = list_scans(points, options.frames.begin, options.frames.end);
    const bool has_oxts = does_path_exist(oxts) && options.poses_file.empty();
    OxtsTrack track;
    if (has_oxts) {
        const auto [matrix, where] = find_line(calibration, {"Tr_imu_velo", "Tr_imu_to_velo"});
        track = read_oxts_lines(oxts, frames, inverse(read::parse_pose(matrix, where)));
    }
    Log log = make_log("KITTI tracking " + sequence, folder, frames, track.poses, options,
                       split / "times" / (sequence + ".txt"));
    log.notes.insert(log.notes.begin(), notes.begin(), notes.end());
    note_missing_scans(log, points, frames, options.allow_missing_scans);
    if (has_oxts) log.georeference = track.place;
    if (does_path_exist(labels)) {
        log.boxes = read_track_labels(labels, calibration, log);
        log.labelled_azimuth = read_labelled_azimuth(calibration);
    } else log.notes.push_back(fmt::format("{} is missing, so this sequence has no labels", labels.string()));
    read_kitti_sweeps(log, points, options, /*hdl64_is_moved=*/false);
    return log;
}

Log load_kitti_object(const fs::path& folder, const DatasetOptions& options) {
    const fs::path split = find_split(folder, {"", "training", "testing", "lidar/training"});
    const fs::path points = split / "velodyne";
    const std::vector<int> frames = list_scans(points, options.frames.begin, options.frames.end);
    std::vector<Pose> poses;
    for (const fs::path& scan : list_folder(points)) {
        const std::optional<int> number = parse_stem(scan.stem().string());
        if (!number || !std::ranges::binary_search(frames, *number) || !options.poses_file.empty()) continue;
        if (!does_path_exist(split / "pose")) break;
        const std::string name = scan.stem().string();
        poses.push_back(read_camera_pose(split / "pose" / (name + ".json")) *
                        read_velo_to_camera(split / "calib" / (name + ".txt")));
    }
    Log log = make_log("KITTI object " + split.filename().string(), folder, frames, poses, options);
    note_missing_scans(log, points, frames, options.allow_missing_scans);
    if (does_path_exist(split / "label_2"))
        log.notes.push_back("the labels of this layout have no track ids, so no boxes are read");
    // View-of-Delft moves the points.
    read_kitti_sweeps(log, points, options, /*hdl64_is_moved=*/does_path_exist(split / "pose"));
    return log;
}

}  // namespace relidar
