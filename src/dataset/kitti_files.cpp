// SPDX-License-Identifier: Apache-2.0
// Scans, timestamps and poses of a KITTI raw drive. Scans are n x float32 {x, y, z, reflectance}; poses come from OXTS by
//   x = s R lon, y = s R ln tan(pi/4 + lat/2), z = alt,  s = cos(first latitude), R = 6378137 m,  R_z(yaw) R_y(pitch) R_x(roll)
// or from a file with 12 numbers a line.
#include "dataset/kitti_files.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include "core/files.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

constexpr double kFarthest_m = 1e4;  // no LiDAR return lies ten kilometres away: a file of another type or byte order

/// Rotation and translation as a pose. @throws DataError where the matrix is no rotation within 1e-3
Pose make_pose(const glm::dmat3& rotation, const glm::dvec3& translation, const std::string& where) {
    const glm::dmat3 excess = glm::transpose(rotation) * rotation - glm::dmat3(1.0);
    double worst = 0.0;
    for (int c = 0; c < 3; ++c) {
        for (int r = 0; r < 3; ++r) worst = std::max(worst, std::abs(excess[c][r]));
    }
    if (!(worst <= 1e-3) || glm::determinant(rotation) < 0.0) {
        throw DataError(
            fmt::format("{}: the 3x3 block is no rotation (R^T R differs from 1 by {:.3g}, determinant {:.3g}), "
                        "expected orthonormal within 0.001",
                        where, worst, glm::determinant(rotation)));
    }
    return {glm::normalize(glm::quat_cast(rotation)), translation};
}

std::vector<double> finite_numbers(const std::string& line, std::size_t n, const std::string& where) {
    const auto numbers = parse_numbers(line);
    if (!numbers) throw DataError(fmt::format("{}: a word is no number, expected {} numbers", where, n));
    if (numbers->size() != n) throw DataError(fmt::format("{}: {} numbers, expected {}", where, numbers->size(), n));
    for (std::size_t i = 0; i < n; ++i) {
        if (!std::isfinite((*numbers)[i])) {
            throw DataError(fmt::format("{}: number {} is {}, expected a finite value", where, i + 1, (*numbers)[i]));
        }
    }
    return *numbers;
}

/// Days from 1970-01-01 in the Gregorian calendar (leap years: divisible by 4, not by 100 unless by 400).
std::int64_t days_of(int year, int month, int day) {
    static constexpr std::array<int, 12> kBefore{0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334};
    const bool leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    const int y = year - 1;
    const std::int64_t leap_days = y / 4 - y / 100 + y / 400 - 477;  // 477 up to 1969
    return 365ll * (year - 1970) + leap_days + kBefore[static_cast<std::size_t>(month - 1)] + (leap && month > 2) + day - 1;
}

/// Nanoseconds since 1970 of "YYYY-MM-DD HH:MM:SS.nnnnnnnnn".
std::int64_t parse_timestamp(const std::string& line, const std::string& where) {
    int year = 0, month = 0, day = 0, hour = 0, minute = 0, used = 0;
    const int n = std::sscanf(line.c_str(), "%4d-%2d-%2d %2d:%2d:%n", &year, &month, &day, &hour, &minute, &used);
    const auto second = n == 5 && used > 0 ? parse_number(trimmed(line).substr(static_cast<std::size_t>(used))) : std::nullopt;
    const bool sane = second && *second >= 0.0 && *second < 61.0 && year >= 1970 && month >= 1 && month <= 12 && day >= 1 && day <= 31 &&
                      hour >= 0 && hour < 24 && minute >= 0 && minute < 60;
    if (!sane) throw DataError(fmt::format("{}: '{}', expected YYYY-MM-DD HH:MM:SS.nnnnnnnnn", where, line));
    const std::int64_t minutes = (days_of(year, month, day) * 24 + hour) * 60 + minute;
    return minutes * 60'000'000'000ll + std::llround(*second * 1e9);
}

