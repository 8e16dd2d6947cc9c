// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <optional>

#include <relidar/read/dataset.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../registration/street_poses.hpp"
#include "../support/device.hpp"
#include "../support/file_size_limit.hpp"
#include "support/names.hpp"
#include "support/same_surfels.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr int kIterations = 40;
constexpr int kStoppedAfter = 17;  // stops between two lines of the log, and within an epoch of ten frames

Config make_resumed_config() {
    Config config = make_preset("quick");
    config.init.voxel_m = 0.4;
    config.train.iterations = kIterations;
    config.train.rays_per_iteration = 1000;
    config.train.sh_degree_interval = 10;
    config.train.log_every = 10;
    config.train.checkpoint_minutes = 0.0;
    return config;
}

class Resume : public test::DeviceTest {
protected:
    TrainResult run(const Config& config, const Checkpoint* start = nullptr, int stop_after = 1 << 30) {
        int calls = 0;
        TrainSession session{folder, start, [&calls, stop_after] { return ++calls >= stop_after; },
                             [this](const std::string& note) { notes.push_back(note); }};
        return train(device(), street, split, config, {}, session);
    }
    std::optional<Checkpoint> newest() {
        return load_newest(folder, [this](const std::string& note) { notes.push_back(note); });
    }

    ScratchFolder scratch;
    const fs::path folder = scratch.path;
    Log street = make_street_log({.n_frames = 11, .rows = 16, .columns = 256});
    Split split = split_frames(street, 10);
    std::vector<std::string> notes;
};

TEST(ResumedSampler, GoesOnWithTheSameFramesAndNumbers) {
    FrameSampler sampler(10, 3), other(10, 99);
    for (int i = 0; i < 27; ++i) {
        sampler.next_frame();
        sampler.generator().next_uint64();
    }
    Checkpoint checkpoint;
    sampler.visit_state(CheckpointWriter(checkpoint));
    other.next_frame();
    other.visit_state(CheckpointReader(checkpoint));
    for (int i = 0; i < 100; ++i) {
        ASSERT_EQ(sampler.next_frame(), other.next_frame());
        ASSERT_EQ(sampler.generator().next_uint64(), other.generator().next_uint64());
    }
}

TEST_F(Resume, IsTheTrainingThatWasNotStopped) {
    const Config config = make_resumed_config();
    const TrainResult uninterrupted = run(config);
    EXPECT_TRUE(list_checkpoints(folder).empty()) << "a short run leaves none";
    const TrainResult first = run(config, nullptr, kStoppedAfter);
    EXPECT_TRUE(first.interrupted);
    EXPECT_EQ(first.iterations, kStoppedAfter);
    const std::optional<Checkpoint> checkpoint = newest();
    ASSERT_TRUE(checkpoint);
    EXPECT_EQ(checkpoint->iteration, kStoppedAfter);
    const TrainResult resumed = run(config, &*checkpoint);
    EXPECT_FALSE(resumed.interrupted);
    ASSERT_EQ(resumed.log.size(), uninterrupted.log.size());
    for (std::size_t i = 0; i < uninterrupted.log.size(); ++i) {
        EXPECT_EQ(resumed.log[i].iteration, uninterrupted.log[i].iteration);
        EXPECT_NEAR(resumed.log[i].loss, uninterrupted.log[i].loss, 0.01 * uninterrupted.log[i].loss);
        EXPECT_GT(resumed.log[i].seconds, i > 0 ? resumed.log[i - 1].seconds : 0.0);
    }
    EXPECT_EQ(resumed.initialise_s, first.initialise_s);
    EXPECT_GE(resumed.train_s, resumed.log.back().seconds);
    EXPECT_EQ(resumed.scene.models.size(), uninterrupted.scene.models.size());
    EXPECT_EQ(resumed.scene.sensor_drop.probability.size(),
              uninterrupted.scene.sensor_drop.probability.size());
}

/// Surfels are added and removed before the stop, between the stop and the next log line,
/// and later.
TEST_F(Resume, ADeterministicTrainingEndsInTheSameBits) {
    using enum DensifyStrategy;
    for (const auto& [strategy, primitive] : {std::pair{none, PrimitiveType::surfel},
                                              {adaptive, PrimitiveType::surfel},
                                              {adaptive, PrimitiveType::gaussian}}) {
        Config config = make_resumed_config();
        config.image.primitive = primitive;
        config.train.deterministic = true;
        config.densify.strategy = strategy;
        config.densify.from = 4;
        config.densify.every = 4;
        config.densify.until = 36;
        config.densify.gradient_threshold = 1e-3;
        config.densify.opacity_reset_every = 20;
        const TrainResult uninterrupted = run(config), first = run(config, nullptr, kStoppedAfter);
        const std::optional<Checkpoint> checkpoint = newest();
        ASSERT_TRUE(checkpoint);
        const TrainResult resumed = run(config, &*checkpoint);
        test::expect_same_surfels(resumed.scene.surfels, uninterrupted.scene.surfels);
        ASSERT_EQ(resumed.log.size(), uninterrupted.log.size());
        std::uint32_t changed = 0;
        for (std::size_t i = 0; i < uninterrupted.log.size(); ++i) {
            EXPECT_EQ(resumed.log[i].n_surfels, uninterrupted.log[i].n_surfels);
            for (const auto& [name, count] : kDensifyCounts)
                EXPECT_EQ(resumed.log[i].densified.*count, uninterrupted.log[i].densified.*count)
                    << name << ", line " << i;
            changed += uninterrupted.log[i].densified.added > 0;
        }
        EXPECT_EQ(changed > 2, strategy != DensifyStrategy::none) << "before and after the stop";
        EXPECT_EQ(first.scene.surfels.size() != first.log.front().n_surfels,
                  strategy != DensifyStrategy::none);
        fs::remove_all(folder);
    }
}

