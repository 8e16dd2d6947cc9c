// SPDX-License-Identifier: Apache-2.0
// Tests the rendering of walls at exact positions, and the choice of the sensor.

#include <gmock/gmock.h>
#include <relidar/base/error.hpp>
#include <relidar/simulate/render.hpp>

#include "../../support/device.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

class Render : public test::DeviceTest {
protected:
    RenderedScan render(const Surfels& surfels, const Config& config, const Log& log, double time_s = 0.0) {
        ScanRenderer renderer(device(), wrap_background(surfels), config, log);
        return renderer.render(make_sensor(config, log), time_s);
    }
};

Surfels make_wall_ahead() { return test::make_plate({10.0f, 0.0f, 0.0f}, glm::vec2(5.0f)); }

Log make_cross_log(int columns = 4) { return test::make_static_log({0.0}, columns); }

Surfels make_post_before_wall() {
    Surfels scene = test::make_plate({10.0f, 0.0f, 0.0f}, {5.0f, 0.02f});
    scene.append_surfels(test::make_plate({14.0f, 0.0f, 0.0f}, glm::vec2(5.0f)));
    scene.sh[0] = scene.sh[kShFloats] = 1.0f;  // equal brightness
    return scene;
}

std::size_t find_ray_towards(const RayTable& rays, const glm::vec3& direction) {
    std::size_t best = 0;
    for (std::size_t i = 0; i < rays.size(); ++i)
        if (glm::dot(rays.direction[i], direction) > glm::dot(rays.direction[best], direction)) best = i;
    return best;
}

/// The wall has intensity 0.5. All lasers of the log measure 0.6 x 0.5 + 0.1.
TEST_F(Render, OtherSensorsHaveTheResponseOfTheLasers) {
    Log log = test::make_static_log({0.1, 0.0, -0.1}, 360);
    for (Beam& beam : log.lidars[0].sensor.beams) beam.intensity_gain = 0.6, beam.intensity_offset = 0.1;
    const Config config;
    ScanRenderer renderer(device(), wrap_background(make_wall_ahead()), config, log);
    for (const char* name : {"native", "VLP-16:300x10"}) {
        const RenderedScan scan = renderer.render(choose_sensor(name, config, log), 0.0);
        int n_hits = 0;
        for (std::size_t i = 0; i < scan.instance.size(); ++i) {
            if (scan.weight[i] < 0.9f) continue;
            EXPECT_NEAR(scan.image.intensity[i], 0.6f * 0.5f * scan.weight[i] + 0.1f, 1e-4f) << name;
            ++n_hits;
        }
        EXPECT_GT(n_hits, 3) << name;
    }
}

/// @param value half of the strip's width divided by the disc's radius
double compute_strip_share(double value) {
    return 2.0 / kPi * (std::asin(value) + value * std::sqrt(1.0 - value * value));
}

/// The edge of the post is where half of the light passes its Gaussian.
TEST_F(Render, AFootprintOnAPostReturnsTheWallToo) {
    Log log = make_cross_log(1);
    log.lidars[0].sensor.first_azimuth_rad = 0.0;
    log.lidars[0].sensor.divergence_rad = 0.02;
    log.rolling_shutter = true;
    const auto render_post = [&](int sub_rays, int returns) {
        Config config;
        config.sensor.sub_rays = sub_rays;
        config.sensor.returns = returns;
        return render(make_post_before_wall(), config, log);
    };
    EXPECT_NEAR(render_post(1, 1).median_range_m[0], 10.0f, 1e-3f) << "the middle of the beam meets the post";
    EXPECT_TRUE(render_post(9, 1).second_returns.empty());
    const RenderedScan scan = render_post(9, 2);
    ASSERT_EQ(scan.image.range_m.size(), 1u);
    EXPECT_NEAR(scan.median_range_m[0], 14.0f, 2e-3f) << "the wider of the two";
    EXPECT_NEAR(scan.second_returns[0].range_m[0], 10.0f, 2e-3f);
    const double opacity = 1.0 / (1.0 + std::exp(-double(make_post_before_wall().opacity_logit[0])));
    const double share = compute_strip_share(0.02 * std::sqrt(2.0 * std::log(2.0 * opacity)) / 0.1);
    EXPECT_NEAR(scan.second_returns[0].intensity[0] / scan.image.intensity[0], share / (1.0 - share), 0.07);
    EXPECT_LT(scan.image.drop_prob[0], 0.1f);
}

