// SPDX-License-Identifier: Apache-2.0
// Reads KITTI-360. The dataset contains poses of the IMU (x forward, y right, z down).
// The poses of the LiDAR are
//   world_from_velo = world_from_imu * imu_from_cam0 * inverse(velo_from_cam0)
// Scans are not motion-compensated. As in KITTI raw, the time of a pose is the moment
// when the head of the LiDAR faces forward.
//
// Box labels are OpenCV XML files. A standing object is one child of the root element. A
// moving object has one child per frame. The 4x4 transform maps the unit cube around the
// origin to the box in the world. Its upper 3x3 block is rotation * diag(length, width,
// height).
#include "read/datasets/kitti/kitti_360.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <pugixml.hpp>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/list_text.hpp"
#include "read/datasets/kitti/kitti_sweeps.hpp"
#include "read/datasets/kitti/log_files.hpp"
#include "read/lidar_rt_benchmark.hpp"
#include "read/readers.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar::kitti {
namespace {

/// All other classes (buildings, ground, poles) belong to the background.
struct MovableClass {
    int id;
    const char* name;
    const char* label;  ///< text label of the class, used if an object has no class number
};
constexpr MovableClass kMovableClasses[] = {
    {13, "car", "car"},           {14, "truck", "truck"},           {15, "trailer", "trailer"},
    {16, "caravan", "caravan"},   {17, "motorcycle", "motorcycle"}, {18, "bicycle", "bicycle"},
    {19, "person", "pedestrian"}, {20, "rider", "rider"},           {34, "bus", "bus"},
};

/// Reads an integer from an XML element, or returns `default_value` if the element is
/// missing or empty.
/// @throws DataError if the text is not an integer
int read_int(const pugi::xml_node& object, const char* field_name, std::optional<int> default_value,
             const std::string& where) {
    constexpr double kMaxValue = 1e8;
    const std::string text = object.child_value(field_name);
    if (text.empty() && default_value) return *default_value;
    const auto value = parse_number(trim(text));
    if (!value || !(std::abs(*value) < kMaxValue) || *value != std::floor(*value))
        fail("{}: {} is '{}', expected a whole number", where, field_name, quote(text));
    return int(*value);
}

/// Returns null for classes that cannot move. Drive 0004 has labels, but no numbers.
const MovableClass* find_movable(const pugi::xml_node& object, const std::string& where) {
    const bool has_number = !object.child("semanticId").empty();
    const int id = has_number ? read_int(object, "semanticId", {}, where) : 0;
    const std::string_view label = trim(object.child_value("label"));
    for (const MovableClass& movable_class : kMovableClasses)
        if (has_number ? id == movable_class.id : label == movable_class.name || label == movable_class.label)
            return &movable_class;
    return nullptr;
}

/// Reads the 4x4 transform of an object from a unit cube to the world. The transform
/// contains the pose and the size of the object.
glm::dmat4 read_transform(const pugi::xml_node& object, const std::string& where) {
    const pugi::xml_node matrix = object.child("transform");
    const int rows = read_int(matrix, "rows", {}, where + ": transform"),
              cols = read_int(matrix, "cols", {}, where + ": transform");
    const auto numbers = parse_numbers(matrix.child_value("data"));
    if (rows != 4 || cols != 4 || !numbers || numbers->size() != 16)
        fail(
            "{}: transform has {} rows and {} columns and contains {}, expected a matrix with 4 rows, 4 "
            "columns and 16 numbers",
            where, rows, cols,
            numbers ? fmt::format("{} numbers", numbers->size()) : "words that are not numbers");
    constexpr double kMaxValue = 1e8;
    glm::dmat4 m;
    for (int i = 0; i < 16; ++i) {
        const double value = (*numbers)[std::size_t(i)];
        if (!(std::abs(value) <= kMaxValue))
            fail("{}: number {} of the matrix transform is {}, expected a number from {:.0e} to {:.0e}",
                 where, i + 1, value, -kMaxValue, kMaxValue);
        m[i % 4][i / 4] = value;  // the file has rows, a glm matrix has columns
    }
    return m;
}

/// Computes the size and the pose of a box from its transform. If the transform contains
/// a reflection, flips the width axis, which makes the rotation of the same box valid.
void set_box(BoxLabel& label, const glm::dmat4& world_from_unit_box, const std::string& where) {
    glm::dmat3 axes(world_from_unit_box);
    label.size_m = {glm::length(axes[0]), glm::length(axes[1]), glm::length(axes[2])};
    for (int c = 0; c < 3; ++c) axes[c] /= label.size_m[c];
    if (glm::determinant(axes) < 0.0) axes[1] = -axes[1];
    label.world_from_box = make_pose(axes, glm::dvec3(world_from_unit_box[3]), where + ": transform");
}

/// Returns the track id of an object: semanticId * 1000 + instanceId. Objects of drive
/// 0004 have no such numbers, so their id consists of class, "moving" and index.
std::string make_track_id(const pugi::xml_node& object, const MovableClass& movable_class, bool is_moving,
                          const std::string& where) {
    if (object.child("instanceId").empty())
        return fmt::format("{}-{}{}", movable_class.name, is_moving ? "moving-" : "",
                           read_int(object, is_moving ? "dynamicSeq" : "index", {}, where));
    return std::to_string(movable_class.id * 1000LL + read_int(object, "instanceId", {}, where));
}

using LabelsByFrame = std::map<int, BoxLabel>;

/// Adds the labels of one object element to the tracks. An element is a moving object in
/// one frame (timestamp), or a standing object in a range of frames (timestamp -1). Skips
/// classes that cannot move.
/// @param frames  loaded frames, sorted by number; only they get labels
void add_object_labels(const pugi::xml_node& object, const std::vector<Frame>& frames,
                       std::map<std::string, LabelsByFrame>& labels_by_track_id, const std::string& where) {
    const MovableClass* movable_class = find_movable(object, where);
    if (!movable_class || object.child("transform").empty()) return;
    const int timestamp = read_int(object, "timestamp", -1, where);
    const bool is_moving = timestamp >= 0;
    const int first = is_moving ? timestamp : read_int(object, "start_frame", {}, where);
    const int last = is_moving ? timestamp : read_int(object, "end_frame", {}, where);
    BoxLabel label;
    label.id = make_track_id(object, *movable_class, is_moving, where);
    label.category = movable_class->name;
    set_box(label, read_transform(object, where), where);
    for (auto frame = std::ranges::lower_bound(frames, first, {}, &Frame::index);
         frame != frames.end() && frame->index <= last; ++frame) {
        LabelsByFrame& track = labels_by_track_id[label.id];
        if (!track.empty() && track.begin()->second.category != label.category)
            fail(
                "{}: found class {} for track {}, which has class {} in another frame, expected one class "
                "per track",
                where, label.category, label.id, track.begin()->second.category);
        label.time_s = frame->time_s;
        track.emplace(frame->index, label);
    }
}

}  // namespace

