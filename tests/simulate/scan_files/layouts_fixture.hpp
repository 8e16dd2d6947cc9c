// SPDX-License-Identifier: Apache-2.0
// Exact scans of two boxes on level ground, and data sets of them.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <relidar/simulate/dataset_layouts.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../plates.hpp"
#include "base/geometry/ray_box.hpp"

namespace relidar::test {

inline constexpr double kRigHeight_m = 2.0, kStart_s = 100.0, kYaw = 0.4;
inline constexpr int kSequenceFrames = 3;
inline const glm::dvec3 kCarSize_m(4.0, 2.0, 1.5), kWalkerSize_m(0.6, 0.6, 1.8);
inline const Pose kSecondMounting{glm::angleAxis(0.2, glm::dvec3(0, 0, 1)), {-1.0, 0.0, 0.0}};

/// The rig drives forward along x with 2 m/s.
inline Pose rig_pose(double time_s) {
    return {{1, 0, 0, 0}, {5.0 + 2.0 * (time_s - kStart_s), 0.0, kRigHeight_m}};
}
/// 10 m before the rig in all frames.
inline Pose car_pose(double time_s) {
    return {glm::angleAxis(kYaw, glm::dvec3(0, 0, 1)),
            rig_pose(time_s).translation + glm::dvec3(10.0, 2.0, 0.5 * kCarSize_m.z - kRigHeight_m)};
}
/// Half of it is outside the front sensor's field of view, which ends at 45 degrees.
inline Pose walker_pose(double time_s) {
    return {glm::angleAxis(0.25 * kPi, glm::dvec3(0, 0, 1)),
            rig_pose(time_s).translation + glm::dvec3(4.0, 4.0, 0.5 * kWalkerSize_m.z - kRigHeight_m)};
}

inline std::optional<double> hit_box(const Pose& box, const glm::dvec3& size_m, const glm::dvec3& origin,
                                     const glm::dvec3& ray) {
    const auto inside =
        cross_box(inverse(box) * origin, glm::conjugate(box.rotation) * ray, -0.5 * size_m, 0.5 * size_m);
    return inside && inside->enter > 0.0 ? std::optional(inside->enter) : std::nullopt;
}

/// Casts rays from 45 degrees left to `last_deg`, without a rolling shutter.
inline RenderedScan cast_rays(double time_s, const Pose& rig_from_sensor, double last_deg,
                              double ring_step_rad = 0.015) {
    RenderedScan scan;
    scan.time_s = time_s;
    scan.world_from_sensor = rig_pose(time_s) * rig_from_sensor;
    scan.image.rows = 40;
    scan.image.columns = 900;
    for (int r = 0; r < scan.image.rows; ++r)
        for (int c = 0; c < scan.image.columns; ++c) {
            const double azimuth = (45.0 - (45.0 - last_deg) * c / scan.image.columns) * kPi / 180.0,
                         elevation = 0.1 - ring_step_rad * r;
            const glm::dvec3 d(std::cos(elevation) * std::cos(azimuth),
                               std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
            const glm::dvec3 o = scan.world_from_sensor.translation,
                             ray = scan.world_from_sensor.rotation * d;
            double range_m = ray.z < 0.0 ? -o.z / ray.z : 0.0;
            int instance = ray.z < 0.0 ? 0 : -1;
            const auto meet = [&](const Pose& pose, const glm::dvec3& size_m, int number) {
                const auto hit_m = hit_box(pose, size_m, o, ray);
                if (!hit_m || (range_m > 0.0 && *hit_m > range_m)) return;
                // A little inside, because floats would round points to the outside.
                range_m = *hit_m + 1e-4;
                instance = number;
            };
            meet(car_pose(time_s), kCarSize_m, 1);
            meet(walker_pose(time_s), kWalkerSize_m, 2);
            scan.image.direction.emplace_back(d);
            scan.image.range_m.push_back(float(range_m));
            scan.image.drop_prob.push_back(range_m > 0.0 ? 0.0f : 1.0f);
            scan.instance.push_back(instance);
            scan.ring.push_back(std::uint16_t(r));
        }
    scan.actor_views = {{"car", 3, 4}, {"walker", 1, 3}};
    return complete(std::move(scan));
}

class Layouts : public TemporaryFolder {
protected:
    std::vector<DatasetSensor> sensors;
    std::vector<double> times_s;
    double ring_step_rad = 0.015;

    void SetUp() override {
        TemporaryFolder::SetUp();
        ScanOutputOptions options;
        options.instance_names = {"background", "car", "walker"};
        options.actors = {{"car", "Car", kCarSize_m, {}}, {"walker", "Pedestrian", kWalkerSize_m, {}}};
        options.time_shift_ns = 1'000'000'000'000;
        for (int i = 0; i < kSequenceFrames; ++i) times_s.push_back(kStart_s + 0.5 * i);
        for (const double t : {kStart_s - 1.0, kStart_s + 3.0}) {
            options.actors[0].world_from_box.append(t, car_pose(t));
            options.actors[1].world_from_box.append(t, walker_pose(t));
        }
        options.frame_id = "front";
        sensors = {{options, Pose{}}, {options, kSecondMounting}};
        sensors[1].options.frame_id = "second";
        sensors[1].options.offset = kSecondMounting;
    }
    void write_sequence(const std::string& layout, std::uint64_t seed, bool replace = false,
                        const DatasetView& view = {}, const RenderedScan* picture = nullptr) {
        for (DatasetSensor& sensor : sensors) sensor.options.sample = seed;
        DatasetSequenceWriter writer(folder, layout, sensors, times_s, replace, view);
        for (const double t : times_s) {
            std::vector<RenderedScan> scans{cast_rays(t, Pose{}, -45.0, ring_step_rad)};
            if (sensors.size() > 1) scans.push_back(cast_rays(t, kSecondMounting, -300.0, ring_step_rad));
            writer.write_scans(scans, picture);
        }
        writer.finish();
    }
};

}  // namespace relidar::test
