// SPDX-License-Identifier: Apache-2.0
#include "read/datasets/nuscenes/nuscenes_folder.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/random.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar::test {
namespace fs = std::filesystem;
namespace {

constexpr std::int64_t kFirst_us = 1533151603547590;
constexpr glm::dvec3 kMap_m(411.3, 1180.9, 0.0);

// Returns the mounting of the LiDAR in nuScenes axes: x right, y forward.
Pose mounted() {
    return {glm::normalize(glm::dquat(0.7077955, -0.0064922, 0.0106464, -0.7063073)),
            {0.943713, 0.0, 1.84023}};
}

std::int64_t time_us(int sweep) { return kFirst_us + sweep * 50000; }

std::string sample_of(const char* token, const char* scene, int sweep) {
    return fmt::format(R"("token": "{}", "scene_token": "{}", "timestamp": {})", token, scene,
                       time_us(sweep));
}

/// Computes the rays of the turn that ends at the time of a sweep.
std::string make_turn(int sweep, int columns, std::vector<YardRay>& rays) {
    std::string bytes;
    const double end_s = sweep * NuscenesFolder::kSweep_s;
    const Pose map_from_raw = NuscenesFolder::compute_vehicle_pose(end_s) * mounted();
    for (int column = 0; column < columns; ++column)
        for (int ring = 0; ring < 32; ++ring) {
            const double time_s = end_s - NuscenesFolder::kSweep_s * (1.0 - double(column) / columns);
            const Pose fired = NuscenesFolder::compute_vehicle_pose(time_s) * mounted();
            const glm::dvec3 d =
                direction_at((-92.0 + 4.0 * ring) / 3.0 * kPi / 180.0, 1.9 - 2.0 * kPi * column / columns);
            // In the file, x points to the right.
            YardRay ray = cast_in_yard(time_s, fired, {-d.y, d.x, d.z}, kMap_m);
            ray.direction = d;
            ray.returned = hash_pair(std::uint64_t(column * 32 + ring), std::uint64_t(sweep)) % 8 != 0 &&
                           column % 60 != 7;
            // compensated like all other points
            const glm::dvec3 nothing = fired * glm::dvec3(0.0, 1e-3, 0.0);
            const glm::dvec3 p = inverse(map_from_raw) * (ray.returned ? ray.point_m : nothing);
            const float values[5] = {float(p.x), float(p.y), float(p.z), 51.0f, float(ring)};
            bytes.append(reinterpret_cast<const char*>(values), sizeof values);
            rays.push_back(ray);
        }
    return bytes;
}

}  // namespace

std::string format_pose_keys(const Pose& pose) {
    const glm::dquat& q = pose.rotation;
    const glm::dvec3& t = pose.translation;
    return fmt::format(R"("translation": [{}, {}, {}], "rotation": [{}, {}, {}, {}])", t.x, t.y, t.z, q.w,
                       q.x, q.y, q.z);
}

void write_records(const fs::path& table, const std::vector<std::string>& records) {
    write_text(table, fmt::format("[\n{{{}}}\n]", fmt::join(records, "},\n{")));
}

Pose NuscenesFolder::compute_vehicle_pose(double time_s) {
    return {glm::angleAxis(0.6 - 0.35 * time_s, glm::dvec3(0, 0, 1)),
            kMap_m + time_s * glm::dvec3(24.0, 9.0, 0.0)};
}

Pose NuscenesFolder::box_at(double time_s) {
    return {glm::angleAxis(0.2 + 0.4 * time_s, glm::dvec3(0, 0, 1)),
            kMap_m + glm::dvec3(12.0 + 5.0 * time_s, 3.0, 0.8)};
}

fs::path NuscenesFolder::sweep(int number) const {
    return folder / (number % 10 == 0 ? "samples" : "sweeps") / "LIDAR_TOP" /
           fmt::format("turn_{}.pcd.bin", number);
}

NuscenesFolder::NuscenesFolder(const std::string& name, int n_columns)
    : LogFolder("relidar_nuscenes_" + name), columns(n_columns), rays(kSweeps) {
    const auto write = [&](const char* of, const std::vector<std::string>& records) {
        write_records(table(of), records);
    };
    write("scene", {R"("token": "s0", "name": "scene-0061", "first_sample_token": "k9", )"
                    "\"description\": \"[a] \\\"{quoted}\\\"\"",
                    R"("token": "s1", "name": "scene-0103", "first_sample_token": "k0")"});
    write("sample", {sample_of("k1", "s1", 10), sample_of("k0", "s1", 0), sample_of("k9", "s0", 0)});
    write("sensor", {R"("token": "c", "channel": "CAM_FRONT")", R"("token": "l", "channel": "LIDAR_TOP")"});
    write("calibrated_sensor",
          {R"("token": "mount", "sensor_token": "l", )" + format_pose_keys(mounted()),
           R"("token": "camera", "sensor_token": "c", )" + format_pose_keys(Pose{}) +
               R"(, "camera_intrinsic": [[1266.4, 0, 816.3], [0, 1266.5, 491.5], [0, 0, 1]])"});
    std::vector<std::string> files, poses;
    const auto add_file = [&](const std::string& token, const std::string& sample,
                              const std::string& calibration, int at, bool key, const std::string& next,
                              const std::string& file) {
        files.push_back(fmt::format(R"("token": "{}", "sample_token": "{}", "ego_pose_token": "e{}", )"
                                    R"("calibrated_sensor_token": "{}", "filename": "{}", "timestamp": {}, )"
                                    R"("is_key_frame": {}, "next": "{}", "width": 1600, "height": 900)",
                                    token, sample, at, calibration, file, time_us(at), key, next));
    };
    for (int i = kSweeps - 1; i >= 0; --i) {  // not ordered by time
        const std::string next = i + 1 < kSweeps ? fmt::format("d{}", i + 1) : "";
        add_file(fmt::format("d{}", i), i < 6 ? "k0" : "k1", "mount", i, i % 10 == 0, next,
                 fs::relative(sweep(i), folder).string());
        add_file(fmt::format("cam{}", i), i < 6 ? "k0" : "k1", "camera", i, i % 10 == 0, "", "none.jpg");
        poses.push_back(fmt::format(R"("token": "e{}", "timestamp": {}, {})", i, time_us(i),
                                    format_pose_keys(compute_vehicle_pose(i * kSweep_s))));
        write_text(sweep(i), make_turn(i, columns, rays[std::size_t(i)]));
    }
    add_file("other", "k9", "mount", 0, true, "", fs::relative(sweep(0), folder).string());
    write("sample_data", files);
    write("ego_pose", poses);
    std::vector<std::string> labels;
    for (const int i : {10, 0})
        labels.push_back(fmt::format(R"("token": "a{}", "sample_token": "k{}", "instance_token": "car", )"
                                     R"("size": [1.9, 4.5, 1.6], {})",
                                     i, i / 10, format_pose_keys(box_at(i * kSweep_s))));
    labels.push_back(R"("token": "a9", "sample_token": "k9", "instance_token": "dog", "size": [1, 1, 1], )" +
                     format_pose_keys(Pose{}));
    write("sample_annotation", labels);
    write("instance", {R"("token": "dog", "category_token": "animal")",
                       R"("token": "car", "category_token": "vehicle")"});
    write("category",
          {R"("token": "animal", "name": "animal")", R"("token": "vehicle", "name": "vehicle.car")"});
}

}  // namespace relidar::test
