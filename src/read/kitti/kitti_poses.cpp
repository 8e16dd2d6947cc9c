// SPDX-License-Identifier: Apache-2.0
// Reads the poses and the calibration of a KITTI raw drive. Poses are read from a file
// with 12 numbers per line, or are computed from GPS/IMU data (OXTS):
//   x = s R lon, y = s R ln tan(pi/4 + lat/2), z = alt,  s = cos(first latitude),
//   R = 6378137 m,  rotation R_z(yaw) R_y(pitch) R_x(roll)
#include "base/fail.hpp"
#include "read/kitti/log_files.hpp"
#include "read/scans/folder_head.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>
#include "base/files.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

std::vector<double> parse_finite(const std::string& line, std::size_t count, const std::string& place) {
    const auto numbers = parse_numbers(line);
    if (!numbers) fail("{}: found a word that is not a number, expected {} numbers", place, count);
    if (numbers->size() != count) fail("{}: found {} numbers, expected {}", place, numbers->size(), count);
    for (std::size_t i = 0; i < count; ++i)
        if (!std::isfinite((*numbers)[i]))
            fail("{}: number {} is {}, expected a finite value", place, i + 1, (*numbers)[i]);
    return *numbers;
}

Pose parse_pose(const std::string& line, const std::string& place) {
    return make_pose(parse_finite(line, 12, place), place);
}

fs::path oxts_path(const fs::path& drive, int frame_number) {
    return drive / "oxts/data" / fmt::format("{:010d}.txt", frame_number);
}

/// Reads the 30 numbers of a GPS/IMU file. The first are latitude, longitude and height.
std::vector<double> read_oxts(const fs::path& oxts_file) {
    const std::vector<std::string> lines = split_lines(read_text_file(oxts_file));
    const std::vector<double> v = parse_finite(lines.empty() ? "" : lines[0], 30, oxts_file.string());
    if (std::abs(v[0]) > 89.0 || std::abs(v[1]) > 360.0)
        fail("{}: found the latitude {} and the longitude {}, expected angles in degrees", oxts_file.string(),
             v[0], v[1]);
    return v;
}

constexpr double kEarthRadius_m = 6378137.0;

/// Reads the pose of the IMU in one frame. The position is in Mercator coordinates, whose
/// origin is at latitude and longitude 0.
/// @param mercator_scale  set from the latitude of the first file that is read
Pose read_imu_pose(const fs::path& oxts_file, std::optional<double>& mercator_scale) {
    const std::vector<double> v = read_oxts(oxts_file);
    const double lat = v[0] * kPi / 180.0, lon = v[1] * kPi / 180.0;
    if (!mercator_scale) mercator_scale = std::cos(lat);
    return {make_rotation(v[5], v[4], v[3]),
            {*mercator_scale * kEarthRadius_m * lon,
             *mercator_scale * kEarthRadius_m * std::log(std::tan(kPi / 4 + lat / 2)), v[2]}};
}

/// Returns the first frame with a GPS/IMU file (OXTS). It defines the origin and scale of
/// all poses, so that poses do not depend on the requested frames.
int find_first_oxts(const fs::path& drive) {
    const fs::path folder = drive / "oxts/data";
    if (does_path_exist(folder))
        for (const fs::path& file : list_folder(folder)) {
            const auto number = parse_stem(file.stem().string());
            if (file.extension() == ".txt" && number) return *number;
        }
    fail(
        "{}: the OXTS files (0000000000.txt) are missing, so the drive has no poses; use dataset.poses=FILE, "
        "or dataset.poses=none to estimate the poses from the scans",
        folder.string());
}

/// Returns the path of calib_imu_to_velo.txt for a drive. Searches the folder of the
/// drive, two folders above it, and their calibration folders.
fs::path find_imu_file(const fs::path& drive) {
    const char* name = "calib_imu_to_velo.txt";
    // date in a name such as 2011_09_26_drive_0005_sync
    const std::string date = drive.filename().string().substr(0, 10);
    for (const fs::path& base : {drive.parent_path(), drive, drive.parent_path().parent_path()}) {
        for (const fs::path& inner : {fs::path(), fs::path("calib"), fs::path("calibration"), fs::path(date),
                                      fs::path(date + "_calib"), fs::path(date + "_calib") / date}) {
            if (does_path_exist(base / inner / name)) return base / inner / name;
        }
    }
    fail(
        "{}: no such file, and it was not found in the folder of the drive or in a folder calib, calibration "
        "or {}_calib either; copy KITTI's calibration file of that day to this path, or use "
        "dataset.poses=FILE",
        (drive.parent_path() / name).string(), date);
}

}  // namespace

