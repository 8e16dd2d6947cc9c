// SPDX-License-Identifier: Apache-2.0
// Tests a server with several runs within a memory budget.
#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include "gpu/forced.hpp"

#include "asset_catalogue.hpp"
#include "scenes.hpp"
#include "small_service.hpp"
#include "support/names.hpp"

namespace relidar::serve {
namespace {

using test::Names;

class Scenes : public ServiceTest {
protected:
    std::vector<SceneSource> sources;
    const AssetCatalogue no_assets{{}};
    const ScanRequest request{0.5, {{0.5}, {make_pose_at_x(1.0)}}};

    void SetUp() override {
        ServiceTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        for (const char* name : {"a", "b", "c"}) {
            save_run(make_small_run(folder / name));
            sources.push_back({name, folder / name});
        }
    }
    std::vector<float> ranges(SceneSet& scenes, std::size_t scene) {
        const relidar::Run& run = scenes.runs()[scene];
        std::vector<float> range_m;
        scenes.use_scene(scene, {}, [&](ScanRenderer& renderer) {
            range_m = renderer.render(make_sensor(run.config, run.log), request).image.range_m;
        });
        return range_m;
    }
    std::uint64_t measure_size_of_one() {
        const std::uint64_t before = device().allocated_bytes();
        SceneSet one(device(), {sources[0]}, std::uint64_t(1) << 40, no_assets);
        ranges(one, 0);
        return device().allocated_bytes() - before;
    }
};

TEST_F(Scenes, ThoseUsedLongestAgoMakeRoomAndComeBackTheSame) {
    const std::uint64_t one = measure_size_of_one(), around = device().allocated_bytes();
    const std::uint64_t budget = around + 5 * one / 2;  // two of three runs fit
    SceneSet scenes(device(), sources, budget, no_assets);
    const std::vector<float> truth = ranges(scenes, 0);
    ASSERT_FALSE(truth.empty());
    ranges(scenes, 1);
    ranges(scenes, 2);  // afterwards, each has allocated the memory for a scan
    std::size_t last = 2;
    for (const std::size_t scene : {1u, 0u, 2u, 0u, 1u, 2u}) {
        EXPECT_EQ(ranges(scenes, scene), truth) << scene;
        EXPECT_TRUE(scenes.is_scene_on_gpu(scene));
        EXPECT_TRUE(scenes.is_scene_on_gpu(last)) << last << " was used before " << scene;
        EXPECT_FALSE(scenes.is_scene_on_gpu(3 - scene - last)) << "the third was used longest ago";
        EXPECT_LE(device().allocated_bytes(), budget);
        last = scene;
    }
}

/// A scan that was submitted to an earlier renderer must not be collected from a later
/// renderer.
TEST_F(Scenes, ThatWereLoadedAnewInBetweenAreTold) {
    SceneSet scenes(device(), sources, std::uint64_t(1) << 40, no_assets);
    const auto nothing = [](ScanRenderer&) {};
    const auto fails = [](ScanRenderer&) { throw DeviceError("planted"); };
    const SceneLoadNumber first = scenes.use_scene(0, {}, nothing);
    EXPECT_NO_THROW(scenes.reuse_scene(0, first, nothing));
    EXPECT_THROW(scenes.use_scene(0, {}, fails), DeviceError);
    EXPECT_THROW(scenes.reuse_scene(0, first, nothing), DeviceError) << "nothing there";
    const SceneLoadNumber second = scenes.use_scene(0, {}, nothing);
    EXPECT_THROW(scenes.reuse_scene(0, first, nothing), DeviceError) << "another one";
    EXPECT_NO_THROW(scenes.reuse_scene(0, second, nothing));
}

/// A scene is copied for parallel scans. The memory of the copies must count towards the
/// memory of the scene.
TEST_F(Scenes, OneThatFillsTheMemoryIsNotCopied) {
    const ForcedBehaviourScope forced(device(), {.side_by_side = 4});
    const std::uint64_t around = device().allocated_bytes();
    std::uint64_t one = 0;
    const auto side_by_side = [&](std::uint64_t budget) {
        SceneSet scenes(device(), {sources[0]}, budget, no_assets);
        one = device().allocated_bytes() - around;
        int n = 0;
        scenes.use_scene(0, {}, [&](ScanRenderer& renderer) { n = renderer.max_parallel(); });
        return n;
    };
    EXPECT_EQ(side_by_side(std::uint64_t(1) << 40), 4);
    EXPECT_EQ(side_by_side(around + 3 * one / 2), 1);
    EXPECT_EQ(side_by_side(around + 5 * one / 2), 2);
}

TEST_F(Scenes, OneThatNeverFitsIsRefusedAtTheStart) {
    const std::string message = get_data_error_message([&] { SceneSet(device(), sources, 1000, no_assets); });
    EXPECT_THAT(message, Names((folder / "a").string() + " ... needs"));
    EXPECT_THAT(message, Names("--memory-mib"));
}

TEST_F(Scenes, MissingAndBrokenRunsAreNamed) {
    sources[1].folder = folder / "nowhere";
    EXPECT_THAT(
        get_data_error_message([&] { SceneSet(device(), sources, std::uint64_t(1) << 40, no_assets); }),
        Names("nowhere"));
}

TEST(SceneSources, NamesAreTheFoldersOrGiven) {
    const std::vector<SceneSource> sources = parse_sources({"runs/17", "town=runs/18/", "runs/19/."});
    ASSERT_EQ(sources.size(), 3u);
    EXPECT_EQ(sources[0].name, "17");
    EXPECT_EQ(sources[1].name, "town");
    EXPECT_EQ(sources[1].folder, "runs/18/");
    EXPECT_EQ(sources[2].name, "19");
    EXPECT_THROW(parse_sources({"a/run", "b/run"}), UsageError);
    EXPECT_NO_THROW(parse_sources({"a/run", "b=b/run"}));
    EXPECT_THROW(parse_sources({"=run"}), UsageError);
}

}  // namespace
}  // namespace relidar::serve
