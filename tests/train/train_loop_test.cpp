// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <limits>

#include <relidar/read/dataset.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/train/train.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "gpu/context.hpp"
#include "support/names.hpp"
#include "support/same_surfels.hpp"
#include "train/iteration_reports.hpp"
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

}  // namespace

}  // namespace relidar