TEST_F(Resume, PreparedLogsAreTheSameAgain) {
    set_trajectory(street, test::perturb_track(street.world_from_vehicle, 0.05, 0.005, 1));
    const Log original_street = street;
    const auto same = [](const Pose& a, const Pose& b) { return a.translation == b.translation; };
    for (const char* refined : {"actors", "sensor,actors"}) {
        Config config = make_resumed_config();
        config.train.deterministic = true;
        config.train.refine_poses = refined;
        config.init.actor_min_points = 10;
        config.train.iterations = 12;
        const auto prepare = [&] {
            street = original_street;
            prepare_log(street, split, config);
        };
        prepare();
        const bool is_registered = refined == std::string("sensor,actors");
        EXPECT_EQ(street.world_from_vehicle.pose[3].translation !=
                      original_street.world_from_vehicle.pose[3].translation,
                  is_registered);
        EXPECT_FALSE(street.intensity_response.factor.empty());
        const TrainResult uninterrupted = run(config), first = run(config, nullptr, 6);
        EXPECT_TRUE(first.interrupted);
        const std::optional<Checkpoint> checkpoint = newest();
        ASSERT_TRUE(checkpoint);
        prepare();
        const TrainResult resumed = run(config, &*checkpoint);
        test::expect_same_surfels(resumed.scene.surfels, uninterrupted.scene.surfels);
        EXPECT_TRUE(std::ranges::equal(resumed.poses->world_from_vehicle.pose,
                                       uninterrupted.poses->world_from_vehicle.pose, same));
        for (std::size_t b = 0; b < street.boxes.size(); ++b) {
            const std::vector<Pose>& end = uninterrupted.poses->boxes[b].world_from_box.pose;
            EXPECT_TRUE(std::ranges::equal(resumed.poses->boxes[b].world_from_box.pose, end, same));
            for (std::size_t k = 0; k < end.size(); ++k)
                EXPECT_FALSE(same(end[k], street.boxes[b].world_from_box.pose[k])) << "it was refined";
        }
        if (!is_registered) continue;
        street = original_street;
        EXPECT_THROW(run(config, &*checkpoint), DataError) << "a log that was not prepared is another log";
        LogPreparationCallbacks session;
        session.stop = [] { return true; };
        EXPECT_THAT([&] { prepare_log(street, split, config, session); },
                    testing::Throws<Error>(testing::Property(&Error::code, ExitCode::interrupted)));
    }
}

TEST_F(Resume, RestoresEveryArrayBitByBit) {
    Config config = make_resumed_config();
    config.train.refine_poses = "sensor,actors";
    config.init.actor_min_points = 10;
    Config other = config;
    other.train.seed = 99;
    const Scene initial = init_scene(street, split.train, config.init);
    TrainLoop trained(device(), street, split, initial, config),
        fresh(device(), street, split, initial, other);
    for (int step = 1; step <= kStoppedAfter; ++step) trained.run_iteration(step);
    Checkpoint saved, again;
    trained.save_to(saved);
    fresh.run_iteration(1);
    fresh.restore_from(saved);
    fresh.save_to(again);
    ASSERT_EQ(saved.arrays.size(), again.arrays.size());
    const auto same = [](const Pose& first, const Pose& second) {
        return first.rotation == second.rotation && first.translation == second.translation;
    };
    EXPECT_TRUE(std::ranges::equal(trained.refined_poses()->world_from_vehicle.pose,
                                   fresh.refined_poses()->world_from_vehicle.pose, same));
    for (const NamedArray& array : saved.arrays)
        EXPECT_TRUE(array.bytes == again.array(array.name).bytes) << array.name;
    for (const char* name :
         {"moment1/mean", "moment2/sh", "term_sums", "poses/sensor/correction", "poses/actor 0/correction"}) {
        const std::vector<float> values = saved.array(name).to_floats();
        EXPECT_TRUE(std::any_of(values.begin(), values.end(), [](float v) { return v != 0.0f; }))
            << name << " is saved as zeros";
    }
}