TEST_F(Render, EachBeamOfATableHasItsOwnFootprint) {
    RayTable rays{1,
                  3,
                  ScanArray<glm::vec3>(3),
                  ScanArray<glm::vec3>(3, {1.0f, 0.0f, 0.0f}),
                  ScanArray<float>(3),
                  {0, 0, 0}};
    rays.ray_divergence_rad = {1e-3f, 0.02f, 0.0f};
    Config config;
    config.sensor.sub_rays = 9;
    config.sensor.returns = 2;
    ScanRenderer renderer(device(), wrap_background(make_post_before_wall()), config, make_cross_log());
    const RenderedScan scan =
        renderer.render(simulate_sensor({.name = "mixed", .limits = {0.0, 80.0}, .pattern = rays}), 0.0);
    EXPECT_THAT(scan.median_range_m, testing::Pointwise(testing::FloatNear(2e-3f), {10.0f, 14.0f, 10.0f}));
    EXPECT_THAT(scan.second_returns[0].range_m,
                testing::Pointwise(testing::FloatNear(2e-3f), {0.0f, 10.0f, 0.0f}));
}

TEST_F(Render, SubRaysNeedADivergence) {
    Log log = make_cross_log();
    Config config;
    config.sensor.sub_rays = 5;
    EXPECT_THROW(render(make_wall_ahead(), config, log), UsageError);
    config.sensor.divergence_mrad = 2.0;
    EXPECT_EQ(render(make_wall_ahead(), config, log).image.range_m.size(), 4u);
    config.sensor.sub_rays = 1;
    config.sensor.returns = 2;
    EXPECT_THROW(render(make_wall_ahead(), config, log), UsageError);
}

TEST_F(Render, WallIsWhereItStands) {
    Log log = make_cross_log(8);
    log.rolling_shutter = true;
    log.world_from_vehicle = {{0.0, 1.0}, {Pose{}, Pose{{1, 0, 0, 0}, {2.0, 0.0, 0.0}}}};
    Config config;
    ScanRenderer renderer(device(), wrap_background(make_wall_ahead()), config, log);
    const SimulatedSensor sensor = make_sensor(config, log);
    const std::size_t ahead = find_ray_towards(sensor.rays, {1, 0, 0});
    config.render.range = "normalised";
    const RenderedScan at_half = renderer.render(sensor, 0.5);
    const double fired_at = 0.5 + sensor.rays.time_offset_s[ahead];
    EXPECT_NEAR(at_half.image.range_m[ahead], 10.0 - 2.0 * fired_at, 1e-4);
    EXPECT_LT(at_half.image.drop_prob[ahead], 0.5f);
    EXPECT_GT(at_half.image.drop_prob[(ahead + 4) % 8], 0.5f) << "nothing stands behind";
    Pose back;
    back.translation.x = -3.0;
    EXPECT_NEAR(renderer.render(sensor, 0.5, back).image.range_m[ahead], 13.0 - 2.0 * fired_at, 1e-4);
}

/// Only one column hits a post. If the head is a column behind, another one does.
TEST_F(Render, TheLogsOwnSensorPointsWhereItsHeadDid) {
    constexpr int kColumns = 64;
    constexpr double kColumn_rad = 2.0 * kPi / kColumns;
    // At the range of the post, columns are 1 m apart.
    const Surfels post = test::make_plate({10.0f, 0.0f, 0.0f}, {5.0f, 0.1f});
    Log log = make_cross_log(kColumns);
    log.lidars[0].sensor.max_range_m = 80.0;
    log.frames = {{0, 0.0, {}}, {1, 1.0, {}}};
    log.frames[1].azimuth_shift_rad.assign(kColumns, float(kColumn_rad));
    log.world_from_vehicle = {{0.0, 1.0}, {Pose{}, Pose{}}};
    Config config;
    config.render.follow_sweeps = true;
    ScanRenderer renderer(device(), wrap_background(post), config, log);
    const auto column_of_post = [&](const RenderedScan& scan) {
        return int(std::min_element(scan.image.drop_prob.begin(), scan.image.drop_prob.end()) -
                   scan.image.drop_prob.begin());
    };
    const SimulatedSensor sensor = make_sensor(config, log);
    EXPECT_TRUE(sensor.follows_sweeps);
    const int nominal = kColumns / 2;  // the azimuth starts at pi and decreases from column to column
    EXPECT_EQ(column_of_post(renderer.render(sensor, 0.0)), nominal) << "a sweep without a shift";
    EXPECT_EQ(column_of_post(renderer.render(sensor, 1.0)), nominal + 1)
        << "the head points one column to the left of where it should";
    EXPECT_EQ(column_of_post(renderer.render(sensor, 0.5)), nominal) << "no sweep of the log";
    EXPECT_EQ(column_of_post(renderer.render(sensor, ScanRequest{1.0, {{1.0}, {Pose{}}}})), nominal);
    config.render.follow_sweeps = false;
    EXPECT_EQ(column_of_post(renderer.render(make_sensor(config, log), 1.0)), nominal);
    EXPECT_FALSE(choose_sensor("HDL-32E", config, log).follows_sweeps);
}

