// SPDX-License-Identifier: Apache-2.0
// Tests the rays of a sensor on the device. Compares fired rays (kernel
// simulate/render/fire_rays) with make_world_ray() in double precision. Compares measured
// rays (measure_rays) with the beam model, range limits and drop probability (M6).
// Compares network channels (drop_channels) with make_drop_image().

#include <gtest/gtest.h>
#include <cmath>
#include <random>

#include <relidar/log/classes.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/log_body.hpp>
#include <relidar/simulate/render.hpp>

#include "../../support/device.hpp"
#include "../plates.hpp"
#include "base/random.hpp"
#include "simulate/render/scan_renderer.hpp"
#include "simulate/render/sensor_rays.hpp"

namespace relidar {
namespace {

class SensorRaysTest : public test::DeviceTest {};

RayTable make_spinning_rays(int columns) {
    SpinningSensor sensor;
    sensor.beams = {{0.05, 0.01, 0.03, 0.12, 0.02}, {0.0}, {-0.4, -0.02, 0.05, 0.2, -0.01}};
    sensor.columns = columns;
    sensor.first_azimuth_rad = kPi;
    return make_rays(sensor);
}

/// Far from the origin, turns about all axes, uneven time intervals.
PoseTrack bend(double rad_per_s, int count, double step_s = 0.03) {
    PoseTrack track;
    for (int k = 0; k < count; ++k) {
        const double t = step_s * (k + 0.13 * std::sin(k));
        track.time_s.push_back(t);
        track.pose.push_back({make_rotation(rad_per_s * t + 2.0, 0.1 * rad_per_s * t, -0.2 * std::sin(t)),
                              {400.0 + 20.0 * t, -250.0 - 3.0 * t, 2.0}});
    }
    return track;
}

double measure_largest_error(Device& device, const RayTable& rays, const PoseTrack& track, double time_s) {
    DeviceSensorRays on_device(device);
    Stream stream(device);
    on_device.upload(rays, "test", [](std::size_t) { return 0.0f; });
    on_device.place(stream, track, time_s);
    stream.submit_and_wait();
    const std::vector<DeviceRay> fired = on_device.world_batch().rays->download();
    double farthest = 0.0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const WorldRay expected = make_world_ray(track, time_s, rays, i, true);
        farthest = std::max({farthest, glm::distance(glm::dvec3(fired[i].origin), expected.origin_m) / 80.0,
                             glm::distance(glm::dvec3(fired[i].direction), expected.direction)});
    }
    return farthest;
}

/// At 400 m, neighbouring floats differ by 3e-5 m. An error of 5e-7 in a direction is
/// 0.04 mm at 80 m.
TEST_F(SensorRaysTest, AreFiredFromWhereTheSensorIsThen) {
    const RayTable rays = make_spinning_rays(301);  // fired from -0.05 to 0.05 s
    const double tolerance = 6e-7;
    EXPECT_LT(measure_largest_error(device(), rays, bend(1.0, 12), 0.15), tolerance);
    EXPECT_LT(measure_largest_error(device(), rays, bend(20.0, 12), 0.15), tolerance)
        << "0.6 rad between poses";
    EXPECT_LT(measure_largest_error(device(), rays, bend(1.0, 12), 0.01), tolerance);
    EXPECT_LT(measure_largest_error(device(), rays, bend(1.0, 12), 0.34), tolerance) << "ends behind it";
    EXPECT_LT(measure_largest_error(device(), rays, bend(1.0, 1), 0.3), tolerance) << "a sensor that stands";
    for (const int count : {2, 3, 4, 3000})
        EXPECT_LT(measure_largest_error(device(), rays, bend(1.0, count, 0.3 / count), 0.15), tolerance)
            << count;
    EXPECT_LT(measure_largest_error(device(), select_rays(rays, {7}), bend(1.0, 12), 0.15), tolerance);
}

TEST_F(SensorRaysTest, OnlyPosesOfTheSweepGoUp) {
    const PoseTrack track = bend(1.0, 1000);
    const auto poses = poses_between(track, 15.0, -0.05, 0.05);
    EXPECT_LE(poses.front().time_offset_s, -0.05f);
    EXPECT_GE(poses.back().time_offset_s, 0.05f);
    EXPECT_LE(poses.size(), 6u);
}

std::vector<shared::RenderedRay> make_random_rendering(std::size_t count) {
    std::mt19937 random(5);
    std::uniform_real_distribution<float> uniform(0.0f, 1.0f);
    std::vector<shared::RenderedRay> rendered(count);
    for (shared::RenderedRay& r : rendered) {
        const float t = 0.5f + 90.0f * uniform(random);
        r.weight = uniform(random) < 0.2f ? 5e-4f * uniform(random) : uniform(random);
        r.depth = r.weight * t;
        r.median_depth = r.weight > 0.5f ? t * (0.9f + 0.2f * uniform(random)) : 0.0f;
        r.intensity = 1.2f * uniform(random);
        r.hit_logit = 8.0f * uniform(random) - 4.0f;
        r.drop_logit = 8.0f * uniform(random) - 4.0f;
        r.transmittance = 1.0f - r.weight;
        r.n_hits = 3;
        r.instance = uniform(random) < 0.5f ? 0u : 2u;
    }
    return rendered;
}

struct Expected {
    double range_m, median_m, mean_m, intensity, drop_prob;
};

Expected compute_expected(const shared::RenderedRay& ray, const Beam& beam, double actor_logit, double sees,
                          double mode_m, const RayMeasurementOptions& options) {
    const double weight = ray.weight, normalised = ray.depth / weight, median = ray.median_depth;
    double chosen = options.range == "median" && median > 0.0 ? median : normalised;
    if (options.range == "mode") chosen = mode_m;
    if (weight < double(options.min_weight)) chosen = 0.0;
    if (options.range == "expected") chosen = ray.depth;
    const double surface = median > 0.0 ? median : chosen;
    Expected e{beam.to_measured_range_m(chosen), beam.to_measured_range_m(surface),
               beam.to_measured_range_m(median > 0.0 ? normalised : surface),
               beam.to_measured_intensity(ray.intensity, options.response.range_factor(surface)), 0.0};
    const double hit = std::exp(double(ray.hit_logit)),
                 drop = std::exp(double(ray.drop_logit) + (ray.instance == 0u ? 0.0 : actor_logit));
    // An actor needs half of the light, the background only the minimum weight.
    const bool is_met = weight >= (ray.instance == 0u ? double(options.min_weight) : 0.5) &&
                        e.range_m > 0.0 && e.median_m > 0.0;
    e.drop_prob = is_met && options.limits.contains(e.range_m) && options.limits.contains(e.median_m)
                      ? 1.0 - sees * hit / (hit + drop)
                      : 1.0;
    return e;
}

TEST_F(SensorRaysTest, AreMeasuredAsBeamLimitsAndDropLogitsSay) {
    const RayTable rays = make_spinning_rays(333);
    const std::vector<shared::RenderedRay> rendering = make_random_rendering(rays.size());
    std::vector<shared::RenderedSurface> of_rays(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) {
        of_rays[i].mode = 1.05f * rendering[i].median_depth;
        of_rays[i].normal = glm::vec3(float(i % 3), 1.0f, float(i % 5) - 2.0f);
    }
    const Array<shared::RenderedSurface> surfaces(device(), std::span<const shared::RenderedSurface>(of_rays),
                                                  "surfaces");
    const Array<shared::RenderedRay> rendered(device(), std::span<const shared::RenderedRay>(rendering),
                                              "rendered rays");
    const std::vector<Beam> beams = {
        {.intensity_gain = 1.3, .intensity_offset = -0.05, .range_offset_m = 0.04},
        {.intensity_gain = 0.8, .intensity_offset = 0.02, .range_offset_m = -0.7}};
    const IntensityResponse response{{4.0, 10.0, 30.0, 70.0}, {0.6, 1.0, 1.4, 0.9}, 0.3};
    const auto never = [](std::size_t index) { return index % 5 == 0 ? 0.75f : 0.0f; };
    DeviceSensorRays on_device(device());
    on_device.upload(rays, "test", never);
    Stream firing(device());
    on_device.place(firing, bend(0.0, 1), 0.0);
    firing.submit_and_wait();
    const std::vector<DeviceRay> fired = on_device.world_batch().rays->download();
    for (const std::string range : {"normalised", "expected", "mode", "median"}) {
        // The third beam has a logit, but no calibration.
        const std::vector<float> actor_logits = {1.25f, 0.0f, -2.0f};
        const RayMeasurementOptions how{range, beams,       response, {range == "median" ? 0.0 : 0.9, 80.0},
                                        1e-3f, actor_logits};
        Stream stream(device());
        on_device.record_measure(
            stream, {.rays = on_device.world_batch(), .rendered = &rendered, .surfaces = &surfaces}, how);
        const std::span<const shared::MeasuredRay> measured = on_device.wait_measured(stream).rays;
        ASSERT_EQ(measured.size(), rays.size());
        for (std::size_t i = 0; i < rays.size(); ++i) {
            const shared::MeasuredRay& m = measured[i];
            const Expected e =
                compute_expected(rendering[i], find_beam(beams, rays.channel[i]),
                                 actor_logits[rays.channel[i]], 1.0 - double(never(i)), of_rays[i].mode, how);
            EXPECT_NEAR(m.range_m, e.range_m, 2e-5) << range << i;
            EXPECT_NEAR(m.median_range_m, e.median_m, 2e-5) << range << i;
            EXPECT_NEAR(m.mean_range_m, e.mean_m, 2e-5) << range << i;
            EXPECT_NEAR(m.intensity, e.intensity, 2e-6) << range << i;
            EXPECT_NEAR(m.drop_prob, e.drop_prob, 2e-6) << range << i;
            const double cosine =
                -glm::dot(glm::normalize(glm::dvec3(of_rays[i].normal)), glm::dvec3(fired[i].direction));
            EXPECT_NEAR(m.incidence, rendering[i].weight < 1e-3f ? 0.0 : std::max(cosine, 0.0), 1e-6)
                << range << i;
            EXPECT_EQ(m.weight, rendering[i].weight);
            EXPECT_EQ(m.instance, rendering[i].weight < 1e-3f ? RELIDAR_NO_INSTANCE : rendering[i].instance)
                << i;
        }
    }
}

/// Gains of the log's beams increase with the elevation, and alternate by 0.2. The mean
/// over neighbours has the increase, but not the alternation.
TEST(MeanResponses, FollowTheBeamsOfSimilarElevation) {
    std::vector<Beam> log_beams;
    for (int k = 0; k < 40; ++k) {
        const double elevation_rad = 0.1 - 0.01 * k, sign = k % 2 == 0 ? 1.0 : -1.0;
        log_beams.push_back({.elevation_rad = elevation_rad,
                             .intensity_gain = 1.0 + 2.0 * elevation_rad + 0.2 * sign,
                             .intensity_offset = -elevation_rad + 0.1 * sign});
    }
    SpinningSensor other;
    other.columns = 12;
    const std::vector<double> elevations_rad{0.5, 0.02, -0.1, -0.165, -0.8};
    for (const double elevation_rad : elevations_rad) other.beams.push_back({elevation_rad});
    const std::vector<Beam> means = mean_responses(make_rays(other), log_beams);
    ASSERT_EQ(means.size(), elevations_rad.size());
    for (std::size_t k = 0; k < means.size(); ++k) {
        // Beyond the log's beams, the response is that of the eight outer beams.
        const double elevation_rad = std::clamp(elevations_rad[k], -0.29 + 0.035, 0.1 - 0.035);
        EXPECT_NEAR(means[k].intensity_gain, 1.0 + 2.0 * elevation_rad, 0.011) << k;
        EXPECT_NEAR(means[k].intensity_offset, -elevation_rad, 0.006) << k;
        EXPECT_EQ(means[k].range_offset_m, 0.0);
    }
    EXPECT_TRUE(mean_responses(make_rays(other), {}).empty());
}

/// The sensor differs, or different rays have the same size.
TEST_F(SensorRaysTest, AreTakenAnewWhereTheyDiffer) {
    RayTable rays = make_spinning_rays(16);
    shared::RenderedRay wall{};
    wall.depth = wall.median_depth = 10.0f;
    wall.weight = 1.0f;
    wall.hit_logit = 20.0f;
    const std::vector<shared::RenderedRay> rendering(rays.size(), wall);
    const Array<shared::RenderedRay> rendered(device(), std::span<const shared::RenderedRay>(rendering),
                                              "rendered rays");
    DeviceSensorRays on_device(device());
    const auto drop_of_first = [&] {
        Stream stream(device());
        on_device.record_measure(stream, {.rays = on_device.world_batch(), .rendered = &rendered},
                                 {"median", {}, {}, {0.0, 80.0}, 1e-3f});
        return on_device.wait_measured(stream).rays[0].drop_prob;
    };
    on_device.upload(rays, "one", [](std::size_t) { return 0.0f; });
    EXPECT_NEAR(drop_of_first(), 0.0f, 1e-6f);
    on_device.upload(rays, "one", [](std::size_t) { return 0.5f; });
    EXPECT_NEAR(drop_of_first(), 0.0f, 1e-6f) << "the same rays of the same sensor stay";
    on_device.upload(rays, "another", [](std::size_t) { return 0.5f; });
    EXPECT_NEAR(drop_of_first(), 0.5f, 1e-6f);
    rays.direction[5] = -rays.direction[5];
    on_device.upload(rays, "another", [](std::size_t) { return 0.25f; });
    EXPECT_NEAR(drop_of_first(), 0.25f, 1e-6f);
}

std::vector<shared::RenderedRay> make_rendered_room(const RayTable& rays) {
    std::vector<shared::RenderedRay> rendered = make_random_rendering(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const double azimuth = std::atan2(rays.direction[i].y, rays.direction[i].x);
        shared::RenderedRay& r = rendered[i];
        r.weight = 0.95f;
        r.median_depth = float(8.0 + 2.0 * std::sin(3.0 * azimuth) + (azimuth > 2.0 ? 6.0 : 0.0));
        r.depth = r.weight * (r.median_depth + 0.3f * float(i % 7));
        if (i % 11 == 0) r.median_depth = r.depth = r.weight = 0.0f;
    }
    return rendered;
}

RenderedScan scan_of(const RayTable& rays, std::span<const shared::MeasuredRay> measured) {
    RenderedScan scan;
    scan.image.rows = rays.rows;
    scan.image.columns = rays.columns;
    scan.image.origin = to_vector(rays.origin);
    scan.image.direction = to_vector(rays.direction);
    std::vector<float> incidence;
    for (const shared::MeasuredRay& m : measured) {
        scan.median_range_m.push_back(m.median_range_m);
        scan.mean_range_m.push_back(m.mean_range_m);
        scan.image.intensity.push_back(m.intensity);
        scan.image.drop_prob.push_back(m.drop_prob);
        scan.weight.push_back(m.weight);
        incidence.push_back(m.incidence);
    }
    scan.channels = {{{.name = "incidence"}, incidence}};
    scan.world_from_sensor.translation = {30.0, -20.0, 1.0};
    return scan;
}

TEST_F(SensorRaysTest, ANetworkSeesThemAsItSeesAScan) {
    RayTable rays = make_spinning_rays(120);
    const std::vector<shared::RenderedRay> rendering = make_rendered_room(rays);
    const Array<shared::RenderedRay> rendered(device(), std::span<const shared::RenderedRay>(rendering),
                                              "rendered rays");
    DeviceSensorRays on_device(device());
    on_device.upload(rays, "test", [](std::size_t) { return 0.0f; });
    Stream stream(device());
    on_device.place(stream, bend(0.0, 1), 0.0);
    std::vector<shared::RenderedSurface> of_rays(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i)
        of_rays[i].normal = {std::sin(0.3f * float(i)), std::cos(0.3f * float(i)), 0.2f};
    const Array<shared::RenderedSurface> surfaces(device(), std::span<const shared::RenderedSurface>(of_rays),
                                                  "surfaces");
    const glm::dvec3 first_origin_m(10.0, 5.0, 0.0);
    const auto measure = [&] {
        on_device.record_measure(
            stream, {.rays = on_device.world_batch(), .rendered = &rendered, .surfaces = &surfaces},
            {"median", {}, {}, {0.0, 80.0}, 1e-3f});
    };
    measure();
    const RenderedScan scan = scan_of(rays, on_device.wait_measured(stream).rays);
    for (const std::string network : {"pixel", "small"}) {
        const RayDropNetworkOptions options{
            .network = network, .levels = 0, .rays = "origin,direction", .epochs = 100, .rate = 1e-2};
        RayDropImage image = make_drop_image(scan, channel_names(options), first_origin_m);
        for (std::size_t i = 0; i < rays.size(); ++i)
            image.dropped.push_back(image.channels[5 * rays.size() + i] > 0.8f ? 1.0f : 0.0f);
        const auto go_on = [](const RayDropTrainProgress&, const std::function<RayDropTrainState()>&) {
            return true;
        };
        const RayDropNetwork trained = train_drop_network(device(), {image}, options, 3, go_on);
        RayDropRefiner refiner(device(), trained);
        const std::vector<float> expected = refiner.predict_drops(image);
        measure();
        on_device.record_drop(stream, refiner.inference(),
                              glm::vec3(scan.world_from_sensor.translation - first_origin_m));
        const std::span<const float> actual = on_device.wait_measured(stream).network_drops;
        double changed = 0.0;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            EXPECT_NEAR(actual[i], expected[i], 2e-4) << network << i;
            changed = std::max(changed, std::abs(double(actual[i]) - double(scan.image.drop_prob[i])));
        }
        EXPECT_GT(changed, 0.05) << "a network that says something";
    }
}

