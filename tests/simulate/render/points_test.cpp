// SPDX-License-Identifier: Apache-2.0
// Tests points that are computed on the device and requested ahead
// (simulate/render/mark_returns, simulate/render/gather_points). They must equal, bit by
// bit, the result of place_points() for scans that are rendered in sequence.
// Also compares place_points() with double precision.

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/simulate/device_points.hpp>
#include <relidar/simulate/place_points.hpp>

#include "../plates.hpp"
#include "../street_scene.hpp"
#include "base/random.hpp"
#include "gpu/context.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

struct PointRequest {
    SimulatedSensor sensor;
    ScanRequest request;
    double points_at_s;
    std::optional<std::uint64_t> sample = {};
};

class PointsOfScans : public test::StreetTest {
protected:
    PointsOfScans() : StreetTest({.n_frames = 12}, 5) { log.world_offset_m = {455000.0, 5428000.0, 113.0}; }
    PoseTrack bend() const {
        PoseTrack track = shift_track(log.lidar_track(0), log.world_offset_m);
        for (std::size_t k = 0; k < track.pose.size(); ++k)
            track.pose[k].rotation =
                make_rotation(0.4 * double(k), 0.01 * double(k), -0.02 * std::sin(double(k)));
        return track;
    }
    double middle_s() const { return log.frames[log.frames.size() / 2].time_s; }
    SimulatedSensor sensor(const std::string& name) const { return choose_sensor(name, config, log); }
    void make_renderer() {
        renderer.emplace(device(), scene, config, log);
        renderer->use_observed(
            observe_coverage(log, log.world_from_vehicle, {0, 2, 4}, config.dataset.max_range_m));
    }
    void TearDown() override {
        renderer.reset();
        DeviceTest::TearDown();
    }
    RenderedPoints on_host(const PointRequest& request) {
        const RenderedScan scan = renderer->render(request.sensor, request.request, request.sample);
        return {place_points(scan, config, request.request.dataset_from_sensor.pose_at(request.points_at_s)),
                scan.image.range_m.size(), scan.unseen_share};
    }
    void ask(const PointRequest& request,
             ScanRenderer::SubmissionTiming mode = ScanRenderer::SubmissionTiming::now) {
        renderer->submit_points(request.sensor, request.request, request.points_at_s, request.sample, mode);
    }
    RenderedPoints alone(const PointRequest& request) {
        ask(request);
        return renderer->wait_for_points();
    }
    void ask_together(const std::vector<PointRequest>& requests) {
        for (const PointRequest& wish : requests)
            ask(wish, &wish == &requests.back() ? ScanRenderer::SubmissionTiming::now
                                                : ScanRenderer::SubmissionTiming::with_next);
    }
    /// Several sensors, some of them equal, at two times and with two sets of actors.
    std::vector<PointRequest> rig() const {
        std::vector<PointRequest> wishes;
        for (const char* name :
             {"VLP-16:300x10", "HDL-32E:256x10", "VLP-16:300x10", "VLP-16:300x10", "HDL-32E:256x10"}) {
            const double k = double(wishes.size());
            PoseTrack track = bend();
            for (Pose& pose : track.pose)
                pose = pose * Pose{make_rotation(0.9 * k, 0.0, 0.0), {0.3 * k, -0.2 * k, 0.1}};
            wishes.push_back({sensor(name), {middle_s() + 0.1 * std::floor(k / 3.0), track}, middle_s()});
            if (k == 2.0) wishes.back().request.dataset_from_actor = ActorTracksByName{};
        }
        return wishes;
    }

    void train_network(const RayDropImage& image, const RayDropNetworkOptions& options) {
        renderer->use_network(train_drop_network(
            device(), {image}, options, 3,
            [](const RayDropTrainProgress&, const std::function<RayDropTrainState()>&) { return true; }));
    }

    std::optional<ScanRenderer> renderer;
};

