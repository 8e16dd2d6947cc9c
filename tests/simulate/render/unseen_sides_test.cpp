// SPDX-License-Identifier: Apache-2.0
// Tests the count of rays that enter a box through a side that the log has not observed.
// The expected counts are numbers of points on a grid.
#include <gtest/gtest.h>

#include "../plates.hpp"

namespace relidar {
namespace {

constexpr double kOffset_m = 500.0;

/// A van of 4 x 2 x 1.6 m, 10 m ahead. The log has observed all but a part of its rear,
/// to the right of `rear_y_m`.
Scene make_van_scene(double rear_y_m) {
    Scene scene;
    scene.models = {{"background", 0, 0, {}}, {"van", 0, 0, {2.0f, 1.0f, 0.8f}}};
    ObservedBoxSurface surface({4.0, 2.0, 1.6});
    for (std::size_t s = 0; s < kBoxSides; ++s)
        surface.parse_patches(BoxSide(s),
                              std::string(surface.format_patches(BoxSide(s)).size(), s == 1 ? '0' : '1'));
    for (double y = rear_y_m + 0.05; y < 1.0; y += 0.1)
        for (double z = -0.75; z < 0.8; z += 0.1) surface.mark_observed({-2.0, y, z}, {1.0, 0.0, 0.0});
    scene.models[1].surface = surface;
    scene.instances = {{0, ""}, {1, "van"}};
    return scene;
}

Log make_van_sequence() {
    Log log;
    log.world_offset_m = {kOffset_m, 0.0, 0.0};
    BoxTrack van{"van", "Van", {4.0, 2.0, 1.6}, {}};
    van.world_from_box.time_s = {0.0, 1.0};
    van.world_from_box.pose.assign(2, {glm::dquat(1, 0, 0, 0), {10.0, 0.0, 0.0}});
    log.boxes = {van};
    return log;
}

/// Rays to points 0.1 m apart on the plane of the rear, x = 8 m; 20 x 16 are on the rear.
/// @param return_m range of all returns; 0 if no ray returns
RenderedScan make_grid_scan(float return_m) {
    RenderedScan scan;
    for (int y = -20; y < 20; ++y)
        for (int z = -20; z < 20; ++z) {
            scan.image.direction.push_back(glm::normalize(glm::vec3(8.0, 0.1 * y + 0.05, 0.1 * z + 0.05)));
        }
    scan.image.range_m.assign(scan.image.direction.size(), return_m);
    scan.world_from_sensor = {glm::dquat(1, 0, 0, 0), {kOffset_m, 0.0, 0.0}};
    scan.track.time_s = {0.0};
    scan.track.pose = {scan.world_from_sensor};
    scan.time_s = 0.5;
    scan.instance.assign(scan.image.range_m.size(), -1);
    return test::complete(std::move(scan));
}

TEST(UnseenSides, CountsTheRaysThatEnterThroughTheRear) {
    for (const float return_m : {0.0f, 30.0f}) {  // no return, or a wall behind the van
        const std::vector<UnobservedActorSide> sides =
            find_unseen_sides(make_grid_scan(return_m), make_van_scene(1.0), make_van_sequence());
        ASSERT_EQ(sides.size(), 1u);
        EXPECT_EQ(sides[0].track, "van");
        EXPECT_EQ(sides[0].side, BoxSide::rear);
        EXPECT_EQ(sides[0].n_rays, 20u * 16u);
    }
}

TEST(UnseenSides, AreNotReportedIfSeenHiddenAbsentOrUnknown) {
    EXPECT_TRUE(find_unseen_sides(make_grid_scan(0.0f), make_van_scene(0.0), make_van_sequence()).empty());
    EXPECT_TRUE(find_unseen_sides(make_grid_scan(5.0f), make_van_scene(1.0), make_van_sequence()).empty());
    RenderedScan late = make_grid_scan(0.0f);
    late.time_s = 9.0;
    EXPECT_TRUE(find_unseen_sides(late, make_van_scene(1.0), make_van_sequence()).empty());
    Scene unknown = make_van_scene(1.0);
    unknown.models[1].surface = {};
    EXPECT_TRUE(find_unseen_sides(make_grid_scan(0.0f), unknown, make_van_sequence()).empty());
}

TEST(UnseenSides, CountsTheRaysThatReturnFromACompletedHalf) {
    Scene scene = make_van_scene(0.0);
    scene.models[1].surface->is_completed = true;
    RenderedScan scan = make_grid_scan(0.0f);
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i)
        scan.median_range_m[i] = 8.0f / scan.image.direction[i].x;
    EXPECT_TRUE(find_unseen_sides(scan, scene, make_van_sequence()).empty()) << "no ray hits an actor";
    scan.instance.assign(scan.median_range_m.size(), 1);
    const std::vector<UnobservedActorSide> sides = find_unseen_sides(scan, scene, make_van_sequence());
    ASSERT_EQ(sides.size(), 1u);
    EXPECT_TRUE(sides[0].is_completed);
    EXPECT_EQ(sides[0].side, BoxSide::rear);
    // The right half is 10 points wide. The lowest of 6 rows of patches is ignored, which
    // leaves 13 of 16 points in height.
    EXPECT_EQ(sides[0].n_rays, 10u * 13u);
}

}  // namespace
}  // namespace relidar
