// SPDX-License-Identifier: Apache-2.0
// Reads the poses and the calibration of a KITTI raw drive. Poses are read from a file
// with 12 numbers per line, or are computed from GPS/IMU data (OXTS):
//   x = s R lon, y = s R ln tan(pi/4 + lat/2), z = alt,  s = cos(first latitude), R = 6378137 m,
//   rotation R_z(yaw) R_y(pitch) R_x(roll)
#include "log/clouds/folder_head.hpp"
#include "log/clouds/log_files.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/clouds.hpp>
#include <relidar/log/dataset.hpp>
#include "base/files.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

// Maximum coordinate of a pose in metres. UTM coordinates are smaller (up to 10^7).
constexpr double kLargestCoordinate_m = 1e8;
// Maximum distance between two poses of a log. Farther points would get wrong keys of
// grid cells, which are unique up to 105 km (base/cell_key.hpp).
constexpr double kLongestLog_m = 1e5;

/// Checks that the positions of all poses are plausible.
/// @throws DataError if a coordinate is too large, or if a position is too far from the
/// first position
void check_extent(const std::vector<Pose>& poses, const std::vector<int>& frames,
                  const std::string& location) {
    for (std::size_t i = 0; i < poses.size(); ++i) {
        const glm::dvec3 t = poses[i].translation, step = t - poses[0].translation;
        if (std::max({std::abs(t.x), std::abs(t.y), std::abs(t.z)}) > kLargestCoordinate_m)
            throw DataError(
                fmt::format("{}: the pose of frame {} is at ({}, {}, {}), expected coordinates of at most "
                            "{} m",
                            location, frames[i], t.x, t.y, t.z, kLargestCoordinate_m));
        if (glm::length(step) > kLongestLog_m)
            throw DataError(fmt::format(
                "{}: the poses of frames {} and {} are {:.6g} m apart, expected at most {} m within a drive",
                location, frames[0], frames[i], glm::length(step), kLongestLog_m));
    }
}

std::vector<double> parse_finite_numbers(const std::string& line, std::size_t count,
                                         const std::string& location) {
    const auto numbers = parse_numbers(line);
    if (!numbers)
        throw DataError(
            fmt::format("{}: found a word that is not a number, expected {} numbers", location, count));
    if (numbers->size() != count)
        throw DataError(fmt::format("{}: found {} numbers, expected {}", location, numbers->size(), count));
    for (std::size_t i = 0; i < count; ++i) {
        if (!std::isfinite((*numbers)[i])) {
            throw DataError(
                fmt::format("{}: number {} is {}, expected a finite value", location, i + 1, (*numbers)[i]));
        }
    }
    return *numbers;
}

/// Parses a 3x4 matrix, row-major.
Pose parse_matrix(const std::string& line, const std::string& location) {
    const std::vector<double> m = parse_finite_numbers(line, 12, location);
    return make_rigid_pose(glm::dmat3(m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]),
                           {m[3], m[7], m[11]}, location);
}

fs::path get_oxts_file(const fs::path& drive, int frame) {
    return drive / "oxts/data" / fmt::format("{:010d}.txt", frame);
}

/// Reads the pose of the IMU in one frame, in Mercator coordinates relative to latitude
/// and longitude 0.
Pose read_oxts(const fs::path& file, std::optional<double>& scale) {
    const std::vector<std::string> lines = split_lines(read_text(file));
    const std::vector<double> v = parse_finite_numbers(lines.empty() ? "" : lines[0], 30, file.string());
    if (std::abs(v[0]) > 89.0 || std::abs(v[1]) > 360.0) {
        throw DataError(fmt::format("{}: found the latitude {} and the longitude {}, expected degrees",
                                    file.string(), v[0], v[1]));
    }
    constexpr double kEarthRadius_m = 6378137.0;
    const double lat = v[0] * kPi / 180.0, lon = v[1] * kPi / 180.0;
    if (!scale) scale = std::cos(lat);
    return {make_rotation(v[5], v[4], v[3]),
            {*scale * kEarthRadius_m * lon, *scale * kEarthRadius_m * std::log(std::tan(kPi / 4 + lat / 2)),
             v[2]}};
}

/// Returns the first frame with an OXTS file. It defines the Mercator scale and the
/// origin of the poses, so that they do not depend on the requested frames.
int find_first_oxts(const fs::path& drive) {
    const fs::path folder = drive / "oxts/data";
    if (does_path_exist(folder)) {
        // files are sorted by name, so the first file has the smallest number
        for (const fs::path& file : list_folder(folder)) {
            const auto number = parse_file_number(file.stem().string());
            if (file.extension() == ".txt" && number) return *number;
        }
    }
    throw DataError(
        fmt::format("{}: the OXTS files (0000000000.txt) are missing, so the drive has no poses; use "
                    "dataset.poses=FILE, or dataset.poses=none to estimate the poses "
                    "from the scans",
                    folder.string()));
}

/// Returns the path of calib_imu_to_velo.txt for a drive. The file can be one folder
/// above the drive, as in KITTI, in the drive, or in the folder from DATE_calib.zip.
fs::path find_calibration(const fs::path& drive) {
    const char* name = "calib_imu_to_velo.txt";
    // date in a name such as 2011_09_26_drive_0005_sync
    const std::string date = drive.filename().string().substr(0, 10);
    for (const fs::path& base : {drive.parent_path(), drive, drive.parent_path().parent_path()}) {
        for (const fs::path& inner : {fs::path(), fs::path("calib"), fs::path("calibration"), fs::path(date),
                                      fs::path(date + "_calib"), fs::path(date + "_calib") / date}) {
            if (does_path_exist(base / inner / name)) return base / inner / name;
        }
    }
    throw DataError(
        fmt::format("{}: no such file here, in the drive, or in a folder calib, calibration or {}_calib "
                    "next to it or above it; expected KITTI's calibration of that day; without it, use "
                    "dataset.poses",
                    (drive.parent_path() / name).string(), date));
}

}  // namespace