void expect_equal(const RenderedPoints& actual, const RenderedPoints& expected, const std::string& text) {
    const LidarPoints &p = actual.points, &e = expected.points;
    ASSERT_EQ(p.size(), e.size()) << text;
    ASSERT_GT(p.size(), 100u) << text;
    EXPECT_EQ(actual.n_rays, expected.n_rays) << text;
    EXPECT_EQ(actual.unseen_share, expected.unseen_share) << text;
    EXPECT_EQ(p.time_s, e.time_s) << text;
    EXPECT_EQ(p.world_from_points.translation, e.world_from_points.translation) << text;
    EXPECT_EQ(std::memcmp(p.position_m.data(), e.position_m.data(), p.size() * sizeof(glm::vec3)), 0) << text;
    EXPECT_EQ(p.intensity, e.intensity) << text;
    EXPECT_EQ(p.ring, e.ring) << text;
    EXPECT_EQ(p.time_offset_s, e.time_offset_s) << text;
    EXPECT_EQ(p.instance, e.instance) << text;
    EXPECT_EQ(p.return_number, e.return_number) << text;
}

/// Columns share a firing time, rows have different times, or rays have any order.
TEST(FiringPoses, AreThoseOfEachRay) {
    RenderedScan scan;
    scan.time_s = 5.0;
    scan.world_from_sensor = {make_rotation(0.3, 0.0, 0.1), {4.0, 5.0, 6.0}};
    PoseTrack bend;
    for (int k = 0; k < 8; ++k) {
        bend.time_s.push_back(4.9 + 0.05 * k);
        bend.pose.push_back({make_rotation(0.1 * k, 0.02, 0.0), {2.0 * k, 0.1 * k, 0.0}});
    }
    const Pose target{make_rotation(-0.5, 0.2, 0.0), {1.0, -2.0, 0.5}};
    for (const PoseTrack& track : {bend, PoseTrack{{5.0}, {bend.pose[3]}}, PoseTrack{}})
        for (const float late_s : {0.0f, 1e-3f}) {  // delay of each row relative to the row above
            scan.track = track;
            scan.image.rows = 4;
            scan.image.columns = 16;
            scan.time_offset_s.clear();
            for (int i = 0; i < 64; ++i)
                scan.time_offset_s.push_back(0.005f * float(i % 16) + late_s * float(i / 16));
            FiringPoseInterpolator poses(scan, target);
            for (std::size_t k = 0; k < 128; ++k) {
                const std::size_t ray = k < 64 ? k : k * 37 % 64;
                const Pose expected = target * scan.firing_pose(ray), actual = poses.pose_of(ray);
                EXPECT_EQ(actual.translation, expected.translation) << ray;
                EXPECT_EQ(actual.rotation, expected.rotation) << ray;
            }
        }
}

