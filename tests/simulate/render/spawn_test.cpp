// SPDX-License-Identifier: Apache-2.0
// Tests actors that are added to a renderer. Scans must equal, bit by bit, those of a
// renderer whose scene had the actors from the start.
#include <chrono>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/place_points.hpp>

#include "../street_scene.hpp"
#include "gpu/forced.hpp"

namespace relidar {
namespace {

/// A run with a copy of the first actor of the street. Its brightness is different.
Run make_asset(const Scene& street, const std::string& name, float brightness) {
    Run asset;
    const std::uint32_t model = street.instances[1].model;
    append_model(asset.scene, street, model);
    for (std::size_t i = 0; i < asset.scene.surfels.size(); ++i)
        asset.scene.surfels.sh[i * kShFloats] += brightness;
    asset.scene.instances = {{0, name}};
    asset.log.boxes = {{name, "Van", {4.0, 2.0, 1.6}, {}}};
    return asset;
}

/// The same with a walking motion that repeats after 1.4 m.
Run make_walker(const Scene& street) {
    Run asset = make_asset(street, "walker", 0.1f);
    asset.scene.surfels.add_still_gait();
    for (std::size_t i = 0; i < asset.scene.surfels.size(); ++i)
        asset.scene.surfels.gait[i] = {float(i % 7) / 7.0f, 0.5f, {0.1f, 0.05f, 0.0f}};
    asset.scene.models[0].stride_m = 1.4f;
    return asset;
}

class SpawnedActors : public test::StreetTest {
protected:
    using Placed = std::vector<std::pair<std::string, glm::dvec3>>;

    SpawnedActors() : StreetTest({.n_frames = 12}, 5) { log.world_offset_m = {455000.0, 5428000.0, 113.0}; }
    Scene scene_with(const std::vector<std::pair<const relidar::Run*, std::string>>& assets) const {
        Scene all = scene;
        std::map<const relidar::Run*, std::uint32_t> models;
        for (const auto& [asset, name] : assets) {
            if (!models.contains(asset)) models[asset] = append_model(all, asset->scene, 0);
            all.instances.push_back({models[asset], name});
        }
        return all;
    }
    /// Actors drive 3 m in a second.
    ScanRequest request_of(const Placed& actors, double after_s = 0.0) const {
        ScanRequest request{log.frames[5].time_s, shift_track(log.lidar_track(0), log.world_offset_m),
                            ActorTracksByName{}};
        const Pose sensor_pose = request.dataset_from_sensor.pose_at(request.time_s);
        for (const auto& [name, place_m] : actors) {
            const Pose begin = sensor_pose * Pose{make_rotation(0.4, 0.0, 0.0), place_m},
                       end = sensor_pose * Pose{make_rotation(0.4, 0.0, 0.0), place_m + glm::dvec3(3, 0, 0)};
            (*request.dataset_from_actor)[name] = {
                {request.time_s - 0.5 - after_s, request.time_s + 0.5 - after_s}, {begin, end}};
        }
        return request;
    }
    static void expect_equal(const RenderedScan& actual, const RenderedScan& expected) {
        EXPECT_EQ(actual.image.range_m, expected.image.range_m);
        EXPECT_EQ(actual.median_range_m, expected.median_range_m);
        EXPECT_EQ(actual.image.intensity, expected.image.intensity);
        EXPECT_EQ(actual.image.drop_prob, expected.image.drop_prob);
        EXPECT_EQ(actual.weight, expected.weight);
        EXPECT_EQ(actual.instance, expected.instance);
    }
    std::size_t count_rays_on(const RenderedScan& scan, std::size_t instance) const {
        return std::size_t(std::ranges::count(scan.instance, std::int32_t(instance)));
    }

