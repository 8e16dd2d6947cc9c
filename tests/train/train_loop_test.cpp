// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <limits>
#include <map>

#include <relidar/read/dataset.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/train/train.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "gpu/context.hpp"
#include "support/names.hpp"
#include "support/same_surfels.hpp"
#include "train/reports/iteration_reports.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

class KeptHits : public test::DeviceTest {
protected:
    Log street = make_street_log({.n_frames = 4, .rows = 16, .columns = 128});
    Split split = split_frames(street, 0);
    Config config = make_preset("quick");

    void SetUp() override {
        test::DeviceTest::SetUp();
        config.init.voxel_m = 0.6;
        config.init.actor_min_points = 5;
        config.train.iterations = 60;
        config.train.rays_per_iteration = 0;
        config.train.refine_poses = "none";
    }

    struct Trained {
        Scene scene;
        std::uint32_t stored_hits_per_ray;
    };
    Trained train(int keep_hits) {
        config.trace.keep_hits = keep_hits;
        TrainLoop loop(device(), street, split, init_scene(street, split.train, config.init), config);
        for (int step = 1; step <= config.train.iterations; ++step) loop.run_iteration(step, step % 4 == 0);
        loop.finish();
        return {loop.download_scene(), loop.max_stored_hits()};
    }

    /// For each n in `counts`, returns the share of rays with more than n hits.
    std::vector<double> share_beyond(const Scene& scene, const std::vector<std::uint32_t>& counts) {
        Renderer renderer(device(), scene, config.image, {.accel = {}, .trace = common_options(config)});
        std::vector<double> shares(counts.size(), 0.0);
        std::size_t n_rays = 0;
        for (const int position : split.train) {
            const Frame& frame = street.frames[std::size_t(position)];
            const PoseTrack track = street.lidar_track(frame.lidar);
            renderer.update(pose_instances(scene, street, timing_of(frame)),
                            glm::vec3(track.pose_at(frame.time_s).translation));
            const RayTable table = make_lidar_rays(street.lidar_of(frame), frame.time_s);
            WorldRays rays;
            for (std::size_t i = 0; i < table.size(); ++i) {
                const WorldRay ray = make_world_ray(track, frame.time_s, table, i, true);
                rays.origin.emplace_back(ray.origin_m);
                rays.direction.emplace_back(ray.direction);
            }
            const std::vector<std::uint32_t> hits = renderer.render_rays(rays).hits;
            for (std::size_t k = 0; k < counts.size(); ++k)
                shares[k] += double(std::count_if(hits.begin(), hits.end(),
                                                  [&](std::uint32_t count) { return count > counts[k]; }));
            n_rays += hits.size();
        }
        for (double& share : shares) share /= double(n_rays);
        return shares;
    }
};

TEST_F(KeptHits, GrowUntilNoRayHasMore) {
    const Trained trained = train(1);
    ASSERT_GT(trained.stored_hits_per_ray, 2u);
    const std::vector<double> shares =
        share_beyond(trained.scene, {trained.stored_hits_per_ray, trained.stored_hits_per_ray / 2});
    EXPECT_LE(shares[0], 0.002) << trained.stored_hits_per_ray << " are kept";
    EXPECT_GT(shares[1], 0.0) << "half of " << trained.stored_hits_per_ray << " would have done";
}

TEST_F(KeptHits, ChangeNothingOfWhatIsLearnt) {
    config.train.deterministic = true;
    const Trained searched = train(0), grown = train(1), all_stored = train(64);
    EXPECT_EQ(searched.stored_hits_per_ray, 0u);
    EXPECT_GT(grown.stored_hits_per_ray, 2u);
    for (const Trained* other : {&grown, &all_stored})
        test::expect_same_surfels(other->scene.surfels, searched.scene.surfels);
}