std::vector<BoxTrack> read_360_boxes(const std::filesystem::path& label_file,
                                     const std::vector<Frame>& frames) {
    pugi::xml_document document;
    const std::string text = read_text_file(label_file);
    const pugi::xml_parse_result parsed = document.load_buffer(text.data(), text.size());
    if (!parsed)
        fail("{}: malformed XML at byte {}: {}", label_file.string(), parsed.offset, parsed.description());
    const pugi::xml_node root = document.child("opencv_storage");
    if (!root)
        fail("{}: the element opencv_storage is missing, expected the boxes of KITTI-360",
             label_file.string());
    std::map<std::string, LabelsByFrame> tracks;
    for (const pugi::xml_node& object : root.children())
        add_object_labels(object, frames, tracks,
                          fmt::format("{}: {}", label_file.string(), quote(object.name())));
    std::vector<BoxLabel> labels;
    for (const auto& [id, track] : tracks)
        for (const auto& [frame, label] : track) labels.push_back(label);
    return build_tracks(labels);
}

}  // namespace relidar::kitti

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace kitti;

std::vector<std::string> list_drives(const fs::path& folder) {
    std::vector<std::string> names;
    for (const fs::path& drive : list_folder(folder))
        if (does_path_exist(drive / "velodyne_points")) names.push_back(drive.filename().string());
    if (names.empty())
        fail("{}: found no drive, expected folders *_drive_*_sync/velodyne_points", folder.string());
    return names;
}

