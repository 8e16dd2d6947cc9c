// SPDX-License-Identifier: Apache-2.0

#include <gtest/gtest.h>

#include <relidar/scene/labels.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {
namespace {

TEST(ObjectKind, IsTheSameInEveryDataset) {
    for (const char* word :
         {"Car", "Van", "Truck", "Tram", "car", "truck", "bus", "vehicle", "vehicle.car", "vehicle.bus.rigid",
          "REGULAR_VEHICLE", "BOX_TRUCK", "ARTICULATED_BUS", "trailer"})
        EXPECT_EQ(parse_kind(word), ObjectKind::vehicle) << word;
    for (const char* word : {"Cyclist", "cyclist", "bicycle", "rider", "motorcycle", "BICYCLIST",
                             "vehicle.bicycle", "vehicle.motorcycle"})
        EXPECT_EQ(parse_kind(word), ObjectKind::cyclist) << word;
    for (const char* word :
         {"Pedestrian", "Person (sitting)", "person", "pedestrian", "PEDESTRIAN", "human.pedestrian.adult"})
        EXPECT_EQ(parse_kind(word), ObjectKind::person) << word;
    for (const char* word : {"Misc", "", "trafficSign", "movable_object.barrier", "Discovered", "cars"})
        EXPECT_EQ(parse_kind(word), ObjectKind::other) << word;
}

TEST(ObjectClass, IsTheSameInEveryDataset) {
    using enum ObjectClass;
    constexpr std::pair<const char*, ObjectClass> kClasses[] = {
        {"Car", car},
        {"REGULAR_VEHICLE", car},
        {"vehicle.car", car},
        {"vehicle", car},
        {"Van", van},
        {"vehicle.emergency.ambulance", van},
        {"Truck", truck},
        {"BOX_TRUCK", truck},
        {"LARGE_VEHICLE", truck},
        {"Medium-sized Truck", truck},
        {"vehicle.construction", truck},
        {"vehicle.bus.rigid", bus},
        {"SCHOOL_BUS", bus},
        {"VEHICULAR_TRAILER", trailer},
        {"truck_trailer", trailer},
        {"caravan", trailer},
        {"Cyclist", cyclist},
        {"vehicle.bicycle", cyclist},
        {"WHEELED_RIDER", cyclist},
        {"vehicle.motorcycle", motorcycle},
        {"MOTORCYCLIST", motorcycle},
        {"Person_sitting", pedestrian},
        {"human.pedestrian.construction_worker", pedestrian},
        {"OFFICIAL_SIGNALER", pedestrian},
        {"Tram", other},
        {"static_object.bicycle_rack", other},
        {"Misc", other},
        {"", other}};
    for (const auto& [label, expected] : kClasses)
        EXPECT_EQ(class_of({"1", label, {4.2, 1.8, 1.5}, {}}), expected) << label;
    EXPECT_EQ(parse_kind("Tram"), ObjectKind::vehicle);
}

TEST(Labels, MoversWithoutALabelGetTheClassOfTheirSize) {
    using enum ObjectClass;
    const auto discovered = [](const glm::dvec3& size_m) {
        return BoxTrack{
            .id = "mover", .category = kDiscoveredCategory, .size_m = size_m, .world_from_box = {}};
    };
    EXPECT_EQ(class_of(discovered({0.8, 0.6, 1.75})), pedestrian);
    EXPECT_EQ(class_of(discovered({1.8, 0.7, 1.7})), cyclist);
    EXPECT_EQ(class_of(discovered({4.2, 1.8, 1.5})), car);
    EXPECT_EQ(class_of(discovered({12.0, 2.5, 3.2})), truck);
    EXPECT_EQ(class_of(discovered({1.5, 1.4, 0.6})), other);
    EXPECT_EQ(guess_kind(discovered({1.8, 0.7, 1.7})), ObjectKind::cyclist);
    EXPECT_EQ(label_of(discovered({1.8, 0.7, 1.7})), "");
    const BoxTrack small_van{.id = "1", .category = "Van", .size_m = {0.8, 0.6, 1.75}, .world_from_box = {}};
    EXPECT_EQ(class_of(small_van), van) << "a label is never overruled";
    EXPECT_EQ(guess_kind(small_van), ObjectKind::vehicle);
    EXPECT_EQ(name_of(class_of(small_van)), "Van");
    EXPECT_EQ(label_of(small_van), "Van");
}

TEST(Labels, RaysCrossTheBoxAboveTheGround) {
    const glm::dvec3 size_m(4.0, 2.0, 1.5), ahead(1, 0, 0);
    EXPECT_TRUE(is_on_object({2.09, -1.09, 0.84}, size_m));
    EXPECT_FALSE(is_on_object({2.11, 0.0, 0.0}, size_m));
    EXPECT_FALSE(is_on_object({0.0, 0.0, -0.61}, size_m)) << "ground";
    const auto through = object_interval({-10.0, 1.0, 0.0}, ahead, size_m);
    ASSERT_TRUE(through);
    EXPECT_NEAR((*through)[0], 7.9, 1e-12);
    EXPECT_NEAR((*through)[1], 12.1, 1e-12);
    // A line at 45 degrees through the upper edge of the margin: z = 0.85 m at x = 1.6 m.
    const auto edge = object_interval({-2.1, 0.0, -2.85}, glm::normalize(glm::dvec3(1, 0, 1)), size_m);
    ASSERT_TRUE(edge);
    EXPECT_NEAR((*edge)[0], (2.85 - 0.6) * std::sqrt(2.0), 1e-12);
    EXPECT_NEAR((*edge)[1], (2.85 + 0.85) * std::sqrt(2.0), 1e-12);
    EXPECT_FALSE(object_interval({-10.0, 1.2, 0.0}, ahead, size_m)) << "beside it";
    EXPECT_FALSE(object_interval({10.0, 0.0, 0.0}, ahead, size_m)) << "behind the ray";
    EXPECT_EQ((*object_interval({0.0, 0.0, 0.0}, ahead, size_m))[0], 0.0) << "from inside";
}

TEST(Labels, StandingObjectsHaveNoModelAndDoNotMove) {
    Log log;
    const auto add_box = [&](const char* id, double speed_mps) {
        BoxTrack box{.id = id, .category = "Car", .size_m = {4.0, 2.0, 1.5}, .world_from_box = {}};
        for (int k = 0; k < 31; ++k) {
            box.world_from_box.time_s.push_back(0.1 * k);
            // Labels jitter by 0.1 m around 5 m.
            box.world_from_box.pose.push_back(
                {{1, 0, 0, 0}, {5.0 + 0.1 * (k % 3 - 1) + 0.1 * k * speed_mps, 0.0, 0.0}});
        }
        log.boxes.push_back(box);
    };
    add_box("parked", 0.0);
    add_box("driving", 8.0);
    add_box("modelled", 0.0);
    add_box("removed", 0.0);
    Scene scene = wrap_background({});
    scene.instances.push_back({0, "modelled"});
    InitOptions options;
    options.actor_tracks = "removed,modelled";
    const std::vector<BoxTrack> standing = list_standing(scene, log, options);
    ASSERT_EQ(standing.size(), 1u);
    EXPECT_EQ(standing[0].id, "parked");
    for (const double time_s : {-10.0, 0.0, 1.5, 10.0})
        EXPECT_NEAR(standing[0].world_from_box.pose_at(time_s).translation.x, 5.0, 1e-12);
}

}  // namespace

}  // namespace relidar
