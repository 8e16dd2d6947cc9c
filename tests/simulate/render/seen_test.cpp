// SPDX-License-Identifier: Apache-2.0
// Tests the share of a scan's rays that cross space which the log has not observed. Scans
// a street from its road, from the side, from below and from far away.

#include <relidar/read/dataset.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/simulate/render.hpp>

#include "../../support/device.hpp"

namespace relidar {
namespace {

class Seen : public test::DeviceTest {
protected:
    void SetUp() override {
        test::DeviceTest::SetUp();
        StreetOptions options;
        options.n_frames = 12;
        log = make_street_log(options);
        split = split_frames(log, 5);
        scene = init_scene(log, split.train, {});
        config.render.channels = "seen";
    }
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

    Log log;
    Split split;
    Scene scene;
    Config config;
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