/// Selects the drive that the setting dataset.sequence names, or the first drive. The
/// setting may also name a part of the benchmark of the LiDAR-RT paper (ks1, kd1, ...),
/// which is a range of frames of a drive.
DriveFrames choose_360_drive(const fs::path& folder, const DatasetOptions& options) {
    const std::vector<std::string> drives = list_drives(folder);
    // A drive has a name such as 2013_05_28_drive_0000_sync.
    const auto is_called = [](const std::string& drive, const std::string& name) {
        return drive == name || drive.find("_drive_" + name + "_") != std::string::npos;
    };
    if (const auto drive = choose_drive(drives, "drives", options, kKitti360Benchmark, is_called))
        return *drive;
    fail<UsageError>(
        "dataset.sequence: found '{}', expected the name or number of a drive in {} ({}), or ks1 to ks4 or "
        "kd1 to kd6, which are the static and dynamic parts of drive 0000 in the LiDAR-RT paper",
        quote(options.sequence), folder.string(), quote(fmt::format("{}", fmt::join(drives, ", "))));
}

/// Returns the LiDAR poses in the world frame, by frame number. Some frames have no pose.
/// The dataset has IMU poses, which the calibrations of both sensors to camera 0 convert.
std::map<int, Pose> read_lidar_poses(const fs::path& dataset_folder, const std::string& drive_name) {
    const fs::path calibration = dataset_folder / "calibration";
    const Pose imu_from_cam0 = read_transform(calibration / "calib_cam_to_pose.txt", "image_00");
    // This file contains a single line of 12 numbers.
    const Pose velo_from_cam0 = read::read_matrices(calibration / "calib_cam_to_velo.txt", {0}).front();
    std::map<int, Pose> poses = read_numbered_poses(dataset_folder / "data_poses" / drive_name / "poses.txt");
    for (auto& [frame, pose] : poses) pose = pose * imu_from_cam0 * inverse(velo_from_cam0);
    return poses;
}

/// Returns the pose of a frame. Interpolates a missing pose if its neighbours are at most
/// five frames (half a second) apart, or if the car stands still. Does not extrapolate.
std::optional<Pose> pose_of_frame(const std::map<int, Pose>& poses_by_frame, int frame_number) {
    constexpr int kMaxFrameGap = 5;
    constexpr double kMaxStandingMotion_m = 0.2;
    const auto next = poses_by_frame.lower_bound(frame_number);
    if (next == poses_by_frame.end()) return std::nullopt;
    if (next->first == frame_number) return next->second;
    if (next == poses_by_frame.begin()) return std::nullopt;
    const auto& [before, pose_before] = *std::prev(next);
    const auto& [after, pose_after] = *next;
    const bool is_standing =
        glm::distance(pose_before.translation, pose_after.translation) <= kMaxStandingMotion_m;
    if (after - before > kMaxFrameGap && !is_standing) return std::nullopt;
    return interpolate(pose_before, pose_after, double(frame_number - before) / (after - before));
}

