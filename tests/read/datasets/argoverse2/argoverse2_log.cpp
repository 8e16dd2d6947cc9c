// SPDX-License-Identifier: Apache-2.0
#include "read/datasets/argoverse2/argoverse2_log.hpp"

#include <fmt/format.h>

#include "base/random.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar::test {
namespace fs = std::filesystem;
namespace {

// Elevations of the beams by Argoverse's laser number, modulo 32
// (../shared/data/sensors/VLP-32C_Argoverse2.csv; pairs as measured in a published
// sweep).
constexpr double kElevation_deg[32] = {7,      -1.667,  1.667,  -0.667, 15,     -0.333, 3.333,  0.667,
                                       1.333,  0,       1,      2.333,  0.333,  -1,     4.667,  10.333,
                                       -6.148, -15.639, -3,     -2,     -4,     -8.843, -4.667, -3.333,
                                       -2.667, -5.333,  -1.333, -7.254, -3.667, -11.31, -2.333, -25};
constexpr double kAzimuth_deg[32] = {1.4,  -1.4, 4.2, -4.2, 1.4,  -1.4, 1.4, -4.2, 1.4,  1.4, -1.4,
                                     -1.4, 4.2,  4.2, -1.4, -1.4, 1.4,  1.4, -1.4, -4.2, 1.4, 1.4,
                                     -1.4, -4.2, 1.4, -4.2, 1.4,  -1.4, 4.2, -1.4, 4.2,  -1.4};
constexpr int kPair[32] = {12, 1, 8,  3,  14, 5, 10, 7,  6,  2, 9,  11, 4, 0, 13, 15,
                           5,  1, 12, 14, 7,  3, 8,  10, 11, 6, 15, 4,  9, 2, 13, 0};

constexpr glm::dvec3 kCity_m(5223.8, 2385.4, 69.1);
constexpr std::int64_t kCycle_ns = 55296, kPair_ns = 2304;

struct SweepColumns {
    std::vector<float> x, y, z;
    std::vector<std::uint8_t> intensity, laser;
    std::vector<std::int32_t> offset_ns;
};

/// @param lidar 0 is the upper LiDAR, 1 is the lower LiDAR
std::vector<YardRay> fire(const Pose& mounted, int lidar, const Argoverse2Options& options, double sweep_s,
                          SweepColumns& points) {
    const int half = lidar ^ int(options.lower_half_up);
    std::vector<YardRay> rays;
    const Pose vehicle_at_sweep = Argoverse2Log::compute_vehicle_pose(sweep_s);
    for (int n = 0; n < options.firings; ++n)
        for (int k = 0; k < 32; ++k) {
            const std::int64_t offset_ns = 2654000 + 611 * lidar + n * kCycle_ns + kPair[k] * kPair_ns;
            const double time_s = 1e-9 * double(offset_ns);
            // Viewed from above, the sensor turns clockwise. A LiDAR that is mounted
            // upside down therefore turns counter-clockwise.
            const double head = (lidar == 0 ? -1.0 : 1.0) * (2.0 * kPi * 10.0 * time_s - 2.5 + 3.0 * lidar);
            const double azimuth = head + kAzimuth_deg[k] * kPi / 180.0;
            YardRay ray =
                cast_in_yard(time_s, Argoverse2Log::compute_vehicle_pose(sweep_s + time_s) * mounted,
                             direction_at(kElevation_deg[k] * kPi / 180.0, azimuth), kCity_m);
            const bool hidden = lidar == 1 && n >= 700 && n < 741;  // the vehicle blocks all beams
            ray.returned = !hidden && hash_pair(std::uint64_t(n * 32 + k),
                                                std::uint64_t(1000.0 * sweep_s) + std::uint64_t(lidar)) %
                                              10 !=
                                          0;
            rays.push_back(ray);
            if (!ray.returned) continue;
            const glm::dvec3 p = inverse(vehicle_at_sweep) * ray.point_m;
            points.x.push_back(float(p.x));
            points.y.push_back(float(p.y));
            points.z.push_back(float(p.z));
            points.intensity.push_back(std::uint8_t(51));
            points.laser.push_back(std::uint8_t(32 * half + k));
            points.offset_ns.push_back(std::int32_t(offset_ns));
        }
    return rays;
}

std::string make_sweep_bytes(const SweepColumns& points, const Argoverse2Options& options) {
    return make_feather_bytes(
        {make_numbers("x", points.x), make_numbers("y", points.y), make_numbers("z", points.z),
         make_numbers("intensity", points.intensity), make_numbers("laser_number", points.laser),
         make_numbers("offset_ns", points.offset_ns)},
        options.codec);
}

std::string make_annotation_bytes(int sweeps, FeatherCodec codec) {
    std::vector<std::int64_t> time_ns, n_points;
    std::vector<double> length, width, height;
    std::vector<Pose> poses;
    for (int i = sweeps - 1; i >= 0; --i) {  // not ordered by time
        const double time_s = 1e-9 * double(Argoverse2Log::sweep_ns(i) - Argoverse2Log::kFirstSweep_ns);
        time_ns.push_back(Argoverse2Log::sweep_ns(i));
        n_points.push_back(7);
        length.push_back(4.5);
        width.push_back(1.9);
        height.push_back(1.6);
        poses.push_back(inverse(Argoverse2Log::compute_vehicle_pose(time_s)) *
                        Argoverse2Log::compute_box_pose(time_s));
    }
    const std::vector<std::string> id(std::size_t(sweeps), "1046f12a"),
        category(std::size_t(sweeps), "REGULAR_VEHICLE");
    std::vector<FeatherColumn> columns{
        make_numbers("timestamp_ns", time_ns),  make_texts("track_uuid", id),
        make_texts("category", category, true), make_numbers("length_m", length),
        make_numbers("width_m", width),         make_numbers("height_m", height)};
    columns = set_poses(std::move(columns), poses);
    columns.push_back(make_numbers("num_interior_pts", n_points));
    return make_feather_bytes(columns, codec);
}

}  // namespace

