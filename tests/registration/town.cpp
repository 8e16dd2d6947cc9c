// SPDX-License-Identifier: Apache-2.0
#include "street_poses.hpp"

#include "base/parallel.hpp"
#include "base/random.hpp"
#include "read/datasets/street/street.hpp"

namespace relidar::test {
namespace {

using street::Material;
using street::StreetShape;

// lengths of the straights, which left turns connect
constexpr double kStraights_m[] = {70.0, 40.0, 70.0, 40.0}, kRadius_m = 10.0;
constexpr double kBeyond_m = 12.0, kStop_s = 2.0;

double compute_loop_length() { return 220.0 + 2.0 * kPi * kRadius_m; }

struct Place {
    glm::dvec2 at_m{0.0};
    double yaw_rad = 0.0;
    bool in_curve = false;
};

Place lane(double s_m) {
    s_m = std::fmod(s_m + compute_loop_length(), compute_loop_length());
    Place p;
    for (const double straight : kStraights_m) {
        const glm::dvec2 ahead(std::cos(p.yaw_rad), std::sin(p.yaw_rad)), left(-ahead.y, ahead.x);
        if (s_m < straight) return {p.at_m + s_m * ahead, p.yaw_rad, false};
        p.at_m += straight * ahead;
        s_m -= straight;
        const double quarter = 0.5 * kPi * kRadius_m, angle = std::min(s_m, quarter) / kRadius_m;
        p.at_m += kRadius_m * (std::sin(angle) * ahead + (1.0 - std::cos(angle)) * left);
        p.yaw_rad += angle;
        if (s_m < quarter) return {p.at_m, p.yaw_rad, true};
        s_m -= quarter;
    }
    return p;
}

/// Places a shape next to the lane, with the x axis of the shape along the lane.
StreetShape beside(StreetShape shape, double s_m, double left_m) {
    const Place p = lane(s_m);
    shape.centre = {p.at_m.x - left_m * std::sin(p.yaw_rad), p.at_m.y + left_m * std::cos(p.yaw_rad),
                    shape.half.z};
    shape.yaw_rad += p.yaw_rad;
    return shape;
}

street::SyntheticStreet make_town() {
    street::SyntheticStreet town;
    Random random(7);
    for (const double side : {1.0, -1.0}) {
        for (double s = 0.0; s < compute_loop_length() - 8.0;) {  // facades
            const double width = random.sample_uniform(7.0, 14.0), depth = random.sample_uniform(5.0, 9.0),
                         height = random.sample_uniform(5.0, 14.0);
            if (side < 0.0 || !(lane(s).in_curve || lane(s + width).in_curve)) {
                const StreetShape wall{StreetShape::Kind::box,
                                       {},
                                       0.5 * glm::dvec3(width, depth, height),
                                       0.0,
                                       Material::wall,
                                       random.sample_uniform(0.3, 0.8)};
                town.shapes.push_back(
                    beside(wall, s + 0.5 * width, side * (random.sample_uniform(7.0, 9.0) + 0.5 * depth)));
            }
            s += width + (random.sample_uniform() < 0.3 ? random.sample_uniform(2.0, 5.0) : 0.0);
        }
        // poles
        for (double s = random.sample_uniform(2.0, 8.0); s < compute_loop_length();
             s += random.sample_uniform(8.0, 15.0))
            town.shapes.push_back(beside({StreetShape::Kind::cylinder,
                                          {},
                                          {0.1, 0.1, random.sample_uniform(2.0, 3.5)},
                                          0.0,
                                          Material::metal,
                                          0.5},
                                         s, 5.0 * side));
        // parked cars
        for (double s = random.sample_uniform(2.0, 8.0); s < compute_loop_length();
             s += random.sample_uniform(7.0, 20.0))
            town.shapes.push_back(beside({StreetShape::Kind::box,
                                          {},
                                          {2.1, 0.9, 0.7},
                                          random.sample_uniform(-0.04, 0.04),
                                          Material::paint,
                                          0.5},
                                         s, 3.5 * side));
    }
    return town;
}

/// The speed is constant except for a smoothed stop half-way.
double compute_driven_m(double t_s, double duration_s) {
    const double speed = (compute_loop_length() + kBeyond_m) / (duration_s - kStop_s),
                 middle = 0.5 * (duration_s - kStop_s);
    const double after = std::clamp((t_s - middle) / kStop_s, 0.0, 1.0);
    // The slope of this polynomial is at most 1.5, so the car rolls back slightly.
    const double lost_s = kStop_s * after * after * (3.0 - 2.0 * after);
    return speed * (t_s - std::min(lost_s, std::max(0.0, t_s - middle)));
}

Pose compute_sensor_pose_at(double s_m) {
    const Place p = lane(s_m);
    const glm::dquat rotation = glm::angleAxis(p.yaw_rad + 0.01 * std::sin(0.31 * s_m), glm::dvec3(0, 0, 1)) *
                                glm::angleAxis(0.004 * std::sin(0.43 * s_m), glm::dvec3(0, 1, 0)) *
                                glm::angleAxis(0.004 * std::sin(0.23 * s_m), glm::dvec3(1, 0, 0));
    return {rotation, {p.at_m.x, p.at_m.y, 1.8 + 0.02 * std::sin(0.5 * s_m)}};
}

SpinningSensor sensor() {
    SpinningSensor sensor;
    for (int i = 0; i < 32; ++i)
        sensor.beams.push_back(
            {.elevation_rad = (3.0 - 28.0 / 31.0 * (i + 0.2 * std::sin(2.1 * i))) * kPi / 180.0});
    sensor.columns = 128;
    sensor.first_azimuth_rad = kPi - kPi / sensor.columns;
    return sensor;
}

}  // namespace

Log drive_around_block(int n_frames) {
    Log drive;
    drive.name = "drive around a block";
    drive.lidars[0].sensor = sensor();
    const RayTable rays = make_rays(drive.lidars[0].sensor);
    for (int k = 0; k < n_frames; ++k) {
        drive.world_from_vehicle.time_s.push_back(0.1 * k);
        drive.world_from_vehicle.pose.push_back(
            compute_sensor_pose_at(compute_driven_m(0.1 * k, 0.1 * n_frames)));
        drive.frames.push_back(
            {.index = k,
             .time_s = 0.1 * k,
             .scan = {rays, ScanArray<float>(rays.size(), 0.0f), ScanArray<float>(rays.size(), 0.0f)}});
    }
    const street::StreetCaster town(make_town());
    parallel_for(n_frames, [&](int k) {
        Frame& frame = drive.frames[std::size_t(k)];
        Random random(hash_pair(11, std::uint64_t(k)));
        for (std::size_t ray = 0; ray < rays.size(); ++ray) {
            const auto hit = town.find_first_hit(
                make_world_ray(drive.world_from_vehicle, frame.time_s, rays, ray, true), frame.time_s, 80.0);
            const double noise_m = 0.01 * random.sample_normal();
            if (hit) frame.scan.range_m[ray] = static_cast<float>(hit->range_m + noise_m);
        }
    });
    return drive;
}

}  // namespace relidar::test
