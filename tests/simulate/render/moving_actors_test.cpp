// SPDX-License-Identifier: Apache-2.0
// Tests actors that move during a sweep. Each ray must hit the actor at its position at
// the firing time of the ray. Expected values are closed forms of straight and circular
// motion.
#include <cmath>

#include <gtest/gtest.h>
#include <glm/gtc/quaternion.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/render.hpp>

#include "../../support/device.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

constexpr double kRevolution_s = 0.1;
/// Half of the light passes the edge of a surfel, at sqrt(2 ln(2 opacity)) standard
/// deviations.
const double kEdge = std::sqrt(2.0 * std::log(2.0 / (1.0 + std::exp(-6.0))));

/// @param half_m visible extent from the middle in each direction
void add_wall(Surfels& surfels, const glm::vec3& middle_m, const glm::quat& from_x_axis,
              const glm::vec2& half_m) {
    // a_u = -z, a_v = y, normal x
    const glm::quat q = from_x_axis * glm::quat(std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f);
    surfels.append_surfels(test::make_plate(middle_m, half_m));
    surfels.rotation.back() = {q.w, q.x, q.y, q.z};
}

const glm::dvec3 kVan_m(4.0, 2.0, 2.0);

/// The front of a van.
Surfels make_front() {
    Surfels front;
    add_wall(front, {2.0f, 0.0f, 0.0f}, glm::quat(1, 0, 0, 0), glm::vec2(1.0f));
    return front;
}

Surfels make_rear() {
    Surfels rear;
    add_wall(rear, {-2.0f, 0.0f, 0.0f}, glm::quat(0, 0, 0, 1), glm::vec2(1.0f));
    return rear;
}

Scene make_one_actor(const Surfels& surfels, Surfels background = {}) {
    const auto n = std::uint32_t(background.size());
    Scene scene;
    scene.models = {{"background", 0, n},
                    {"actor", n, std::uint32_t(surfels.size()), glm::vec3(0.5 * kVan_m + kObjectMargin_m)}};
    scene.instances = {{0, ""}, {1, "actor"}};
    scene.surfels = std::move(background);
    scene.surfels.append_surfels(surfels);
    return scene;
}

/// Poses at 40 Hz, and a sensor with a single horizontal beam.
template <class PoseAt>
Log drive(int columns, const PoseAt& sensor_at, const PoseAt& actor_at) {
    Log log;
    log.lidars[0].sensor.beams = {{0.0}};
    log.lidars[0].sensor.columns = columns;
    log.lidars[0].sensor.first_azimuth_rad = kPi - kPi / columns;
    log.lidars[0].sensor.period_s = kRevolution_s;
    BoxTrack box{.id = "actor", .category = "Van", .size_m = kVan_m, .world_from_box = {}};
    for (int k = 0; k <= 40; ++k) {
        const double t_s = 0.025 * k;
        log.world_from_vehicle.time_s.push_back(t_s);
        log.world_from_vehicle.pose.push_back(sensor_at(t_s));
        box.world_from_box.time_s.push_back(t_s);
        box.world_from_box.pose.push_back(actor_at(t_s));
    }
    log.boxes = {box};
    return log;
}

using PoseAt = std::function<Pose(double)>;
const PoseAt kStands = [](double) { return Pose{}; };
const PoseAt kVanAhead = [](double) { return Pose{{1, 0, 0, 0}, {12.0, 0.0, 0.0}}; };

/// Separately for the rays at the start and at the end of the sweep.
std::array<double, 2> measure_halves_behind(const RenderedScan& scan) {
    std::array<double, 2> sum{}, n{};
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i) {
        const glm::dvec3 d(scan.image.direction[i]);
        if (!(scan.median_range_m[i] > 0.0f) || d.x > 0.0) continue;
        // a motion-compensated scan has no time offsets, so its rays are divided by side
        const bool has_times = scan.time_offset_s[i] != 0.0f;
        const std::size_t half = (has_times ? double(scan.time_offset_s[i]) : d.y) < 0.0 ? 0 : 1;
        sum[half] += -d.x * double(scan.median_range_m[i]);
        n[half] += 1.0;
    }
    EXPECT_GT(std::min(n[0], n[1]), 5.0) << "rays that meet the actor";
    return {sum[0] / n[0], sum[1] / n[1]};
}