constexpr double kSlack_m = 1e-9;

/// Distance along a ray to the first point on the surface of a box. The ray starts
/// outside.
std::optional<double> distance_to_sides(const VehicleBox& box, const glm::dvec3& origin_m,
                                        const glm::dvec3& direction) {
    std::optional<double> nearest_m;
    for (int k = 0; k < 3; ++k)
        for (const double sign : {-1.0, 1.0}) {
            const glm::dvec3 normal =
                box.frame_from_box.rotation *
                glm::dvec3(k == 0 ? sign : 0.0, k == 1 ? sign : 0.0, k == 2 ? sign : 0.0);
            const glm::dvec3 on_side_m = box.frame_from_box.translation + 0.5 * box.size_m[k] * normal;
            const double t = glm::dot(on_side_m - origin_m, normal) / glm::dot(direction, normal);
            const glm::dvec3 p = glm::abs(inverse(box.frame_from_box) * (origin_m + t * direction));
            if (t > 0.0 && glm::all(glm::lessThan(p, 0.5 * box.size_m + kSlack_m)) &&
                (!nearest_m || t < *nearest_m))
                nearest_m = t;
        }
    return nearest_m;
}

TEST(OwnVehicle, RayMeetsTheNearestSideOfItsBoxes) {
    Random random(7);
    const auto any = [&](double most) { return random.sample_uniform(-most, most); };
    int n_hits = 0;
    for (int i = 0; i < 20000; ++i) {
        std::vector<VehicleBox> boxes;
        for (int b = 0; b < 2; ++b)
            boxes.push_back({{make_rotation(any(3), any(1), any(1)), {any(3), any(3), any(3)}},
                             {1.0 + any(0.8), 2.0 + any(1.5), 1.0 + any(0.5)}});
        const glm::dvec3 origin_m = 8.0 * glm::normalize(glm::dvec3(any(1), any(1), any(1) + 1e-3));
        const glm::dvec3 direction = glm::normalize(glm::dvec3(any(3), any(3), any(3)) - origin_m);
        std::optional<double> expected;
        for (const VehicleBox& box : boxes)
            if (const auto t = distance_to_sides(box, origin_m, direction);
                t && (!expected || *t < *expected))
                expected = t;
        const std::optional<BodyHit> hit = find_body_hit(boxes, origin_m, direction);
        ASSERT_EQ(hit.has_value(), expected.has_value()) << i;
        if (!hit) continue;
        ++n_hits;
        EXPECT_NEAR(hit->range_m, *expected, 1e-9);
        EXPECT_LT(glm::dot(hit->normal, direction), 0.0);
        EXPECT_FALSE(find_body_hit(boxes, origin_m, -direction)) << "the boxes are ahead of the sensor";
    }
    EXPECT_GT(n_hits, 2000);
    const std::vector<VehicleBox> around{{{}, {4.0, 2.0, 2.0}}};
    EXPECT_FALSE(find_body_hit(around, {0.5, 0.0, 0.0}, {1, 0, 0})) << "a sensor inside the outline";
    // parallel to four sides: from 3 m to the front at 2 m, and past the box
    EXPECT_EQ(find_body_hit(around, {5.0, 0.5, 0.0}, {-1, 0, 0})->range_m, 3.0);
    EXPECT_FALSE(find_body_hit(around, {5.0, 1.5, 0.0}, {-1, 0, 0}));
}