/// At 80 m, floats have errors of 4e-6 m, and about seven roundings happen. At 5428 km,
/// floats have errors of 0.25 m.
TEST(PlacePoints, LieWhereDoublePrecisionPutsThem) {
    RenderedScan scan;
    scan.time_s = 5.0;
    for (int k = 0; k < 5; ++k) {
        scan.track.time_s.push_back(4.92 + 0.05 * k);
        scan.track.pose.push_back(
            {make_rotation(0.3 * k, 0.05, 0.1 * k), {455000.0 + k, 5428000.0 - k, 113.0}});
    }
    scan.world_from_sensor = scan.track.pose_at(scan.time_s);
    Random random(7);
    const std::size_t n = 4000;
    for (std::size_t i = 0; i < n; ++i) {
        const glm::vec3 random_vector(random.sample_uniform() - 0.5, random.sample_uniform() - 0.5,
                                      random.sample_uniform() - 0.5);
        scan.image.direction.push_back(glm::normalize(random_vector));
        scan.image.origin.emplace_back(0.1f, 0.0f, -0.2f);
        scan.image.range_m.push_back(float(1.0 + 79.0 * random.sample_uniform()));
        scan.time_offset_s.push_back(float(0.14 * random.sample_uniform() - 0.07));
    }
    scan = test::complete(std::move(scan));
    for (const auto& [frame, tolerance_m] : {std::pair(scan.world_from_sensor, 3e-5), {Pose{}, 0.26}}) {
        const LidarPoints points = place_points(scan, Config{}, frame);
        ASSERT_EQ(points.size(), n);
        double farthest_m = 0.0;
        for (std::size_t i = 0; i < n; ++i) {
            const glm::dvec3 end = glm::dvec3(scan.image.origin[i]) +
                                   double(scan.image.range_m[i]) * glm::dvec3(scan.image.direction[i]);
            const glm::dvec3 expected = inverse(frame) * (scan.firing_pose(i) * end);
            for (int axis = 0; axis < 3; ++axis)
                farthest_m =
                    std::max(farthest_m, std::abs(double(points.position_m[i][axis]) - expected[axis]));
        }
        EXPECT_LT(farthest_m, tolerance_m);
    }
    const LidarPoints unmoved = place_points(scan, Config{}, std::nullopt);
    for (std::size_t i = 0; i < n; ++i)
        EXPECT_EQ(unmoved.position_m[i],
                  scan.image.origin[i] + scan.image.range_m[i] * scan.image.direction[i]);
}

TEST_F(PointsOfScans, AreThoseOfTheScan) {
    for (const std::string points : {"median", "image"}) {
        config.render.points = points;
        make_renderer();
        for (const double at_s : {middle_s(), middle_s() + 0.05, middle_s() - 0.4}) {
            const PointRequest wish{sensor("native"), {middle_s(), bend()}, at_s};
            const RenderedPoints expected = on_host(wish);
            EXPECT_LT(expected.points.size(), expected.n_rays) << "some rays are dropped";
            expect_equal(alone(wish), expected, points);
        }
    }
}

TEST_F(PointsOfScans, OfASensorThatStandsAndAmongActorsOfTheCaller) {
    make_renderer();
    const PointRequest stands{sensor("native"), {middle_s(), {{0.0}, {bend().pose_at(middle_s())}}}, 0.0};
    const PointRequest alone{sensor("native"), {middle_s(), bend(), ActorTracksByName{}}, middle_s()};
    const RenderedPoints standing = on_host(stands), empty = on_host(alone);
    ask(stands);
    ask(alone);
    expect_equal(renderer->wait_for_points(), standing, "stands");
    expect_equal(renderer->wait_for_points(), empty, "no actor");
}

/// Two scans of different sensors are always pending, with other scans between them.
TEST_F(PointsOfScans, ManyInFlightDoNotMix) {
    make_renderer();
    const std::vector<SimulatedSensor> sensors = {sensor("native"), sensor("VLP-16:300x10"),
                                                  sensor("HDL-32E:256x10")};
    std::vector<PointRequest> wishes;
    for (int k = 0; k < 9; ++k)
        wishes.push_back({sensors[std::size_t(k % 3)], {middle_s() - 0.4 + 0.1 * k, bend()}, middle_s()});
    std::vector<RenderedPoints> expected;
    for (const PointRequest& wish : wishes) expected.push_back(on_host(wish));
    ask(wishes[0]);
    for (std::size_t k = 0; k < wishes.size(); ++k) {
        if (k + 1 < wishes.size()) ask(wishes[k + 1]);
        if (k % 4 == 1) renderer->render(sensors[0], {middle_s(), bend(), ActorTracksByName{}});
        expect_equal(renderer->wait_for_points(), expected[k], "scan " + std::to_string(k));
    }
}

