// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <numeric>

#include "../../base/codecs/temporary_folder.hpp"
#include "support/names.hpp"
#include "two_streets.hpp"

namespace relidar {
namespace {

using test::log_along;
using test::Names;
using testing::Each;
using testing::Ge;
using testing::Le;
using testing::SizeIs;

glm::dvec3 place(const Log& log, int position) {
    return log.world_from_vehicle.pose[std::size_t(position)].translation;
}

/// Each frame belongs to exactly one block, in order. A block is trained with exactly the
/// frames that are at most `halo_m` away from it.
void expect_valid(const Log& log, const Split& split, const std::vector<TrajectoryBlock>& blocks,
                  double halo_m) {
    std::vector<int> all_recorded_frames;
    for (const TrajectoryBlock& block : blocks) {
        ASSERT_FALSE(block.recorded_frames.empty());
        all_recorded_frames.insert(all_recorded_frames.end(), block.recorded_frames.begin(),
                                   block.recorded_frames.end());
        for (const int position : split.train) {
            double nearest_m = 1e30;
            for (const int other : block.recorded_frames)
                nearest_m = std::min(nearest_m, glm::distance(place(log, position), place(log, other)));
            EXPECT_EQ(std::count(block.train.begin(), block.train.end(), position), nearest_m <= halo_m)
                << "frame " << position;
        }
        EXPECT_EQ(std::count_if(block.train.begin(), block.train.end(),
                                [&](int p) {
                                    return std::find(split.test.begin(), split.test.end(), p) !=
                                           split.test.end();
                                }),
                  0);
    }
    std::vector<int> all(log.frames.size());
    std::iota(all.begin(), all.end(), 0);
    EXPECT_EQ(all_recorded_frames, all);
}

TEST(PlanBlocks, StraightStreetIsCutIntoEqualParts) {
    const Log log = log_along(201, [](int index) { return glm::dvec3(1.0 * index, 0.0, 0.0); });
    const Split split = split_frames(log, 10);
    const std::vector<TrajectoryBlock> blocks = plan_blocks(log, split, {60.0, 25.0});
    ASSERT_THAT(blocks, SizeIs(4));  // three blocks of 60 m would cover only 180 m
    for (const TrajectoryBlock& block : blocks) EXPECT_NEAR(block.end_m - block.begin_m, 50.0, 1e-9);
    std::vector<int> second(50);
    std::iota(second.begin(), second.end(), 50);
    EXPECT_EQ(blocks[1].recorded_frames, second);
    EXPECT_THAT(blocks[1].train, Each(testing::AllOf(Ge(25), Le(124))));
    expect_valid(log, split, blocks, 25.0);
}

TEST(PlanBlocks, SecondWayThroughAStreetTeachesTheSameBlocks) {
    // 150 m forward and 150 m back on the other lane
    const Log log = log_along(301, [](int index) {
        return index <= 150 ? glm::dvec3(index, 0.0, 0.0) : glm::dvec3(300 - index, 3.0, 0.0);
    });
    const Split split = split_frames(log, 0);
    const std::vector<TrajectoryBlock> blocks = plan_blocks(log, split, {50.0, 10.0});
    expect_valid(log, split, blocks, 10.0);
    EXPECT_EQ(std::count(blocks[0].train.begin(), blocks[0].train.end(), 299), 1);
    EXPECT_EQ(std::count(blocks[0].train.begin(), blocks[0].train.end(), 150), 0);
}

TEST(PlanBlocks, StandstillAndGapsAreNoTrouble) {
    const Log standing = log_along(40, [](int) { return glm::dvec3(1.0, 2.0, 3.0); });
    const std::vector<TrajectoryBlock> one = plan_blocks(standing, split_frames(standing, 10), {60.0, 40.0});
    ASSERT_THAT(one, SizeIs(1));
    EXPECT_THAT(one[0].recorded_frames, SizeIs(40));
    // a tunnel of 300 m without a sweep
    const Log gap =
        log_along(40, [](int index) { return glm::dvec3(index < 20 ? index : index + 300, 0.0, 0.0); });
    const std::vector<TrajectoryBlock> blocks = plan_blocks(gap, split_frames(gap, 10), {60.0, 40.0});
    EXPECT_THAT(blocks, SizeIs(2)) << "a stretch without a sweep is no block";
    expect_valid(gap, split_frames(gap, 10), blocks, 40.0);
}

TEST(PlanBlocks, RefusesABlockThatNothingTrains) {
    const Log log = log_along(6, [](int index) { return glm::dvec3(100.0 * index, 0.0, 0.0); });
    Split split = split_frames(log, 0);
    split.train = {0, 1, 2, 4, 5};
    split.test = {3};
    EXPECT_THAT(get_data_error_message([&] {
                    plan_blocks(log, split, {100.0, 40.0});
                }),
                Names("40 m ... 300 ... 400"));
}

TEST(BlockLog, MovesAsTheLogDoes) {
    // along a road and back after a long detour
    const Log log = log_along(300, [](int index) {
        if (index < 100) return glm::dvec3(0.8 * index, 0.0, 0.0);
        return index < 200 ? glm::dvec3(80.0, 5.0 * (index - 100), 0.0)
                           : glm::dvec3(0.8 * (299 - index), 2.0, 0.0);
    });
    const Split split = split_frames(log, 10);
    const std::vector<TrajectoryBlock> blocks = plan_blocks(log, split, {40.0, 15.0});
    const BlockTrainingLog part = cut_log(log, split, blocks[0], make_preset("quick"));
    EXPECT_EQ(part.config.blocks.length_m, 0.0);
    EXPECT_EQ(part.split.train.size(), blocks[0].train.size());
    for (std::size_t i = 0; i < part.split.train.size(); ++i)
        EXPECT_EQ(part.sequence.frames[std::size_t(part.split.train[i])].index,
                  log.frames[std::size_t(blocks[0].train[i])].index);
    for (const Frame& frame : part.sequence.frames)
        for (const double s : {-0.05, 0.0, 0.05}) {
            const double t = std::clamp(frame.time_s + s, 0.0, 29.9);
            EXPECT_LT(glm::distance(part.sequence.world_from_vehicle.pose_at(t).translation,
                                    log.world_from_vehicle.pose_at(t).translation),
                      1e-9)
                << "at " << t << " s of frame " << frame.index;
        }
    int held_out = 0;
    for (const int position : blocks[0].recorded_frames)
        held_out += std::find(split.test.begin(), split.test.end(), position) != split.test.end();
    EXPECT_EQ(part.split.test.size(), std::size_t(held_out)) << "its own, and none of the halo";
}

TEST(BlockLog, HasTheBoxesThatComeNear) {
    Log log = log_along(400, [](int index) { return glm::dvec3(1.0 * index, 0.0, 0.0); });
    const auto box_at = [&](const char* id, double value, double from_s, double to_s) {
        log.boxes.push_back(
            {id,
             "Car",
             {4, 2, 2},
             {{from_s, to_s}, {Pose{{1, 0, 0, 0}, {value, 5, 0}}, Pose{{1, 0, 0, 0}, {value + 9, 5, 0}}}}});
    };
    box_at("near", 30.0, 2.0, 5.0);
    box_at("far", 350.0, 2.0, 5.0);     // visible while the sensor is at 20 to 50 m
    box_at("later", 30.0, 38.0, 39.0);  // visible after the sensor has passed
    const Split split = split_frames(log, 10);
    const std::vector<TrajectoryBlock> blocks = plan_blocks(log, split, {100.0, 40.0});
    Config config = make_preset("quick");
    config.init.actor_tracks = "far,near";
    const BlockTrainingLog first = cut_log(log, split, blocks[0], config),
                           third = cut_log(log, split, blocks[2], config);
    ASSERT_THAT(first.sequence.boxes, SizeIs(1));
    EXPECT_EQ(first.sequence.boxes[0].id, "near");
    EXPECT_EQ(first.config.init.actor_tracks, "near");
    EXPECT_THAT(third.sequence.boxes, SizeIs(0));
    EXPECT_EQ(third.config.init.actor_tracks, "");
    EXPECT_EQ(third.config.init.actor_classes, "");
}

TEST(KeepOwnSurfels, EachPlaceBelongsToTheBlockOfTheNearestSweep) {
    const Log log =
        log_along(120, [](int index) { return glm::dvec3(2.0 * index, 10.0 * std::sin(0.05 * index), 0.0); });
    const std::vector<TrajectoryBlock> blocks = plan_blocks(log, split_frames(log, 10), {70.0, 40.0});
    std::vector<float> xs;
    for (float x = -60.0f; x < 300.0f; x += 1.7f) xs.push_back(x);
    Scene all = wrap_background(test::make_walls_at(xs));
    const Surfels actor = test::make_walls_at({1.0f, 2.0f});
    all.models.push_back({"actor", std::uint32_t(all.surfels.size()), std::uint32_t(actor.size())});
    all.instances.push_back({1, "actor"});
    all.surfels.append_surfels(actor);
    std::size_t n_remaining_surfels = 0;
    for (std::size_t k = 0; k < blocks.size(); ++k) {
        Scene scene = all;
        keep_block_surfels(scene, log, blocks, k);
        n_remaining_surfels += scene.models[0].count;
        for (std::uint32_t i = 0; i < scene.models[0].count; ++i) {
            std::size_t nearest = 0;
            for (std::size_t f = 0; f < log.frames.size(); ++f)
                if (glm::distance(place(log, int(f)), glm::dvec3(scene.surfels.mean[i])) <
                    glm::distance(place(log, int(nearest)), glm::dvec3(scene.surfels.mean[i])))
                    nearest = f;
            EXPECT_THAT(blocks[k].recorded_frames, testing::Contains(int(nearest)));
        }
        ASSERT_EQ(scene.models[1].first, scene.models[0].count);
        ASSERT_EQ(scene.surfels.size(), scene.models[0].count + actor.size());
        EXPECT_EQ(scene.surfels.slice(scene.models[1].first, actor.size()).mean, actor.mean);
    }
    EXPECT_EQ(n_remaining_surfels, all.models[0].count) << "each surfel in one block";
}

}  // namespace
}  // namespace relidar