std::vector<std::int64_t> parse_timestamps(const fs::path& file) {
    const std::vector<std::string> lines = split_lines(read_file(file));
    std::vector<std::int64_t> time_ns;
    for (std::size_t l = 0; l < lines.size(); ++l) {
        time_ns.push_back(parse_timestamp(lines[l], fmt::format("{} line {}", file.string(), l + 1)));
    }
    if (time_ns.empty()) throw DataError(fmt::format("{}: empty, expected one timestamp a frame", file.string()));
    return time_ns;
}

fs::path oxts_file(const fs::path& drive, int frame) {
    return drive / "oxts/data" / fmt::format("{:010d}.txt", frame);
}

/// world_from_imu before the first frame's position is taken off.
Pose read_oxts(const fs::path& file, std::optional<double>& scale) {
    const std::vector<std::string> lines = split_lines(read_file(file));
    const std::vector<double> v = finite_numbers(lines.empty() ? "" : lines[0], 30, file.string());
    if (std::abs(v[0]) > 89.0 || std::abs(v[1]) > 360.0) {
        throw DataError(fmt::format("{}: latitude {} and longitude {}, expected degrees", file.string(), v[0], v[1]));
    }
    constexpr double kEarthRadius_m = 6378137.0;
    const double lat = v[0] * kPi / 180.0, lon = v[1] * kPi / 180.0;
    if (!scale) scale = std::cos(lat);
    const glm::dquat rotation =
        glm::angleAxis(v[5], glm::dvec3(0, 0, 1)) * glm::angleAxis(v[4], glm::dvec3(0, 1, 0)) * glm::angleAxis(v[3], glm::dvec3(1, 0, 0));
    return {rotation, {*scale * kEarthRadius_m * lon, *scale * kEarthRadius_m * std::log(std::tan(kPi / 4 + lat / 2)), v[2]}};
}

/// Smallest frame number with an OXTS file; the Mercator scale and the origin belong to it, whatever frames are loaded.
int first_oxts(const fs::path& drive) {
    std::error_code failed;
    int first = -1;
    for (const auto& entry : fs::directory_iterator(drive / "oxts/data", failed)) {
        const auto number = parse_number(entry.path().stem().string());
        if (entry.path().extension() == ".txt" && number && (first < 0 || *number < first)) first = static_cast<int>(*number);
    }
    if (first < 0) {
        throw DataError(
            fmt::format("{}: no poses, expected OXTS files %010d.txt (or give a file of poses)", (drive / "oxts/data").string()));
    }
    return first;
}

}  // namespace

std::vector<int> list_scans(const fs::path& drive, int begin, int end) {
    const fs::path folder = drive / "velodyne_points/data";
    std::error_code failed;
    if (!fs::is_directory(folder, failed)) {
        throw DataError(fmt::format("{}: no such folder, expected KITTI raw scans %010d.bin in it", folder.string()));
    }
    std::vector<int> all, frames;
    for (const auto& entry : fs::directory_iterator(folder)) {
        const std::string stem = entry.path().stem().string();
        const bool digits = !stem.empty() && stem.size() <= 10 && stem.find_first_not_of("0123456789") == std::string::npos;
        if (entry.path().extension() == ".bin" && digits) all.push_back(static_cast<int>(std::stoll(stem)));
    }
    if (all.empty()) throw DataError(fmt::format("{}: no scans, expected files %010d.bin", folder.string()));
    std::sort(all.begin(), all.end());
    std::copy_if(all.begin(), all.end(), std::back_inserter(frames), [&](int f) { return f >= begin && (end < 0 || f < end); });
    if (frames.empty()) {
        throw UsageError(fmt::format("frames {}:{}: no scan of {} lies in it, expected numbers in [{}, {}]", begin,
                                     end < 0 ? "" : std::to_string(end), drive.string(), all.front(), all.back()));
    }
    return frames;
}