/// Four rays of a roof sensor, with a bonnet whose top is 1 m below: a ray that meets it,
/// a ray above it, a ray to a near object, and a ray that the scene has dropped.
RenderedScan make_scan(const glm::vec3& down) {
    RenderedScan scan;
    scan.image.direction = {down, {1.0f, 0.0f, 0.0f}, down, down};
    scan.image.range_m = {9.0f, 30.0f, 0.8f, 0.0f};
    scan.image.drop_prob = {0.2f, 0.1f, 0.0f, 1.0f};
    scan.weight = {1.0f, 1.0f, 1.0f, 0.0f};
    scan.channels = {{parse_channels("class").front(), std::vector<std::int32_t>{5, 9, 3, -1}},
                     {parse_channels("incidence").front(), std::vector<float>(4, 0.5f)}};
    return test::complete(std::move(scan));
}

TEST(OwnVehicle, PointsOnItAreKeptOrDropped) {
    const glm::vec3 down(0.8f, 0.0f, -0.6f);  // meets the bonnet after 1 m / 0.6
    const VehicleBody drop{{{{{1, 0, 0, 0}, {2.0, 0.0, -1.5}}, {4.0, 2.0, 1.0}}}, false};
    VehicleBody keep = drop;
    keep.keeps_points = true;
    for (const VehicleBody& body : {drop, keep}) {
        RenderedScan scan = make_scan(down);
        block_rays(scan, body, {0.5, 80.0});
        scan.median_range_m[0] += 0.03f;  // noise
        block_rays(scan, body, {0.5, 80.0});
        for (const std::size_t hit : {0, 3}) {
            EXPECT_NEAR(scan.median_range_m[hit], 1.0 / 0.6, 1e-6);
            EXPECT_EQ(scan.image.range_m[hit], scan.median_range_m[hit]);
            EXPECT_EQ(scan.image.drop_prob[hit], body.keeps_points ? 0.0f : 1.0f);
            EXPECT_EQ(scan.instance[hit], kOwnVehicleInstance);
            EXPECT_EQ((*find_values<std::int32_t>(scan.channels, "class"))[hit], int(SurfaceClass::ego));
            EXPECT_NEAR((*find_values<float>(scan.channels, "incidence"))[hit], 0.6f, 1e-6f);
        }
        const RenderedScan before = make_scan(down);
        for (const std::size_t other : {1, 2}) {
            EXPECT_EQ(scan.median_range_m[other], before.median_range_m[other]);
            EXPECT_EQ(scan.image.drop_prob[other], before.image.drop_prob[other]);
            EXPECT_EQ(scan.instance[other], 0);
        }
    }
    RenderedScan near = make_scan(down);
    block_rays(near, keep, {2.0, 80.0});
    EXPECT_EQ(near.image.drop_prob[0], 1.0f) << "nearer than the sensor can measure";
}