Pose read_calibration(const fs::path& file) {
    std::vector<double> r, t;
    for (const std::string& line : split_lines(read_text(file))) {
        const std::string where = file.string();
        if (line.rfind("R:", 0) == 0) r = parse_finite_numbers(line.substr(2), 9, where + " key R");
        if (line.rfind("T:", 0) == 0) t = parse_finite_numbers(line.substr(2), 3, where + " key T");
    }
    if (r.empty() || t.empty()) {
        throw DataError(fmt::format("{}: the line '{}:' is missing, expected the keys R and T", file.string(),
                                    r.empty() ? "R" : "T"));
    }
    return make_rigid_pose(glm::dmat3(r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]),
                           {t[0], t[1], t[2]}, file.string());
}

Pose read_transform(const fs::path& file, const std::string& key) {
    for (const std::string& line : split_lines(read_text(file)))
        if (line.rfind(key + ":", 0) == 0)
            return parse_matrix(line.substr(key.size() + 1), fmt::format("{} key {}", file.string(), key));
    throw DataError(
        fmt::format("{}: the line '{}:' is missing, expected this key with 12 numbers", file.string(), key));
}

std::vector<Pose> read_oxts_poses(const fs::path& drive, const std::vector<int>& frames) {
    std::optional<double> scale;
    const glm::dvec3 origin = read_oxts(get_oxts_file(drive, find_first_oxts(drive)), scale).translation;
    const Pose imu_from_sensor = inverse(read_calibration(find_calibration(drive)));
    std::vector<Pose> poses;
    for (const int frame : frames) {
        Pose world_from_imu = read_oxts(get_oxts_file(drive, frame), scale);
        world_from_imu.translation -= origin;
        poses.push_back(world_from_imu * imu_from_sensor);
    }
    check_extent(poses, frames, (drive / "oxts/data").string());
    return poses;
}

std::vector<Pose> read_pose_file(const fs::path& file, const std::vector<int>& frames) {
    const std::vector<std::string> lines = split_lines(read_text(file));
    std::vector<Pose> poses;
    for (const int frame : frames) {
        const std::size_t line = static_cast<std::size_t>(frame);
        if (line >= lines.size()) {
            throw DataError(fmt::format("{}: found {} lines, but frame {} needs line {}", file.string(),
                                        lines.size(), frame, line + 1));
        }
        const std::string where = fmt::format("{} line {}", file.string(), line + 1);
        poses.push_back(parse_matrix(lines[line], where));
    }
    check_extent(poses, frames, file.string());
    return poses;
}

std::vector<Pose> read_user_poses(const fs::path& file, const std::vector<int>& frames,
                                  const std::vector<double>& time_s, std::vector<std::string>& notes) {
    std::vector<folder::HeadFrame> heads;
    for (std::size_t i = 0; i < frames.size(); ++i) heads.push_back({frames[i], time_s[i], 0, {}});
    const auto poses = folder::read_poses(file, heads, nullptr, notes);
    if (!poses)
        throw DataError(fmt::format("{}: no such file, expected poses (dataset.poses)", file.string()));
    return *poses;
}

void use_pose_file(Sequence& sequence, const fs::path& poses_file) {
    if (poses_file.empty()) return;
    PoseTrack given{sequence.world_from_vehicle.time_s,
                    std::vector<Pose>(sequence.world_from_vehicle.time_s.size())};
    // LiDARs of the same sweep share a pose, so each frame number is listed once.
    std::vector<int> frames;
    for (const Frame& frame : sequence.frames)
        if (frames.empty() || frames.back() != frame.index) frames.push_back(frame.index);
    if (poses_file != kNoPoses)
        given.pose = read_user_poses(poses_file, frames, given.time_s, sequence.notes);
    else sequence.notes.push_back(kNoPosesNote);
    set_vehicle_poses(sequence, std::move(given));
}

std::map<int, Pose> read_numbered_poses(const fs::path& file) {
    const std::vector<std::string> lines = split_lines(read_text(file));
    std::vector<int> frames;
    std::vector<Pose> poses;
    for (std::size_t l = 0; l < lines.size(); ++l) {
        const std::string where = fmt::format("{} line {}", file.string(), l + 1);
        const std::string_view line = trim_spaces(lines[l]);
        const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
        const std::optional<int> frame = parse_file_number(std::string(line.substr(0, end)));
        if (!frame || (!frames.empty() && *frame <= frames.back()))
            throw DataError(fmt::format("{}: found the frame '{}'{}, expected increasing frame numbers",
                                        where, make_excerpt(line.substr(0, end)),
                                        frames.empty() ? "" : fmt::format(" after {}", frames.back())));
        frames.push_back(*frame);
        poses.push_back(parse_matrix(std::string(line.substr(end)), where));
    }
    if (poses.empty())
        throw DataError(fmt::format("{}: the file is empty, expected a frame number and 12 numbers per line",
                                    file.string()));
    check_extent(poses, frames, file.string());
    std::map<int, Pose> by_frame;
    for (std::size_t i = 0; i < frames.size(); ++i)
        by_frame.emplace_hint(by_frame.end(), frames[i], poses[i]);
    return by_frame;
}

}  // namespace relidar::kitti