std::vector<FeatherColumn> set_poses(std::vector<FeatherColumn> columns, const std::vector<Pose>& poses) {
    const auto add = [&](const char* name, const auto& value_of) {
        std::vector<double> values;
        for (const Pose& pose : poses) values.push_back(value_of(pose));
        columns.push_back(make_numbers(name, values));
    };
    add("qw", [](const Pose& p) { return p.rotation.w; });
    add("qx", [](const Pose& p) { return p.rotation.x; });
    add("qy", [](const Pose& p) { return p.rotation.y; });
    add("qz", [](const Pose& p) { return p.rotation.z; });
    add("tx_m", [](const Pose& p) { return p.translation.x; });
    add("ty_m", [](const Pose& p) { return p.translation.y; });
    add("tz_m", [](const Pose& p) { return p.translation.z; });
    return columns;
}

Pose Argoverse2Log::compute_vehicle_pose(double time_s) {
    return {glm::angleAxis(0.6 + 0.35 * time_s, glm::dvec3(0, 0, 1)),
            kCity_m + time_s * glm::dvec3(9.0, 6.0, 0.1)};
}

Pose Argoverse2Log::compute_box_pose(double time_s) {
    return {glm::angleAxis(0.2, glm::dvec3(0, 0, 1)), kCity_m + glm::dvec3(12.0 + 5.0 * time_s, 3.0, 0.5)};
}

fs::path Argoverse2Log::sweep(int number) const {
    return folder / "sensors" / "lidar" / fmt::format("{}.feather", sweep_ns(number));
}

Argoverse2Log::Argoverse2Log(const std::string& name, const Argoverse2Options& options)
    : LogFolder("relidar_argoverse2_" + name) {
    vehicle_from_lidar = {Pose{glm::dquat(1, 0, 0, 0), {1.3626, 0.0006, 1.6406}},
                          Pose{glm::normalize(glm::dquat(0.000639, 0.9944968, -0.1047668, 0.0000928)),
                               {1.37536, 0.00165, 1.52427}}};
    const Pose camera{glm::dquat(0.5, -0.5, 0.5, -0.5), {1.6, 0.0, 1.4}};
    const std::vector<FeatherColumn> sensors =
        set_poses({make_texts("sensor_name", {"ring_front_center", "up_lidar", "down_lidar"})},
                  {camera, vehicle_from_lidar[0], vehicle_from_lidar[1]});
    write_text(file("calibration/egovehicle_SE3_sensor.feather"), make_feather_bytes(sensors, options.codec));
    // The dataset also has poses between the sweeps.
    std::vector<std::int64_t> time_ns;
    std::vector<Pose> poses;
    for (int i = 0; i < 4 * options.sweeps; ++i) {
        time_ns.push_back(sweep_ns(0) + i * (sweep_ns(1) - sweep_ns(0)) / 4);
        poses.push_back(compute_vehicle_pose(1e-9 * double(time_ns.back() - kFirstSweep_ns)));
    }
    const std::vector<FeatherColumn> pose_columns = set_poses({make_numbers("timestamp_ns", time_ns)}, poses);
    write_text(file("city_SE3_egovehicle.feather"), make_feather_bytes(pose_columns, options.codec));
    write_text(file("annotations.feather"), make_annotation_bytes(options.sweeps, options.codec));
    for (int i = 0; i < options.sweeps; ++i) {
        SweepColumns points;
        const double sweep_s = 1e-9 * double(sweep_ns(i) - kFirstSweep_ns);
        rays.emplace_back();
        for (int lidar = 0; lidar < 2; ++lidar)
            rays.back()[std::size_t(lidar)] =
                fire(vehicle_from_lidar[std::size_t(lidar)], lidar, options, sweep_s, points);
        write_text(sweep(i), make_sweep_bytes(points, options));
    }
}

}  // namespace relidar::test
