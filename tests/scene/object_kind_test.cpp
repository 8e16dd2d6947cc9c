// SPDX-License-Identifier: Apache-2.0
// Tests the classification of objects from the class names of several datasets.
#include <relidar/scene/scene.hpp>

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace relidar
