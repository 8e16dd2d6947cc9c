// SPDX-License-Identifier: Apache-2.0
// Tests edits of a labelled car that stands on a slope and is part of the background.
// The log has not observed the ground below it.
#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/render.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "../../support/names.hpp"
#include "../plates.hpp"
#include "base/geometry/ray_box.hpp"

namespace relidar {
namespace {

const glm::dvec3 kCar_m{4.0, 1.8, 1.5}, kOffset_m{1000.0, -50.0, 3.0}, kSensor_m{0.0, 0.0, 1.8};
constexpr double kSlope = 0.02, kStrayOutside_m = 0.4;

double ground_m(double x) { return kSlope * x; }

/// The car stands across the slope, its bottom 0.02 m above the ground in its middle.
Pose car_pose() { return {make_rotation(0.5, 0.0, 0.0), {10.0, 1.0, ground_m(10.0) + 0.77}}; }

void add_plate(Surfels& surfels, const glm::dvec3& mean_m, const glm::dvec3& normal, double scale_m) {
    Surfels plate = test::make_plate(glm::vec3(mean_m), glm::vec2(float(scale_m)), true);
    const glm::dvec3 up(0.0, 0.0, 1.0), to = glm::normalize(normal), axis = glm::cross(up, to);
    const glm::dquat q = glm::normalize(glm::dquat(1.0 + glm::dot(up, to), axis.x, axis.y, axis.z));
    plate.rotation[0] = glm::vec4(q.w, q.x, q.y, q.z);
    surfels.append_surfels(plate);
}

/// The sides and tyres of the car, and a mirror that its label leaves out.
Surfels make_car() {
    Surfels car;
    const Pose pose = car_pose();
    const glm::dvec3 half_m = 0.5 * kCar_m;
    const auto add = [&](const glm::dvec3& point_m, const glm::dvec3& normal) {
        add_plate(car, pose * point_m, pose.rotation * normal, 0.12);
    };
    for (double u = -0.95; u < 1.0; u += 0.05)
        for (double v = -0.8; v < 1.0; v += 0.1) {
            for (const double side : {-1.0, 1.0}) {
                add({u * half_m.x, side * half_m.y, v * half_m.z}, {0.0, side, 0.0});
                add({side * half_m.x, u * half_m.y, v * half_m.z}, {side, 0.0, 0.0});
            }
            add({u * half_m.x, v * half_m.y, half_m.z}, {0.0, 0.0, 1.0});
        }
    // Upright surfels of the tyres, whose centres are on the ground.
    for (const double x : {-1.4, 1.4})
        for (const double side : {-1.0, 1.0}) {
            const glm::dvec3 tyre_m = pose * glm::dvec3(x, side * (half_m.y - 0.1), 0.0);
            add_plate(car, {tyre_m.x, tyre_m.y, ground_m(tyre_m.x)},
                      pose.rotation * glm::dvec3(0.0, side, 0.0), 0.12);
        }
    add({0.5, half_m.y + kStrayOutside_m, 0.4}, {-1.0, 0.0, 0.0});
    return car;
}

/// The slope without the ground below the car, and a long wall 0.5 m beside the car.
Surfels make_street() {
    Surfels street;
    const Pose car_from_world = inverse(car_pose());
    for (double x = 2.0; x <= 22.0; x += 0.25)
        for (double y = -8.0; y <= 10.0; y += 0.25) {
            const glm::dvec3 point_m(x, y, ground_m(x)),
                out_m = glm::abs(car_from_world * point_m) - 0.5 * kCar_m;
            if (std::max(out_m.x, out_m.y) > 0.0) add_plate(street, point_m, {-kSlope, 0.0, 1.0}, 0.15);
        }
    for (double u = -6.0; u <= 6.0; u += 0.2)
        for (double z = 0.2; z <= 2.0; z += 0.2)
            add_plate(street, car_pose() * glm::dvec3(u, -0.5 * kCar_m.y - 0.5, z - 0.77),
                      car_pose().rotation * glm::dvec3(0.0, 1.0, 0.0), 0.12);
    return street;
}

relidar::Run make_run() {
    relidar::Run run;
    run.config = make_preset("quick");
    std::vector<double> elevations_rad;
    for (double degrees = -1.0; degrees > -16.0; degrees -= 0.25)
        elevations_rad.push_back(degrees * kPi / 180.0);
    run.log = test::make_static_log(elevations_rad, 1440);
    run.log.world_offset_m = kOffset_m;
    run.log.world_from_vehicle = {};
    BoxTrack car{"5", "Car", kCar_m, {}};
    for (int i = 0; i < 11; ++i) {
        run.log.frames.push_back({i, 0.1 * i, {}});
        run.log.world_from_vehicle.append(0.1 * i, {{1, 0, 0, 0}, kSensor_m});
        Pose label = car_pose();
        label.translation.x += 0.02 * (i - 5);  // labels drift
        if (i >= 3 && i <= 7) car.world_from_box.append(0.1 * i, label);
    }
    run.log.boxes = {car};
    Surfels all = make_street();
    all.append_surfels(make_car());
    run.scene = wrap_background(all.reorder(kd_tree_order(all.mean)));
    return run;
}

/// A ray of a scan, in the world frame.
struct Ray {
    glm::dvec3 origin_m, direction;
    double range_m;
    glm::dvec3 end_m() const { return origin_m + range_m * direction; }
    double ground_range_m() const {
        return (ground_m(origin_m.x) - origin_m.z) / (direction.z - kSlope * direction.x);
    }
    /// Range at which the ray enters the box of the car.
    std::optional<double> car_range_m(const Pose& pose) const {
        const Pose box_from_world = inverse(pose);
        const auto inside = cross_box(box_from_world * origin_m, box_from_world.rotation * direction,
                                      -0.5 * kCar_m, 0.5 * kCar_m);
        return inside && inside->enter > 0.0 ? std::optional(inside->enter) : std::nullopt;
    }
};

bool is_in_car(const glm::dvec3& point_m, const Pose& pose, double margin_m) {
    return glm::all(glm::lessThan(glm::abs(inverse(pose) * point_m), 0.5 * kCar_m + margin_m)) &&
           point_m.z > ground_m(point_m.x) + 0.05;
}

class StandingObjects : public test::DeviceTest {
protected:
    std::vector<Ray> render(const SceneWithLog& driving) {
        ScanRenderer renderer(device(), driving.scene, {}, driving.log);
        const RenderedScan scan = renderer.render(make_sensor({}, driving.log), 0.0);
        std::vector<Ray> rays;
        for (std::size_t i = 0; i < scan.median_range_m.size(); ++i)
            rays.push_back({kSensor_m, glm::dvec3(scan.image.direction[i]),
                            scan.image.drop_prob[i] < 0.5f ? double(scan.median_range_m[i]) : 0.0});
        return rays;
    }
};

TEST_F(StandingObjects, RemovedCarShowsTheGroundBehindIt) {
    const SceneWithLog edited = remove_track(make_run().driving_scene(), "5");
    EXPECT_EQ(edited.log.boxes.size(), 0u);
    EXPECT_EQ(edited.scene.instances.size(), 1u);
    int n_ground = 0;
    for (const Ray& ray : render(edited)) {
        EXPECT_FALSE(ray.range_m > 0.0 && is_in_car(ray.end_m(), car_pose(), 0.1)) << ray.range_m;
        const glm::dvec3 ground_point_m = ray.origin_m + ray.ground_range_m() * ray.direction,
                         in_box_m = inverse(car_pose()) * ground_point_m;
        const glm::dvec3 out_m = glm::abs(in_box_m) - 0.5 * kCar_m;
        if (std::max(out_m.x, out_m.y) > 0.0) continue;
        ++n_ground;
        EXPECT_NEAR(ray.range_m * -ray.direction.z, ray.ground_range_m() * -ray.direction.z, 0.02)
            << "height at " << in_box_m.x << ", " << in_box_m.y;
    }
    EXPECT_GT(n_ground, 500) << "rays to the ground below the car";
}

TEST_F(StandingObjects, MovedCarIsAtItsNewPlaceOnly) {
    const Pose shift{make_rotation(0.2, 0.0, 0.0), {1.0, 4.0, 0.0}}, place = car_pose() * shift;
    int n_near = 0, n_on_car = 0;
    for (const Ray& ray : render(move_track(make_run().driving_scene(), "5", shift))) {
        const auto expected_m = ray.car_range_m(place);
        EXPECT_FALSE(ray.range_m > 0.0 && is_in_car(ray.end_m(), car_pose(), 0.1) &&
                     !is_in_car(ray.end_m(), place, 0.2));
        // Leaves out rays to the edges of the car.
        if (!expected_m || !is_in_car(ray.origin_m + (*expected_m + 0.2) * ray.direction, place, -0.1))
            continue;
        ++n_on_car;
        n_near += std::abs(ray.range_m - *expected_m) < 0.02;
    }
    EXPECT_GT(n_on_car, 1000);
    EXPECT_GT(n_near, 0.99 * n_on_car);
}

TEST_F(StandingObjects, CarThatStaysLooksTheSame) {
    const relidar::Run run = make_run();
    SceneWithLog edited = move_track(run.driving_scene(), "5", {});
    EXPECT_TRUE(list_changed_tracks({edited.scene, edited.log}, run.log.boxes).empty());
    edited = complete_actors(std::move(edited), run.log.boxes);
    const std::vector<Ray> before = render(run.driving_scene()), after = render(edited);
    ASSERT_EQ(before.size(), after.size());
    std::size_t n_equal = 0;
    for (std::size_t i = 0; i < before.size(); ++i)
        n_equal += std::abs(before[i].range_m - after[i].range_m) < 0.01;
    EXPECT_GT(double(n_equal), 0.997 * double(before.size()));
    EXPECT_EQ(find_standing({run.scene, run.log}, "5")->world_from_box.pose.size(), run.log.frames.size());
    EXPECT_TRUE(list_standing(edited.scene, edited.log, {}).empty());
}

TEST(ReleasedObjects, OnlySurfelsOfTheCarLeaveTheBackground) {
    const relidar::Run run = make_run();
    const ReleasedObject released = release_standing(run.driving_scene(), "5");
    const Scene& scene = released.edited.scene;
    ASSERT_EQ(scene.models.size(), 2u);
    EXPECT_EQ(scene.models[1].count, make_car().size()) << "with the mirror, without the wall";
    const double hidden_m2 = kCar_m.x * kCar_m.y;
    EXPECT_NEAR(released.filled_m2, hidden_m2, 0.2 * hidden_m2);
    EXPECT_NO_THROW(check_layout(scene));
    ASSERT_TRUE(scene.models[1].surface);
    const ObservedSideFractions sides = scene.models[1].surface->covered_sides();
    EXPECT_GT(sides[std::size_t(BoxSide::rear)], 0.9f) << "faces the sensor";
    EXPECT_EQ(sides[std::size_t(BoxSide::front)], 0.0f);
    EXPECT_THAT(describe_release(released, "5"), test::Names("5 ... m2 ... front, right"));
    EXPECT_EQ(release_standing(released.edited, "5").filled_m2, 0.0) << "it is an actor now";
}

TEST(ReleasedObjects, AllEditsAcceptAStandingCar) {
    const relidar::Run run = make_run();
    const SceneWithLog driving = run.driving_scene();
    const Pose place{make_rotation(0.0, 0.0, 0.0), glm::dvec3(8.0, -5.0, 1.0) + kOffset_m};
    EXPECT_EQ(copy_track(driving, "5", {place}).scene.instances.back().track, "5-copy-1");
    const SceneWithLog inserted = insert_track(driving, driving, "5", {place});
    EXPECT_EQ(inserted.scene.instances.back().track, "5-insert-1");
    EXPECT_TRUE(find_standing({inserted.scene, inserted.log}, "5")) << "only the other run is changed";
    EXPECT_EQ(inserted.scene.models.back().count, make_car().size());
    const SceneWithLog later = delay_track(driving, "5", 0.3);
    EXPECT_FALSE(find_box(later.log, "5")->is_observed(0.2));
    const SceneWithLog drives = replace_track(driving, "5", {{0.0, 1.0}, {place, place}});
    EXPECT_EQ(drives.scene.instances.size(), 2u);
    const NewActorMotion start =
        stand_on_ground({driving.scene, driving.log}, {{kOffset_m.x + 8.0, kOffset_m.y - 5.0}, 0.0},
                        {driving.scene, driving.log}, "5");
    EXPECT_NEAR(start.dataset_from_box.translation.z - kOffset_m.z, ground_m(8.0) + 0.77, 0.03);
}

TEST(ReleasedObjects, ErrorsNameTheTrack) {
    relidar::Run run = make_run();
    EXPECT_THAT(error_message<UsageError>([&] { scale_speed(run.driving_scene(), "5", 2.0); }),
                test::Names("\"5\" ... stands still"));
    run.scene = wrap_background(make_street());
    EXPECT_THAT(error_message<UsageError>([&] { remove_track(run.driving_scene(), "5"); }),
                test::Names("\"5\" ... no surfels"));
    EXPECT_THAT(error_message<UsageError>([&] { move_track(run.driving_scene(), "5", {}); }),
                test::Names("\"5\" ... no surfels"));
}

using ReleasedRun = TemporaryFolder;

TEST_F(ReleasedRun, IsSavedAndLoaded) {
    relidar::Run run = make_run();
    const auto cell_at = [](const glm::dvec3& point_m, SurfaceClass surface) {
        return SurfaceClassCell{glm::ivec3(glm::floor(point_m / kClassCell_m)), surface};
    };
    const glm::dvec3 car_m = car_pose().translation;
    const SurfaceClassCell road = cell_at(car_m - glm::dvec3(0.0, 0.0, 0.7), SurfaceClass::road);
    run.classes = {road, cell_at(car_m, SurfaceClass::vehicle)};
    run.split = {{0}, {1}};
    run.folder = folder / "run";
    run.set_driving_scene(move_track(run.driving_scene(), "5", {{1, 0, 0, 0}, {0.0, -3.0, 0.0}}));
    save_run(run);
    const relidar::Run loaded = load_run(run.folder);
    EXPECT_EQ(loaded.classes, SurfaceClassMap{road}) << "the place of the car";
    EXPECT_EQ(loaded.scene.instances.back().track, "5");
    EXPECT_EQ(loaded.scene.surfels.mean, run.scene.surfels.mean);
    EXPECT_TRUE(list_standing(loaded.scene, loaded.log, loaded.config.init).empty());
    EXPECT_EQ(loaded.scene.models.back().surface, run.scene.models.back().surface);
}

}  // namespace
}  // namespace relidar