/// The host computes the points of scans with a random sample.
TEST_F(PointsOfScans, OnTheDeviceAreThoseOnTheHost) {
    make_renderer();
    using enum ScanRenderer::SubmissionTiming;
    using enum ScanRenderer::PointMemory;
    std::vector<PointRequest> wishes = rig();
    wishes[3].sample = 7;
    const auto submit = [&](const PointRequest& wish, ScanRenderer::PointMemory memory) {
        renderer->submit_points(wish.sensor, wish.request, wish.points_at_s, wish.sample, now, memory);
    };
    std::vector<RenderedPoints> expected;
    for (const PointRequest& wish : wishes) expected.push_back(alone(wish));
    for (const PointRequest& wish : wishes) submit(wish, device);
    std::vector<DevicePoints> actual;
    for (std::size_t k = 0; k < wishes.size(); ++k) actual.push_back(renderer->wait_for_device_points());
    for (std::size_t k = 0; k < wishes.size(); ++k) {
        const LidarPoints& e = expected[k].points;
        EXPECT_EQ(actual[k].n_rays, expected[k].n_rays);
        EXPECT_EQ(actual[k].dataset_from_points.translation, e.world_from_points.translation);
        ASSERT_EQ(actual[k].n_points, e.size());
        const std::vector<shared::ReturnedPoint> points = actual[k].points.download(actual[k].n_points);
        for (std::size_t i = 0; i < points.size(); ++i) {
            ASSERT_EQ(points[i].position, e.position_m[i]) << k << " " << i;
            ASSERT_EQ(points[i].intensity, e.intensity[i]) << k << " " << i;
            ASSERT_EQ(points[i].time_offset_s, e.time_offset_s[i]);
            ASSERT_EQ(points[i].ring, e.ring[i]);
            ASSERT_EQ(std::int32_t(points[i].instance), e.instance[i]);
        }
    }
    submit(wishes[0], device);
    EXPECT_THROW(renderer->wait_for_points(), UsageError);
    renderer->set_parallel(1);  // waits for pending scans, which stay on the device
    EXPECT_EQ(renderer->wait_for_device_points().n_points, expected[0].points.size());
    submit(wishes[0], host);
    EXPECT_THROW(renderer->wait_for_device_points(), UsageError);
    expect_equal(renderer->wait_for_points(), expected[0], "host");
}

/// More scans than fit into a batch, exactly as many, and fewer. A further batch is read
/// before it was submitted. Launches alternate, to detect shared arrays.
TEST_F(PointsOfScans, OfScansSideBySideAreThoseOfEachAlone) {
    for (const ShDirection direction : {ShDirection::surfel, ShDirection::ray}) {
        config.image.sh_direction = direction;
        make_renderer();
        const std::vector<PointRequest> wishes = rig();
        std::vector<RenderedPoints> expected;
        for (const PointRequest& wish : wishes) expected.push_back(alone(wish));
        expect_equal(expected[2], on_host(wishes[2]), "without actors");
        for (const int n : {2, 3, 5, 1}) {
            const std::string what = std::to_string(n) + " side by side, scan ";
            renderer->set_parallel(n);
            EXPECT_EQ(renderer->max_parallel(), n);
            ask_together(wishes);
            ask_together(wishes);
            ask(wishes[0], ScanRenderer::SubmissionTiming::with_next);
            ask(wishes[1], ScanRenderer::SubmissionTiming::with_next);
            for (std::size_t k = 0; k < 2 * wishes.size() + 2; ++k)
                expect_equal(renderer->wait_for_points(), expected[k % wishes.size()],
                             what + std::to_string(k));
        }
    }
}

