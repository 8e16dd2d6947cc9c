// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/classes.hpp>

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>

#include "base/random.hpp"
#include "log/classes/dataset_classes.hpp"

namespace relidar {
namespace {

using Place = std::tuple<int, int, int>;
Place to_place(const glm::ivec3& place) { return {place.x, place.y, place.z}; }

std::map<Place, std::array<int, kSurfaceClasses>> count_labels(const Log& log,
                                                               const std::vector<int>& positions) {
    std::map<Place, std::array<int, kSurfaceClasses>> counts;
    for (const int position : positions) {
        const Frame& frame = log.frames[std::size_t(position)];
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
            if (frame.scan.range_m[ray] == 0.0f) continue;
            const WorldReturn hit = locate_return(log, frame, ray);
            if (is_in_moving_box(log.boxes, hit.point_m, hit.time_s, kMoverMargin_m)) continue;
            ++counts[to_place(glm::ivec3(glm::floor(10.0 * hit.point_m)))]
                    [std::size_t(frame.scan.classes[ray])];
        }
    }
    return counts;
}

SurfaceClassMap map_of(const Log& log, const std::vector<BoxTrack>& boxes, const std::vector<int>& frames) {
    return map_classes(log, log.world_from_vehicle, boxes, frames);
}

TEST(ClassMap, HasTheMostFrequentClassOfEachCell) {
    const Log log = make_street_log({.n_frames = 8, .rows = 16, .columns = 256, .people = true});
    const std::vector<int> positions = {0, 1, 3, 4};
    auto counts = count_labels(log, positions);
    const SurfaceClassMap map = map_of(log, log.boxes, positions);
    ASSERT_EQ(map.size(), counts.size());
    std::array<std::size_t, kSurfaceClasses> n_cells{};
    for (const SurfaceClassCell& cell : map) {
        const std::array<int, kSurfaceClasses>& votes = counts[to_place(cell.grid_index)];
        ++n_cells[std::size_t(cell.surface)];
        for (const int n : votes) ASSERT_LE(n, votes[std::size_t(cell.surface)]);
    }
    using enum SurfaceClass;
    for (const SurfaceClass surface : {vehicle, road, sidewalk, building, fence, vegetation, pole})
        EXPECT_GT(n_cells[std::size_t(surface)], 10u) << int(surface);
    for (const SurfaceClass surface : {unknown, person, cyclist})
        EXPECT_EQ(n_cells[std::size_t(surface)], 0u) << int(surface) << ": only in moving boxes";
}

TEST(ClassMap, IgnoresReturnsInTheBoxesThatAreGiven) {
    Log log = make_street_log({.n_frames = 4, .rows = 16, .columns = 256, .people = true});
    const std::vector<BoxTrack> boxes = log.boxes;
    const SurfaceClassMap expected = map_of(log, boxes, {0, 1, 2, 3});
    for (BoxTrack& box : log.boxes)
        for (Pose& pose : box.world_from_box.pose) pose.translation.z += 100.0;
    EXPECT_EQ(map_of(log, boxes, {0, 1, 2, 3}), expected);
    EXPECT_GT(map_of(log, log.boxes, {0, 1, 2, 3}).size(), expected.size());
}

TEST(ClassMap, IgnoresScansWithoutLabels) {
    Log log = make_street_log({.n_frames = 2, .rows = 8, .columns = 64});
    const std::size_t n_first = map_of(log, log.boxes, {0}).size();
    log.frames[1].scan.classes.clear();
    EXPECT_EQ(map_of(log, log.boxes, {0, 1}).size(), n_first);
    log.frames[0].scan.classes.clear();
    EXPECT_TRUE(map_of(log, log.boxes, {0, 1}).empty());
}

TEST(ClassMap, KeepsItsOwnCellsIfAnotherMapIsAdded) {
    SurfaceClassMap map = {{{-1, 2, 3}, SurfaceClass::road}};
    merge_class_map(map, {{{-1, 2, 3}, SurfaceClass::pole}, {{1, 2, 3}, SurfaceClass::sign}});
    EXPECT_EQ(map, (SurfaceClassMap{{{-1, 2, 3}, SurfaceClass::road}, {{1, 2, 3}, SurfaceClass::sign}}));
}

TEST(ClassFinder, FindsTheNearestCell) {
    Random random(3);
    const auto random_vector = [&](double reach) {
        return glm::dvec3(random.sample_uniform(-reach, reach), random.sample_uniform(-reach, reach),
                          random.sample_uniform(-reach, reach));
    };
    SurfaceClassMap map;
    for (int i = 0; i < 300; ++i)
        map.push_back({glm::ivec3(random_vector(60.0)), SurfaceClass(random.sample_uniform() * 15.99)});
    const SurfaceClassLookup finder(map);
    std::size_t n_far = 0;
    for (int i = 0; i < 2000; ++i) {
        const glm::dvec3 point = random_vector(8.0);
        double nearest_m = std::numeric_limits<double>::infinity();
        SurfaceClass expected = SurfaceClass::unknown;
        for (const SurfaceClassCell& cell : map)
            if (const double away_m = glm::distance(0.1 * (glm::dvec3(cell.grid_index) + 0.5), point);
                away_m < nearest_m) {
                nearest_m = away_m;
                expected = cell.surface;
            }
        if (nearest_m > 2.0) {
            expected = SurfaceClass::unknown;
            ++n_far;
        }
        ASSERT_EQ(finder.find_class(point), expected) << i;
    }
    EXPECT_GT(n_far, 50u);
    EXPECT_EQ(finder.find_class(glm::dvec3(0.0, std::nan(""), 0.0)), SurfaceClass::unknown);
}

TEST(DatasetClasses, AreRelidarsClasses) {
    using enum SurfaceClass;
    EXPECT_EQ(from_semantic_kitti(0), unknown);
    EXPECT_EQ(from_semantic_kitti(48), sidewalk);
    EXPECT_EQ(from_semantic_kitti(252), vehicle);
    EXPECT_EQ(from_nuscenes("vehicle.ego"), unknown);
    EXPECT_EQ(from_nuscenes("vehicle.bus.rigid"), vehicle);
    EXPECT_EQ(from_nuscenes("flat.other"), other_ground);
    EXPECT_EQ(from_nuscenes("static_object.bicycle_rack"), object);
    EXPECT_EQ(from_nuscenes("noise"), unknown);
    EXPECT_EQ(from_waymo(17), sidewalk);
    EXPECT_EQ(from_waymo(23), unknown);
}

}  // namespace
}  // namespace relidar
