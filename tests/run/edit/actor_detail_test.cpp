// SPDX-License-Identifier: Apache-2.0
// Compares the number of rays that hit an actor at its nearest position with the solid
// angle of the actor's box.
#include <relidar/run/edit.hpp>

#include <cmath>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

/// A cube of 2 m passes a LiDAR at the origin at 10 m on the left. The LiDAR has 200
/// beams from -30 to 30 degrees and 3600 columns.
SceneWithLog make_passing_cube(std::uint32_t n_surfels) {
    SceneWithLog d;
    d.scene.surfels.resize(n_surfels);
    d.scene.models = {{"background", 0, 0, {}}, {"cube", 0, n_surfels, {1, 1, 1}}};
    d.scene.instances = {{0, ""}, {1, "cube"}};
    SpinningSensor& sensor = d.sequence.lidars[0].sensor;
    for (int i = 0; i < 200; ++i) sensor.beams.push_back({(30.0 - 60.0 * (i + 0.5) / 200.0) * kPi / 180.0});
    sensor.columns = 3600;
    BoxTrack cube{"cube", "Car", {2, 2, 2}, {}};
    for (int i = 0; i < 11; ++i) {
        d.sequence.frames.push_back({i, 0.1 * i, {}});
        d.sequence.world_from_vehicle.time_s.push_back(0.1 * i);
        d.sequence.world_from_vehicle.pose.push_back({});
        cube.world_from_box.time_s.push_back(0.1 * i);
        cube.world_from_box.pose.push_back({{1, 0, 0, 0}, {double(i) * 4.0 - 20.0, 10.0, 0.0}});
    }
    d.sequence.boxes = {cube};
    return d;
}

TEST(ActorDetail, CountsTheRaysThatMeetTheBoxWhereItIsNearest) {
    const ActorModelResolution detail = model_resolution(make_passing_cube(500), "cube");
    EXPECT_DOUBLE_EQ(detail.nearest_m, 10.0);
    EXPECT_NEAR(detail.time_s, 0.5, 1e-12);
    EXPECT_EQ(detail.surfels, 500u);
    // The near face of 2 x 2 m at 9 m hides the remaining faces.
    double expected = 0.0;
    for (int column = 0; column < 3600; ++column) {
        const double azimuth = (column + 0.5) * 2.0 * kPi / 3600.0 - kPi;
        if (std::abs(azimuth) < std::atan(1.0 / 9.0))
            expected += 2.0 * std::atan(std::cos(azimuth) / 9.0) / (60.0 * kPi / 180.0 / 200.0);
    }
    EXPECT_NEAR(double(detail.rays), expected, 0.02 * expected);
}

TEST(ActorDetail, OfGivenRaysThoseAreCountedWhoseLinesMeetTheBox) {
    const glm::vec3 ahead(1.0f, 0.0f, 0.0f), across(0.0f, 1.0f, 0.0f);
    const std::vector<glm::vec3> direction{ahead, ahead, ahead, -ahead, across}, origin{{0.0f, 0.0f, 0.0f},
                                                                                        {0.0f, 0.9f, 0.0f},
                                                                                        {0.0f, 1.1f, 0.0f},
                                                                                        {0.0f, 0.0f, 0.0f},
                                                                                        {10.0f, -3.0f, 0.0f}};
    const Pose box_from_sensor = inverse(Pose{make_rotation(0.5 * kPi, 0.0, 0.0), {10.0, 0.0, 0.0}});
    const ActorModelResolution detail =
        model_resolution(origin, direction, box_from_sensor, {2.0, 2.0, 1.0}, 7);
    EXPECT_EQ(detail.rays, 3u) << "two ahead and one from the side; one passes by, one goes the other way";
    EXPECT_DOUBLE_EQ(detail.nearest_m, 10.0);
    EXPECT_EQ(detail.surfels, 7u);
    EXPECT_EQ(model_resolution(origin, direction, {}, {30.0, 30.0, 30.0}, 7).rays, 5u) << "from within";
}

TEST(ActorDetail, IsSparseWhereFewSurfelsMeetManyRays) {
    const std::size_t rays = model_resolution(make_passing_cube(1), "cube").rays;
    EXPECT_TRUE(model_resolution(make_passing_cube(std::uint32_t(rays / 10)), "cube").is_too_coarse());
    EXPECT_FALSE(model_resolution(make_passing_cube(std::uint32_t(rays)), "cube").is_too_coarse());
}

TEST(ActorDetail, OfOneThatIsNeverThereNothingIsClaimed) {
    SceneWithLog d = make_passing_cube(5);
    for (double& t : d.sequence.boxes[0].world_from_box.time_s) t += 100.0;
    EXPECT_EQ(model_resolution(d, "cube").rays, 0u);
    EXPECT_FALSE(model_resolution(d, "cube").is_too_coarse());
    EXPECT_THROW(model_resolution(d, "van"), UsageError);
}

}  // namespace
}  // namespace relidar