class MovingActors : public test::DeviceTest {
protected:
    RenderedScan render(const Scene& scene, const Log& log, double time_s) {
        Config config;
        ScanRenderer renderer(device(), scene, config, log);
        return renderer.render(make_sensor(config, log), time_s);
    }
    /// The front of a van must be 8 m behind the sensor for every ray.
    void expect_front(const Log& log, double time_s = 0.5) {
        for (const double behind_m : measure_halves_behind(render(make_one_actor(make_front()), log, time_s)))
            EXPECT_NEAR(behind_m, 8.0, 1e-3) << "at " << time_s << " s";
    }
};

TEST_F(MovingActors, AVanThatFollowsIsNotTornBehindTheSensor) {
    for (const double speed_mps : {0.0, 20.0, 30.0}) {
        SCOPED_TRACE(speed_mps);
        const PoseAt sensor = [&](double t_s) { return Pose{{1, 0, 0, 0}, {speed_mps * t_s, 0.0, 0.0}}; };
        const PoseAt van = [&](double t_s) { return Pose{{1, 0, 0, 0}, {speed_mps * t_s - 10.0, 0.0, 0.0}}; };
        // at a label, and between two labels
        for (const double time_s : {0.5, 0.51}) expect_front(drive(720, sensor, van), time_s);
    }
}

/// Tolerance: interpolated poses lie on chords of 0.015 rad.
TEST_F(MovingActors, AVanThatFollowsRoundABendIsNotTorn) {
    const auto at = [](double t_s, double behind_m) {
        const glm::dquat rotation = glm::angleAxis(0.6 * t_s, glm::dvec3(0, 0, 1));
        return Pose{rotation, rotation * glm::dvec3(-behind_m, -20.0, 0.0)};
    };
    const PoseAt sensor = [&](double t_s) { return at(t_s, 0.0); },
                 van = [&](double t_s) { return at(t_s, 10.0); };
    expect_front(drive(720, sensor, van));
}

/// Two posts, 4 m apart, are measured at different times.
TEST_F(MovingActors, ACarThatPassesIsStretchedByItsWay) {
    constexpr double kCarSpeed_mps = 20.0;
    Surfels posts;
    for (const float x : {-2.0f, 2.0f})
        add_wall(posts, {x, -1.0f, 0.0f}, glm::quat(std::sqrt(0.5f), 0.0f, 0.0f, std::sqrt(0.5f)),
                 {1.0f, 0.02f});
    // next to the sensor when the head faces it
    const PoseAt car = [](double t_s) {
        return Pose{{1, 0, 0, 0}, {kCarSpeed_mps * (t_s - 0.475), 7.0, 0.0}};
    };
    const RenderedScan scan = render(make_one_actor(posts), drive(7200, kStands, car), 0.5);
    double n[2] = {}, x_m[2] = {}, t_s[2] = {};
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i) {
        if (!(scan.median_range_m[i] > 0.0f)) continue;
        const double x = double(scan.median_range_m[i] * scan.image.direction[i].x);
        const int post = x < 0.0 ? 0 : 1;
        n[post] += 1.0;
        x_m[post] += x;
        t_s[post] += double(scan.time_offset_s[i]);
        EXPECT_NEAR(scan.median_range_m[i] * scan.image.direction[i].y, 6.0f, 1e-3f) << "the side of the car";
    }
    ASSERT_GT(std::min(n[0], n[1]), 3.0);
    const double between_s = t_s[1] / n[1] - t_s[0] / n[0];
    EXPECT_NEAR(between_s, 2.0 * std::atan(2.1 / 6.0) / (2.0 * kPi) * kRevolution_s, 5e-4);
    EXPECT_NEAR(x_m[1] / n[1] - x_m[0] / n[0], 4.0 + kCarSpeed_mps * between_s, 0.01);
    EXPECT_NEAR(x_m[0] / n[0], -2.0 + kCarSpeed_mps * (t_s[0] / n[0] + 0.025), 0.01);
}

