// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <functional>

#include <numeric>
#include <set>

#include <relidar/run/blocks.hpp>
#include <relidar/simulate/render.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using test::Names;
using testing::Each;
using testing::Ge;
using testing::Le;
using testing::SizeIs;

/// Frames at intervals of 0.1 s. In frame i the vehicle is at path(i).
Log log_along(int count, const std::function<glm::dvec3(int)>& path) {
    Log log;
    log.name = "way";
    for (int i = 0; i < count; ++i) {
        log.frames.push_back({100 + i, 0.1 * i, {}});
        log.world_from_vehicle.append(0.1 * i, {{1, 0, 0, 0}, path(i)});
    }
    return log;
}

/// Standard deviation of 1 m, facing along x. At each x, at intervals of 10 m along y.
Surfels make_walls_at(const std::vector<float>& xs) {
    Surfels surfels;
    surfels.resize(3 * xs.size());
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        surfels.mean[i] = {xs[i / 3], -10.0f + 10.0f * float(i % 3), 0.5f};
        surfels.rotation[i] = {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f};
        surfels.log_scale[i] = glm::vec2(0.0f);
        surfels.opacity_logit[i] = 6.0f;
        for (std::size_t k = 0; k < kShFloats; ++k) surfels.sh[i * kShFloats + k] = 0.0f;
        surfels.sh[i * kShFloats + kShCoefficients] = 20.0f;  // hit logit
        surfels.sh[i * kShFloats] = 0.01f * (xs[i / 3] - 100.0f) / 3.0f;
    }
    return surfels;
}

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
        EXPECT_EQ(part.log.frames[std::size_t(part.split.train[i])].index,
                  log.frames[std::size_t(blocks[0].train[i])].index);
    for (const Frame& frame : part.log.frames)
        for (const double s : {-0.05, 0.0, 0.05}) {
            const double t = std::clamp(frame.time_s + s, 0.0, 29.9);
            EXPECT_LT(glm::distance(part.log.world_from_vehicle.pose_at(t).translation,
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
    ASSERT_THAT(first.log.boxes, SizeIs(1));
    EXPECT_EQ(first.log.boxes[0].id, "near");
    EXPECT_EQ(first.config.init.actor_tracks, "near");
    EXPECT_THAT(third.log.boxes, SizeIs(0));
    EXPECT_EQ(third.config.init.actor_tracks, "");
    EXPECT_EQ(third.config.init.actor_classes, "");
}

TEST(KeepOwnSurfels, EachPlaceBelongsToTheBlockOfTheNearestSweep) {
    const Log log =
        log_along(120, [](int index) { return glm::dvec3(2.0 * index, 10.0 * std::sin(0.05 * index), 0.0); });
    const std::vector<TrajectoryBlock> blocks = plan_blocks(log, split_frames(log, 10), {70.0, 40.0});
    std::vector<float> xs;
    for (float x = -60.0f; x < 300.0f; x += 1.7f) xs.push_back(x);
    Scene all = wrap_background(make_walls_at(xs));
    const Surfels actor = make_walls_at({1.0f, 2.0f});
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

namespace fs = std::filesystem;
using testing::ElementsAre;

constexpr int kFrames = 80;

/// 790 m of road in four blocks, walls at intervals of 7 m, and a car that is part of the
/// training of two blocks.
class JoinedBlocks : public test::DeviceTest {
protected:
    void SetUp() override {
        DeviceTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        log = log_along(kFrames, [](int index) { return glm::dvec3(10.0 * index, 0.0, 0.0); });
        log.lidars[0].sensor.beams = {{0.02}, {-0.05}};
        log.lidars[0].sensor.columns = 64;
        log.lidars[0].sensor.first_azimuth_rad = kPi;
        log.boxes.push_back(
            {"car",
             "Car",
             {4, 2, 2},
             {{0.0, 7.9}, {Pose{{1, 0, 0, 0}, {30, 5, 0}}, Pose{{1, 0, 0, 0}, {260, 5, 0}}}}});
        run = {folder / "run", make_preset("quick"), log, split_frames(log, 10), {}};
        run.config.refine.enabled = false;
        std::vector<float> xs;
        for (float x = -40.0f; x < 830.0f; x += 7.0f) xs.push_back(x);
        full_scene = wrap_background(make_walls_at(xs));
        for (std::size_t i = 1; i < full_scene.surfels.size(); i += 3) full_scene.surfels.mean[i].y = 14.0f;
        blocks = plan_blocks(log, run.split, {200.0, 40.0});
        ASSERT_THAT(blocks, SizeIs(4));
        for (std::size_t k = 0; k < blocks.size(); ++k) save_block(k);
        join_blocks(run, blocks, folders);
        save_run(run);
    }

    /// Blocks 0 and 1 contain the car. In block 0, the car is near the sensor in more
    /// frames.
    void save_block(std::size_t index) {
        const BlockTrainingLog part = cut_log(log, run.split, blocks[index], run.config);
        folders.push_back(run.folder / "blocks" / ("00" + std::to_string(index)));
        relidar::Run block{folders.back(), part.config, part.log, part.split, full_scene};
        keep_block_surfels(block.scene, log, blocks, index);
        block.scene.sensor_drop = {1, 2, {0.25f * float(index), 0.5f}};
        // poses as after refinement
        for (Pose& pose : block.log.world_from_vehicle.pose) pose.translation.z += 0.001 * double(index);
        block.refined_poses = "sensor";
        if (index < 2) {
            const Surfels car = make_walls_at({0.1f * float(index)});
            block.scene.models.push_back(
                {"car", std::uint32_t(block.scene.surfels.size()), std::uint32_t(car.size())});
            block.scene.instances.push_back({1, "car"});
            block.scene.surfels.append_surfels(car);
        }
        save_run(block);
    }

    RenderedScan rendered(const Scene& scene, const Config& config, int frame) {
        ScanRenderer renderer(device(), scene, config, log);
        return renderer.render(make_sensor(config, log), log.frames[std::size_t(frame)].time_s);
    }

    ScratchFolder scratch;
    const fs::path folder = scratch.path;
    Log log;
    relidar::Run run;
    Scene full_scene;
    std::vector<TrajectoryBlock> blocks;
    std::vector<fs::path> folders;
};

void expect_same(const RenderedScan& first, const RenderedScan& second, const std::string& description) {
    ASSERT_EQ(first.image.range_m.size(), second.image.range_m.size());
    std::size_t returned = 0;
    for (std::size_t i = 0; i < first.image.range_m.size(); ++i) {
        returned += first.image.drop_prob[i] < 0.5f;
        EXPECT_FLOAT_EQ(first.image.range_m[i], second.image.range_m[i]) << description << ", ray " << i;
        EXPECT_FLOAT_EQ(first.image.drop_prob[i], second.image.drop_prob[i]) << description << ", ray " << i;
        EXPECT_EQ(first.instance[i], second.instance[i]) << description << ", ray " << i;
    }
    EXPECT_GT(returned, 20u) << description << ": hardly a ray meets anything";
}

TEST_F(JoinedBlocks, HasEverySurfelOnceAndTheCarOfTheBlockThatSawItMost) {
    const relidar::Run read = load_run(run.folder);
    EXPECT_THAT(read.scene.blocks, SizeIs(4));
    EXPECT_EQ(read.scene.models[0].count, 0u);
    EXPECT_EQ(count_surfels(read.scene), full_scene.surfels.size() + 3);
    ASSERT_THAT(read.scene.instances, SizeIs(2));
    EXPECT_EQ(read.scene.instances[1].track, "car");
    EXPECT_EQ(read.scene.surfels.mean[read.scene.models[1].first].x, 0.0f) << "the car of block 0";

    const Scene all = with_all_blocks(read.scene);
    EXPECT_TRUE(all.blocks.empty());
    const auto collect_surfel_positions = [](const Scene& scene) {
        std::multiset<std::tuple<float, float, float>> surfel_positions;
        for (std::uint32_t i = 0; i < scene.models[0].count; ++i)
            surfel_positions.emplace(scene.surfels.mean[i].x, scene.surfels.mean[i].y,
                                     scene.surfels.sh[i * kShFloats]);
        return surfel_positions;
    };
    EXPECT_EQ(collect_surfel_positions(all), collect_surfel_positions(full_scene));
}

TEST_F(JoinedBlocks, TakesPosesAndDropsFromTheBlocks) {
    for (std::size_t k = 0; k < blocks.size(); ++k)
        for (const int position : blocks[k].recorded_frames)
            EXPECT_DOUBLE_EQ(run.log.world_from_vehicle.pose[std::size_t(position)].translation.z,
                             0.001 * double(k));
    EXPECT_EQ(run.refined_poses, "sensor");
    double frames = 0.0, sum = 0.0;
    for (std::size_t k = 0; k < blocks.size(); ++k) {
        frames += double(blocks[k].train.size());
        sum += 0.25 * double(k) * double(blocks[k].train.size());
    }
    EXPECT_NEAR(run.scene.sensor_drop.probability[0], sum / frames, 1e-6);
    EXPECT_NEAR(run.scene.sensor_drop.probability[1], 0.5, 1e-6);
}

TEST_F(JoinedBlocks, RendersAsOnePieceWithFewBlocksOnTheDevice) {
    Config config = run.config;
    config.render.memory_mib = 0;
    const Scene one = with_all_blocks(run.scene);
    const SimulatedSensor sensor = make_sensor(config, log);
    const std::uint64_t before = device().allocated_bytes();
    std::uint64_t most = 0;
    {
        ScanRenderer in_blocks(device(), run.scene, config, log);
        for (const int frame : {0, 20, 21, 40, 60, 79, 3}) {
            const RenderedScan scan = in_blocks.render(sensor, log.frames[std::size_t(frame)].time_s);
            most = std::max(most, device().allocated_bytes() - before);
            expect_same(scan, rendered(one, config, frame), "frame " + std::to_string(frame));
        }
        EXPECT_FALSE(in_blocks.times().milliseconds.empty());
    }
    EXPECT_EQ(device().allocated_bytes(), before);
    ScanRenderer all(device(), one, config, log);
    all.render(sensor, 0.0);
    EXPECT_LT(double(most), 0.8 * double(device().allocated_bytes() - before));
}

TEST_F(JoinedBlocks, EditedAndSavedElsewhereItRendersTheSame) {
    relidar::Run read = load_run(run.folder);
    const RenderedScan before = rendered(read.scene, read.config, 22);
    read.folder = folder / "edited";
    save_run(read);
    fs::remove_all(run.folder);
    expect_same(rendered(load_run(folder / "edited").scene, run.config, 22), before, "the edited run");
}

TEST_F(JoinedBlocks, NamesTheFileThatIsWrong) {
    fs::rename(folders[2], folder / "aside");
    EXPECT_THAT(get_data_error_message([&] { load_run(run.folder); }),
                Names("blocks/002/model.safetensors ... missing"));
    fs::create_directories(folders[2]);
    fs::copy_file(folders[0] / kModelFile, folders[2] / kModelFile);
    EXPECT_THAT(get_data_error_message([&] { with_all_blocks(load_run(run.folder).scene); }),
                Names("blocks/002/model.safetensors ... block"));
    Scene scene = run.scene;
    scene.blocks[1].file = folder / "aside" / kModelFile;  // outside of the run's folder
    save_model(run.folder / kModelFile, scene);
    EXPECT_THAT(get_data_error_message([&] { load_run(run.folder); }), Names("model"));
}

}  // namespace

}  // namespace relidar
