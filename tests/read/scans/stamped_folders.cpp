// SPDX-License-Identifier: Apache-2.0
// From the documentation of the datasets: Boreas' data reference, MulRan's tables and
// mounting, and ONCE's description of its formats.
#include "read/scans/stamped_folders.hpp"

#include <fmt/format.h>

#include "base/random.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/datasets/street/yard.hpp"

namespace relidar::test {
namespace {

constexpr double kRevolution_s = 0.1;
constexpr double kDegree = kPi / 180.0;

void append_floats(std::string& bytes, std::initializer_list<float> values) {
    for (const float v : values) bytes.append(reinterpret_cast<const char*>(&v), sizeof v);
}

std::string format_matrix(const Pose& pose, const char* between) {
    const glm::dmat4 m = to_matrix(pose);
    std::string text;
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 4; ++c) text += fmt::format("{}{}", r + c > 0 ? between : "", m[c][r]);
    return text;
}

/// Returns the angles roll, pitch and yaw of a rotation in the order 0 to 3:
/// R_x(-roll) R_y(-pitch) R_z(-yaw), R_z(yaw) R_y(pitch) R_x(roll),
/// R_z(-yaw) R_y(-pitch) R_x(-roll), R_x(roll) R_y(pitch) R_z(yaw).
glm::dvec3 angles_of(const glm::dquat& rotation, int order) {
    const glm::dmat3 m = glm::mat3_cast(order == 0 || order == 3 ? glm::conjugate(rotation) : rotation);
    const glm::dvec3 angles{std::atan2(m[1][2], m[2][2]), -std::asin(m[0][2]), std::atan2(m[0][1], m[0][0])};
    return order == 2 || order == 3 ? -angles : angles;
}

}  // namespace

double measure_distance_to_yard_m(const glm::dvec3& point) {
    return std::min({std::abs(point.z + 0.35), std::abs(point.x + 31.0), std::abs(point.x - 42.0),
                     std::abs(point.y + 24.0), std::abs(point.y - 29.0)});
}

Pose StampedDrive::compute_vehicle_pose(double time_s) const {
    const double heading = heading_rad + rate_rad_s * time_s, radius_m = speed_mps / rate_rad_s;
    const glm::dvec3 gone(std::sin(heading) - std::sin(heading_rad),
                          std::cos(heading_rad) - std::cos(heading), 0.0);
    return {make_rotation(heading, pitch_rad, roll_rad), world_m + start_m + radius_m * gone};
}

void StampedDrive::cast() {
    for (int s = 0; s < n_scans; ++s) {
        std::vector<StampedRay>& scan = rays.emplace_back();
        for (int c = 0; c < columns; ++c)
            for (std::size_t b = 0; b < beams.size(); ++b) {
                StampedRay ray;
                ray.time_s = s * step_s + kRevolution_s * (double(c) / columns - 0.5);
                const glm::dvec3 d =
                    aim_beam(beams[b], first_azimuth_rad - 2.0 * kPi * c / columns).direction;
                const Pose fired = compute_lidar_pose_at(ray.time_s);
                ray.origin_m = fired.translation;
                ray.point_m = world_m + intersect_yard(ray.origin_m - world_m, fired.rotation * d);
                ray.local_m = glm::vec3(glm::distance(ray.origin_m, ray.point_m) * d);
                ray.returned = hash_pair(std::uint64_t(c) * beams.size() + b, std::uint64_t(s)) % 8 != 0;
                scan.push_back(ray);
            }
    }
}

std::size_t StampedDrive::count_returns(int scan) const {
    return std::size_t(std::ranges::count_if(rays[std::size_t(scan)], &StampedRay::returned));
}