TEST(OwnVehicle, BlocksWhatTheLogsLidarSawOfIt) {
    const glm::vec3 down(0.8f, 0.0f, -0.6f), left(0.0f, 0.8f, -0.6f);
    VehicleBody body;
    body.seen = {std::vector<float>(BodyTable::kCells), std::vector<float>(BodyTable::kCells)};
    // The other sensor is turned to the left, so its ray ahead is the log's ray to the
    // left.
    body.seen_from_sensor = make_rotation(0.5 * kPi, 0.0, 0.0);
    body.seen.range_m[BodyTable::cell_of(left)] = 1.2f;
    for (const float intensity : {0.3f, BodyTable::kNoReturn}) {
        body.seen.intensity[BodyTable::cell_of(left)] = intensity;
        const bool is_returned = intensity > 0.0f;
        RenderedScan scan = make_scan(down);
        block_rays(scan, body, {0.5, 80.0});
        for (const std::size_t hit : {0, 3}) {
            EXPECT_EQ(scan.median_range_m[hit], 1.2f);
            EXPECT_EQ(scan.image.intensity[hit], is_returned ? 0.3f : 0.0f);
            EXPECT_EQ(scan.image.drop_prob[hit], is_returned ? 0.0f : 1.0f);
            EXPECT_EQ(scan.instance[hit], kOwnVehicleInstance);
        }
        EXPECT_EQ(scan.median_range_m[1], 30.0f) << "another direction";
        EXPECT_EQ(scan.median_range_m[2], 0.8f) << "an object in front of the body";
    }
}