    const SimulatedSensor sensor = choose_sensor("VLP-16:300x10", config, log);
};

TEST_F(SpawnedActors, AreRenderedAsIfTheyHadBeenThereFromTheStart) {
    const relidar::Run van = make_asset(scene, "van", 0.5f);
    const std::string car = scene.instances[1].track;
    const Placed places{{"a", {6, 2, 0}}, {"b", {9, -3, 0}}, {"c", {-7, 1, 0}}, {car, {12, 0, 0}}};
    for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
        for (const bool is_rendered_before : {false, true}) {
            config.image.sh_direction = direction;
            ScanRenderer from_start(device(), scene_with({{&van, "a"}, {&van, "c"}}), config, log);
            ScanRenderer renderer(device(), scene, config, log);
            const RenderedScan empty = from_start.render(sensor, request_of({}));
            if (is_rendered_before) renderer.render(sensor, request_of({{car, {5, 0, 0}}}));
            const ActorHandle a = renderer.spawn(van, "a"), c = renderer.spawn("a", "c");
            EXPECT_EQ(std::size_t(a), scene.instances.size());
            EXPECT_EQ(renderer.find_actor("c"), c);
            for (const double after_s : {0.0, 0.3}) {
                Placed two{places[0], places[2], places[3]};
                const RenderedScan expected = from_start.render(sensor, request_of(two, after_s));
                const RenderedScan actual = renderer.render(sensor, request_of(two, after_s));
                expect_equal(actual, expected);
                EXPECT_GT(count_rays_on(actual, std::size_t(a)), 20u);
                EXPECT_GT(count_rays_on(actual, std::size_t(c)), 20u);
                ScanRequest by_handle = request_of({places[3]}, after_s);
                const ScanRequest by_name = request_of(two, after_s);
                for (const auto& [handle, name] : {std::pair(a, "a"), std::pair(c, "c")})
                    by_handle.placed.push_back({handle, by_name.dataset_from_actor->at(name)});
                expect_equal(renderer.render(sensor, by_handle), expected);
            }
            expect_equal(renderer.render(sensor, request_of({})), empty);

            // A copy of an actor of the log, and a slot that is used again.
            renderer.despawn("a");
            EXPECT_THROW(renderer.render(sensor, request_of({places[0]})), UsageError);
            const std::uint64_t before = device().allocated_bytes();
            EXPECT_EQ(renderer.spawn(van, "a"), a);
            EXPECT_EQ(device().allocated_bytes(), before);
            EXPECT_NE(renderer.spawn(car, "b"), a);
            Scene with_copy = scene_with({{&van, "a"}, {&van, "c"}});
            with_copy.instances.push_back({scene.instances[1].model, "b"});
            ScanRenderer with_all(device(), with_copy, config, log);
            expect_equal(renderer.render(sensor, request_of(places)),
                         with_all.render(sensor, request_of(places)));
        }
    }
}

TEST_F(SpawnedActors, ManyGrowTheSceneWithoutChangingTheOthers) {
    std::vector<relidar::Run> assets;
    for (int i = 0; i < 6; ++i) assets.push_back(make_asset(scene, "asset", 0.1f * float(i)));
    ScanRenderer renderer(device(), scene, config, log);
    std::vector<std::pair<const relidar::Run*, std::string>> spawned;
    Placed places;
    for (int i = 0; i < 30; ++i) {
        spawned.emplace_back(&assets[std::size_t(i % 6)], std::to_string(100 + i));
        renderer.spawn(*spawned.back().first, spawned.back().second);
        places.emplace_back(spawned.back().second,
                            glm::dvec3(12.0 * std::cos(i), 12.0 * std::sin(i), 0.1 * i - 1.0));
    }
    EXPECT_EQ(renderer.spawned().size(), 30u);
    ScanRenderer from_start(device(), scene_with(spawned), config, log);
    expect_equal(renderer.render(sensor, request_of(places)), from_start.render(sensor, request_of(places)));
}

TEST_F(SpawnedActors, WalkAsIfTheyHadBeenThereFromTheStart) {
    const relidar::Run walker = make_walker(scene), van = make_asset(scene, "van", 0.5f);
    const Placed places{{"a", {6, 2, 0}}, {"v", {9, -3, 0}}, {"b", {5, -2, 0}}};
    ScanRenderer from_start(device(), scene_with({{&walker, "a"}, {&van, "v"}, {&walker, "b"}}), config, log);
    ScanRenderer renderer(device(), scene, config, log);
    renderer.render(sensor, request_of({}));
    renderer.spawn(walker, "a");
    renderer.spawn(van, "v");
    renderer.spawn("a", "b");
    for (const double after_s : {0.0, 0.1, 0.25})
        expect_equal(renderer.render(sensor, request_of(places, after_s)),
                     from_start.render(sensor, request_of(places, after_s)));
}

TEST_F(SpawnedActors, AreInScansThatAreRenderedInParallel) {
    const ForcedBehaviourScope forced(device(), {.side_by_side = 3});
    const relidar::Run van = make_asset(scene, "van", 0.5f);
    ScanRenderer renderer(device(), scene, config, log);
    ScanRenderer from_start(device(), scene_with({{&van, "a"}}), config, log);
    const double time_s = log.frames[5].time_s;
    using enum ScanRenderer::SubmissionTiming;
    for (const Placed& places : {Placed{}, Placed{{"a", {6, 2, 0}}}}) {
        for (int i = 0; i < 4; ++i)
            renderer.submit_points(sensor, request_of(places, 0.1 * i), time_s, {}, i < 3 ? with_next : now);
        if (places.empty()) renderer.spawn(van, "a");  // waits for pending scans
        for (int i = 0; i < 4; ++i) {
            const ScanRequest request = request_of(places, 0.1 * i);
            const LidarPoints actual = renderer.wait_for_points().points,
                              expected = place_points(from_start.render(sensor, request), config,
                                                      request.dataset_from_sensor.pose_at(time_s));
            EXPECT_EQ(actual.instance, expected.instance) << i;
            EXPECT_EQ(actual.intensity, expected.intensity) << i;
        }
    }
}

TEST_F(SpawnedActors, WrongNamesChangeNothing) {
    relidar::Run van = make_asset(scene, "van", 0.5f);
    const std::string car = scene.instances[1].track;
    ScanRenderer renderer(device(), scene, config, log);
    renderer.spawn(van, "a");
    for (const std::string& name : {std::string("a"), car, std::string(), std::string("actors")})
        EXPECT_THROW(renderer.spawn(van, name), UsageError) << name;
    EXPECT_THROW(renderer.spawn("nobody", "b"), UsageError);
    for (const std::string& name : {car, std::string("b"), std::string()})
        EXPECT_THROW(renderer.despawn(name), UsageError) << name;
    convert_surfels(van.scene.surfels, PrimitiveType::gaussian, 0.1);
    EXPECT_THROW(renderer.spawn(van, "b"), DataError);
    ScanRequest request = request_of({});
    request.placed = {{ActorHandle(99), {{0.0}, {Pose{}}}}};
    EXPECT_THROW(renderer.render(sensor, request), UsageError);
    ASSERT_EQ(renderer.spawned().size(), 1u);
    EXPECT_EQ(renderer.spawned()[0].category, "Van");
}

/// In comparison with the build of the actor alone and the loading of the scene.
TEST_F(SpawnedActors, CostAboutTheirBuild) {
    const auto measure_ms = [](const auto& call) {
        const auto start = std::chrono::steady_clock::now();
        call();
        return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    };
    std::optional<ScanRenderer> renderer;
    const double load_ms = measure_ms([&] {
        renderer.emplace(device(), scene, config, log);
        renderer->render(sensor, request_of({}));
    });
    double build_ms = 1e9, spawn_ms = 1e9;
    for (int i = 0; i < 12; ++i) {
        const relidar::Run asset = make_asset(scene, "asset", 0.01f * float(i + 1));
        build_ms = std::min(build_ms, measure_ms([&] {
                                Renderer alone(device(), asset.scene, config.image);
                                alone.update({InstancePose{}}, glm::vec3(0.0f));
                                alone.stream().submit_and_wait();
                            }));
        spawn_ms = std::min(spawn_ms, measure_ms([&] { renderer->spawn(asset, std::to_string(100 + i)); }));
    }
    EXPECT_LT(spawn_ms, build_ms + load_ms);
}

}  // namespace
}  // namespace relidar