void expect_truth(const StampedDrive& drive, const Log& log, const StampedTolerance& tolerance) {
    const PoseTrack track = log.lidar_track(0);
    for (const Frame& frame : log.frames) {
        EXPECT_NEAR(frame.time_s, frame.index * 0.1, 1e-9);
        EXPECT_EQ(frame.scan.count_returns(), drive.count_returns(frame.index));
        const std::vector<StampedRay>& truth = drive.rays[std::size_t(frame.index)];
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            const double offset_s = double(frame.scan.rays.time_offset_s[i]);
            const auto column = std::size_t(std::lround((offset_s / 0.1 + 0.5) * drive.columns));
            const StampedRay& ray = truth.at(column * drive.beams.size() + frame.scan.rays.channel[i]);
            ASSERT_TRUE(ray.returned) << frame.index << " " << i;
            const auto [origin_m, point_m] = place_return(log, track, frame, i);
            ASSERT_LT(glm::distance(origin_m, ray.origin_m), tolerance.origin_m);
            ASSERT_LT(glm::distance(point_m, ray.point_m), tolerance.point_m);
            ASSERT_FLOAT_EQ(frame.scan.intensity[i], tolerance.intensity);
        }
    }
}

void expect_elevations(const StampedDrive& drive, const SpinningSensor& sensor) {
    ASSERT_EQ(sensor.beams.size(), drive.beams.size());
    for (std::size_t b = 0; b < sensor.beams.size(); ++b)
        EXPECT_NEAR(sensor.beams[b].elevation_rad, drive.beams[b].elevation_rad, 1e-5);
}

BoreasFolder::BoreasFolder(const std::string& name, int angles, int columns)
    : StampedFolder("relidar_boreas/boreas-" + name) {
    drive.pitch_rad = 0.02;
    drive.roll_rad = -0.015;
    drive.start_m = {-3.0, -4.0, 0.9};
    drive.world_m = {312.5, -204.25, 12.0};
    drive.vehicle_from_lidar.rotation = make_rotation(-42.6 * kDegree, 0.0, 0.0);
    drive.beams = std::get<SpinningSensor>(find_built_in("VLS-128")->pattern).beams;
    drive.columns = columns;
    drive.n_scans = kScans;
    drive.first_azimuth_rad = 0.0;
    drive.cast();
    for (int s = 0; s < kScans; ++s) {
        std::string bytes;
        for (std::size_t i = 0; i < drive.rays[std::size_t(s)].size(); ++i) {
            const StampedRay& ray = drive.rays[std::size_t(s)][i];
            if (!ray.returned) continue;
            const glm::vec3& p = ray.local_m;
            append_floats(bytes, {p.x, p.y, p.z, 51.0f, float(find_laser(i % 128)),
                                  float(ray.time_s - s * drive.step_s)});
        }
        write_text(scan(s), bytes);
    }
    std::string lines =
        "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,"
        "angvel_x\n";
    for (int s = 0; s < 400; ++s) {
        const Pose pose = drive.compute_lidar_pose_at(s * drive.step_s);
        const glm::dvec3 a = angles_of(pose.rotation, angles), &t = pose.translation;
        const double heading = drive.heading_rad + drive.rate_rad_s * s * drive.step_s;
        lines += fmt::format("{},{},{},{},{},{},0.0,{},{},{},0.3,0.0,0.0\n", stamp(s), t.x, t.y, t.z,
                             8.0 * std::cos(heading), 8.0 * std::sin(heading), a.x, a.y, a.z);
    }
    write_text(poses(), lines);
    const Pose applanix_from_vehicle{make_rotation(kPi / 2.0, 0.0, 0.0), {}};  // x right, y forward
    write_text(calibration(),
               format_matrix(applanix_from_vehicle * drive.vehicle_from_lidar, " ") + "\n0 0 0 1\n");
}

