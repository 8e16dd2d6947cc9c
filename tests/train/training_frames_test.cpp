// SPDX-License-Identifier: Apache-2.0

#include <gtest/gtest.h>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include <relidar/read/dataset.hpp>
#include <relidar/train/train.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "base/random.hpp"
#include "support/names.hpp"
#include "support/same_surfels.hpp"
#include "train/frames/training_frames.hpp"

namespace relidar {
namespace {

constexpr std::uint64_t kAll = ~0ull;

/// The published KITTI-360 grid has 66 rows from +2.0 to -24.9 degrees and 1030 columns
/// with decreasing azimuth from +180 degrees. Rays are in the centres of the cells.
int find_cell(const glm::vec3& point) {
    const double degrees = 180.0 / kPi,
                 elevation =
                     degrees * std::atan2(double(point.z), std::hypot(double(point.x), double(point.y)));
    const double azimuth = degrees * std::atan2(double(point.y), double(point.x));
    const int row = int(std::floor((2.0 - elevation) / 26.9 * 66.0 + 0.5));
    const int column = int(std::floor((180.0 - azimuth) / 360.0 * 1030.0 + 0.5));
    return row >= 0 && row < 66 ? row * 1030 + column % 1030 : -1;
}

TEST(OnGrid, NearestReturnsOfCells) {
    const Log log = make_street_log({.n_frames = 1, .rows = 32, .columns = 2048});
    const Scan& scan = log.frames[0].scan;
    std::map<int, std::size_t> nearest;
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
        const int cell = scan.range_m[i] > 0.0f ? find_cell(scan.return_point(i)) : -1;
        if (cell < 0) continue;
        const auto [at, is_new] = nearest.try_emplace(cell, i);
        if (!is_new && glm::length(scan.return_point(i)) < glm::length(scan.return_point(at->second)))
            at->second = i;
    }
    ASSERT_GT(nearest.size(), 10000u);
    const Frame binned = frame_to_grid(log, log.frames[0], kitti360_grid());
    ASSERT_EQ(binned.scan.range_m.size(), 66u * 1030u);
    EXPECT_EQ(binned.scan.rays.rows, 66);
    // single and double precision may select different cells for a point at the border of
    // two cells
    int elsewhere = 0;
    for (std::size_t cell = 0; cell < binned.scan.range_m.size(); ++cell) {
        const glm::vec3& d = binned.scan.rays.direction[cell];
        EXPECT_EQ(find_cell(10.0f * d), int(cell));
        EXPECT_EQ(binned.scan.rays.origin[cell], glm::vec3(0.0f));
        const auto match = nearest.find(int(cell));
        if (match == nearest.end()) {
            elsewhere += binned.scan.range_m[cell] != 0.0f;
            continue;
        }
        const std::size_t ray = match->second;
        if (std::abs(binned.scan.range_m[cell] - glm::length(scan.return_point(ray))) > 1e-4f) {
            ++elsewhere;
            continue;
        }
        EXPECT_EQ(binned.scan.intensity[cell], scan.intensity[ray]);
        EXPECT_EQ(binned.scan.rays.time_offset_s[cell], scan.rays.time_offset_s[ray]);
        EXPECT_EQ(binned.scan.rays.channel[cell], scan.rays.channel[ray]);
    }
    EXPECT_LE(elsewhere, 20);
}

class FramesInTurn : public test::DeviceTest {
protected:
    static Log street(int n_frames) {
        return make_street_log({.n_frames = n_frames, .rows = 8, .columns = 64});
    }
    static std::vector<int> positions(const Log& log) {
        std::vector<int> all(log.frames.size());
        std::iota(all.begin(), all.end(), 0);
        return all;
    }
    static std::uint64_t measure_bytes_of_frame(const Log& log) {
        return log.frames[0].scan.range_m.size() *
               (sizeof(DeviceRay) + sizeof(DeviceTarget) + sizeof(shared::PoseInterpolation));
    }
};

/// In random order with repetitions, and with correct, wrong and missing predictions of
/// the next frame.
TEST_F(FramesInTurn, AreThoseOfTheLog) {
    Log log = street(5);
    log.frames[3].scan = make_street_log({.n_frames = 5, .rows = 4, .columns = 50}).frames[3].scan;
    for (const auto& [resident_bytes, n_resident] :
         {std::pair(std::uint64_t(0), 0u), {2 * measure_bytes_of_frame(log), 2u}, {kAll, 5u}}) {
        TrainingFrames frames(device(), log, positions(log),
                              {.unknown = {}, .moves_rays = true, .resident_bytes = resident_bytes});
        EXPECT_EQ(frames.count_resident(), n_resident);
        Stream stream(device());
        Random random(1);
        std::size_t next = 0;
        for (int step = 0; step < 30; ++step) {
            const TrainingFrameData& frame = frames.ensure_resident(stream, next);
            const Frame& sweep = log.frames[next];
            next = random.next_uint64() % 5;
            if (step % 3 != 0) frames.prefetch_frame(step % 3 == 1 ? next : (next + 1) % 5);
            stream.submit_and_wait();
            std::vector<DeviceRay> rays;
            std::vector<DeviceTarget> targets;
            make_frame_arrays(log, sweep, {}, rays, targets);
            ASSERT_EQ(frame.n_rays, rays.size());
            const std::vector<DeviceRay> there = frame.device_rays().download(frame.n_rays);
            const std::vector<DeviceTarget> measured = frame.loss_targets().download(frame.n_rays);
            const std::vector<shared::PoseInterpolation> track_positions =
                frame.arrays->track_positions.download(frame.n_rays);
            double n_known_rays = 0.0, returned = 0.0;
            for (std::size_t i = 0; i < rays.size(); ++i) {
                ASSERT_TRUE(there[i].origin == rays[i].origin && there[i].direction == rays[i].direction)
                    << step << ", ray " << i;
                ASSERT_TRUE(measured[i].range_m == targets[i].range_m &&
                            measured[i].weight == targets[i].weight)
                    << step << ", ray " << i;
                const TrackInterpolation interpolation = log.world_from_vehicle.find_segment(
                    sweep.time_s + double(sweep.scan.rays.time_offset_s[i]));
                ASSERT_EQ(frame.first_knot + track_positions[i].left, interpolation.left)
                    << "turn " << step << ", ray " << i;
                ASSERT_LT(track_positions[i].left + 1, frame.n_knots + (frame.n_knots == 1))
                    << "turn " << step << ", ray " << i;
                ASSERT_FLOAT_EQ(track_positions[i].s, float(interpolation.s))
                    << "turn " << step << ", ray " << i;
                n_known_rays += targets[i].weight > 0.0f;
                returned += targets[i].weight > 0.0f && targets[i].range_m > 0.0f;
            }
            EXPECT_EQ(frame.n_returned, returned);
            EXPECT_EQ(frame.n_known_rays, n_known_rays);
        }
    }
}

TEST_F(FramesInTurn, TakeNoMoreMemoryForALongerLog) {
    const auto bytes = [&](int n_frames, std::uint64_t resident_bytes) {
        const Log log = street(n_frames);
        const std::uint64_t before = device().allocated_bytes();
        const TrainingFrames frames(device(), log, positions(log),
                                    {.unknown = {}, .moves_rays = true, .resident_bytes = resident_bytes});
        return device().allocated_bytes() - before;
    };
    EXPECT_EQ(bytes(4, 0), bytes(12, 0));
    EXPECT_GT(bytes(12, kAll), bytes(4, kAll));
    EXPECT_LT(bytes(12, 0), bytes(4, kAll));
}

TEST_F(FramesInTurn, AFrameWithoutRaysIsNamed) {
    Log log = street(3);
    log.frames[1].scan = {};
    const std::string message =
        error_message<DataError>([&] { TrainingFrames(device(), log, positions(log), {}); });
    EXPECT_THAT(message, test::Names("frame 1 ... " + log.name + " ... rays"));
}

/// Includes the features that read a frame twice: refined poses, and sensor drops.
TEST_F(FramesInTurn, TrainTheSameSceneBitByBit) {
    const Log log = make_street_log({.n_frames = 8, .rows = 16, .columns = 256, .moving_cars = true});
    const auto trained = [&](int frame_memory_mib, const std::string& batch) {
        Config config = make_preset("quick");
        config.init.voxel_m = 0.4;
        config.train.iterations = 20;
        config.train.rays_per_iteration = 1000;
        config.loss.intensity_ssim = batch == "columns" ? 0.15f : 0.0f;
        config.train.refine_poses = "sensor,actors";
        config.train.sensor_drop = true;
        config.train.deterministic = true;
        config.train.frame_memory_mib = frame_memory_mib;
        std::vector<std::string> notes;
        const TrainSession session{{}, nullptr, {}, [&](const std::string& note) { notes.push_back(note); }};
        TrainResult result = train(device(), log, split_frames(log, 0), config, {}, session);
        const auto n_reported = std::count_if(notes.begin(), notes.end(), [](const std::string& note) {
            return test::find_missing_part(note, "0 of 8 ... train.frame_memory_mib=0").empty();
        });
        EXPECT_EQ(n_reported, frame_memory_mib > 0 ? 0 : 1);
        return result;
    };
    for (const char* batch : {"rays", "columns"}) {
        const TrainResult stay = trained(2048, batch), come = trained(0, batch);
        test::expect_same_surfels(stay.scene.surfels, come.scene.surfels);
        EXPECT_EQ(stay.scene.sensor_drop.probability, come.scene.sensor_drop.probability) << batch;
        ASSERT_TRUE(stay.poses && come.poses);
        EXPECT_TRUE(std::ranges::equal(stay.poses->world_from_vehicle.pose,
                                       come.poses->world_from_vehicle.pose,
                                       [](const Pose& a, const Pose& b) {
                                           return a.translation == b.translation && a.rotation == b.rotation;
                                       }))
            << batch;
    }
}

TEST_F(FramesInTurn, WindowsAreNotCircular) {
    Log log = street(1);
    const WindowScanSensor window{"", 4, 20, 0.25 * kPi, -0.25 * kPi, 0.1, -0.1};
    log.frames[0].scan = {make_rays(window), ScanArray<float>(80, 5.0f), ScanArray<float>(80, 0.5f)};
    Stream stream(device());
    EXPECT_FALSE(
        TrainingFrames(device(), log, {0}, {.unknown = {}}).ensure_resident(stream, 0).image.circular);
}

/// Settings that need fired rays must be rejected.
TEST_F(FramesInTurn, AreCellsOfAGrid) {
    const Log log = street(2);
    TrainingFrames frames(device(), log, positions(log), {.unknown = {}, .grid = kitti360_grid()});
    Stream stream(device());
    const TrainingFrameData& frame = frames.ensure_resident(stream, 0);
    EXPECT_EQ(frame.n_rays, 66u * 1030u);
    EXPECT_EQ(frame.image.rows, 66u);
    EXPECT_TRUE(frame.image.circular);
    const Frame binned = frame_to_grid(log, log.frames[0], kitti360_grid());
    const std::vector<DeviceTarget> targets = frame.loss_targets().download(frame.n_rays);
    for (std::size_t i = 0; i < targets.size(); ++i)
        ASSERT_EQ(targets[i].range_m, binned.scan.range_m[i]) << i;

    Config config = make_preset("quick");
    config.train.grid = "kitti360";
    const Split split{positions(log), {}};
    EXPECT_THAT(error_message<UsageError>([&] { train(device(), log, split, config); }),
                test::Names("train.grid=kitti360 ... train.sensor_drop ... train.grid=native"));
}

/// A background, an actor in all frames, and an actor in every fifth frame.
struct LogitFactors : testing::Test {
    Scene scene;
    std::vector<TrainingFrameData> frames{20};
    TrainConfig config{.iterations = 400, .rays_per_iteration = 250, .sh_rate = 0.1};

