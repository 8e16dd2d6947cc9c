// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <set>

#include <relidar/simulate/render.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "support/names.hpp"
#include "two_streets.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::Names;
using testing::ElementsAre;
using testing::SizeIs;

constexpr int kFrames = 80;

/// 790 m of road in four blocks, walls at intervals of 7 m, and a car that is part of the
/// training of two blocks.
class JoinedBlocks : public test::DeviceTest {
protected:
    void SetUp() override {
        DeviceTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        log = test::log_along(kFrames, [](int index) { return glm::dvec3(10.0 * index, 0.0, 0.0); });
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
        full_scene = wrap_background(test::make_walls_at(xs));
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
        relidar::Run block{folders.back(), part.config, part.sequence, part.split, full_scene};
        keep_block_surfels(block.scene, log, blocks, index);
        block.scene.sensor_drop = {1, 2, {0.25f * float(index), 0.5f}};
        // poses as after refinement
        for (Pose& pose : block.sequence.world_from_vehicle.pose) pose.translation.z += 0.001 * double(index);
        block.refined_poses = "sensor";
        if (index < 2) {
            const Surfels car = test::make_walls_at({0.1f * float(index)});
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
            EXPECT_DOUBLE_EQ(run.sequence.world_from_vehicle.pose[std::size_t(position)].translation.z,
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
