// SPDX-License-Identifier: Apache-2.0
// A cloud is PCD with a time stamp of each point in microseconds, not motion-compensated.
// The vehicle has a pose every 10 ms, and files refer to the nearest pose.
#include "read/datasets/nuscenes/truckscenes_folder.hpp"

#include <fmt/format.h>

#include "base/random.hpp"
#include "read/datasets/nuscenes/nuscenes_folder.hpp"
#include "read/datasets/street/yard.hpp"

namespace relidar::test {
namespace fs = std::filesystem;
namespace {

constexpr std::int64_t kFirst_us = 1695473372703000, kPoseStep_us = 10000, kPoseOffset_us = 3000;
const glm::dvec3 kWorld_m(689012.5, 5337123.25, 0.0);

std::int64_t compute_stamp_us(int sweep, double later_s) {
    return kFirst_us + sweep * 100000 + std::llround(later_s * 1e6);
}

glm::dquat make_rotation_about(double degrees, const glm::dvec3& axis) {
    return glm::angleAxis(degrees * kPi / 180.0, axis);
}

}  // namespace

Pose TruckScenesFolder::compute_vehicle_pose(double time_s) {
    return {make_rotation_about(30.0 - 20.0 * time_s, {0, 0, 1}),
            kWorld_m + time_s * glm::dvec3(14.0, 6.0, 0.0)};
}

Pose TruckScenesFolder::box_at(double time_s) {
    return {make_rotation_about(10.0 + 25.0 * time_s, {0, 0, 1}),
            kWorld_m + glm::dvec3(12.0 + 5.0 * time_s, 3.0, 1.0)};
}

fs::path TruckScenesFolder::sweep(const std::string& channel, int number) const {
    return folder / (number % 5 == 0 ? "samples" : "sweeps") / channel /
           fmt::format("{}_{}.pcd", channel, number);
}

void TruckScenesFolder::write_clouds(Lidar& lidar, double later_s) const {
    const std::size_t n_beams = lidar.elevations_deg.size();
    for (int s = 0; s < kSweeps; ++s) {
        lidar.rays.emplace_back();
        std::string bytes;
        std::size_t n = 0;
        for (int column = 0; column < kColumns; ++column)
            for (std::size_t beam = 0; beam < n_beams; ++beam) {
                TruckRay ray;
                const std::int64_t time_us = compute_stamp_us(s, later_s) + column * 250;
                ray.time_s = double(time_us - kFirst_us) * 1e-6;
                const double e = lidar.elevations_deg[beam] * kPi / 180.0,
                             a = 2.5 - 2.0 * kPi * column / kColumns;
                const glm::dvec3 d(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e));
                const Pose fired = compute_vehicle_pose(ray.time_s) * lidar.mounted;
                ray.origin_m = fired.translation;
                ray.point_m = kWorld_m + intersect_yard(ray.origin_m - kWorld_m, fired.rotation * d);
                const double range_m = glm::distance(ray.origin_m, ray.point_m);
                ray.returned = range_m < 200.0 &&
                               hash_pair(std::uint64_t(column) * n_beams + beam, std::uint64_t(s)) % 8 != 0;
                lidar.rays.back().push_back(ray);
                if (!ray.returned) continue;
                const glm::dvec3 p = range_m * d;
                const float values[4] = {float(p.x), float(p.y), float(p.z), 51.0f};
                const auto t = std::uint64_t(time_us);
                bytes.append(reinterpret_cast<const char*>(values), sizeof values)
                    .append(reinterpret_cast<const char*>(&t), sizeof t);
                ++n;
            }
        write_text(sweep(lidar.channel, s),
                   fmt::format("# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z "
                               "intensity timestamp\nSIZE 4 4 4 4 8\n"
                               "TYPE F F F F U\nCOUNT 1 1 1 1 1\nWIDTH {0}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 "
                               "0\nPOINTS {0}\nDATA binary\n",
                               n) +
                       bytes);
    }
}

