// SPDX-License-Identifier: Apache-2.0
// Reads the calibration of KITTI, and poses with frame numbers. Computes the poses of a
// KITTI raw drive from GPS/IMU data (OXTS):
//   x = s R lon, y = s R ln tan(pi/4 + lat/2), z = alt,  s = cos(first latitude),
//   R = 6378137 m,  rotation R_z(yaw) R_y(pitch) R_x(roll)
#include "base/fail.hpp"
#include "read/datasets/kitti/log_files.hpp"
#include "read/scans/pose_files.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include <relidar/log/camera.hpp>
#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>
#include "base/files.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

fs::path oxts_path(const fs::path& drive, int frame_number) {
    return drive / "oxts/data" / fmt::format("{:010d}.txt", frame_number);
}

/// Parses 30 numbers of GPS/IMU data (OXTS). The first are latitude, longitude (both in
/// degrees), height in metres, and roll, pitch and yaw in radians.
std::vector<double> parse_oxts(const std::string& line, const std::string& where) {
    constexpr std::size_t kOxtsNumbers = 30;
    const std::vector<double> v = read::parse_finite(line, kOxtsNumbers, where);
    if (std::abs(v[0]) > 89.0 || std::abs(v[1]) > 360.0)
        fail("{}: found the latitude {} and the longitude {}, expected angles in degrees", where, v[0], v[1]);
    return v;
}

std::vector<double> read_oxts(const fs::path& oxts_file) {
    const std::vector<std::string> lines = split_lines(read_text_file(oxts_file));
    return parse_oxts(lines.empty() ? "" : lines[0], oxts_file.string());
}

constexpr double kEarthRadius_m = 6378137.0;

/// Returns the scale with which Mercator coordinates are metres at a frame's latitude.
double mercator_scale(const std::vector<double>& oxts) { return std::cos(oxts[0] * kPi / 180.0); }

/// Returns the pose of the IMU in one frame. The position is in Mercator coordinates,
/// whose origin is at latitude and longitude 0.
Pose imu_pose(const std::vector<double>& oxts, double scale) {
    const double lat = oxts[0] * kPi / 180.0, lon = oxts[1] * kPi / 180.0, height_m = oxts[2];
    const double roll = oxts[3], pitch = oxts[4], yaw = oxts[5];
    return {make_rotation(yaw, pitch, roll),
            {scale * kEarthRadius_m * lon, scale * kEarthRadius_m * std::log(std::tan(kPi / 4 + lat / 2)),
             height_m}};
}

/// Returns the pose of the IMU in a world whose origin is the IMU in the first frame.
Pose place_imu(const std::vector<double>& oxts, const std::vector<double>& first) {
    const double scale = mercator_scale(first);
    Pose world_from_imu = imu_pose(oxts, scale);
    world_from_imu.translation -= imu_pose(first, scale).translation;
    return world_from_imu;
}

/// Returns the place on the earth of the world of place_imu().
Georeference place_of(const std::vector<double>& first) {
    const double latitude_deg = first[0], longitude_deg = first[1], height_m = first[2];
    const glm::dvec3 origin_m = imu_pose(first, mercator_scale(first)).translation;
    // PROJ adds x_0 and y_0 to the coordinates. The scale is 1 at the latitude lat_ts.
    const std::string projection = fmt::format("+proj=merc +R={} +lat_ts={} +x_0={} +y_0={}", kEarthRadius_m,
                                               latitude_deg, -origin_m.x, -origin_m.y);
    return {.position = {latitude_deg, longitude_deg, height_m}, .point_m = {}, .crs = projection};
}

/// Returns the numbers of the first GPS/IMU file of a drive, see parse_oxts(). It defines
/// the origin and Mercator scale of all poses, whichever frames are requested.
std::vector<double> read_first_oxts(const fs::path& drive) {
    const fs::path folder = drive / "oxts/data";
    if (does_path_exist(folder))
        for (const fs::path& file : list_folder(folder)) {
            const auto number = parse_stem(file.stem().string());
            if (file.extension() == ".txt" && number) return read_oxts(oxts_path(drive, *number));
        }
    fail(
        "{}: the OXTS files (0000000000.txt) are missing, so the drive has no poses; use dataset.poses=FILE, "
        "or dataset.poses=none to estimate the poses from the scans",
        folder.string());
}

/// Returns the path of a calibration file of a drive, or an empty path. Users unpack
/// KITTI's calibration archive in different places. Searches the drive, the two folders
/// above it, and usual folders of calibration files in them.
fs::path find_calibration(const fs::path& drive, const char* name) {
    // the first ten characters of a name such as 2011_09_26_drive_0005_sync
    const std::string date = drive.filename().string().substr(0, 10), archive = date + "_calib";
    const fs::path subfolders[] = {"", "calib", "calibration", date, archive, fs::path(archive) / date};
    for (const fs::path& base : {drive.parent_path(), drive, drive.parent_path().parent_path()})
        for (const fs::path& subfolder : subfolders)
            if (does_path_exist(base / subfolder / name)) return base / subfolder / name;
    return {};
}