TEST_F(MovingActors, WithoutRollingShutterActorsStand) {
    const PoseAt van = [](double t_s) { return Pose{{1, 0, 0, 0}, {20.0 * (t_s - 0.5) - 10.0, 0.0, 0.0}}; };
    Log log = drive(720, kStands, van);
    log.rolling_shutter = false;
    expect_front(log);
}

TEST_F(MovingActors, AWallHidesHalfOfTheVan) {
    Log log = drive(7200, kStands, kVanAhead);
    log.boxes[0].category = "Pedestrian";
    const auto expect_share = [&](double wall_x_m, double share) {
        Surfels wall;
        // Three narrow surfels in a row, so that the wall has a sharp edge at y = 0.
        for (int k = 0; k < 3; ++k)
            add_wall(wall, {float(wall_x_m), float(0.25 * kEdge + 0.45 * k), 0.0f}, glm::quat(0, 0, 0, 1),
                     {2.0f, 0.25f});
        const Scene scene = make_one_actor(make_rear(), wall);
        Config config;
        config.render.channels = "class";
        ScanRenderer renderer(device(), scene, config, log);
        EXPECT_TRUE(renderer.render(make_sensor(config, log), 0.5).actor_views.empty());
        renderer.count_actor_rays();
        const RenderedScan scan = renderer.render(make_sensor(config, log), 0.5);
        ASSERT_EQ(scan.actor_views.size(), 1u);
        const ActorVisibility& view = scan.actor_views[0];
        EXPECT_EQ(view.track, "actor");
        // The van's rear is 10 m ahead, 2 m wide and has margins. A column is 2 pi / 7200
        // wide.
        EXPECT_NEAR(double(view.n_rays_alone), 2.0 * std::atan(1.1 / 10.0) / (2.0 * kPi) * 7200.0, 3.0);
        EXPECT_NEAR(double(view.n_rays) / double(view.n_rays_alone), share, 0.015);
        // 0 is the background, 3 is a person, and -1 means that the ray hits nothing.
        const auto& classes = *find_values<std::int32_t>(scan.channels, "class");
        for (std::size_t i = 0; i < classes.size(); ++i)
            EXPECT_EQ(classes[i], scan.instance[i] == 1 ? 3 : scan.instance[i]);
        EXPECT_GE(std::ranges::count(classes, 3), std::ptrdiff_t(view.n_rays));
    };
    expect_share(5.0, 0.5);
    expect_share(20.0, 1.0);
}

/// The plate of the rear ends 0.17 m below the ground. The ground hides that part, but no
/// object hides the van. A dark van, of which few rays return, is as visible.
TEST_F(MovingActors, TheGroundDoesNotHideTheVan) {
    const double n_rays = 2.0 * std::atan(1.1 / 10.0) / (2.0 * kPi) * 7200.0;
    for (const float hit_logit : {20.0f, -5.0f}) {
        Log log = drive(7200, kStands, kVanAhead);
        // The second beam meets the plate 0.1 m below the ground, the third 0.1 m above.
        for (const double z_m : {-1.1, -0.9})
            log.lidars[0].sensor.beams.push_back({.elevation_rad = std::atan(z_m / 10.0)});
        Surfels rear = make_rear();
        rear.sh[kShCoefficients] = hit_logit;
        const Scene scene = make_one_actor(rear, test::make_plate({0.0f, 0.0f, -1.0f}, {60.0f, 60.0f}, true));
        ScanRenderer renderer(device(), scene, {}, log);
        renderer.count_actor_rays();
        const RenderedScan scan = renderer.render(make_sensor({}, log), 0.5);
        ASSERT_EQ(scan.actor_views.size(), 1u) << hit_logit;
        EXPECT_NEAR(double(scan.actor_views[0].n_rays), n_rays, 3.0) << "the lowest 0.15 m do not count";
        EXPECT_EQ(scan.actor_views[0].n_rays, scan.actor_views[0].n_rays_alone);
        // Without the highest beam, only the lowest part of the van is in view.
        log.lidars[0].sensor.beams.erase(log.lidars[0].sensor.beams.begin());
        ScanRenderer low(device(), scene, {}, log);
        low.count_actor_rays();
        const ActorViews views = low.render(make_sensor({}, log), 0.5).actor_views;
        ASSERT_EQ(views.size(), 1u);
        EXPECT_GT(views[0].n_rays, 100u) << "the rays between the ground and 0.15 m";
    }
}