TEST_F(PointsOfScans, OfScansSideBySideBesideOthers) {
    make_renderer();
    renderer->set_parallel(3);
    const std::vector<PointRequest> wishes = rig();
    PointRequest wrong = wishes[0], sampled = wishes[1];
    wrong.request.dataset_from_sensor.time_s.clear();
    sampled.sample = 7;
    const std::vector<RenderedPoints> expected = {alone(wishes[0]), alone(sampled), alone(wishes[2]),
                                                  alone(wishes[3])};
    const RenderedScan scan = renderer->render(wishes[4].sensor, wishes[4].request);
    ask(wishes[0], ScanRenderer::SubmissionTiming::with_next);
    ask(sampled, ScanRenderer::SubmissionTiming::with_next);
    ask(wishes[2], ScanRenderer::SubmissionTiming::with_next);
    EXPECT_THROW(ask(wrong, ScanRenderer::SubmissionTiming::with_next), DataError);
    EXPECT_EQ(renderer->render(wishes[4].sensor, wishes[4].request).image.range_m, scan.image.range_m);
    ask(wishes[3], ScanRenderer::SubmissionTiming::with_next);
    EXPECT_THROW(ask(wrong), DataError);
    for (const RenderedPoints& of_one : expected)
        expect_equal(renderer->wait_for_points(), of_one, "one of four");
    EXPECT_THAT([&] { renderer->set_parallel(0); },
                testing::ThrowsMessage<UsageError>(test::Names("0 scans")));
    ask(wishes[0], ScanRenderer::SubmissionTiming::with_next);
    ask(wishes[1], ScanRenderer::SubmissionTiming::with_next);
    make_renderer();  // the two scans are never submitted
    expect_equal(alone(wishes[0]), expected[0], "of the next renderer");
}

TEST_F(PointsOfScans, AreDroppedAsTheNetworkSays) {
    make_renderer();
    const std::vector<PointRequest> wishes = {
        {sensor("native"), {middle_s(), bend()}, middle_s()},
        {sensor("VLP-16:300x10"), {middle_s() + 0.1, bend()}, middle_s()}};
    const RenderedScan scan = renderer->render(wishes[0].sensor, wishes[0].request);
    const RayDropNetworkOptions options{.network = "pixel", .epochs = 60, .rate = 1e-2};
    RayDropImage image = make_drop_image(scan, channel_names(options), first_position(log));
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i)
        image.dropped.push_back(scan.median_range_m[i] > 12.0f ? 1.0f : 0.0f);
    const std::size_t before = on_host(wishes[0]).points.size();
    train_network(image, options);
    const std::vector<RenderedPoints> expected = {on_host(wishes[0]), on_host(wishes[1])};
    EXPECT_NE(expected[0].points.size(), before) << "a network that says something";
    ask(wishes[0]);
    ask(wishes[1]);
    for (const RenderedPoints& scan_expected : expected)
        expect_equal(renderer->wait_for_points(), scan_expected, "refined");
    std::vector<PointRequest> beside = {wishes[0], wishes[0], wishes[0], wishes[1]};
    for (std::size_t k = 0; k < 3; ++k) beside[k].request.time_s += 0.1 * double(k);
    std::vector<RenderedPoints> expected_each;
    for (const PointRequest& wish : beside) expected_each.push_back(alone(wish));
    renderer->set_parallel(3);
    for (int round = 0; round < 2; ++round) {
        ask_together(beside);
        for (const RenderedPoints& scan_expected : expected_each)
            expect_equal(renderer->wait_for_points(), scan_expected, "refined side by side");
    }
    renderer->set_parallel(1);
    std::vector<std::uint64_t> buffers;
    for (int round = 0; round < 3; ++round) {
        expect_equal(alone(beside[2]), expected_each[2], "by turns");
        expect_equal(alone(beside[3]), expected_each[3], "by turns");
        buffers.push_back(device().impl().n_buffers);
    }
    EXPECT_EQ(buffers[2], buffers[0]) << "memory is found once";
}