/// Half of the light is blocked at the second surface, but most returns from the wall.
TEST_F(Render, ModeIsTheHeaviestSurface) {
    Surfels scene;
    const float x[] = {6.0f, 8.0f, 10.0f, 10.1f}, opacity[] = {0.3f, 0.35f, 0.5f, 0.9f};
    for (std::size_t i = 0; i < 4; ++i) {
        scene.append_surfels(test::make_plate({x[i], 0.0f, 0.0f}, glm::vec2(5.0f)));
        scene.opacity_logit[i] = std::log(opacity[i] / (1.0f - opacity[i]));
    }
    const Log log = make_cross_log();
    const float w[] = {0.3f, 0.245f, 0.2275f, 0.20475f};
    for (const std::string range : {"median", "mode"}) {
        Config config;
        config.render.range = range;
        ScanRenderer renderer(device(), wrap_background(scene), config, log);
        const SimulatedSensor sensor = make_sensor(config, log);
        const RenderedScan scan = renderer.render(sensor, 0.0);
        for (std::size_t i = 0; i < 4; ++i) {
            const bool ahead = sensor.rays.direction[i].x > 0.9f;
            const float at_wall = (w[2] * 10.0f + w[3] * 10.1f) / (w[2] + w[3]);
            const float ahead_m = range == "mode" ? at_wall : 8.0f;
            EXPECT_NEAR(scan.image.range_m[i], ahead ? ahead_m : 0.0f, 1e-4f) << range;
            EXPECT_NEAR(scan.median_range_m[i], ahead ? 8.0f : 0.0f, 1e-4f);
        }
    }
}

/// Beams belong to the sensor of the log, and do not change a different sensor.
TEST_F(Render, LasersMeasureInTheirOwnWay) {
    const Surfels wall = make_wall_ahead();
    Log log = make_cross_log();
    log.lidars[0].sensor.beams = {{.elevation_rad = 0.1}, {.elevation_rad = 0.0}, {.elevation_rad = -0.1}};
    log.lidars[0].sensor.beams[1] = {.intensity_gain = 1.4, .intensity_offset = -0.1, .range_offset_m = 0.07};
    log.lidars[0].sensor.beams[2] = {.elevation_rad = -0.1, .intensity_gain = 3.0};
    Config config;
    config.render.range = "normalised";
    ScanRenderer renderer(device(), wrap_background(wall), config, log);
    const SimulatedSensor sensor = make_sensor(config, log);
    const std::size_t ahead = find_ray_towards(sensor.rays, {1, 0, 0}) % 4;
    const RenderedScan scan = renderer.render(sensor, 0.0);
    SimulatedSensor ideal = sensor;
    ideal.beams.clear();
    const RenderedScan surface = renderer.render(ideal, 0.0);
    ASSERT_NEAR(surface.image.range_m[4 + ahead], 10.0, 1e-4);
    const float brightness = surface.image.intensity[4 + ahead];
    ASSERT_GT(brightness, 0.4f);
    EXPECT_EQ(scan.image.range_m[ahead], surface.image.range_m[ahead]);
    EXPECT_EQ(scan.image.intensity[ahead], surface.image.intensity[ahead]);
    EXPECT_NEAR(scan.image.range_m[4 + ahead], 10.07, 1e-4);
    EXPECT_NEAR(scan.median_range_m[4 + ahead], 10.07, 1e-4);
    EXPECT_NEAR(scan.image.intensity[4 + ahead], 1.4 * brightness - 0.1, 1e-5);
    EXPECT_EQ(scan.image.intensity[8 + ahead], 1.0f) << "cut at what a sensor reports";
    const std::size_t behind = (ahead + 2) % 4;
    EXPECT_EQ(scan.image.range_m[4 + behind], 0.0f) << "nothing stays nothing";
}

