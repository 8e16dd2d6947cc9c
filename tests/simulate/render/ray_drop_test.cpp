// SPDX-License-Identifier: Apache-2.0
// Tests that the drop of a ray depends neither on other rays nor on the yaw of the
// sensor. A ray that hits nothing must be dropped for any output of the network.
#include <numeric>
#include <random>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/simulate/place_points.hpp>

#include "../../support/drop_networks.hpp"
#include "../street_scene.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

class RayDrop : public test::StreetTest {
protected:
    // Small surfels, so that some rays miss all of them.
    RayDrop() : StreetTest({.n_frames = 6, .speed_mps = 5.0}, 0, {.max_scale_m = 0.5}) {}
    RenderedScan scan_of(const RayTable& rays, const RayDropNetwork& network) {
        return scan_of(rays, network, shift_track(log.lidar_track(0), log.world_offset_m));
    }
    RenderedScan scan_of(const RayTable& rays, const RayDropNetwork& network,
                         const PoseTrack& dataset_from_sensor) {
        SimulatedSensor sensor = choose_sensor("VLP-16:300x10", config, log);
        sensor.rays = rays;
        ScanRenderer renderer(device(), scene, config, log);
        renderer.use_network(network);
        return renderer.render(sensor, {log.frames[3].time_s, dataset_from_sensor, ActorTracksByName{}});
    }
    RayTable rays() const { return choose_sensor("VLP-16:300x10", config, log).rays; }
};

std::size_t count_returns(const std::vector<float>& drop_prob) {
    return std::size_t(std::ranges::count_if(drop_prob, [](float p) { return p < 0.5f; }));
}

void expect_same_rays(const RenderedScan& scan, const RenderedScan& other,
                      const std::vector<std::size_t>& order) {
    ASSERT_EQ(other.image.drop_prob.size(), order.size());
    std::size_t n_ranges = 0, n_drops = 0;
    for (std::size_t k = 0; k < order.size(); ++k) {
        n_ranges += other.median_range_m[k] != scan.median_range_m[order[k]];
        n_drops += other.image.drop_prob[k] != scan.image.drop_prob[order[k]];
    }
    EXPECT_EQ(n_ranges, 0u) << "of " << order.size();
    EXPECT_EQ(n_drops, 0u) << "of " << order.size();
}