TEST_F(PointsOfScans, NetworksBringNothingBackFromBeyondTheLimits) {
    config.sensor.divergence_mrad = 3.0;
    make_renderer();
    PointRequest wish{sensor("native"), {middle_s(), bend()}, middle_s()};
    const RayDropNetworkOptions options{.network = "pixel", .epochs = 60, .rate = 2e-2};
    RayDropImage image = make_drop_image(renderer->render(wish.sensor, wish.request), channel_names(options),
                                         first_position(log));
    image.dropped.assign(std::size_t(image.rows) * std::size_t(image.columns), 0.0f);
    image.dropped[0] = 1.0f;  // without a dropped ray, the loss of the network would have no gradient
    train_network(image, options);
    wish.sensor.limits = {2.0, 12.0};
    const auto farthest = [](const RenderedScan& scan) {
        float most_m = 0.0f;
        for (std::size_t i = 0; i < scan.image.range_m.size(); ++i)
            if (scan.image.drop_prob[i] < kDropThreshold) most_m = std::max(most_m, scan.image.range_m[i]);
        return most_m;
    };
    const RenderedScan of_beams = renderer->render(wish.sensor, wish.request);
    EXPECT_LE(farthest(of_beams), 12.0f);
    EXPECT_GT(farthest(of_beams), 11.0f);
    expect_equal(alone(wish), on_host(wish), "limits");
    SimulatedSensor parted = wish.sensor;
    parted.returns = 2;
    const RenderedScan of_parts = renderer->render(parted, wish.request);
    EXPECT_LE(farthest(of_parts), 12.0f);
    EXPECT_GT(farthest(of_parts), 11.0f);
}

TEST_F(PointsOfScans, HaveTheStepsOfTheLog) {
    make_renderer();
    const PointRequest wish{sensor("native"), {middle_s(), bend()}, middle_s()};
    const double step = 1.0 / 64.0;
    IntensityScatterModel scatter;
    scatter.step = step;
    renderer->use_scatter({scatter});
    const RenderedPoints actual = alone(wish);
    expect_equal(actual, on_host(wish), "steps");
    for (const float intensity : actual.points.intensity)
        EXPECT_NEAR(double(intensity) / step, std::round(double(intensity) / step), 1e-5);
}

/// The host must complete them with the same result.
TEST_F(PointsOfScans, OfGridsSubRaysSamplesAndWeatherAreTheSame) {
    config.sensor.divergence_mrad = 3.0;
    make_renderer();
    SimulatedSensor parted = sensor("VLP-16:300x10");
    parted.returns = 2;
    std::vector<PointRequest> wishes = {{sensor("kitti360"), {middle_s(), bend()}, middle_s()},
                                        {parted, {middle_s(), bend()}, middle_s()},
                                        {sensor("native"), {middle_s(), bend()}, middle_s(), 7}};
    for (const PointRequest& wish : wishes) {
        const RenderedPoints expected = on_host(wish);
        expect_equal(alone(wish), expected, wish.sensor.name);
    }
    renderer->set_weather({.fog_visibility_m = 60.0});
    const PointRequest fog{sensor("native"), {middle_s(), bend()}, middle_s()};
    expect_equal(alone(fog), on_host(fog), "fog");
}

TEST_F(PointsOfScans, AreTakenAsOftenAsAskedFor) {
    make_renderer();
    const PointRequest wish{sensor("VLP-16:300x10"), {middle_s(), bend()}, middle_s()};
    const auto says = [](const char* text) { return testing::ThrowsMessage<UsageError>(test::Names(text)); };
    EXPECT_THAT([&] { renderer->wait_for_points(); }, says("requested"));
    for (std::size_t k = 0; k < ScanRenderer::kScansInFlight; ++k) ask(wish);
    EXPECT_THAT([&] { ask(wish); }, says("64 requested"));
    for (std::size_t k = 0; k < ScanRenderer::kScansInFlight; ++k) renderer->wait_for_points();
    PointRequest wrong = wish;
    wrong.request.dataset_from_sensor.time_s.clear();
    EXPECT_THROW(ask(wrong), DataError);
    EXPECT_THAT([&] { renderer->wait_for_points(); }, says("requested")) << "a request that was refused";
}

}  // namespace
}  // namespace relidar