TEST_F(Render, RangesBeyondTheSensorAreDrops) {
    Log log = make_cross_log();
    const Scene scene = wrap_background(make_wall_ahead());
    Config config;
    ScanRenderer renderer(device(), scene, config, log);
    const auto dropped = [&](double min_m, double max_m) {
        SimulatedSensor sensor = make_sensor(config, log);
        sensor.limits = {min_m, max_m};
        const RenderedScan scan = renderer.render(sensor, 0.0);
        const std::size_t ahead = find_ray_towards(sensor.rays, {1, 0, 0});
        EXPECT_NEAR(scan.image.range_m[ahead], 10.0 + log.lidars[0].sensor.beams[0].range_offset_m, 1e-4);
        return scan.image.drop_prob[ahead] == 1.0f;
    };
    EXPECT_FALSE(dropped(9.9, 10.1));
    EXPECT_TRUE(dropped(0.0, 9.9));
    EXPECT_TRUE(dropped(10.1, 80.0));
    log.lidars[0].sensor.beams[0].range_offset_m = 0.2;  // limits apply to the measured range
    EXPECT_TRUE(dropped(0.0, 10.1));
}

TEST_F(Render, LimitsAreTheSensorsAndTheSettings) {
    Log log = make_cross_log();
    log.lidars[0].sensor.min_range_m = 0.5;
    log.lidars[0].sensor.max_range_m = 60.0;
    Config config;
    EXPECT_EQ(make_sensor(config, log).limits.min_m, 0.5);
    EXPECT_EQ(make_sensor(config, log).limits.max_m, 60.0);
    config.dataset.max_range_m = 30.0;
    config.dataset.min_range_m = 2.0;
    EXPECT_EQ(make_sensor(config, log).limits.max_m, 30.0);
    EXPECT_EQ(choose_sensor("Native", config, log).limits.min_m, 2.0);
    EXPECT_EQ(choose_sensor("VLP-16", config, log).limits.max_m, 100.0) << "another sensor has its own";
    config.sensor.grid = "kitti360";
    EXPECT_EQ(make_sensor(config, log).limits.max_m, 30.0);
    config.dataset.max_range_m = log.lidars[0].sensor.max_range_m = 200.0;
    EXPECT_EQ(make_sensor(config, log).limits.max_m, 80.0) << "of the grid's convention";
}

Surfels make_faint_plate_before_wall() {
    Surfels surfels = make_wall_ahead();
    surfels.append_surfels(make_wall_ahead());
    surfels.mean[0].x = 4.0f;
    surfels.opacity_logit[0] = std::log(0.3f / 0.7f);
    return surfels;
}

/// The mean range lies between plate and wall, but the point on the wall.
TEST_F(Render, PointsLieOnTheDominantSurface) {
    Surfels surfels = make_faint_plate_before_wall();
    const Log log = make_cross_log();
    Config config;
    const SimulatedSensor sensor = make_sensor(config, log);
    const RenderedScan scan = render(surfels, config, log);
    const std::size_t ahead = find_ray_towards(sensor.rays, {1, 0, 0}),
                      behind = find_ray_towards(sensor.rays, {-1, 0, 0});
    EXPECT_NEAR(scan.image.range_m[ahead], 0.3 * 4.0 + 0.7 * 10.0, 0.05);
    EXPECT_NEAR(point_ranges(scan, config)[ahead], 10.0, 1e-4);
    EXPECT_EQ(point_ranges(scan, config)[behind], 0.0f);
    config.render.points = "range";
    EXPECT_EQ(point_ranges(scan, config), scan.image.range_m);

    surfels.opacity_logit.assign(2, -1.5f);  // T stays above 0.5
    const RenderedScan faint = render(surfels, config, log);
    EXPECT_NEAR(faint.median_range_m[ahead], (4.0 + 0.818 * 10.0) / 1.818, 1e-2)
        << "a point without a surface is no point at the sensor";
    EXPECT_EQ(faint.median_range_m[behind], 0.0f);
}

