// SPDX-License-Identifier: Apache-2.0
// Tests what the log has not observed: the share of rays, and the rays that enter a box
// through an unobserved side. The expected counts are numbers of points on a grid.

#include <gtest/gtest.h>

#include <relidar/run/edit.hpp>

#include "../plates.hpp"
#include "../street_scene.hpp"

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

Log make_van_log() {
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
            find_unseen_sides(make_grid_scan(return_m), make_van_scene(1.0), make_van_log());
        ASSERT_EQ(sides.size(), 1u);
        EXPECT_EQ(sides[0].track, "van");
        EXPECT_EQ(sides[0].side, BoxSide::rear);
        EXPECT_EQ(sides[0].n_rays, 20u * 16u);
    }
}

TEST(UnseenSides, AreNotReportedIfSeenHiddenAbsentOrUnknown) {
    EXPECT_TRUE(find_unseen_sides(make_grid_scan(0.0f), make_van_scene(0.0), make_van_log()).empty());
    EXPECT_TRUE(find_unseen_sides(make_grid_scan(5.0f), make_van_scene(1.0), make_van_log()).empty());
    RenderedScan late = make_grid_scan(0.0f);
    late.time_s = 9.0;
    EXPECT_TRUE(find_unseen_sides(late, make_van_scene(1.0), make_van_log()).empty());
    Scene unknown = make_van_scene(1.0);
    unknown.models[1].surface = {};
    EXPECT_TRUE(find_unseen_sides(make_grid_scan(0.0f), unknown, make_van_log()).empty());
}

TEST(UnseenSides, CountsTheRaysThatReturnFromACompletedHalf) {
    Scene scene = make_van_scene(0.0);
    scene.models[1].surface->is_completed = true;
    RenderedScan scan = make_grid_scan(0.0f);
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i)
        scan.median_range_m[i] = 8.0f / scan.image.direction[i].x;
    EXPECT_TRUE(find_unseen_sides(scan, scene, make_van_log()).empty()) << "no ray hits an actor";
    scan.instance.assign(scan.median_range_m.size(), 1);
    const std::vector<UnobservedActorSide> sides = find_unseen_sides(scan, scene, make_van_log());
    ASSERT_EQ(sides.size(), 1u);
    EXPECT_TRUE(sides[0].is_completed);
    EXPECT_EQ(sides[0].side, BoxSide::rear);
    // The right half is 10 points wide. The lowest of 6 rows of patches is ignored, which
    // leaves 13 of 16 points in height.
    EXPECT_EQ(sides[0].n_rays, 10u * 13u);
}

class Seen : public test::StreetTest {
protected:
    Seen() : StreetTest({.n_frames = 12}, 5) { config.render.channels = "seen"; }
    RenderedScan scan(const Pose& offset, const Config& settings, const std::string& sensor = "native") {
        ScanRenderer renderer(device(), scene, settings, log);
        renderer.use_observed(
            observe_coverage(log, log.world_from_vehicle, split.train, settings.dataset.max_range_m));
        return renderer.render(choose_sensor(sensor, settings, log),
                               log.frames[std::size_t(split.test[0])].time_s, offset);
    }
    static const std::vector<float>& seen(const RenderedScan& scan) {
        return *find_values<float>(scan.channels, "seen");
    }
    double unseen(const glm::dvec3& offset_m) {
        return scan({{1, 0, 0, 0}, offset_m}, config).unseen_share.value();
    }
};

TEST_F(Seen, AHeldOutScanLooksWhereTheLogDid) {
    const RenderedScan native = scan({}, config);
    EXPECT_LT(native.unseen_share.value(), 0.02);
    ASSERT_EQ(seen(native).size(), native.image.range_m.size());
    EXPECT_EQ(native.unseen_share.value(),
              double(std::ranges::count_if(seen(native), [](float s) { return s < 0.5f; })) /
                  double(seen(native).size()));
    EXPECT_LT(unseen({0.0, 3.0, 0.0}), kMuchUnseen) << "the next lane";
}

TEST_F(Seen, WhatLiesOutsideIsSaid) {
    EXPECT_GT(unseen({0.0, 0.0, -5.0}), 0.9) << "under the ground";
    EXPECT_EQ(unseen({10000.0, 0.0, 0.0}), 1.0);
    EXPECT_GT(unseen({0.0, 60.0, 0.0}), 0.5) << "behind the houses";
}

TEST_F(Seen, AShareIsKnownWithoutTheChannel) {
    Config plain = config;
    plain.render.channels.clear();
    const Pose beside{{1, 0, 0, 0}, {0.0, 5.0, 2.0}};
    const RenderedScan some = scan(beside, plain), all = scan(beside, config);
    EXPECT_TRUE(some.channels.empty());
    EXPECT_NEAR(some.unseen_share.value(), all.unseen_share.value(), 0.02);
    EXPECT_EQ(some.image.range_m, all.image.range_m);
}

TEST_F(Seen, BinnedAndMergedScansKeepIt) {
    const RenderedScan native = scan({}, config), grid = scan({}, config, "kitti360"),
                       below = scan({{1, 0, 0, 0}, {0, 0, -5.0}}, config);
    EXPECT_EQ(seen(grid).size(), grid.image.range_m.size());
    EXPECT_EQ(grid.unseen_share, native.unseen_share);
    const RenderedScan both = merge_scans({native, below}, {Pose{}, Pose{{1, 0, 0, 0}, {0, 0, -5.0}}});
    ASSERT_EQ(seen(both).size(), seen(native).size() + seen(below).size());
    EXPECT_EQ(seen(both).back(), seen(below).back());
    EXPECT_NEAR(both.unseen_share.value(), (*native.unseen_share + *below.unseen_share) / 2.0, 1e-12);
}

TEST_F(Seen, AScanWithoutBackgroundHasNoShare) {
    const SimulatedSensor sensor = choose_sensor("native", config, log);
    const double time_s = log.frames[std::size_t(split.test[0])].time_s;
    const auto make_renderer = [&](const Scene& shown) {
        auto renderer = std::make_unique<ScanRenderer>(device(), shown, config, log);
        renderer->use_observed(
            observe_coverage(log, log.world_from_vehicle, split.train, config.dataset.max_range_m));
        return renderer;
    };
    const auto renderer = make_renderer(scene);
    renderer->show_instances(select_instances(scene, {"actors"}));
    EXPECT_FALSE(renderer->render(sensor, time_s).unseen_share.has_value());
    renderer->submit_points(sensor, {time_s, log.world_from_vehicle}, time_s);
    EXPECT_FALSE(renderer->wait_for_points().unseen_share.has_value());
    const Scene actors = remove_background({scene, log}).scene;
    EXPECT_FALSE(make_renderer(actors)->render(sensor, time_s).unseen_share.has_value());
    renderer->show_instances(select_instances(scene, {"background"}));
    EXPECT_TRUE(renderer->render(sensor, time_s).unseen_share.has_value());
}

TEST_F(Seen, WithoutACoverageNothingIsClaimed) {
    ScanRenderer renderer(device(), scene, config, log);
    const RenderedScan native = renderer.render(choose_sensor("native", config, log), log.frames[0].time_s);
    EXPECT_FALSE(native.unseen_share.has_value());
    EXPECT_TRUE(native.channels.empty());
}

}  // namespace

}  // namespace relidar
