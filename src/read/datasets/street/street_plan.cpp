// SPDX-License-Identifier: Apache-2.0
// Creates the objects of the synthetic street. Facades with gaps are on both sides, along
// 160 m or along the full path of the sensor. Poles and trees stand on the pavements, and
// parked cars at the kerbs. One car drives ahead of the sensor in the same lane, slightly
// faster. One oncoming car passes, or several on a long street.
//
// The arguments of a function draw at most one random number, because the compiler
// chooses the order of arguments. Another order of the draws would change the street.
//
// Optional people are one person on each pavement, one person who crosses the street, and
// a cyclist next to the lane. With people, a yard on the left contains parked cars behind
// a fence.
#include "read/datasets/street/street.hpp"

#include <cmath>

#include "base/random.hpp"

namespace relidar::street {
namespace {

constexpr double kHalfLength_m = 80.0, kLongDrive_m = 100.0, kBetweenCars_m = 120.0;
// The sensor drives at y = 0, in the right-hand lane. The middle is at y = 1.1.
constexpr double kLeftKerb_m = 6.6, kRightKerb_m = -4.4;
constexpr double kCarLength_m = 4.3, kCarWidth_m = 1.8;
// A box contains the full car, from 0.2 m, but no ground.
constexpr double kBoxBottom_m = 0.15, kBoxTop_m = 1.5;
constexpr double kBoxCentre_m = 0.5 * (kBoxBottom_m + kBoxTop_m);
// along the street, left of the pavement
constexpr double kYardBegin_m = 6.0, kYardEnd_m = 32.0;

StreetShape make_box(const glm::dvec3& centre, const glm::dvec3& half, double reflectance,
                     SurfaceClass surface = SurfaceClass::building, double yaw_rad = 0.0) {
    return {StreetShape::Kind::box, centre, half, yaw_rad, false, reflectance, surface};
}

StreetShape make_wall(const glm::dvec3& centre, const glm::dvec3& half, double reflectance,
                      SurfaceClass surface = SurfaceClass::building) {
    return {StreetShape::Kind::box, centre, half, 0.0, true, reflectance, surface};
}

StreetShape make_cylinder(const glm::dvec3& centre, double radius_m, double half_height_m, double reflectance,
                          SurfaceClass surface = SurfaceClass::building) {
    const glm::dvec3 half(radius_m, radius_m, half_height_m);
    return {StreetShape::Kind::cylinder, centre, half, 0.0, false, reflectance, surface};
}

double middle_time_s(const StreetOptions& options) { return frame_time_of_s(options.n_frames / 2); }

double driven_m(const StreetOptions& options) {
    return options.speed_mps * frame_time_of_s(options.n_frames - 1);
}

struct StreetSide {
    double left;  ///< sign of y on this side: 1 on the left, -1 on the right
    double kerb_m;
    double half_m;  ///< half of the length of the street
};

/// Adds house facades on one side of the street. A gap of 2 to 5 m follows 30 % of the
/// houses.
/// @param yard_gap  if true, leaves a gap for the yard
void add_facades(SyntheticStreet& street, Random& random, const StreetSide& street_side, bool yard_gap) {
    double x = -street_side.half_m;  // begin of the next house
    while (x < street_side.half_m) {
        const double width = random.sample_uniform(8.0, 18.0), height = random.sample_uniform(5.0, 14.0),
                     depth = random.sample_uniform(6.0, 10.0);
        const double setback = random.sample_uniform(2.5, 4.5);  // distance from the kerb
        const double y = street_side.kerb_m + street_side.left * (setback + 0.5 * depth);
        const double reflectance = random.sample_uniform(0.3, 0.8);
        const bool is_in_yard = x + width >= kYardBegin_m && x <= kYardEnd_m;
        if (!(yard_gap && is_in_yard))
            street.shapes.push_back(make_wall({x + 0.5 * width, y, 0.5 * height},
                                              0.5 * glm::dvec3(width, depth, height), reflectance));
        const bool has_gap = random.sample_uniform() < 0.3;
        x += width + (has_gap ? random.sample_uniform(2.0, 5.0) : 0.0);
    }
}

/// Adds lamp posts and trees (a trunk and a cube of leaves) on the pavement of one side.
void add_poles(SyntheticStreet& street, Random& random, const StreetSide& street_side) {
    const double half_m = street_side.half_m;
    for (double x = -half_m + random.sample_uniform(2.0, 8.0); x < half_m;
         x += random.sample_uniform(9.0, 16.0)) {
        const double y = street_side.kerb_m + street_side.left * random.sample_uniform(0.5, 1.0);
        const bool is_tree = random.sample_uniform() < 0.4;
        if (!is_tree) {
            const double height = random.sample_uniform(4.0, 7.0);
            const double radius = random.sample_uniform(0.07, 0.13);
            street.shapes.push_back(
                make_cylinder({x, y, 0.5 * height}, radius, 0.5 * height, 0.5, SurfaceClass::pole));
            continue;
        }
        constexpr double kTrunk_m = 3.0, kTrunkRadius_m = 0.18;
        street.shapes.push_back(make_cylinder({x, y, 0.5 * kTrunk_m}, kTrunkRadius_m, 0.5 * kTrunk_m, 0.3,
                                              SurfaceClass::vegetation));
        const double half_crown = random.sample_uniform(0.7, 1.2), yaw = random.sample_uniform(0.0, 1.5);
        street.shapes.push_back(make_box({x, y, kTrunk_m + half_crown}, glm::dvec3(half_crown), 0.4,
                                         SurfaceClass::vegetation, yaw));
    }
}

/// Returns the shapes of a car in the frame of its box. The body is 0.20 to 0.90 m above
/// the ground, and the cabin 0.90 to 1.45 m.
std::vector<StreetShape> make_car_shapes(double paint_reflectance) {
    return {make_box({0.0, 0.0, 0.55 - kBoxCentre_m}, {0.5 * kCarLength_m, 0.5 * kCarWidth_m, 0.35},
                     paint_reflectance),
            make_box({-0.2, 0.0, 1.175 - kBoxCentre_m}, {1.15, 0.5 * kCarWidth_m - 0.12, 0.275},
                     0.6 * paint_reflectance)};
}

/// Returns the shapes of a car with transparent windows. Its cabin has pillars, seats and
/// a roof, but no walls.
std::vector<StreetShape> make_glazed_car(double paint_reflectance) {
    const StreetShape body = make_car_shapes(paint_reflectance)[0],
                      roof = make_box({-0.2, 0.0, 1.42 - kBoxCentre_m},
                                      {0.95, 0.5 * kCarWidth_m - 0.12, 0.03}, paint_reflectance),
                      seats = make_box({-0.3, 0.0, 1.0 - kBoxCentre_m}, {0.12, 0.6, 0.2}, 0.3);
    std::vector<StreetShape> shapes{body, roof, seats};
    for (const double pillar_x : {-1.2, -0.1, 0.8})
        for (const double pillar_y : {-0.75, 0.75})
            shapes.push_back(
                make_box({pillar_x, pillar_y, 1.16 - kBoxCentre_m}, {0.05, 0.04, 0.26}, paint_reflectance));
    return shapes;
}

/// Adds a car at rest. Moves its shapes from the frame of its box to the street.
void add_parked_car(SyntheticStreet& street, double x_m, double y_m, double yaw_rad,
                    const std::vector<StreetShape>& car_shapes) {
    for (StreetShape shape : car_shapes) {
        const glm::dvec3 in_box = shape.centre;
        shape.centre = glm::dvec3(x_m + in_box.x * std::cos(yaw_rad) - in_box.y * std::sin(yaw_rad),
                                  y_m + in_box.x * std::sin(yaw_rad) + in_box.y * std::cos(yaw_rad),
                                  in_box.z + kBoxCentre_m);
        shape.yaw_rad = yaw_rad;
        shape.surface = SurfaceClass::vehicle;
        street.shapes.push_back(shape);
    }
}

/// Adds parked cars on the road, next to the kerb.
void add_parked_cars(SyntheticStreet& street, Random& random, const StreetSide& side, bool glass_windows) {
    for (double x = -side.half_m + random.sample_uniform(2.0, 10.0); x < side.half_m - 5.0;
         x += random.sample_uniform(6.0, 20.0)) {
        const double yaw = random.sample_uniform(-0.04, 0.04),
                     y = side.kerb_m - 1.1 * side.left + random.sample_uniform(-0.15, 0.15);
        const double paint = random.sample_uniform(0.15, 0.8);
        add_parked_car(street, x, y, yaw, glass_windows ? make_glazed_car(paint) : make_car_shapes(paint));
    }
}

/// Adds a yard with parked cars behind a fence. The fence hides about half of each car,
/// so a moving sensor sees other parts of the cars in every sweep.
void add_yard(SyntheticStreet& street, Random& random) {
    const double fence_y = kLeftKerb_m + 2.4;
    // The fence consists of boards with gaps.
    for (double x = kYardBegin_m; x < kYardEnd_m; x += random.sample_uniform(0.4, 1.2))
        street.shapes.push_back(make_wall({x, fence_y, 0.9}, {0.15, 0.05, 0.9}, 0.4, SurfaceClass::fence));
    for (double x = kYardBegin_m + 1.5; x < kYardEnd_m; x += random.sample_uniform(2.6, 4.0)) {
        const double paint_reflectance = random.sample_uniform(0.15, 0.8);
        const double yaw_rad = 0.5 * kPi + random.sample_uniform(-0.05, 0.05);
        const double y_m = fence_y + random.sample_uniform(3.0, 4.0);
        add_parked_car(street, x, y_m, yaw_rad, make_glazed_car(paint_reflectance));
    }
    const double middle_x = 0.5 * (kYardBegin_m + kYardEnd_m),
                 half_length_m = 0.5 * (kYardEnd_m - kYardBegin_m);
    street.shapes.push_back(make_wall({middle_x, fence_y + 12.0, 3.0}, {half_length_m, 1.0, 3.0}, 0.5));
}

/// Returns a car that drives straight at constant speed. In the middle of the log, the
/// sensor is at x = 0 and the car at `x_at_middle_time_m`.
MovingStreetActor make_moving_car(const StreetOptions& options, double x_at_middle_time_m, double y_m,
                                  double yaw_rad, double speed_mps, double paint_reflectance) {
    MovingStreetActor car;
    car.yaw_rad = yaw_rad;
    car.speed_mps = speed_mps;
    car.size_m = {kCarLength_m + 0.1, kCarWidth_m + 0.1, kBoxTop_m - kBoxBottom_m};
    const double x = x_at_middle_time_m - std::cos(yaw_rad) * speed_mps * middle_time_s(options);
    car.start_m = {x, y_m, kBoxCentre_m};
    car.shapes = make_car_shapes(paint_reflectance);
    return car;
}

/// Adds a car that drives towards the sensor and is 14 m ahead of it in the middle of the
/// log. On a long drive, the sensor meets one more after every 120 m of its path.
void add_oncoming_cars(SyntheticStreet& street, Random& random, const StreetOptions& options) {
    constexpr double kSpeed_mps = 9.0, kLane_m = 3.2, kFirstAhead_m = 14.0, kFirstPaint = 0.35;
    const auto add_car = [&](double x_at_middle_time_m, double paint_reflectance) {
        street.cars.push_back(make_moving_car(options, x_at_middle_time_m, kLane_m, /*yaw_rad=*/kPi,
                                              kSpeed_mps, paint_reflectance));
    };
    add_car(kFirstAhead_m, kFirstPaint);
    if (driven_m(options) <= kLongDrive_m) return;
    // In the middle of the log, the sensor is at x = 0. It meets a car at x = meeting_m,
    // after this time if x > 0. In between, the sensor drives meeting_m, and the car
    // drives meeting_m * car_ratio in the other direction, so it was this much farther.
    const double car_ratio = kSpeed_mps / options.speed_mps;
    for (double x = kBetweenCars_m; x < 0.5 * driven_m(options); x += kBetweenCars_m)
        for (const double meeting_m : {x, -x})
            add_car(meeting_m * (1.0 + car_ratio), random.sample_uniform(0.15, 0.8));
}

/// Adds a bush: 60 small cubes, so that most rays pass between its leaves.
void add_bush(SyntheticStreet& street, Random& random, const glm::dvec2& position_m) {
    for (int leaf = 0; leaf < 60; ++leaf) {
        const double z_m = random.sample_uniform(0.1, 1.6);
        const double y_m = position_m.y + random.sample_uniform(-0.5, 0.5);
        const double x_m = position_m.x + random.sample_uniform(-1.0, 1.0);
        const double half_m = random.sample_uniform(0.03, 0.08);
        const double yaw_rad = random.sample_uniform(0.0, 1.5);
        constexpr double kReflectance = 0.4;
        street.shapes.push_back(
            make_box({x_m, y_m, z_m}, glm::dvec3(half_m), kReflectance, SurfaceClass::vegetation, yaw_rad));
    }
}

constexpr double kLegs_m = 0.8;  // length of legs
constexpr double kLegReflectance = 0.35, kBodyReflectance = 0.5;

/// Returns a person without legs, who walks or rides straight: a body in the upper part
/// of a box. The box begins 0.05 m above the ground, so that it contains the feet but no
/// ground.
/// @param position_at_middle_time_m  x, y in the street frame in the middle of the log
MovingStreetActor make_person(const StreetOptions& options, const glm::dvec2& position_at_middle_time_m,
                              double yaw_rad, double speed_mps) {
    constexpr double kTall_m = 1.75, kBottom_m = 0.05, kWidth_m = 0.6, kHalf_m = 0.5 * (kTall_m - kBottom_m);
    constexpr double kBody_m = 0.9, kBodyRadius_m = 0.175;
    MovingStreetActor person;
    person.category = "Pedestrian";
    person.yaw_rad = yaw_rad;
    person.speed_mps = speed_mps;
    person.size_m = {kWidth_m, kWidth_m, 2.0 * kHalf_m};
    const glm::dvec2 start = position_at_middle_time_m - speed_mps * middle_time_s(options) *
                                                             glm::dvec2(std::cos(yaw_rad), std::sin(yaw_rad));
    person.start_m = {start, kBottom_m + kHalf_m};
    // The bottom of the box, where legs begin, is at z = -kHalf_m.
    person.shapes = {make_cylinder({0.0, 0.0, kLegs_m + 0.5 * kBody_m - kHalf_m}, kBodyRadius_m,
                                   0.5 * kBody_m, kBodyReflectance)};
    return person;
}

/// Adds legs that do not move, as one cylinder.
void add_stiff_legs(MovingStreetActor& person) {
    constexpr double kRadius_m = 0.125;
    const glm::dvec3 centre(0.0, 0.0, 0.5 * kLegs_m - 0.5 * person.size_m.z);
    person.shapes.push_back(make_cylinder(centre, kRadius_m, 0.5 * kLegs_m, kLegReflectance));
}

/// Adds arms and legs that swing: capsules that hang from a joint, in the frame of the
/// box (origin at its centre, x forward, y left). Feet on the ground do not slide: they
/// swing backward as far as the body moves forward.
void add_swinging_limbs(MovingStreetActor& person) {
    constexpr double kLeg_m = 0.72, kLegRadius_m = 0.075, kHip_m = 0.09, kArm_m = 0.5, kArmRadius_m = 0.045,
                     kShoulder_m = 0.23;
    constexpr double kSwing_rad = 0.45, kShoulderBelowTop_m = 0.35, kMargin_m = 0.02;
    // The capsule of a straight leg ends at the bottom of the box.
    const double half_height_m = 0.5 * person.size_m.z, hip_z_m = -half_height_m + kLeg_m + kLegRadius_m;
    const auto add_limb = [&](const glm::dvec3& joint_m, double length_m, double radius_m, double phase_rad,
                              double reflectance) {
        person.limbs.push_back({joint_m, length_m, radius_m, kSwing_rad, phase_rad, reflectance});
    };
    for (const double side : {1.0, -1.0}) {  // left, right
        const double phase_rad = side > 0.0 ? 0.0 : kPi;
        add_limb({0.0, side * kHip_m, hip_z_m}, kLeg_m, kLegRadius_m, phase_rad, kLegReflectance);
        // An arm swings opposite to the leg of its side.
        add_limb({0.0, side * kShoulder_m, half_height_m - kShoulderBelowTop_m}, kArm_m, kArmRadius_m,
                 phase_rad + kPi, kBodyReflectance);
    }
    // The foot on the ground moves from foot_forward_m before the hip to as far behind
    // it. The body moves this distance forward, once for each foot in a stride.
    const double foot_forward_m = kLeg_m * std::sin(kSwing_rad);
    person.stride_m = 2.0 * (2.0 * foot_forward_m);
    // The box contains both feet at their largest distance.
    person.size_m.x = 2.0 * (foot_forward_m + kLegRadius_m) + 2.0 * kMargin_m;
}

/// Returns a person on a bicycle, which is a box below the body.
MovingStreetActor make_cyclist(const StreetOptions& options, const glm::dvec2& middle_m, double speed_mps) {
    MovingStreetActor rider = make_person(options, middle_m, 0.0, speed_mps);
    rider.category = "Cyclist";
    rider.size_m.x = 1.8;
    rider.shapes[0].centre.x -= 0.2;
    rider.shapes.push_back(make_box({0.0, 0.0, 0.5 - 0.5 * rider.size_m.z}, {0.85, 0.08, 0.45}, 0.4));
    return rider;
}

/// Adds a pedestrian on each pavement, a pedestrian who crosses the street, and a cyclist
/// next to the lane.
void add_people(SyntheticStreet& street, Random& random, const StreetOptions& options) {
    struct Walk {
        double min_x_m, max_x_m, y_m, yaw_rad;  // position and heading in the middle of the log
    };
    constexpr Walk kRightPavement{4.0, 16.0, kRightKerb_m - 1.6, 0.0},
        kLeftPavement{4.0, 16.0, kLeftKerb_m + 1.7, kPi}, kAcross{24.0, 30.0, 4.5, -0.5 * kPi};
    for (const Walk& walk : {kRightPavement, kLeftPavement, kAcross}) {
        const double speed_mps = random.sample_uniform(1.0, 1.6);
        const double x_m = random.sample_uniform(walk.min_x_m, walk.max_x_m);
        MovingStreetActor& person =
            street.cars.emplace_back(make_person(options, {x_m, walk.y_m}, walk.yaw_rad, speed_mps));
        if (options.gait) add_swinging_limbs(person);
        else add_stiff_legs(person);
    }
    const double cyclist_speed_mps = random.sample_uniform(4.0, 6.0);
    const double cyclist_x_m = random.sample_uniform(6.0, 9.0);
    street.cars.push_back(make_cyclist(options, {cyclist_x_m, kRightKerb_m + 2.7}, cyclist_speed_mps));
}

}  // namespace

SyntheticStreet make_street(const StreetOptions& options) {
    SyntheticStreet street;
    Random random(options.seed);
    // The street continues beyond both ends of the sensor's path, even for a long log.
    const bool is_long = driven_m(options) > kLongDrive_m;
    const double half_length_m = is_long ? 0.5 * driven_m(options) + kHalfLength_m : kHalfLength_m;
    const StreetSide left{.left = 1.0, .kerb_m = kLeftKerb_m, .half_m = half_length_m},
        right{.left = -1.0, .kerb_m = kRightKerb_m, .half_m = half_length_m};
    add_facades(street, random, left, options.people);
    add_facades(street, random, right, false);
    add_poles(street, random, left);
    add_poles(street, random, right);
    add_parked_cars(street, random, left, options.people);
    add_parked_cars(street, random, right, options.people);
    if (options.moving_cars) {
        // The car ahead is 5 % faster. Its distance in the middle of the log is so large
        // that it is ahead of the sensor from the beginning.
        constexpr double kAhead_m = 12.0, kLane_m = 0.1, kPaint = 0.6;
        const double ahead_m = is_long ? kAhead_m + 0.05 * 0.5 * driven_m(options) : kAhead_m;
        street.cars.push_back(
            make_moving_car(options, ahead_m, kLane_m, /*yaw_rad=*/0.0, 1.05 * options.speed_mps, kPaint));
        add_oncoming_cars(street, random, options);
    }
    if (options.people) {
        add_yard(street, random);
        const double pavement_y_m = kRightKerb_m - 0.9;
        for (const double x_m : {-14.0, -4.0, 18.0}) add_bush(street, random, {x_m, pavement_y_m});
        add_people(street, random, options);
    }
    return street;
}

Pose sensor_pose_at(const StreetOptions& options, double time_s) {
    constexpr double kSwing_m = 0.5, kWave = 2.0 * kPi / 90.0, kHeight_m = 1.8;
    const double x = options.speed_mps * (time_s - middle_time_s(options));
    const double yaw = std::atan(kSwing_m * kWave * std::cos(kWave * x)) + 0.01 * std::sin(0.31 * x);
    const double pitch = 0.004 * std::sin(0.43 * x), roll = 0.004 * std::sin(0.23 * x + 1.0);
    return {make_rotation(yaw, pitch, roll), {x, kSwing_m * std::sin(kWave * x), kHeight_m}};
}

}  // namespace relidar::street
