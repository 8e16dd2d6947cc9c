// SPDX-License-Identifier: Apache-2.0
// Tests assets, which are actors that are saved for use in other runs. Checks the visible
// surface of an actor, the surfels of the asset, and its files. In a different run, an
// asset must render like the original actor.
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <relidar/run/edit.hpp>
#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/render.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "car.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using test::Names;

const Pose kAhead{{1, 0, 0, 0}, {10.0, 0.0, -0.5}};  // its rear faces the LiDAR

class Sightings : public test::DeviceTest {
protected:
    double seen(const relidar::Run& run, BoxSide side) {
        const auto sightings = observe_actors(device(), run);
        return sightings.empty() ? 0.0
                                 : observed_surface(kCarSize_m, sightings.at("7")).observed_fraction(side);
    }
};

TEST_F(Sightings, AreOnTheSideThatIsTurnedToTheSensor) {
    const relidar::Run run = run_of(make_plates(), kAhead);
    const auto sightings = observe_actors(device(), run);
    ASSERT_EQ(sightings.count("7"), 1u);
    const ActorObservations& actor = sightings.at("7");
    ASSERT_GT(actor.points_m.size(), 100u);
    for (const glm::vec3& point_m : actor.points_m)
        EXPECT_LT(point_m.x, -1.6f) << "at the rear, or on the rim of a side";
    const auto on_plate = std::ranges::count_if(
        actor.points_m, [](const glm::vec3& point) { return std::abs(point.x + 1.95f) < 0.02f; });
    EXPECT_GT(double(on_plate), 0.8 * double(actor.points_m.size()));
    EXPECT_NEAR(actor.nearest_m, 8.05, 0.02);
    EXPECT_GT(seen(run, BoxSide::rear), 0.9);
    EXPECT_EQ(seen(run, BoxSide::left) + seen(run, BoxSide::right), 0.0);
}

TEST_F(Sightings, TurnWithTheActor) {
    // its left side faces the LiDAR
    const Pose across{glm::angleAxis(0.5 * kPi, glm::dvec3(0, 0, 1)), {10.0, 0.0, -0.5}};
    EXPECT_GT(seen(run_of(make_plates(), across), BoxSide::left), 0.9);
    EXPECT_EQ(seen(run_of(make_plates(), across), BoxSide::right), 0.0);
}

TEST_F(Sightings, WhatHidesAnActorHidesIt) {
    relidar::Run run = run_of(make_plates(), kAhead);
    run.scene = replace_background(run.scene, test::make_plate({4.0f, 0.0f, 0.0f}, glm::vec2(5.0f)));
    EXPECT_EQ(seen(run, BoxSide::rear), 0.0);
}

TEST_F(Sightings, HeldOutFramesDoNotCount) {
    relidar::Run run = run_of(make_plates(), kAhead);
    run.split = {{}, {0, 1, 2}};
    EXPECT_TRUE(observe_actors(device(), run).empty());
}

TEST(MakeAsset, LeavesOutWhatCanShowNowhere) {
    Surfels car = make_plates();
    const std::size_t n = car.size();
    car.opacity_logit[3] = -7.0f;      // below 1 / 255
    car.mean[5] = {2.3f, 0.0f, 0.0f};  // 30 cm in front of the box
    const ActorAsset asset = extract_asset(run_of(car, kAhead), "7", {});
    EXPECT_EQ(asset.facts.surfels, n - 2);
    EXPECT_EQ(asset.run.scene.surfels.size(), n - 2);
    EXPECT_EQ(asset.facts.mirrored, 0u) << "nothing was seen that a mirror image could be of";
}

TEST(MakeAsset, OnlyVehiclesAreMirrored) {
    ActorObservations left = from_outside(make_plates().mean);
    for (std::size_t i = left.points_m.size(); i-- > 0;) {
        if (left.points_m[i].y > 0.9f) continue;
        left.points_m.erase(left.points_m.begin() + std::ptrdiff_t(i));
        left.directions.erase(left.directions.begin() + std::ptrdiff_t(i));
    }
    for (const auto& [category, is_vehicle] :
         {std::pair("Car", true), {"Pedestrian", false}, {"Cyclist", false}, {kDiscoveredCategory, true}}) {
        relidar::Run run = run_of(make_plates(), kAhead);
        run.log.boxes[0].category = category;
        const ActorAsset asset = extract_asset(run, "7", left);
        EXPECT_EQ(asset.facts.kind == ObjectKind::vehicle, is_vehicle) << category;
        EXPECT_EQ(asset.facts.mirrored > 0, is_vehicle) << category;
        EXPECT_EQ(asset.facts.completed > 0.1, is_vehicle) << category;
        EXPECT_DOUBLE_EQ(asset.facts.covered_share(), asset.facts.seen + asset.facts.completed);
    }
}