/// For any range of the image, relative to the farther surface.
TEST_F(Render, SpreadTellsEdgesFromSurfacesWhateverRangeTheImageHas) {
    const Surfels surfels = make_faint_plate_before_wall();
    const Log log = make_cross_log();
    Config config;
    const SimulatedSensor sensor = make_sensor(config, log);
    const std::size_t ahead = find_ray_towards(sensor.rays, {1, 0, 0}),
                      behind = find_ray_towards(sensor.rays, {-1, 0, 0});
    const RenderedScan plane = render(make_wall_ahead(), config, log);
    EXPECT_NEAR(range_spread(plane)[ahead], 0.0f, 1e-4f);
    // The share of the light is 0.3 for the plate. For the wall, it is the remainder
    // times the maximum opacity of a surfel.
    const double wall = 0.7 * double(config.image.alpha_max), weight = 0.3 + wall;
    std::vector<std::string> channels = channel_names(config.refine);
    std::vector<RayDropImage> drop_images;
    for (const char* range : {"normalised", "expected", "median", "mode"}) {
        config.render.range = range;
        const RenderedScan scan = render(surfels, config, log);
        EXPECT_NEAR(range_spread(scan)[ahead], 10.0 - (0.3 * 4.0 + wall * 10.0) / weight, 1e-3) << range;
        EXPECT_EQ(range_spread(scan)[behind], 0.0f) << range;
        drop_images.push_back(make_drop_image(scan, channels, glm::dvec3(0.0)));
        EXPECT_EQ(drop_images.back().channels, drop_images.front().channels)
            << "a network sees the same with render.range=" << range;
        if (drop_images.size() > 1) continue;
        for (std::size_t i = 0; i < scan.image.range_m.size(); ++i)
            EXPECT_EQ(range_spread(scan)[i], std::abs(scan.median_range_m[i] - scan.image.range_m[i]));
    }
}

TEST_F(Render, FiringPosesPutPointsWhereThingsStand) {
    Log log = make_cross_log(64);
    log.world_from_vehicle = {{0.0, 1.0},
                              {Pose{}, Pose{glm::angleAxis(1.0, glm::dvec3(0, 0, 1)), {4.0, -1.0, 0.0}}}};
    log.world_offset_m = {100.0, 0.0, 0.0};
    for (const bool rolling : {true, false}) {
        log.rolling_shutter = rolling;
        const SimulatedSensor sensor = make_sensor({}, log);
        const RenderedScan scan = ScanRenderer(device(), wrap_background(make_wall_ahead()), {}, log)
                                      .render(sensor, 0.5, {{1, 0, 0, 0}, {-1.0, 0.0, 0.0}});
        std::size_t met = 0;
        for (std::size_t i = 0; i < scan.image.range_m.size(); ++i) {
            if (!(scan.median_range_m[i] > 0.0f)) continue;
            EXPECT_NEAR((scan.firing_pose(i) * glm::dvec3(scan.end_of(i))).x, 110.0, 1e-4);
            ++met;
        }
        EXPECT_GT(met, 5u);
        EXPECT_NEAR(glm::length(scan.track.pose_at(0.5).translation - scan.world_from_sensor.translation),
                    0.0, 1e-12);
    }
}

/// For any orientation, motion and binning of the sensor. The test computes the normal
/// exactly.
TEST_F(Render, NormalsFaceTheSensorInItsOwnFrame) {
    Log log = make_cross_log(64);
    log.rolling_shutter = true;
    log.world_from_vehicle = {
        {0.0, 1.0},
        {Pose{}, Pose{glm::angleAxis(1.0, glm::normalize(glm::dvec3(0.1, 0.2, 1))), {4.0, -1.0, 0.0}}}};
    Config config;
    const SimulatedSensor sensor = make_sensor(config, log);
    EXPECT_TRUE(render(make_wall_ahead(), config, log, 0.5).channels.empty());
    config.render.channels = "normal";
    const RenderedScan scan = render(make_wall_ahead(), config, log, 0.5);
    const std::vector<glm::vec3>& normal = *find_values<glm::vec3>(scan.channels, "normal");
    ASSERT_EQ(normal.size(), scan.instance.size());
    std::size_t met = 0;
    for (std::size_t i = 0; i < normal.size(); ++i) {
        if (scan.instance[i] < 0) EXPECT_EQ(normal[i], glm::vec3(0.0f));
        else
            EXPECT_LT(glm::length(scan.firing_pose(i).rotation * glm::dvec3(normal[i]) -
                                  glm::dvec3(-1.0, 0.0, 0.0)),
                      1e-5)
                << "ray " << i;
        met += scan.instance[i] >= 0;
    }
    EXPECT_GT(met, 5u);
    const RenderedScan binned = project_scan(scan, kitti360_grid());
    const std::vector<glm::vec3>& of_cells = *find_values<glm::vec3>(binned.channels, "normal");
    ASSERT_EQ(of_cells.size(), binned.instance.size());
    for (std::size_t i = 0; i < of_cells.size(); ++i)
        EXPECT_NEAR(glm::length(of_cells[i]), binned.instance[i] < 0 ? 0.0f : 1.0f, 1e-6f);
    config.render.channels = "incidence";
    const RenderedScan again = render(make_wall_ahead(), config, log, 0.5);
    const std::vector<float>& incidence = *find_values<float>(again.channels, "incidence");
    for (std::size_t i = 0; i < normal.size(); ++i) {
        const glm::dvec3 in_world = again.firing_pose(i).rotation * glm::dvec3(again.image.direction[i]);
        EXPECT_NEAR(incidence[i], again.instance[i] < 0 ? 0.0 : in_world.x, 1e-5) << "a wall across x";
    }
    config.image.primitive = PrimitiveType::gaussian;
    EXPECT_THROW(ScanRenderer(device(), wrap_background(make_wall_ahead()), config, log), UsageError);
}