TEST(KeptHitsWanted, TwiceAsManyWhileAnyRayHasMore) {
    EXPECT_EQ(grow_stored_hits(64, 0), 64u);
    EXPECT_EQ(grow_stored_hits(64, 1), 128u);
    EXPECT_EQ(grow_stored_hits(128, 1000), 256u);
    EXPECT_EQ(grow_stored_hits(256, 1000), 256u) << "bounded";
    EXPECT_EQ(grow_stored_hits(1000, 1000), 1000u) << "as asked for";
    EXPECT_EQ(grow_stored_hits(0, 1000), 0u) << "the paper's way";
}

class NoWait : public KeptHits {
protected:
    void SetUp() override {
        KeptHits::SetUp();
        street = make_street_log({.n_frames = 6, .rows = 16, .columns = 128});
        split = split_frames(street, 0);
        config.train.iterations = 150;
        config.train.rays_per_iteration = 500;
        config.train.refine_poses = "sensor,actors";
    }
};

TEST_F(NoWait, NorAllocationInAnIteration) {
    for (const bool deterministic : {false, true}) {
        config.train.deterministic = deterministic;
        const Scene initial = init_scene(street, split.train, config.init);
        ASSERT_GT(initial.instances.size(), 1u) << "actors are to be refined too";
        TrainLoop loop(device(), street, split, initial, config);
        const Device::Impl& d = device().impl();
        const auto run_iteration = [&](int from, int to) {
            for (int step = from; step <= to; ++step) loop.run_iteration(step, step % 7 == 0 && step < 75);
        };
        // after these iterations, every frame was used and all arrays have their final
        // sizes
        run_iteration(1, 12);
        const std::uint64_t buffers = d.n_buffers, waits = d.n_full_waits;
        run_iteration(13, 150);  // these iterations include log lines, a full report, and checks of the tree
        EXPECT_EQ(d.n_full_waits, waits);
        EXPECT_EQ(d.n_buffers, buffers);
        EXPECT_EQ(loop.take_log_lines().size(), 10u);
        loop.finish();
        EXPECT_GT(d.n_full_waits, waits) << "waits are counted";
    }
}

TEST_F(NoWait, ButALossThatIsNoNumberEndsTrainingSoon) {
    FrameSampler sampler(split.train.size(), config.train.seed);
    int poisoned_step = 1;
    while (sampler.next_frame() != 3) {
        ++poisoned_step;
        sampler.generator().next_uint64();
    }
    Frame& frame = street.frames[std::size_t(split.train[3])];
    std::fill(frame.scan.intensity.begin(), frame.scan.intensity.end(),
              std::numeric_limits<float>::quiet_NaN());
    TrainLoop loop(device(), street, split, init_scene(street, split.train, config.init), config);
    int step = 0;
    const std::string message = error_message<DataError>([&] {
        while (step < 150) loop.run_iteration(++step);
    });
    EXPECT_THAT(message, test::Names("iteration " + std::to_string(poisoned_step) + ", frame " +
                                     std::to_string(frame.index) + " ... intensity"));
    EXPECT_LE(step, poisoned_step + 64 + kReadbackLag);
}

class DensifyTrain : public test::DeviceTest {};

Log make_growing_street() { return make_street_log({.n_frames = 11, .rows = 16, .columns = 256}); }

Config make_sparse_config() {
    Config config = make_preset("quick");
    config.init.voxel_m = 1.2;
    config.init.max_scale_m = 1.0;
    config.init.scale_factor = 0.7;
    config.init.opacity = 0.3;
    config.train.iterations = 160;
    config.train.rays_per_iteration = 2048;
    config.train.log_every = 10;
    config.train.mean_rate = 1e-4;  // allows the two halves of a split surfel to move apart
    config.train.mean_rate_final = 1e-5;
    config.train.rate_decay = 0.3;
    // With larger rates, a few surfels would stretch over the holes, and new surfels
    // would lag behind.
    config.train.opacity_rate = 0.05;
    config.train.scale_rate = 1e-2;
    config.train.rotation_rate = 3e-4;
    config.train.sh_rate = 3e-2;
    config.densify.from = 20;
    config.densify.every = 20;
    config.densify.until = 81;
    config.densify.gradient_threshold = 5e-4;
    return config;
}