TEST(MakeAsset, IsARunOfThatActorAlone) {
    relidar::Run run = run_of(make_plates(), kAhead);
    run.scene.instances.push_back({1, "copy"});
    run.log.boxes.push_back(run.log.boxes[0]);
    run.log.boxes[1].id = "copy";
    run.log.boxes.push_back({"8", "Pedestrian", {1, 1, 2}, {}});  // without a model
    const ActorAsset asset = extract_asset(run, "7", {});
    EXPECT_EQ(asset.facts.name, "car-7");
    EXPECT_EQ(only_track(asset.run), "car-7");
    ASSERT_EQ(asset.run.log.boxes.size(), 1u);
    EXPECT_EQ(asset.run.log.boxes[0].id, "car-7");
    EXPECT_EQ(asset.run.scene.models.size(), 2u);
    EXPECT_THROW(extract_asset(run, "nobody", {}), UsageError);
    EXPECT_THROW(only_track(run), UsageError) << "it has two";
}

class AssetFiles : public TemporaryFolder {};

TEST_F(AssetFiles, SayAgainWhatTheyWereTold) {
    ActorAsset asset = extract_asset(run_of(make_plates(), kAhead), "7",
                                     from_outside({{-1.95f, 0.0f, 0.2f}, {0.1f, 0.95f, 0.3f}}, 8.25));
    asset.facts.clearance_m = 0.15;
    save_asset(asset, folder / "car-7");
    EXPECT_EQ(read_clearance(load_run(folder / "car-7")), 0.15);
    EXPECT_FALSE(read_clearance(run_of(make_plates(), kAhead)));
    ASSERT_EQ(list_assets(folder), std::vector<std::filesystem::path>{folder / "car-7"});
    const AssetDescription facts = read_description(folder / "car-7");
    EXPECT_EQ(facts.name, "car-7");
    EXPECT_EQ(facts.category, "Car");
    EXPECT_EQ(facts.kind, ObjectKind::vehicle);
    EXPECT_EQ(facts.size_m, kCarSize_m);
    EXPECT_EQ(facts.source_track, "7");
    EXPECT_EQ(facts.sensor, "small");
    EXPECT_EQ(facts.seen_sides, asset.facts.seen_sides);
    EXPECT_EQ(facts.seen, asset.facts.seen);
    EXPECT_EQ(facts.completed, asset.facts.completed);
    EXPECT_GT(facts.seen, 0.0);
    EXPECT_EQ(facts.nearest_m, 8.25);
    EXPECT_EQ(facts.surfels, asset.facts.surfels);
    EXPECT_EQ(facts.mirrored, asset.facts.mirrored);
    EXPECT_GT(facts.mirrored, 0u);
    EXPECT_EQ(load_run(folder / "car-7").scene.surfels.sh, asset.run.scene.surfels.sh);
}

TEST_F(AssetFiles, DamageIsNamed) {
    EXPECT_THAT(get_data_error_message([&] { list_assets(folder); }), Names("asset"));
    EXPECT_THAT(get_data_error_message([&] { list_assets(folder / "nowhere"); }), Names("nowhere"));
    save_asset(extract_asset(run_of(make_plates(), kAhead), "7", from_outside({}, 8.0)), folder / "car-7");
    const std::string good = read_contents(folder / "car-7" / kAssetFile);
    const nlohmann::json wrong = {{"seen", 1.5}, {"kind", "plane"}, {"size_m", {1, 2}}, {"format", "x"}};
    for (const auto& [member, value] : wrong.items()) {
        nlohmann::json json = nlohmann::json::parse(good);
        json[member] = value;
        put(folder / "car-7" / kAssetFile, json.dump());
        EXPECT_THAT(get_data_error_message([&] { read_description(folder / "car-7"); }), Names(member));
    }
}

class InsertedAsset : public Sightings {};

TEST_F(InsertedAsset, RendersAsTheActorItWas) {
    const relidar::Run run = run_of(make_plates(), kAhead);
    // no surfel is mirrored or omitted
    const ActorAsset asset = extract_asset(run, "7", from_outside(make_plates().mean));
    ASSERT_EQ(asset.facts.mirrored, 0u);
    const SceneWithLog empty = remove_track(run.driving_scene(), "7");
    Pose dataset_from_car = kAhead;
    dataset_from_car.translation += run.log.world_offset_m;
    const SceneWithLog inserted =
        insert_track(empty, asset.run.driving_scene(), asset.facts.name, {dataset_from_car});
    const SimulatedSensor sensor = make_sensor(run.config, run.log);
    const RenderedScan before = ScanRenderer(device(), run.scene, run.config, run.log).render(sensor, 0.5);
    const RenderedScan after =
        ScanRenderer(device(), inserted.scene, run.config, inserted.log).render(sensor, 0.5);
    EXPECT_EQ(after.instance, before.instance);
    ASSERT_GT(std::ranges::count(before.instance, 1), 50);
    for (std::size_t i = 0; i < before.weight.size(); ++i)
        EXPECT_NEAR(after.median_range_m[i], before.median_range_m[i], 1e-5) << i;
}

}  // namespace
}  // namespace relidar
