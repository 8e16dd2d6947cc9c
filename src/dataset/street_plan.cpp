// SPDX-License-Identifier: Apache-2.0
// Lays out the synthetic street: 160 m of facades with gaps and setbacks on both sides, poles and trees on the pavements,
// parked cars, one car ahead in the sensor's lane (a little faster than the sensor), one oncoming.
#include "dataset/street.hpp"

#include <cmath>

#include "core/random.hpp"

namespace relidar::street {
namespace {

constexpr double kHalfLength_m = 80.0;
constexpr double kLeftKerb_m = 6.6, kRightKerb_m = -4.4;  // about y = 1.1: the sensor drives in the right-hand lane, y = 0
constexpr double kCarLength_m = 4.3, kCarWidth_m = 1.8;
constexpr double kBoxBottom_m = 0.15, kBoxTop_m = 1.5;  // the body begins at 0.2 m: a box holds its car and no ground
constexpr double kBoxCentre_m = 0.5 * (kBoxBottom_m + kBoxTop_m);

double middle_time_s(const SyntheticOptions& options) {
    return frame_time_s(options.n_frames / 2);
}

void add_facades(Street& street, Random& random, double side, double kerb_m) {
    for (double x = -kHalfLength_m; x < kHalfLength_m;) {
        const double width = random.uniform(8.0, 18.0), height = random.uniform(5.0, 14.0), depth = random.uniform(6.0, 10.0);
        const double setback = random.uniform(2.5, 4.5);
        const double y = kerb_m + side * (setback + 0.5 * depth);
        street.shapes.push_back({Shape::Kind::box,
                                 {x + 0.5 * width, y, 0.5 * height},
                                 0.5 * glm::dvec3(width, depth, height),
                                 0.0,
                                 Material::wall,
                                 random.uniform(0.3, 0.8)});
        x += width + (random.uniform() < 0.3 ? random.uniform(2.0, 5.0) : 0.0);
    }
}

void add_poles_and_trees(Street& street, Random& random, double side, double kerb_m) {
    for (double x = -kHalfLength_m + random.uniform(2.0, 8.0); x < kHalfLength_m; x += random.uniform(9.0, 16.0)) {
        const double y = kerb_m + side * random.uniform(0.5, 1.0);
        const bool tree = random.uniform() < 0.4;
        const double height = tree ? 3.0 : random.uniform(4.0, 7.0), radius = tree ? 0.18 : random.uniform(0.07, 0.13);
        street.shapes.push_back({Shape::Kind::cylinder,
                                 {x, y, 0.5 * height},
                                 {radius, radius, 0.5 * height},
                                 0.0,
                                 tree ? Material::leaves : Material::metal,
                                 tree ? 0.3 : 0.5});
        if (!tree) continue;
        const double size = random.uniform(0.7, 1.2);
        street.shapes.push_back({Shape::Kind::box, {x, y, 3.0 + size}, glm::dvec3(size), random.uniform(0.0, 1.5), Material::leaves, 0.4});
    }
}

/// Body (0.20 ... 0.90 m above the ground) and cabin (0.90 ... 1.45 m) about the centre of the car's box.
std::vector<Shape> car_shapes(double paint) {
    const Shape body{
        Shape::Kind::box, {0.0, 0.0, 0.55 - kBoxCentre_m}, {0.5 * kCarLength_m, 0.5 * kCarWidth_m, 0.35}, 0.0, Material::paint, paint};
    const Shape cabin{Shape::Kind::box, {-0.2, 0.0, 1.175 - kBoxCentre_m}, {1.15, 0.5 * kCarWidth_m - 0.12, 0.275}, 0.0, Material::paint,
                      0.6 * paint};
    return {body, cabin};
}

void add_parked_cars(Street& street, Random& random, double y_m) {
    for (double x = -kHalfLength_m + random.uniform(2.0, 10.0); x < kHalfLength_m - 5.0; x += random.uniform(6.0, 20.0)) {
        const double yaw = random.uniform(-0.04, 0.04), y = y_m + random.uniform(-0.15, 0.15);
        for (Shape shape : car_shapes(random.uniform(0.15, 0.8))) {
            shape.centre =
                glm::dvec3(x + shape.centre.x * std::cos(yaw), y + shape.centre.x * std::sin(yaw), shape.centre.z + kBoxCentre_m);
            shape.yaw_rad = yaw;
            street.shapes.push_back(shape);
        }
    }
}

MovingCar moving_car(const SyntheticOptions& options, double x_at_middle_m, double y_m, double yaw_rad, double speed_mps, double paint) {
    MovingCar car;
    car.yaw_rad = yaw_rad;
    car.speed_mps = speed_mps;
    car.size_m = {kCarLength_m + 0.1, kCarWidth_m + 0.1, kBoxTop_m - kBoxBottom_m};
    const double x = x_at_middle_m - std::cos(yaw_rad) * speed_mps * middle_time_s(options);
    car.start_m = {x, y_m, kBoxCentre_m};
    car.shapes = car_shapes(paint);
    return car;
}

}  // namespace

Street make_street(const SyntheticOptions& options) {
    Street street;
    Random random(options.seed);
    add_facades(street, random, 1.0, kLeftKerb_m);
    add_facades(street, random, -1.0, kRightKerb_m);
    add_poles_and_trees(street, random, 1.0, kLeftKerb_m);
    add_poles_and_trees(street, random, -1.0, kRightKerb_m);
    add_parked_cars(street, random, kLeftKerb_m - 1.1);
    add_parked_cars(street, random, kRightKerb_m + 1.1);
    if (options.moving_cars) {
        street.cars.push_back(moving_car(options, 12.0, 0.1, 0.0, 1.05 * options.speed_mps, 0.6));
        street.cars.push_back(moving_car(options, 14.0, 3.2, kPi, 9.0, 0.35));
    }
    return street;
}

Pose sensor_pose(const SyntheticOptions& options, double t_s) {
    constexpr double kSwing_m = 0.5, kWave = 2.0 * kPi / 90.0, kHeight_m = 1.8;
    const double x = options.speed_mps * (t_s - middle_time_s(options));
    const double yaw = std::atan(kSwing_m * kWave * std::cos(kWave * x)) + 0.01 * std::sin(0.31 * x);
    const double pitch = 0.004 * std::sin(0.43 * x), roll = 0.004 * std::sin(0.23 * x + 1.0);
    const glm::dquat rotation =
        glm::angleAxis(yaw, glm::dvec3(0, 0, 1)) * glm::angleAxis(pitch, glm::dvec3(0, 1, 0)) * glm::angleAxis(roll, glm::dvec3(1, 0, 0));
    return {rotation, {x, kSwing_m * std::sin(kWave * x), kHeight_m}};
}

}  // namespace relidar::street