/// A plate fills the front of a labelled box that stands. Rays at |y| < 1.1 m, the side
/// of the box with its margin, hit the plate 10 m ahead.
TEST_F(MovingActors, AWallHidesHalfOfAParkedVan) {
    const auto view_of = [&](const glm::dvec3& box_m, float first_wall_y_m) {
        const PoseAt parked = [&](double) { return Pose{{1, 0, 0, 0}, box_m}; };
        Log log = drive(7200, kStands, parked);
        Surfels surfels;
        add_wall(surfels, {10.0f, 0.0f, 0.0f}, glm::quat(0, 0, 0, 1), glm::vec2(1.5f));
        for (int k = 0; k < 6; ++k)
            add_wall(surfels, {5.0f, first_wall_y_m + float(0.25 * kEdge + 0.45 * k), 0.0f},
                     glm::quat(0, 0, 0, 1), {2.0f, 0.25f});
        Config config;
        ScanRenderer renderer(device(), wrap_background(std::move(surfels)), config, log);
        renderer.count_actor_rays();
        const ActorViews views = renderer.render(make_sensor(config, log), 0.5).actor_views;
        return views.empty() ? ActorVisibility{} : views.front();
    };
    const double n_rays = 2.0 * std::atan(1.1 / 10.0) / (2.0 * kPi) * 7200.0;
    const ActorVisibility free = view_of({12.0, 0.0, 0.0}, 20.0f), half = view_of({12.0, 0.0, 0.0}, 0.0f),
                          hidden = view_of({12.0, 0.0, 0.0}, -1.5f),
                          empty = view_of({12.0, -9.0, 0.0}, 20.0f);
    EXPECT_EQ(free.track, "actor");
    EXPECT_NEAR(double(free.n_rays), n_rays, 3.0);
    EXPECT_EQ(free.n_rays, free.n_rays_alone);
    EXPECT_NEAR(double(half.n_rays_alone), n_rays, 5.0);
    EXPECT_NEAR(double(half.n_rays) / double(half.n_rays_alone), 0.5, 0.015);
    EXPECT_EQ(hidden.n_rays, 0u);
    EXPECT_NEAR(double(hidden.n_rays_alone), n_rays, 5.0);
    EXPECT_EQ(empty.track, "actor") << "no surface was observed there";
    EXPECT_EQ(empty.n_rays_alone, 0u);
    EXPECT_EQ(view_of({-500.0, 0.0, 0.0}, 20.0f).track, "") << "not a single ray crosses the box";
}

/// A ray that loses less than half of its light at the edge passes the van.
TEST_F(MovingActors, TheOutlineDoesNotDependOnWhatIsBehind) {
    Surfels wall;
    add_wall(wall, {30.0f, 0.0f, 0.0f}, glm::quat(0, 0, 0, 1), glm::vec2(30.0f));
    const Log log = drive(7200, kStands, kVanAhead);
    for (const bool has_wall : {true, false}) {
        const Scene scene = make_one_actor(make_rear(), has_wall ? wall : Surfels{});
        const RenderedScan scan = ScanRenderer(device(), scene, {}, log).render(make_sensor({}, log), 0.5);
        int n_returns = 0, n_touched = 0;
        for (std::size_t i = 0; i < scan.instance.size(); ++i) {
            n_touched += scan.instance[i] == 1;
            n_returns +=
                scan.instance[i] == 1 && is_ray_returned(scan.image.drop_prob[i], scan.median_range_m[i]);
        }
        EXPECT_NEAR(n_returns, 2.0 * std::atan(kEdge / 10.0) / (2.0 * kPi) * 7200.0, 3.0) << has_wall;
        EXPECT_EQ(n_touched > n_returns + 100, !has_wall);
    }
}