TEST_F(RayDrop, DoesNotDependOnTheOrderOfTheRays) {
    const RayTable all = rays();
    const RenderedScan scan = scan_of(all, test::make_network_of_rays());
    const std::size_t n_plain = count_returns(scan_of(all, {}).image.drop_prob),
                      n = count_returns(scan.image.drop_prob);
    EXPECT_GT(std::max(n, n_plain) - std::min(n, n_plain), all.size() / 50);
    std::vector<std::size_t> order(all.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    std::shuffle(order.begin(), order.end(), std::mt19937_64(4));
    RayTable shuffled = select_rays(all, order);
    shuffled.rows = all.rows;
    shuffled.columns = all.columns;
    expect_same_rays(scan, scan_of(shuffled, test::make_network_of_rays()), order);
    shuffled.rows = 1;
    shuffled.columns = int(all.size());  // a list without image order
    expect_same_rays(scan, scan_of(shuffled, test::make_network_of_rays()), order);
}

TEST_F(RayDrop, OfOneRayAloneIsThatOfTheRayInAnImage) {
    const RayTable all = rays();
    const RenderedScan scan = scan_of(all, test::make_network_of_rays());
    for (std::size_t ray = 77; ray < all.size(); ray += all.size() / 9)
        expect_same_rays(scan, scan_of(select_rays(all, {ray}), test::make_network_of_rays()), {ray});
}

/// A static sensor turned by 180 degrees has the same rays in another order.
TEST_F(RayDrop, DoesNotDependOnTheSensorsYaw) {
    RayTable all = rays();
    std::fill(all.time_offset_s.begin(), all.time_offset_s.end(), 0.0f);
    const glm::dvec3 position_m =
        log.lidar_track(0).pose_at(log.frames[3].time_s).translation + log.world_offset_m;
    std::vector<std::size_t> order;
    for (std::size_t row = 0; row < std::size_t(all.rows); ++row)
        for (std::size_t c = 0; c < std::size_t(all.columns); ++c)
            order.push_back(row * std::size_t(all.columns) +
                            (c + std::size_t(all.columns / 2)) % std::size_t(all.columns));
    RayTable turned = select_rays(all, order);
    turned.rows = all.rows;
    turned.columns = all.columns;
    for (glm::vec3& d : turned.direction) d = {-d.x, -d.y, d.z};
    for (glm::vec3& o : turned.origin) o = {-o.x, -o.y, o.z};
    const auto standing = [&](const glm::dquat& rotation) {
        return PoseTrack{{log.frames[3].time_s}, {{rotation, position_m}}};
    };
    const RenderedScan scan = scan_of(all, test::make_network_of_rays(), standing({1.0, 0.0, 0.0, 0.0}));
    EXPECT_GT(count_returns(scan.image.drop_prob), 100u);
    expect_same_rays(scan, scan_of(turned, test::make_network_of_rays(), standing({0.0, 0.0, 0.0, 1.0})),
                     order);
}

/// Beams, sub-rays, cells of a grid, a sensor that points into the sky, and points from
/// the device.
TEST_F(RayDrop, OfRaysThatMeetNothingIsCertain) {
    for (const char* name : {"native", "kitti360", "VLP-16:300x10"})
        for (const int sub_rays : {1, 5})
            for (const char* range : {"median", "expected"}) {
                Config of_scan = config;
                of_scan.sensor.sub_rays = sub_rays;
                of_scan.sensor.divergence_mrad = 3.0;
                of_scan.render.range = range;
                ScanRenderer renderer(device(), scene, of_scan, log);
                renderer.use_network(test::make_network_that_never_drops());
                const ScanRequest request{log.frames[3].time_s,
                                          shift_track(log.lidar_track(0), log.world_offset_m)};
                SimulatedSensor sensor = choose_sensor(name, of_scan, log);
                sensor.limits.min_m = 0.0;
                const RenderedScan scan = renderer.render(sensor, request);
                std::size_t n_returns = 0, n_empty = 0;
                for (std::size_t i = 0; i < scan.instance.size(); ++i) {
                    const bool returns = scan.image.drop_prob[i] < 0.5f;
                    n_returns += returns;
                    n_empty += scan.instance[i] < 0;
                    EXPECT_FALSE(returns && (scan.instance[i] < 0 || !(scan.median_range_m[i] > 0.0f) ||
                                             !(scan.image.range_m[i] > 0.0f)))
                        << name << ", " << sub_rays << " parts, " << range << ", ray " << i << ": "
                        << scan.instance[i] << " " << scan.median_range_m[i] << " " << scan.image.range_m[i]
                        << " " << scan.weight[i];
                }
                EXPECT_GT(n_returns, 100u) << name;
                EXPECT_GT(n_empty, 100u) << name;
                EXPECT_EQ(place_points(scan, of_scan, {}).size(), n_returns)
                    << name << ", README's recipe and points";
                renderer.submit_points(sensor, request, request.time_s);
                EXPECT_EQ(renderer.wait_for_points().points.size(), n_returns)
                    << name << ", points of the device";
            }
}

TEST_F(RayDrop, WeatherReturnsWhereSurfacesDoNot) {
    ScanRenderer renderer(device(), scene, config, log);
    renderer.use_network(test::make_network_that_never_drops());
    renderer.set_weather({.fog_visibility_m = 20.0});
    const RenderedScan scan =
        renderer.render(choose_sensor("VLP-16:300x10", config, log), log.frames[3].time_s);
    const std::vector<std::int32_t>& source = *find_values<std::int32_t>(scan.channels, "source");
    std::size_t n_fog = 0;
    for (std::size_t i = 0; i < source.size(); ++i) {
        EXPECT_EQ(scan.image.drop_prob[i] < 0.5f, source[i] >= 0) << i;
        EXPECT_TRUE(source[i] < 0 || scan.median_range_m[i] > 0.0f) << i;
        n_fog += source[i] == int(ReturnCause::fog);
    }
    EXPECT_GT(n_fog, 10u);
}

TEST_F(RayDrop, ANetworkOfOtherInputsIsRefused) {
    RayDropNetwork network = test::make_network_of_rays();
    network.inputs.back() = "direction_x";
    ScanRenderer renderer(device(), scene, config, log);
    EXPECT_THAT([&] { renderer.use_network(network); },
                testing::ThrowsMessage<DataError>(test::Names("\"direction_x\" ... refine")));
}

}  // namespace
}  // namespace relidar