MulranFolder::MulranFolder(const std::string& name, bool by_column)
    : StampedFolder("relidar_mulran/" + name) {
    kind = "mulran:";
    drive.start_m = {-3.0, -4.0, -0.35};
    drive.world_m = {353012.5, 4026107.25, 21.0};
    drive.vehicle_from_lidar = {make_rotation(179.6654 * kDegree, 0.0003 * kDegree, 0.0001 * kDegree),
                                {1.7042, -0.021, 1.8047}};
    for (int b = 0; b < 64; ++b)
        drive.beams.push_back({.elevation_rad = (16.6 - b * 33.2 / 63.0) * kDegree,
                               .azimuth_offset_rad = (3.164 - b % 4 * 2.109) * kDegree});
    drive.columns = 1024;
    drive.n_scans = kScans;
    drive.first_azimuth_rad = 0.0;  // first azimuth of the sensor, which looks backward
    drive.cast();
    for (int s = 0; s < kScans; ++s) {
        std::string bytes;
        for (std::size_t i = 0; i < 65536; ++i) {
            const StampedRay& ray = drive.rays[std::size_t(s)][by_column ? i : i % 1024 * 64 + i / 1024];
            const glm::vec3 p = ray.returned ? ray.local_m : glm::vec3(0.0f);
            append_floats(bytes, {p.x, p.y, p.z, ray.returned ? 200.0f : 0.0f});
        }
        write_text(scan(s), bytes);
    }
    std::string lines;
    for (int k = 0; k < 32; ++k)  // 100 per second, starting 46 ms after the first scan
        lines += fmt::format("{},{}\n", stamp(0) + 46000000 + k * std::int64_t(10000000),
                             format_matrix(drive.compute_vehicle_pose(0.046 + 0.01 * k), ","));
    write_text(poses(), lines);
}

OnceFolder::OnceFolder(const std::string& name, bool w_first, int columns)
    : StampedFolder("relidar_once/" + name) {
    drive.rate_rad_s = 0.1;
    drive.start_m = {-12.0, -6.0, 1.45};
    // x axis to the left, y axis backward
    drive.vehicle_from_lidar.rotation = make_rotation(kPi / 2.0, 0.0, 0.0);
    drive.beams = std::get<SpinningSensor>(find_built_in("Pandar40P")->pattern).beams;
    drive.columns = columns;
    drive.n_scans = kScans;
    drive.step_s = 0.5;
    // Starts half a step after backward, because a point that is exactly backward can
    // belong to either end of the turn.
    drive.first_azimuth_rad = kPi / 2.0 - kPi / columns;
    drive.cast();
    const Pose world = drive.compute_lidar_pose_at(0.0);
    std::string frames;
    for (int s = 0; s < kScans; ++s) {
        std::string bytes;
        for (const StampedRay& ray : drive.rays[std::size_t(s)])
            if (ray.returned) append_floats(bytes, {ray.local_m.x, ray.local_m.y, ray.local_m.z, 0.25f});
        write_text(scan(s), bytes);
        const Pose pose = inverse(world) * drive.compute_lidar_pose_at(s * drive.step_s);
        const glm::dquat& q = pose.rotation;
        const std::string rotation = w_first ? fmt::format("{}, {}, {}, {}", q.w, q.x, q.y, q.z)
                                             : fmt::format("{}, {}, {}, {}", q.x, q.y, q.z, q.w);
        frames +=
            fmt::format("{}{{\"sequence_id\": \"{}\", \"frame_id\": \"{}\", \"pose\": [{}, {}, {}, {}]{}}}",
                        s > 0 ? ", " : "", name, stamp(s), rotation, pose.translation.x, pose.translation.y,
                        pose.translation.z,
                        s != 1 ? ""
                               : ", \"annos\": {\"names\": [\"Car\"], \"boxes_3d\": [[3.0, -9.0, -0.5, 4.5, "
                                 "1.9, 1.6, 1.6]], \"boxes_2d\": {}}");
    }
    write_text(
        json(),
        fmt::format("{{\"meta_info\": {{\"weather\": \"sunny\"}}, \"calib\": {{}}, \"frames\": [{}]}}\n",
                    frames));
}

}  // namespace relidar::test