/// As many rays return as the log measured on them, up to 3 %.
TEST_F(MovingActors, AloneTheyHaveTheSilhouetteOfTheLog) {
    const Log log = make_street_log({.n_frames = 5, .rows = 48, .columns = 1024});
    Config config = make_preset("quick");
    config.init.opacity = 0.95;  // training makes surfels nearly opaque
    const Scene scene = init_scene(log, {0, 1, 2, 3, 4}, config.init);
    ScanRenderer renderer(device(), scene, config, log);
    renderer.show_instances(select_instances(scene, {"actors"}));
    const Frame& frame = log.frames[2];
    const RenderedScan scan = renderer.render(make_sensor(config, log), frame.time_s);
    double n_returns = 0.0, n_measured = 0.0;
    for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
        n_returns += is_ray_returned(scan.image.drop_prob[i], scan.median_range_m[i]);
        if (!(frame.scan.range_m[i] > 0.0f)) continue;
        const WorldReturn w = locate_return(log, frame, i);
        n_measured += std::ranges::any_of(
            log.boxes, [&](const BoxTrack& box) { return box.contains_point(w.point_m, w.time_s, 0.0); });
    }
    EXPECT_GT(n_measured, 300.0);
    EXPECT_NEAR(n_returns / n_measured, 1.0, 0.03);
}

TEST_F(MovingActors, TheVelocityIsTheRateOfTheRange) {
    Surfels wall;
    add_wall(wall, {0.0f, 12.0f, 0.0f}, glm::quat(std::sqrt(0.5f), 0.0f, 0.0f, -std::sqrt(0.5f)),
             {2.0f, 30.0f});
    const Scene scene = make_one_actor(make_rear(), wall);
    const PoseAt sensor = [](double t_s) {
        return Pose{glm::angleAxis(0.4 * (t_s - 0.5), glm::dvec3(0, 0, 1)), {15.0 * (t_s - 0.5), 0.0, 0.0}};
    };
    const PoseAt van = [](double t_s) {
        return Pose{glm::angleAxis(0.5 * (t_s - 0.5), glm::dvec3(0, 0, 1)),
                    {10.0 + 9.0 * (t_s - 0.5), 2.0 * (t_s - 0.5), 0.0}};
    };
    for (const bool rolls : {true, false}) {
        Log log = drive(720, sensor, van);
        log.rolling_shutter = rolls;
        Config config;
        config.render.channels = "velocity";
        ScanRenderer renderer(device(), scene, config, log);
        const RenderedScan scan = renderer.render(make_sensor(config, log), 0.5);
        const std::vector<float>& velocity = *find_values<float>(scan.channels, "velocity");
        int n[2] = {};
        for (std::size_t i = 0; i < velocity.size(); ++i) {
            if (scan.instance[i] < 0) {
                EXPECT_EQ(velocity[i], 0.0f);
                continue;
            }
            constexpr double kStep_s = 1e-3;
            const double time_s = 0.5 + double(scan.time_offset_s[i]);
            const glm::dvec3 hit_m =
                sensor(time_s) * (double(scan.median_range_m[i]) * glm::dvec3(scan.image.direction[i]));
            const bool is_van = scan.instance[i] == 1;
            const auto range_at = [&](double t_s) {
                const glm::dvec3 point_m = is_van ? van(t_s) * (inverse(van(time_s)) * hit_m) : hit_m;
                return glm::distance(point_m, sensor(t_s).translation);
            };
            const double rate = (range_at(time_s + kStep_s) - range_at(time_s - kStep_s)) / (2.0 * kStep_s);
            EXPECT_NEAR(velocity[i], rate, 0.01) << (is_van ? "van" : "wall") << " at " << hit_m.x;
            ++n[is_van];
        }
        EXPECT_GT(n[0], 100);
        EXPECT_GT(n[1], 10);
    }
}

}  // namespace
}  // namespace relidar