/// Adds all frames with a pose to the log. Notes name interpolated and missing poses.
void add_posed_frames(Log& log, const std::vector<int>& numbers, const std::vector<double>& times_s,
                      const std::map<int, Pose>& poses_by_frame) {
    std::vector<int> interpolated, without_pose;
    for (std::size_t i = 0; i < numbers.size(); ++i) {
        const std::optional<Pose> pose = pose_of_frame(poses_by_frame, numbers[i]);
        if (pose) add_frame(log, numbers[i], times_s[i], *pose);
        if (!pose) without_pose.push_back(numbers[i]);
        else if (!poses_by_frame.contains(numbers[i])) interpolated.push_back(numbers[i]);
    }
    if (log.frames.empty())
        fail("{}: none of the frames {} to {} has a pose, expected frames between {} and {}", log.name,
             numbers.front(), numbers.back(), poses_by_frame.begin()->first, poses_by_frame.rbegin()->first);
    if (!interpolated.empty())
        log.notes.push_back(fmt::format(
            "poses of these frames are interpolated, because data_poses does not contain them: {}",
            list_text(interpolated)));
    if (!without_pose.empty())
        log.notes.push_back(
            fmt::format("frames that are skipped, because they have no pose: {}", list_text(without_pose)));
}

/// Returns the file with the boxes of a drive, or an empty path if the dataset has none.
/// Prefers the folder train_full to the smaller folder train.
fs::path find_box_file(const fs::path& dataset_folder, const std::string& drive_name) {
    for (const char* set : {"train_full", "train"}) {
        const fs::path file = dataset_folder / "data_3d_bboxes" / set / (drive_name + ".xml");
        if (does_path_exist(file)) return file;
    }
    return {};
}

/// Adds the frames, poses and boxes of a drive. Boxes are in the world of the dataset, so
/// they are omitted if the user gives poses and the dataset has none.
void add_kitti_360_frames(Log& log, const fs::path& dataset_folder, const DriveFrames& chosen,
                          const std::vector<int>& numbers, const fs::path& user_pose_file) {
    const std::vector<double> time_s = read_frame_times(
        dataset_folder / "data_3d_raw" / chosen.drive / "velodyne_points/timestamps.txt", numbers, log);
    const bool has_poses = does_path_exist(dataset_folder / "data_poses" / chosen.drive);
    if (!user_pose_file.empty() && !has_poses) {
        // The caller replaces these poses by those of the user.
        for (std::size_t i = 0; i < numbers.size(); ++i) add_frame(log, numbers[i], time_s[i], Pose{});
        log.notes.push_back("data_poses is missing, so the boxes are not read");
        return;
    }
    add_posed_frames(log, numbers, time_s, read_lidar_poses(dataset_folder, chosen.drive));
    const fs::path box_file = find_box_file(dataset_folder, chosen.drive);
    if (box_file.empty()) log.notes.push_back("data_3d_bboxes is missing, so this drive has no labels");
    else log.boxes = read_360_boxes(box_file, log.frames);
}

}  // namespace

/// Loads a drive of KITTI-360: times, poses, boxes and scans.
Log load_kitti_360(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "KITTI-360 (data_3d_raw/, data_poses/, calibration/)");
    const fs::path folder = fs::canonical(log_folder);
    const DriveFrames chosen = choose_360_drive(folder / "data_3d_raw", options);
    const fs::path points = folder / "data_3d_raw" / chosen.drive / "velodyne_points";
    const std::vector<int> frames = list_scans(points / "data", chosen.frames.begin, chosen.frames.end);

    Log log;
    log.name = chosen.drive;
    log.source = log_folder.string();
    log.conventions =
        "Sensor frame: x forward, y left, z up, in metres. Times are seconds after the first sweep of the "
        "drive. At the time of a frame, the head faces forward. World frame: x east, y north, z up "
        "(Mercator). Scans are not motion-compensated.";
    log.notes = chosen.notes;
    log.test_frames = chosen.test_frames;
    note_missing_scans(log, points / "data", frames, options.allow_missing_scans);
    log.lidars[0].sensor.period_s = read_time_step_s(points / "timestamps.txt");
    add_kitti_360_frames(log, folder, chosen, frames, options.poses_file);
    read::replace_poses(log, options);
    centre_log(log);
    constexpr int kFileNameDigits = 10;
    read_hdl64_sweeps(log, points / "data", kFileNameDigits, options);
    return log;
}

}  // namespace relidar