std::vector<glm::vec4> read_scan(const fs::path& file) {
    const std::string bytes = read_file(file);
    static_assert(sizeof(glm::vec4) == 16);
    if (bytes.empty()) throw DataError(fmt::format("{}: empty, expected points of 16 bytes", file.string()));
    if (bytes.size() % 16 != 0) {
        throw DataError(fmt::format("{}: truncated: {} bytes, expected a multiple of 16 ({} points and {} bytes)", file.string(),
                                    bytes.size(), bytes.size() / 16, bytes.size() % 16));
    }
    std::vector<glm::vec4> points(bytes.size() / 16);
    std::memcpy(points.data(), bytes.data(), bytes.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::vec4& p = points[i];
        const bool finite = std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z) && std::isfinite(p.w);
        const double largest = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
        if (finite && largest <= kFarthest_m) continue;
        throw DataError(fmt::format("{}: point {} is ({}, {}, {}) with intensity {}, expected finite values within {} m", file.string(), i,
                                    p.x, p.y, p.z, p.w, kFarthest_m));
    }
    return points;
}

std::vector<double> read_timestamps(const fs::path& file) {
    const std::vector<std::int64_t> time_ns = parse_timestamps(file);
    std::vector<double> time_s;
    for (const std::int64_t t : time_ns) time_s.push_back(static_cast<double>(t - time_ns[0]) * 1e-9);
    return time_s;
}

double read_period(const fs::path& drive) {
    const fs::path file = drive / "velodyne_points/timestamps_end.txt";
    const std::vector<std::int64_t> start = parse_timestamps(drive / "velodyne_points/timestamps_start.txt");
    const std::vector<std::int64_t> end = parse_timestamps(file);
    std::vector<double> turn;
    for (std::size_t i = 0; i < std::min(start.size(), end.size()); ++i) turn.push_back(static_cast<double>(end[i] - start[i]) * 1e-9);
    std::nth_element(turn.begin(), turn.begin() + static_cast<std::ptrdiff_t>(turn.size() / 2), turn.end());
    const double period_s = turn[turn.size() / 2];
    if (!(period_s > 0.01 && period_s < 1.0)) {
        throw DataError(fmt::format("{}: a turn lasts {} s from start to end, expected 0.01 ... 1 s", file.string(), period_s));
    }
    return period_s;
}

Pose read_calibration(const fs::path& file) {
    std::vector<double> r, t;
    for (const std::string& line : split_lines(read_file(file))) {
        const std::string where = file.string();
        if (line.rfind("R:", 0) == 0) r = finite_numbers(line.substr(2), 9, where + " key R");
        if (line.rfind("T:", 0) == 0) t = finite_numbers(line.substr(2), 3, where + " key T");
    }
    if (r.empty() || t.empty()) {
        throw DataError(fmt::format("{}: no line '{}:', expected the keys R and T", file.string(), r.empty() ? "R" : "T"));
    }
    return make_pose(glm::dmat3(r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]), {t[0], t[1], t[2]}, file.string());
}

std::vector<Pose> read_oxts_poses(const fs::path& drive, const std::vector<int>& frames) {
    const Pose imu_from_sensor = inverse(read_calibration(drive.parent_path() / "calib_imu_to_velo.txt"));
    std::optional<double> scale;
    const glm::dvec3 origin = read_oxts(oxts_file(drive, first_oxts(drive)), scale).translation;
    std::vector<Pose> poses;
    for (const int frame : frames) {
        Pose world_from_imu = read_oxts(oxts_file(drive, frame), scale);
        world_from_imu.translation -= origin;
        poses.push_back(world_from_imu * imu_from_sensor);
    }
    return poses;
}

std::vector<Pose> read_pose_file(const fs::path& file, const std::vector<int>& frames) {
    const std::vector<std::string> lines = split_lines(read_file(file));
    std::vector<Pose> poses;
    for (const int frame : frames) {
        const std::size_t line = static_cast<std::size_t>(frame);
        if (line >= lines.size()) {
            throw DataError(fmt::format("{}: {} lines, frame {} needs line {}", file.string(), lines.size(), frame, line + 1));
        }
        const std::string where = fmt::format("{} line {}", file.string(), line + 1);
        const std::vector<double> m = finite_numbers(lines[line], 12, where);
        poses.push_back(make_pose(glm::dmat3(m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]), {m[3], m[7], m[11]}, where));
    }
    return poses;
}

}  // namespace relidar::kitti