void TruckScenesFolder::write_tables() const {
    write_records(table("scene"),
                  {"\"token\": \"s0\", \"name\": \"scene-0044384af3d8494e913fb8b14915239e-3\"",
                   "\"token\": \"s1\", \"name\": \"scene-ef1a21a0a9c14c9a9eb1b1a0c2ff1d10-7\""});
    std::vector<std::string> samples, mounts;
    std::vector<std::string> sensors = {
        "\"token\": \"radar\", \"channel\": \"RADAR_LEFT_FRONT\", \"modality\": \"radar\""};
    // The time of a sample differs slightly from the times of its files.
    for (int k = 0; k < kSweeps; k += 5)
        samples.push_back(fmt::format("\"token\": \"k{}\", \"scene_token\": \"s0\", \"timestamp\": {}", k,
                                      compute_stamp_us(k, 0.0) + (k == 0 ? 900 : -900)));
    std::vector<std::string> files, poses;
    for (const Lidar& lidar : lidars) {
        const bool is_top = &lidar != &lidars[0];
        sensors.push_back(
            fmt::format("\"token\": \"{0}\", \"channel\": \"{0}\", \"modality\": \"lidar\"", lidar.channel));
        mounts.push_back(fmt::format("\"token\": \"on_{0}\", \"sensor_token\": \"{0}\", {1}", lidar.channel,
                                     format_pose_keys(lidar.mounted)));
        for (int s = 0; s < kSweeps; ++s) {
            if (is_top && s == kMissing) continue;
            const int after = is_top && s + 1 == kMissing ? s + 2 : s + 1;
            const std::int64_t time_us = compute_stamp_us(s, is_top ? kLater_s : 0.0);
            const auto pose =
                std::llround(double(time_us - kFirst_us - kPoseOffset_us) / double(kPoseStep_us));
            files.push_back(fmt::format(
                "\"token\": \"{0}{1}\", \"sample_token\": \"k{2}\", \"ego_pose_token\": \"e{3}\", "
                "\"calibrated_sensor_token\": \"on_{0}\", \"filename\": \"{4}\", \"fileformat\": \"pcd\", "
                "\"timestamp\": {5}, \"is_key_frame\": {6}, \"next\": \"{7}\"",
                lidar.channel, s, (s + 4) / 5 * 5, pose,
                fs::relative(sweep(lidar.channel, s), folder).string(), time_us, s % 5 == 0,
                after < kSweeps ? lidar.channel + std::to_string(after) : ""));
        }
    }
    for (std::int64_t e = -5; e <= 115; ++e) {
        const std::int64_t after_us = kPoseOffset_us + e * kPoseStep_us;
        const Pose pose = compute_vehicle_pose(double(after_us) * 1e-6);
        poses.push_back(fmt::format("\"token\": \"e{}\", \"timestamp\": {}, {}", e, kFirst_us + after_us,
                                    format_pose_keys(pose)));
    }
    std::vector<std::string> labels;
    for (int k = 0; k < kSweeps; k += 5) {
        const double time_s = k * kSweep_s + (k == 0 ? 900e-6 : -900e-6);
        labels.push_back(
            fmt::format("\"token\": \"a{0}\", \"sample_token\": \"k{0}\", \"instance_token\": \"van\", "
                        "\"size\": [2.1, 5.5, 2.4], {1}",
                        k, format_pose_keys(box_at(time_s))));
    }
    write_records(table("sample"), samples);
    write_records(table("sensor"), sensors);
    write_records(table("calibrated_sensor"), mounts);
    write_records(table("sample_data"), files);
    write_records(table("ego_pose"), poses);
    write_records(table("sample_annotation"), labels);
    write_records(table("instance"), {"\"token\": \"van\", \"category_token\": \"c\""});
    write_records(table("category"), {"\"token\": \"c\", \"name\": \"vehicle.other\""});
}

TruckScenesFolder::TruckScenesFolder(const std::string& name) : LogFolder("relidar_truckscenes_" + name) {
    Lidar left{"LIDAR_LEFT", {make_rotation_about(85.0, {0, 0, 1}), {1.2, 1.5, 3.1}}, {}, {}};
    for (const double e :
         {15.0, 11.0, 8.0, 5.0, 3.0, 2.0, 1.0, 0.0, -1.0, -2.0, -3.0, -4.0, -6.0, -9.0, -14.0, -19.0, -25.0})
        left.elevations_deg.push_back(e);
    Lidar top{"LIDAR_TOP_FRONT",
              {make_rotation_about(-12.0, {0, 0, 1}) * make_rotation_about(40.0, {0, 1, 0}), {2.4, 0.3, 3.4}},
              {},
              {}};
    for (int b = 0; b < 24; ++b) top.elevations_deg.push_back(43.0 - b * 86.0 / 23.0);
    lidars = {left, top};
    write_clouds(lidars[0], 0.0);
    write_clouds(lidars[1], kLater_s);
    fs::remove(sweep("LIDAR_TOP_FRONT", kMissing));
    write_tables();
}

}  // namespace relidar::test