    LogitFactors() {
        for (const float half_m : {0.0f, 1.0f, 1.0f}) {
            scene.instances.push_back({std::uint32_t(scene.models.size()), ""});
            scene.models.emplace_back().half_size_m = glm::vec3(half_m);
        }
        for (std::size_t f = 0; f < frames.size(); ++f) {
            frames[f].n_rays = 1000;
            frames[f].placed = {{}, {{}, true}, {{}, f % 5 == 0}};
        }
    }
};

/// The first actor is hit in a quarter of 400 steps, the second in a fifth of these.
TEST_F(LogitFactors, GiveRarelyHitActorsTheSameReach) {
    const std::vector<float> factors = logit_factors(scene, frames, config);
    ASSERT_EQ(factors.size(), 3u);
    EXPECT_EQ(factors[0], 1.0f);
    EXPECT_FLOAT_EQ(factors[1], 50.0f / 100.0f / 0.1f);
    EXPECT_FLOAT_EQ(factors[2], 2.0f / 0.1f) << "2.5 would be above the highest rate";
}

TEST_F(LogitFactors, AreNotNeededInALongTraining) {
    config.iterations = 10'000;
    config.rays_per_iteration = 0;
    frames[0].n_rays = 0;  // an empty scan
    EXPECT_TRUE(logit_factors(scene, frames, config).empty());
}

TEST_F(LogitFactors, DoNotSlowDownAnActor) {
    config.rays_per_iteration = 5000;  // more than a frame has
    config.iterations = 1200;
    const std::vector<float> factors = logit_factors(scene, frames, config);
    ASSERT_EQ(factors.size(), 3u);
    EXPECT_EQ(factors[1], 1.0f);
    EXPECT_FLOAT_EQ(factors[2], 50.0f / 240.0f / 0.1f);
}

}  // namespace

}  // namespace relidar
