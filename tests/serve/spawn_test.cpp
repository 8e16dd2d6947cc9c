// SPDX-License-Identifier: Apache-2.0
// Compares scans with actors of clients with the edits of the library.
#include <cmath>

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/simulate/render.hpp>

#include "asset_catalogue.hpp"
#include "refusal.hpp"
#include "scenes.hpp"
#include "small_service.hpp"
#include "support/names.hpp"

namespace relidar::serve {
namespace {

using test::Names;
using testing::ElementsAre;
using Code = grpc::StatusCode;

/// Returns an asset: a plate perpendicular to its x axis. It is wider than the car of the
/// small run and has a different brightness.
ActorAsset make_plate_asset(const std::string& name, std::size_t n_surfels = 1,
                            PrimitiveType primitive = PrimitiveType::surfel) {
    relidar::Run run = make_small_run("");
    Surfels& surfels = run.scene.surfels;
    surfels = surfels.slice(0, 1);
    surfels.log_scale[0] = glm::vec2(std::log(0.8f));
    surfels.mean[0] = {};
    surfels.sh[0] = 1.0f;
    const Surfels one = surfels;
    for (std::size_t i = 1; i < n_surfels; ++i) surfels.append_surfels(one);
    if (primitive == PrimitiveType::gaussian) convert_surfels(surfels, PrimitiveType::gaussian, 0.1);
    run.scene.models = {{"background", 0, 0}, {name, 0, std::uint32_t(n_surfels)}};
    run.scene.instances = {{0, ""}, {1, name}};
    run.log.boxes[0].id = name;
    run.config.image.primitive = primitive;
    AssetDescription facts;
    facts.name = name;
    facts.category = "Van";
    facts.kind = ObjectKind::vehicle;
    facts.size_m = {5, 2, 2.5};
    facts.seen = 0.5;
    facts.completed = 0.25;
    facts.nearest_m = 6.0;
    facts.surfels = n_surfels;
    facts.sensor = "HDL-64E";
    return {facts, run};
}

using NamesAndSources = std::vector<std::pair<std::string, std::string>>;

/// @param actors name of each actor, and an actor of the run or "asset NAME"
v1::SpawnActorsRequest make_spawn_request(const NamesAndSources& actors) {
    v1::SpawnActorsRequest request;
    for (const auto& [name, source] : actors) {
        v1::Spawn& spawn = *request.add_actors();
        spawn.set_name(name);
        if (source.starts_with("asset ")) spawn.set_asset(source.substr(6));
        else if (!source.empty()) spawn.set_actor(source);
    }
    return request;
}

Pose beside(double x_m, double y_m, double yaw_rad = 0.0) {
    return {make_rotation(yaw_rad, 0.0, 0.0), kDatasetOrigin_m + glm::dvec3(x_m, y_m, 0.0)};
}

void place(v1::RenderLidarRequest& request, const std::string& name, const Pose& pose) {
    v1::ActorTrack& actor = *request.mutable_actors()->add_actors();
    actor.set_name(name);
    add_pose(*actor.mutable_poses(), 0.5, pose);
}

class Spawn : public ServiceTest {
protected:
    void SetUp() override {
        ServiceTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        save_asset(make_plate_asset("van-1"), folder / "assets" / "van-1");
        save_asset(make_plate_asset("gauss", 3, PrimitiveType::gaussian), folder / "assets" / "gauss");
        assets = {(folder / "assets").string()};
    }
    v1::SpawnActorsResponse spawned(const NamesAndSources& actors) {
        const auto [status, answer] = call(*calls, &Stub::SpawnActors, make_spawn_request(actors));
        EXPECT_TRUE(status.ok()) << status.error_message();
        return answer;
    }
    void expect_refused(const v1::SpawnActorsRequest& request, Code code, const std::string& says) {
        const grpc::Status status = call(*calls, &Stub::SpawnActors, request).status;
        EXPECT_EQ(status.error_code(), code) << status.error_message();
        EXPECT_THAT(status.error_message(), Names(says));
    }
    Reply<v1::DespawnActorsResponse> despawn(const std::vector<std::string>& names) {
        v1::DespawnActorsRequest request;
        request.mutable_names()->Assign(names.begin(), names.end());
        return call(*calls, &Stub::DespawnActors, request);
    }
    std::vector<std::string> listed() {
        const v1::ListScenesResponse scenes = call(*calls, &Stub::ListScenes, {}).answer;
        std::vector<std::string> names;
        for (const v1::SpawnedActor& actor : scenes.scenes(0).spawned()) names.push_back(actor.name());
        return names;
    }
};

TEST_F(Spawn, CopiesRenderAsThoseOfEdits) {
    start();
    const v1::SpawnActorsResponse answer =
        spawned({{"first", "car"}, {"second", "asset van-1"}, {"third", "asset van-1"}, {"unused", "car"}});
    ASSERT_EQ(answer.actors_size(), 4);
    const std::vector<std::pair<std::string, Pose>> actor_poses{
        {"first", beside(3.0, 1.0)}, {"second", beside(5.0, -1.5, 0.3)}, {"third", beside(6.0, 0.5, -0.2)}};
    v1::RenderLidarRequest request = make_standing_request();
    for (const auto& [name, pose] : actor_poses) place(request, name, pose);
    const v1::LidarScan scan = scan_of(request);

    const relidar::Run run = load_run(folder / "small"), asset = load_run(folder / "assets" / "van-1");
    SceneWithLog edited = copy_track(run.driving_scene(), "car", {actor_poses[0].second});
    for (const std::size_t i : {1u, 2u})
        edited = insert_track(std::move(edited), asset.driving_scene(), "van-1", {actor_poses[i].second});
    edited = remove_track(std::move(edited), "car");
    ScanRenderer renderer(device(), edited.scene, run.config, edited.log);
    const RenderedScan truth =
        renderer.render(make_sensor(run.config, run.log), {0.5, {{0.5}, {make_pose_at_x(0.0)}}});
    EXPECT_EQ(values<float>(scan.image().range_m()), truth.image.range_m);
    EXPECT_EQ(values<float>(scan.image().intensity()), truth.image.intensity);
    EXPECT_EQ(values<float>(scan.image().drop_probability()), truth.image.drop_prob);

    // The instances of the edited run are 1, 2 and 3. The small run has two instances, so
    // spawned instances start at 2.
    std::vector<std::int32_t> expected;
    for (std::size_t i = 0; i < truth.image.range_m.size(); ++i)
        if (truth.image.drop_prob[i] < 0.5f && truth.image.range_m[i] > 0.0f)
            expected.push_back(truth.instance[i] < 1
                                   ? truth.instance[i]
                                   : std::int32_t(answer.actors(truth.instance[i] - 1).instance()));
    EXPECT_EQ(values<std::int32_t>(scan.points().instance()), expected);
    for (const std::int32_t actor : {1, 2, 3})
        EXPECT_GT(std::ranges::count(truth.instance, actor), 0) << actor;

    const v1::LidarScan before = scan_of(make_standing_request());
    EXPECT_THAT(values<std::int32_t>(before.points().instance()), testing::Contains(1))
        << "as the log has them";
    EXPECT_THAT(values<std::int32_t>(before.points().instance()), testing::Each(testing::Lt(2)))
        << "nowhere where none is named";
}

TEST_F(Spawn, IsListedUntilItIsTakenOut) {
    start();
    const v1::ListScenesResponse before = call(*calls, &Stub::ListScenes, {}).answer;
    ASSERT_EQ(before.assets_size(), 2);
    EXPECT_THAT(before.assets(1), IsMessage(R"(name: "van-1" category: "Van" kind: "vehicle"
        size_m { x: 5 y: 2 z: 2.5 } score: 0.75 seen: 0.5 nearest_m: 6 surfels: 1 sensor: "HDL-64E")"));
    EXPECT_TRUE(before.scenes(0).spawned().empty());

    const v1::SpawnActorsResponse answer = spawned({{"a", "asset van-1"}, {"b", "car"}});
    EXPECT_THAT(answer, IsMessage(R"(
        actors { name: "a" asset: "van-1" instance: 2 size_m { x: 5 y: 2 z: 2.5 } surfels: 1 }
        actors { name: "b" actor: "car" instance: 3 size_m { x: 1 y: 1 z: 1 } surfels: 1 })"));
    EXPECT_THAT(listed(), ElementsAre("a", "b"));
    const auto [despawned, answer_of_despawn] = despawn({"a"});
    EXPECT_TRUE(despawned.ok());
    EXPECT_EQ(answer_of_despawn.left(), 1u);
    EXPECT_THAT(listed(), ElementsAre("b"));
    v1::RenderLidarRequest request = make_standing_request();
    place(request, "a", beside(3.0, 0.0));
    const grpc::Status status = call(*calls, &Stub::RenderLidar, request).status;
    EXPECT_EQ(status.error_code(), Code::NOT_FOUND);
    EXPECT_THAT(status.error_message(), Names("actors.actors[0].name ... \"a\""));
    EXPECT_EQ(spawned({{"again", "asset van-1"}}).actors(0).instance(), answer.actors(0).instance())
        << "the place was free";
}

TEST_F(Spawn, WhatMakesNoSenseIsRefusedByNameAndChangesNothing) {
    start();
    spawned({{"mine", "car"}});
    NamesAndSources many;
    for (std::size_t i = 0; i <= SpawnedActorRegistry::kMaxSlots; ++i)
        many.emplace_back(fmt::format("n{}", i), "car");
    const std::vector<std::tuple<NamesAndSources, Code, const char*>> cases{
        {{{"mine", "car"}}, Code::ALREADY_EXISTS, "\"mine\""},
        {{{"x", "car"}, {"mine", "car"}}, Code::ALREADY_EXISTS, "spawn \"mine\""},
        {{{"x", "car"}, {"x", "asset van-1"}}, Code::ALREADY_EXISTS, "spawn \"x\""},
        {{{"car", "asset van-1"}}, Code::ALREADY_EXISTS, "run"},
        {{{"x", "cat"}}, Code::NOT_FOUND, "actors[0].actor ... \"cat\""},
        {{{"x", "asset van-2"}}, Code::NOT_FOUND, "actors[0].asset ... \"van-2\""},
        {{{"x", "mine"}}, Code::NOT_FOUND, "actors[0].actor ... \"mine\""},
        {{{"x", ""}}, Code::INVALID_ARGUMENT, "asset"},
        {{{"", "car"}}, Code::INVALID_ARGUMENT, "actors[0].name"},
        {{{std::string(201, 'x'), "car"}}, Code::INVALID_ARGUMENT, "201 bytes"},
        {{}, Code::INVALID_ARGUMENT, "actors"},
        {{{"x", "asset gauss"}}, Code::FAILED_PRECONDITION, "3D Gaussians"},
        {many, Code::RESOURCE_EXHAUSTED, "4096 ... actors"}};
    for (const auto& [actors, code, says] : cases) expect_refused(make_spawn_request(actors), code, says);
    v1::SpawnActorsRequest elsewhere = make_spawn_request({{"x", "car"}});
    elsewhere.set_scene("nowhere");
    expect_refused(elsewhere, Code::NOT_FOUND, "scene ... \"nowhere\"");
    for (const std::vector<std::string>& names :
         {std::vector<std::string>{"x"}, {"mine", "mine"}, {"car"}, {""}}) {
        const grpc::Status status = despawn(names).status;
        EXPECT_EQ(status.error_code(), Code::NOT_FOUND) << names[0];
        EXPECT_THAT(status.error_message(), Names("despawn \"" + names[0] + "\""));
    }
    EXPECT_THAT(listed(), ElementsAre("mine"));
    v1::RenderLidarRequest request = make_standing_request();
    place(request, "mine", beside(3.0, 0.0));
    EXPECT_THAT(values<std::int32_t>(scan_of(request).points().instance()), testing::Contains(2));
}

/// A spawned asset must have the class that its file states, here vehicle (1).
TEST_F(Spawn, AnAssetHasItsClass) {
    channels = "class";
    start();
    spawned({{"van", "asset van-1"}});
    v1::RenderLidarRequest request = make_standing_request();
    place(request, "van", beside(4.0, 0.0));
    *request.mutable_sensor()->mutable_spec() = make_rays_ahead(3);
    const v1::LidarScan scan = scan_of(request);
    ASSERT_EQ(scan.points().channels_size(), 1);
    EXPECT_EQ(scan.points().channels(0).name(), "class");
    EXPECT_EQ(values<std::int32_t>(scan.points().channels(0).values()), std::vector<std::int32_t>(3, 1));
}

TEST_F(Spawn, ActorsWithTooFewSurfelsForTheirRaysAreNamed) {
    start();
    spawned({{"van", "asset van-1"}});
    v1::RenderLidarRequest request = make_standing_request();
    place(request, "van", beside(4.0, 0.0));
    *request.mutable_sensor()->mutable_spec() = make_rays_ahead(9);
    const v1::LidarScan near_scan = scan_of(request);
    ASSERT_EQ(near_scan.sparse_actors_size(), 1);
    EXPECT_EQ(near_scan.sparse_actors(0).name(), "van");
    EXPECT_NEAR(near_scan.sparse_actors(0).distance_m(), 4.0, 1e-6);
    EXPECT_EQ(near_scan.sparse_actors(0).rays(), 9u);
    EXPECT_EQ(near_scan.sparse_actors(0).surfels(), 1u);
    *request.mutable_sensor()->mutable_spec() = make_rays_ahead(8);
    EXPECT_EQ(scan_of(request).sparse_actors_size(), 0) << "eight rays a surfel do";
    *request.mutable_sensor()->mutable_spec() = make_rays_ahead(9);
    request.clear_actors();
    place(request, "van", beside(4.0, 5.0));
    EXPECT_EQ(scan_of(request).sparse_actors_size(), 0) << "beside the rays";
    request.clear_actors();
    place(request, "car", beside(4.0, 0.0));
    EXPECT_EQ(scan_of(request).sparse_actors_size(), 1) << "an actor of the log that the client places";
    request.clear_actors();
    EXPECT_EQ(scan_of(request).sparse_actors_size(), 0) << "where the log had it";
}

TEST_F(Spawn, WhatDoesNotFitIntoMemoryIsRefusedAndTheSceneIsAsBefore) {
    save_run(make_small_run(folder / "small"));
    save_asset(make_plate_asset("large", 20000), folder / "more" / "large");
    const std::uint64_t before = device().allocated_bytes();
    std::uint64_t budget = 0;
    const std::vector<SceneSource> sources{{"small", folder / "small"}};
    const ScanRequest request{0.5, {{0.5}, {make_pose_at_x(1.0)}}};
    {
        // A scan needs memory too, which stays allocated.
        const AssetCatalogue none({});
        SceneSet one(device(), sources, std::uint64_t(1) << 40, none);
        const relidar::Run& run = one.runs()[0];
        one.use_scene(0, {}, [&](ScanRenderer& renderer) {
            renderer.render(make_sensor(run.config, run.log), request);
        });
        budget = 2 * (device().allocated_bytes() - before);
    }
    const AssetCatalogue shelf({(folder / "more").string()});
    SceneSet scenes(device(), sources, before + budget, shelf);
    const SimulatedSensor sensor = make_sensor(scenes.runs()[0].config, scenes.runs()[0].log);
    const auto ranges = [&] {
        std::vector<float> range_m;
        scenes.use_scene(
            0, {}, [&](ScanRenderer& renderer) { range_m = renderer.render(sensor, request).image.range_m; });
        return range_m;
    };
    const std::vector<float> truth = ranges();
    const auto refused = [&](const ActorToSpawn& actor) {
        try {
            scenes.spawn_actors(0, {actor});
        } catch (const RejectedRequest& refusal) {
            EXPECT_EQ(refusal.code(), Code::RESOURCE_EXHAUSTED);
            return std::string(refusal.what());
        }
        return std::string();
    };
    EXPECT_THAT(refused({"x", {true, "large"}, {1, 1, 1}, 20000}), Names("memory"));
    EXPECT_TRUE(scenes.spawned().list_occupied(0).empty());
    EXPECT_TRUE(scenes.spawned().list_all_slots(0).empty());
    EXPECT_EQ(ranges(), truth);
    EXPECT_EQ(refused({"x", {false, "car"}, {1, 1, 1}, 1}), "") << "the name is free, and this one fits";
    EXPECT_EQ(scenes.spawned().list_occupied(0).size(), 1u);
}

TEST(SpawnedPlaces, AreUsedAgain) {
    SpawnedActorRegistry actors(2);
    const SpawnedModelSource car{false, "car"}, van{true, "van"};
    for (std::size_t i = 0; i < 5; ++i)
        EXPECT_EQ(actors.assign_slots(1, {{fmt::format("{}", i), car}})[0].position, i);
    EXPECT_TRUE(actors.list_all_slots(0).empty()) << "of another scene";
    actors.remove_actors(1, {"1", "3"});
    EXPECT_EQ(actors.assign_slots(1, {{"v", van}})[0].position, 5u) << "a place keeps its source";
    EXPECT_EQ(actors.assign_slots(1, {{"c", car}})[0].position, 1u);
}

TEST_F(Spawn, ADamagedAssetIsToldToWhoPlacesIt) {
    const std::filesystem::path model = folder / "assets" / "van-1" / "model.safetensors";
    std::filesystem::resize_file(model, std::filesystem::file_size(model) / 2);
    start();  // The server must start although it has read only the descriptions of assets.
    expect_refused(make_spawn_request({{"x", "asset van-1"}}), Code::FAILED_PRECONDITION, "van-1");
    EXPECT_EQ(spawned({{"y", "car"}}).actors_size(), 1) << "the scene is as it was";
}

TEST_F(Spawn, AnAssetsNameIsGivenOnce) {
    save_asset(make_plate_asset("van-1"), folder / "others" / "van-1");
    const std::string message = error_message<UsageError>([&] {
        AssetCatalogue({(folder / "assets").string(), (folder / "others").string()});
    });
    EXPECT_THAT(message, Names("van-1"));
    EXPECT_THAT(get_data_error_message([&] { AssetCatalogue({folder.string() + "/nowhere"}); }),
                Names("nowhere"));
}

}  // namespace
}  // namespace relidar::serve