/// A wall behind the sensor on its right, and a plate ahead and, turned, behind. Its
/// brightness depends on the direction.
Scene make_two_placements(Log& log) {
    Surfels surfels = test::make_plate({0.0f, -6.0f, 0.0f}, glm::vec2(1.0f));
    surfels.rotation[0] = {std::sqrt(0.5f), std::sqrt(0.5f), 0.0f, 0.0f};  // normal along y
    surfels.append_surfels(test::make_plate({0.5f, 0.0f, 0.0f}, glm::vec2(1.0f)));
    // bright for one sign of x of the direction, dark for the other
    surfels.sh[kShFloats + 3] = -0.5f;
    Scene scene;
    scene.surfels = surfels;
    scene.models = {{"background", 0, 1}, {"plate", 1, 1}};
    scene.instances = {{0, ""}, {1, "ahead"}, {1, "behind"}};
    const glm::dquat yaw_180_deg = glm::angleAxis(kPi, glm::dvec3(0, 0, 1));
    log.boxes = {{"ahead", "Car", {1, 1, 1}, {{0.0}, {Pose{{1, 0, 0, 0}, {5, 0, 0}}}}},
                 {"behind", "Car", {1, 1, 1}, {{0.0}, {Pose{yaw_180_deg, {-5, 0, 0}}}}}};
    return scene;
}

TEST_F(Render, EachPlacementOfAModelIsLitFromTheSensor) {
    Log log = make_cross_log();
    const Scene scene = make_two_placements(log);
    for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
        Config config;
        config.image.sh_direction = direction;
        const SimulatedSensor sensor = make_sensor(config, log);
        const RenderedScan scan = ScanRenderer(device(), scene, config, log).render(sensor, 0.0);
        const std::size_t ahead = find_ray_towards(sensor.rays, {1, 0, 0}),
                          behind = find_ray_towards(sensor.rays, {-1, 0, 0});
        EXPECT_EQ(scan.instance[ahead], 1);
        EXPECT_EQ(scan.instance[behind], 2);
        EXPECT_GT(std::abs(scan.image.intensity[ahead] - 0.5f), 0.1f) << "the harmonics must matter";
        EXPECT_NEAR(scan.image.intensity[ahead], scan.image.intensity[behind], 1e-5f);
    }
}

TEST_F(Render, OnlyVisibleActorsAreHit) {
    Log log = make_cross_log();
    const Scene scene = make_two_placements(log);
    const SimulatedSensor sensor = make_sensor({}, log);
    ScanRenderer renderer(device(), scene, {}, log);
    const std::size_t ahead = find_ray_towards(sensor.rays, {1, 0, 0}),
                      behind = find_ray_towards(sensor.rays, {-1, 0, 0}),
                      right = find_ray_towards(sensor.rays, {0, -1, 0});
    const auto labels = [&](const std::vector<std::string>& names) {
        renderer.show_instances(select_instances(scene, names));
        const RenderedScan scan = renderer.render(sensor, 0.0);
        return std::vector<int>{scan.instance[ahead], scan.instance[behind], scan.instance[right]};
    };
    EXPECT_EQ(labels({"background"}), (std::vector<int>{-1, -1, 0}));
    EXPECT_EQ(labels({"actors"}), (std::vector<int>{1, 2, -1}));
    EXPECT_EQ(labels({"behind"}), (std::vector<int>{-1, 2, -1}));
    EXPECT_EQ(labels({"behind", "background"}), (std::vector<int>{-1, 2, 0}));
    EXPECT_THROW(select_instances(scene, {"ahed"}), UsageError);
    EXPECT_THROW(renderer.show_instances({true}), UsageError);
}

}  // namespace
}  // namespace relidar