Pose read_calibration(const fs::path& file) {
    std::vector<double> r, t;
    for (const std::string& line : split_lines(read_text_file(file))) {
        const std::string where = file.string();
        if (line.rfind("R:", 0) == 0) r = parse_finite(line.substr(2), 9, where + " key R");
        if (line.rfind("T:", 0) == 0) t = parse_finite(line.substr(2), 3, where + " key T");
    }
    if (r.empty() || t.empty())
        fail(
            "{}: the line that begins with '{}:' is missing, expected a line 'R:' with 9 numbers and a line "
            "'T:' with 3 numbers",
            file.string(), r.empty() ? "R" : "T");
    // dmat3 expects columns, but the file contains rows.
    return make_pose(glm::dmat3(r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]), {t[0], t[1], t[2]},
                     file.string());
}

Pose read_transform(const fs::path& file, const std::string& key) {
    for (const std::string& line : split_lines(read_text_file(file)))
        if (line.rfind(key + ":", 0) == 0)
            return parse_pose(line.substr(key.size() + 1), fmt::format("{} key {}", file.string(), key));
    fail("{}: the line '{}:' is missing, expected this key with 12 numbers", file.string(), key);
}

std::vector<Pose> read_oxts_poses(const fs::path& drive, const std::vector<int>& frame_numbers) {
    // read_imu_pose() sets the scale of all poses from the first file of the drive.
    std::optional<double> scale;
    const glm::dvec3 origin = read_imu_pose(oxts_path(drive, find_first_oxts(drive)), scale).translation;
    const Pose imu_from_sensor = inverse(read_calibration(find_imu_file(drive)));
    std::vector<Pose> poses;
    for (const int frame : frame_numbers) {
        Pose world_from_imu = read_imu_pose(oxts_path(drive, frame), scale);
        world_from_imu.translation -= origin;
        poses.push_back(world_from_imu * imu_from_sensor);
    }
    return poses;
}

Georeference read_oxts_place(const fs::path& drive) {
    const fs::path file = oxts_path(drive, find_first_oxts(drive));
    const std::vector<double> v = read_oxts(file);
    std::optional<double> scale;
    const glm::dvec3 origin_m = read_imu_pose(file, scale).translation;
    return {{v[0], v[1], v[2]},
            {},
            fmt::format("+proj=merc +R={} +lat_ts={} +x_0={} +y_0={}", kEarthRadius_m, v[0], -origin_m.x,
                        -origin_m.y)};
}

std::vector<FrameLine> read_frame_lines(const fs::path& file, const std::vector<int>& frame_numbers) {
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    std::vector<FrameLine> of_frames;
    for (const int frame : frame_numbers) {
        const std::size_t line = std::size_t(frame);
        if (line >= lines.size())
            fail("{}: found {} lines, but frame {} needs line {}", file.string(), lines.size(), frame,
                 line + 1);
        of_frames.push_back({lines[line], fmt::format("{} line {}", file.string(), line + 1)});
    }
    return of_frames;
}

std::vector<Pose> read_matrices(const fs::path& pose_file, const std::vector<int>& frame_numbers) {
    std::vector<Pose> poses;
    for (const auto& [text, where] : read_frame_lines(pose_file, frame_numbers))
        poses.push_back(parse_pose(text, where));
    return poses;
}

void replace_poses(Log& sequence, const fs::path& pose_file, const read::ScanPairReader& read_scan_pairs) {
    if (pose_file.empty()) return;
    PoseTrack user_track{sequence.world_from_vehicle.time_s,
                         std::vector<Pose>(sequence.world_from_vehicle.time_s.size())};
    if (pose_file == kNoPoses) {
        sequence.notes.push_back(kNoPosesNote);
    } else {
        // LiDARs share the pose of a sweep, as in add_frame().
        std::vector<read::LogFrame> heads;
        for (const Frame& frame : sequence.frames)
            if (heads.empty() || heads.back().time_s != frame.time_s)
                heads.push_back({frame.index, frame.time_s, frame.lidar, {}});
        auto poses = read::load_poses(pose_file, heads, read_scan_pairs, sequence.notes);
        if (!poses) fail("{}: no such file, expected poses (dataset.poses)", pose_file.string());
        user_track.pose = std::move(*poses);
        user_track = shift_track(std::move(user_track), -sequence.world_offset_m);
    }
    set_trajectory(sequence, std::move(user_track));
}

std::map<int, Pose> read_numbered_poses(const fs::path& file) {
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    std::map<int, Pose> by_frame;
    for (std::size_t l = 0; l < lines.size(); ++l) {
        const std::string where = fmt::format("{} line {}", file.string(), l + 1);
        const std::string_view line = trim(lines[l]);
        const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
        const std::optional<int> frame = parse_stem(std::string(line.substr(0, end)));
        if (!frame || (!by_frame.empty() && *frame <= by_frame.rbegin()->first))
            fail("{}: found the frame '{}', expected increasing frame numbers", where,
                 quote(line.substr(0, end)));
        by_frame.emplace(*frame, parse_pose(std::string(line.substr(end)), where));
    }
    if (by_frame.empty())
        fail("{}: the file is empty, expected a frame number and 12 numbers per line", file.string());
    return by_frame;
}

}  // namespace relidar::kitti
