// SPDX-License-Identifier: Apache-2.0
#include "street_poses.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include "base/median.hpp"
#include "base/parallel.hpp"
#include "base/random.hpp"
#include "read/datasets/street/street.hpp"

namespace relidar::test {

Log set_poses(Log street, PoseTrack track) {
    set_trajectory(street, std::move(track));
    return street;
}

PoseTrack perturb_track(PoseTrack track, double sigma_m, double sigma_rad, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal(0.0, 1.0 / std::sqrt(3.0));
    for (Pose& pose : track.pose) {
        Twist twist;
        for (std::size_t i = 0; i < 6; ++i) twist[i] = (i < 3 ? sigma_m : sigma_rad) * normal(random);
        pose = apply_twist(pose, twist);
    }
    return track;
}

PoseTrack add_drift(PoseTrack track, double amplitude_m, double amplitude_rad) {
    for (std::size_t k = 0; k < track.pose.size(); ++k) {
        const double x = 2.0 * kPi * double(k) / double(track.pose.size());
        const double m = amplitude_m, w = amplitude_rad;
        track.pose[k] =
            apply_twist(track.pose[k], {m * std::sin(x), m * std::cos(1.3 * x), 0.5 * m * std::sin(0.7 * x),
                                        0.4 * w * std::sin(x), 0.5 * w * std::cos(x), w * std::sin(1.1 * x)});
    }
    return track;
}

PoseTrack add_drift_and_jumps(const PoseTrack& exact) {
    PoseTrack track = exact;
    const std::size_t n = exact.pose.size();
    for (std::size_t k = 1; k < n; ++k) {
        Pose step = inverse(exact.pose[k - 1]) * exact.pose[k];
        const double driven_length_m = glm::length(step.translation),
                     drift_rad = 0.01 * driven_length_m * kPi / 180.0;
        step.translation *= 1.01;
        step.rotation = glm::normalize(step.rotation * glm::angleAxis(drift_rad, glm::dvec3(0, 0, 1)) *
                                       glm::angleAxis(0.3 * drift_rad, glm::dvec3(0, 1, 0)));
        track.pose[k] = track.pose[k - 1] * step;
        if (k % (n / 5) == 0)
            track.pose[k].translation +=
                0.3 * glm::normalize(glm::dvec3(std::sin(double(k)), std::cos(double(k)), 0.2));
    }
    return track;
}

namespace {

/// Removes the mean rigid motion at the given positions between a track and the exact
/// track.
PoseTrack align_track(PoseTrack track, const PoseTrack& exact, const std::vector<int>& positions) {
    glm::dvec3 centre(0.0), v(0.0), w(0.0);
    for (const int k : positions) {
        const Twist twist = compute_twist(exact.pose[std::size_t(k)], track.pose[std::size_t(k)]);
        centre += track.pose[std::size_t(k)].translation / double(positions.size());
        v += glm::dvec3(twist[0], twist[1], twist[2]) / double(positions.size());
        w += glm::dvec3(twist[3], twist[4], twist[5]) / double(positions.size());
    }
    const glm::dquat rotation_correction = apply_twist(Pose{}, {0, 0, 0, -w.x, -w.y, -w.z}).rotation;
    for (Pose& pose : track.pose)
        pose = {glm::normalize(rotation_correction * pose.rotation),
                centre - v + rotation_correction * (pose.translation - centre)};
    return track;
}

}  // namespace

PoseError error_of(PoseTrack track, const PoseTrack& exact, const std::vector<int>& positions) {
    const Pose start =
        exact.pose[std::size_t(positions.front())] * inverse(track.pose[std::size_t(positions.front())]);
    for (Pose& pose : track.pose) pose = start * pose;  // close enough to average rotations
    for (int i = 0; i < 5; ++i) track = align_track(std::move(track), exact, positions);
    std::vector<double> metres, degrees;
    double squares = 0.0;
    for (const int k : positions) {
        const Twist e = compute_twist(exact.pose[std::size_t(k)], track.pose[std::size_t(k)]);
        metres.push_back(glm::length(glm::dvec3(e[0], e[1], e[2])));
        degrees.push_back(glm::length(glm::dvec3(e[3], e[4], e[5])) * 180.0 / kPi);
        squares += metres.back() * metres.back();
    }
    return {compute_median(metres), compute_median(degrees), std::sqrt(squares / double(positions.size())),
            *std::max_element(metres.begin(), metres.end()),
            *std::max_element(degrees.begin(), degrees.end())};
}

namespace {

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
                const StreetShape wall{
                    StreetShape::Kind::box,         {}, 0.5 * glm::dvec3(width, depth, height), 0.0, true,
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
                                          false,
                                          0.5},
                                         s, 5.0 * side));
        // parked cars
        for (double s = random.sample_uniform(2.0, 8.0); s < compute_loop_length();
             s += random.sample_uniform(7.0, 20.0))
            town.shapes.push_back(beside(
                {StreetShape::Kind::box, {}, {2.1, 0.9, 0.7}, random.sample_uniform(-0.04, 0.04), false, 0.5},
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

Log record_drive(const PoseTrack& track, std::vector<street::StreetShape> shapes, int columns) {
    Log drive;
    drive.name = "drive";
    drive.lidars[0].sensor = sensor();
    drive.lidars[0].sensor.columns = columns;
    drive.world_from_vehicle = track;
    const RayTable rays = make_rays(drive.lidars[0].sensor);
    const ScanArray<float> zeros(rays.size(), 0.0f);
    for (std::size_t k = 0; k < track.pose.size(); ++k)
        drive.frames.push_back({.index = int(k), .time_s = track.time_s[k], .scan = {rays, zeros, zeros}});
    const street::StreetCaster town({std::move(shapes), {}});
    parallel_for(int(track.pose.size()), [&](int k) {
        Frame& frame = drive.frames[std::size_t(k)];
        Random random(hash_pair(11, std::uint64_t(k)));
        street::ActorPoses no_actors;
        for (std::size_t ray = 0; ray < rays.size(); ++ray) {
            const auto hit =
                town.find_first_hit(make_world_ray(drive.world_from_vehicle, frame.time_s, rays, ray, true),
                                    frame.time_s, 80.0, no_actors);
            const double noise_m = 0.01 * random.sample_normal();
            if (hit) frame.scan.range_m[ray] = static_cast<float>(hit->range_m + noise_m);
        }
    });
    return drive;
}

Log drive_around_block(int n_frames) {
    PoseTrack track;
    for (int k = 0; k < n_frames; ++k)
        track.append(0.1 * k, compute_sensor_pose_at(compute_driven_m(0.1 * k, 0.1 * n_frames)));
    return record_drive(track, make_town().shapes, 128);
}

}  // namespace relidar::test