fs::path find_imu_file(const fs::path& drive) {
    const char* name = "calib_imu_to_velo.txt";
    if (const fs::path file = find_calibration(drive, name); !file.empty()) return file;
    fail(
        "{}: no such file, and it was not found in the folder of the drive or in a folder calib, calibration "
        "or {}_calib either; copy KITTI's calibration file of that day to this path, or use "
        "dataset.poses=FILE",
        (drive.parent_path() / name).string(), drive.filename().string().substr(0, 10));
}

/// Returns the numbers of a line "key: numbers", or no numbers without this line.
std::vector<double> read_numbers(const fs::path& file, const std::string& key, std::size_t count) {
    for (const std::string& line : split_lines(read_text_file(file)))
        if (line.starts_with(key + ":"))
            return read::parse_finite(line.substr(key.size() + 1), count,
                                      fmt::format("{} key {}", file.string(), key));
    return {};
}

}  // namespace

std::vector<Camera> read_cameras(const fs::path& drive) {
    constexpr double kMaxSide_px = 16384.0;
    const fs::path file = find_calibration(drive, "calib_cam_to_cam.txt"),
                   lidar_file = find_calibration(drive, "calib_velo_to_cam.txt");
    if (file.empty() || lidar_file.empty()) return {};
    const std::vector<double> r = read_numbers(file, "R_rect_00", 9);
    if (r.empty()) return {};
    const glm::dmat3 rectified_from_cam0(r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]);
    const Pose rectified_from_lidar =
        make_pose(rectified_from_cam0, {}, file.string() + " key R_rect_00") * read_calibration(lidar_file);
    std::vector<Camera> cameras;
    for (int number = 0; number < 4; ++number) {
        const std::vector<double> p = read_numbers(file, fmt::format("P_rect_0{}", number), 12),
                                  size = read_numbers(file, fmt::format("S_rect_0{}", number), 2);
        if (p.empty() || size.empty()) continue;
        if (!(p[0] > 0.0 && p[5] > 0.0) || std::ranges::min(size) < 1.0 ||
            std::ranges::max(size) > kMaxSide_px)
            fail(
                "{}: camera {}: found focal lengths of {} and {} and {} x {} pixels, expected numbers above "
                "0",
                file.string(), number, p[0], p[5], size[0], size[1]);
        std::array<double, 12> projection;
        std::ranges::copy(p, projection.begin());
        Camera camera = make_camera(fmt::format("image_{}", number), projection, rectified_from_lidar);
        camera.columns = int(size[0]);
        camera.rows = int(size[1]);
        cameras.push_back(camera);
    }
    return cameras;
}

Pose read_calibration(const fs::path& file) {
    std::vector<double> r, t;
    for (const std::string& line : split_lines(read_text_file(file))) {
        if (line.starts_with("R:")) r = read::parse_finite(line.substr(2), 9, file.string() + " key R");
        if (line.starts_with("T:")) t = read::parse_finite(line.substr(2), 3, file.string() + " key T");
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
        if (line.starts_with(key + ":"))
            return read::parse_pose(line.substr(key.size() + 1),
                                    fmt::format("{} key {}", file.string(), key));
    fail("{}: the line '{}:' is missing, expected this key with 12 numbers", file.string(), key);
}

std::vector<Pose> read_oxts_poses(const fs::path& drive, const std::vector<int>& frame_numbers) {
    const std::vector<double> first = read_first_oxts(drive);
    const Pose imu_from_sensor = inverse(read_calibration(find_imu_file(drive)));
    std::vector<Pose> poses;
    for (const int frame : frame_numbers)
        poses.push_back(place_imu(read_oxts(oxts_path(drive, frame)), first) * imu_from_sensor);
    return poses;
}

Georeference read_oxts_place(const fs::path& drive) { return place_of(read_first_oxts(drive)); }

OxtsTrack read_oxts_lines(const fs::path& file, const std::vector<int>& numbers,
                          const Pose& imu_from_sensor) {
    const read::FrameLine first_line = read::read_frame_lines(file, {0}).front();
    const std::vector<double> first = parse_oxts(first_line.text, first_line.where);
    OxtsTrack track{{}, place_of(first)};
    for (const auto& [text, where] : read::read_frame_lines(file, numbers))
        track.poses.push_back(place_imu(parse_oxts(text, where), first) * imu_from_sensor);
    return track;
}

std::map<int, Pose> read_numbered_poses(const fs::path& file) {
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    std::map<int, Pose> by_frame;
    for (std::size_t l = 0; l < lines.size(); ++l) {
        const std::string where = fmt::format("{} line {}", file.string(), l + 1);
        const std::string line(trim(lines[l]));
        const std::string number = line.substr(0, line.find_first_of(" \t")),
                          matrix = line.substr(number.size());
        const std::optional<int> frame = parse_stem(number);
        if (!frame || (!by_frame.empty() && *frame <= by_frame.rbegin()->first))
            fail("{}: found the frame '{}', expected increasing frame numbers", where, quote(number));
        by_frame.emplace(*frame, read::parse_pose(matrix, where));
    }
    if (by_frame.empty())
        fail("{}: the file is empty, expected a frame number and 12 numbers per line", file.string());
    return by_frame;
}

}  // namespace relidar::kitti
