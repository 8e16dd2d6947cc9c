// SPDX-License-Identifier: Apache-2.0
// Tests that the host neither waits until the device is idle nor allocates device memory
// in an iteration, and that it receives the results after a bounded number of iterations.
#include <algorithm>
#include <limits>

#include <relidar/read/dataset.hpp>
#include <relidar/train/train.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "gpu/context.hpp"
#include "support/names.hpp"
#include "train/readback_lag.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

class NoWait : public test::DeviceTest {
protected:
    Log street = make_street_log({.n_frames = 6, .rows = 16, .columns = 128});
    Split split = split_frames(street, 0);
    Config config = make_preset("quick");

    void SetUp() override {
        test::DeviceTest::SetUp();
        config.init.voxel_m = 0.6;
        config.init.actor_min_points = 5;
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