TEST(OwnVehicle, OfTheLogIsWhereItsLidarHasNoReturns) {
    relidar::Run run;
    run.log.lidars[0].sensor.beams = {{.elevation_rad = 0.0}, {.elevation_rad = -0.06}};
    EXPECT_TRUE(find_log_body(run, 0, {}).empty());
    // All rays of the upper beam behind the sensor are dropped, within 45 degrees.
    run.scene.sensor_drop = {2, 8, std::vector<float>(16, 0.4f)};
    EXPECT_TRUE(find_log_body(run, 0, {}).empty());
    run.scene.sensor_drop.probability[0] = run.scene.sensor_drop.probability[7] = 1.0f;
    const VehicleBody body = find_log_body(run, 0, {});
    const auto is_blocked = [&](double azimuth_rad, double elevation_rad) {
        const glm::dvec3 direction = make_rotation(azimuth_rad, -elevation_rad, 0.0) * glm::dvec3(1, 0, 0);
        return body.seen.range_m[BodyTable::cell_of(glm::vec3(direction))] > 0.0f;
    };
    EXPECT_TRUE(is_blocked(2.6, 0.01));
    EXPECT_TRUE(is_blocked(-2.6, -0.02)) << "nearer to the upper beam";
    EXPECT_FALSE(is_blocked(2.6, -0.04)) << "nearer to the lower beam";
    EXPECT_FALSE(is_blocked(2.6, 0.1)) << "above all beams";
    EXPECT_FALSE(is_blocked(2.2, 0.01)) << "beside the sector";
}

}  // namespace

}  // namespace relidar