double get_final_loss(const TrainResult& result) {
    double sum = 0.0;
    for (std::size_t i = result.log.size() - 3; i < result.log.size(); ++i) sum += result.log[i].loss / 3.0;
    return sum;
}

TEST_F(DensifyTrain, GrowthLowersTheLoss) {
    const Log log = make_growing_street();
    const Split split = split_frames(log, 10);
    std::map<DensifyStrategy, double> loss;
    for (const DensifyStrategy strategy : {DensifyStrategy::none, DensifyStrategy::adaptive}) {
        Config config = make_sparse_config();
        config.densify.strategy = strategy;
        const TrainResult result = train(device(), log, split, config);
        loss[strategy] = get_final_loss(result);
        std::uint32_t n = result.log.front().n_surfels;
        for (const TrainProgress& line : result.log) {
            n = n + line.densified.added - line.densified.n_removed();
            EXPECT_EQ(line.n_surfels, n) << "the log accounts for every surfel";
        }
        EXPECT_EQ(result.scene.surfels.size(), n);
        EXPECT_GE(n, strategy == DensifyStrategy::none ? 1u : result.log.front().n_surfels * 11 / 10);
    }
    EXPECT_LT(loss[DensifyStrategy::adaptive], loss[DensifyStrategy::none]);
}

TEST_F(DensifyTrain, ActorsStayInTheirModels) {
    const Log log = make_growing_street();
    const Split split = split_frames(log, 10);
    Config config = make_sparse_config();
    config.init.actor_classes = "Car";
    config.init.actor_min_points = 20;
    config.init.voxel_m = 0.6;
    config.train.iterations = 20;
    config.densify.strategy = DensifyStrategy::adaptive;
    config.densify.from = config.densify.every = 10;
    const Scene scene = train(device(), log, split, config).scene;
    ASSERT_EQ(scene.models.size(), 3u);
    std::uint32_t next = 0;
    for (const SurfelModel& model : scene.models) {
        EXPECT_EQ(model.first, next);
        EXPECT_GT(model.count, 10u);
        next += model.count;
    }
    EXPECT_EQ(next, scene.surfels.size());
    for (std::size_t m = 1; m < 3; ++m)
        for (std::uint32_t i = 0; i < scene.models[m].count; ++i)
            ASSERT_LT(glm::length(scene.surfels.mean[scene.models[m].first + i]), 6.0f);
}

TEST_F(DensifyTrain, OutOfMemoryEndsGrowthNotTraining) {
    const Log log = make_growing_street();
    const Split split = split_frames(log, 10);
    Config config = make_sparse_config();
    config.train.iterations = 40;
    config.densify.from = config.densify.every = 5;
    config.densify.strategy = DensifyStrategy::adaptive;
    config.densify.gradient_threshold = 0.0;  // every visible surfel grows
    std::uint64_t needed = 0;
    {
        Device unlimited;
        train(unlimited, log, split, config,
              [](const TrainProgress& progress) { return progress.iteration < 1; });
        needed = unlimited.peak_bytes();
    }
    Device limited({.memory_limit_bytes = needed + (std::uint64_t(2) << 20)});
    const TrainResult result = train(limited, log, split, config);
    EXPECT_EQ(result.log.back().iteration, 40);
    EXPECT_FALSE(result.interrupted);
    EXPECT_GT(result.scene.surfels.size(), result.log.front().n_surfels);
    EXPECT_LT(result.scene.surfels.size(), 4u * result.log.front().n_surfels)
        << "without a limit it doubles at each of seven times";
    int notes = 0;
    for (const TrainProgress& line : result.log) notes += !line.densified.note.empty();
    EXPECT_EQ(notes, 1);
}

}  // namespace

}  // namespace relidar