TEST_F(Resume, AFinishedRunStaysAndMayBeExtended) {
    Config config = make_resumed_config();
    config.train.checkpoint_every = 15;
    const TrainResult uninterrupted = run(config);
    ASSERT_EQ(list_checkpoints(folder).size(), 2u) << "30 and the last one";
    const std::optional<Checkpoint> end = newest();
    EXPECT_EQ(end->iteration, kIterations);
    const TrainResult nothing = run(config, &*end);
    test::expect_same_surfels(nothing.scene.surfels, uninterrupted.scene.surfels);
    EXPECT_EQ(nothing.log.size(), uninterrupted.log.size());
    config.train.iterations = kIterations + 10;
    const TrainResult more = run(config, &*end);
    EXPECT_EQ(more.iterations, kIterations + 10);
    EXPECT_EQ(more.log.back().iteration, kIterations + 10);
    EXPECT_EQ(newest()->iteration, kIterations + 10);
}

TEST_F(Resume, AnotherLogOrOtherSettingsAreRefusedByName) {
    run(make_resumed_config(), nullptr, 1);
    const Checkpoint start = *newest();
    const auto setting = [&](const char* key, const char* value) {
        Config config = make_resumed_config();
        set_value(config, key, value);
        return error_message<UsageError>([&] { check_resume(start, street, split, config); });
    };
    EXPECT_THAT(setting("loss.depth", "0.3"), test::Names("loss.depth ... 0.3 ... 0.1"));
    EXPECT_THAT(setting("train.seed", "2"), test::Names("train.seed ... 2 ... 1"));
    EXPECT_THAT(setting("train.iterations", "0"), test::Names("train.iterations ... 0"));
    Config free = make_resumed_config();
    for (const auto& [key, value] : {std::pair{"train.log_every", "3"},
                                     {"train.checkpoint_minutes", "5"},
                                     {"train.iterations", "99"},
                                     {"render.range", "median"},
                                     {"dataset.path", "moved"}})
        set_value(free, key, value);
    EXPECT_NO_THROW(check_resume(start, street, split, free));

    Checkpoint other_version = start;
    const auto error = [&] {
        return get_data_error_message(
            [&] { check_resume(other_version, street, split, make_resumed_config()); });
    };
    other_version.texts["setting/train.colour"] = "red";
    EXPECT_THAT(error(), test::Names("train.colour"));
    other_version = start;
    other_version.texts.erase("setting/loss.depth");
    EXPECT_THAT(error(), test::Names("setting loss.depth"));

    const auto log = [&](const char* part, const Log& other, const Split& frames) {
        const std::string message =
            get_data_error_message([&] { check_resume(start, other, frames, make_resumed_config()); });
        EXPECT_THAT(message, test::Names(std::string("log's ... ") + part));
    };
    log("training frames", street, split_frames(street, 5));
    Log other = street;
    other.frames[3].scan.range_m[100] += 1e-3f;
    log("scans", other, split);
    other = street;
    other.world_from_vehicle.pose[3].translation.x += 1e-6;
    log("sensor poses", other, split);
    other = street;
    ASSERT_FALSE(other.boxes.empty());
    other.boxes[0].size_m.x += 0.1;
    log("boxes", other, split);
    TrainSession session{folder, &start, {}, {}};
    EXPECT_THROW(train(device(), other, split, make_resumed_config(), {}, session), DataError);
}

TEST_F(Resume, AFullDiskCostsTheCheckpointOnly) {
    Config config = make_resumed_config();
    run(config, nullptr, 5);
    const Checkpoint start = *newest();
    config.train.checkpoint_every = 10;
    {
        const test::FileSizeLimit limit(4096);
        const TrainResult result = run(config, &start);
        EXPECT_EQ(result.iterations, kIterations);
        EXPECT_EQ(result.scene.surfels.size(), start.array("parameters/mean").shape[0]);
    }
    ASSERT_EQ(notes.size(), 4u) << "10, 20, 30, 40";
    EXPECT_THAT(notes[0], test::Names("write ... iteration 10 ... iteration 5"));
    EXPECT_EQ(newest()->iteration, 5);
    EXPECT_EQ(std::distance(fs::directory_iterator(folder), fs::directory_iterator()), 1);
}

TEST_F(Resume, ParametersThatAreNoNumbersAreNeverSaved) {
    Config config = make_resumed_config();
    config.train.checkpoint_every = 1;
    config.train.scale_rate = 1e39;  // exceeds the range of float
    const std::string message = get_data_error_message([&] { run(config); });
    EXPECT_THAT(message, test::Names("iteration 1 ... row ... \"parameters/log_scale\""));
    EXPECT_TRUE(list_checkpoints(folder).empty());
}

TEST_F(Resume, AFailureLeavesTheLastCheckpoint) {
    Config config = make_resumed_config();
    config.train.checkpoint_every = 5;
    int calls = 0;
    const TrainSession session{
        folder,
        nullptr,
        [&]() -> bool { return ++calls == 13 ? throw DeviceError("out of device memory") : false; },
        {}};
    EXPECT_THROW(train(device(), street, split, config, {}, session), DeviceError);
    const std::optional<Checkpoint> checkpoint = newest();
    ASSERT_TRUE(checkpoint);
    EXPECT_EQ(checkpoint->iteration, 10);
    EXPECT_EQ(run(config, &*checkpoint).iterations, kIterations);
    EXPECT_TRUE(notes.empty());
}

}  // namespace
}  // namespace relidar
