// SPDX-License-Identifier: Apache-2.0
// Tests the learned scatter of intensities on a street whose sensor measures noisy values
// in steps of 1/64. Held-out frames differ more, because the untrained scene consists of
// the noisy points of the training frames.
#include <cmath>

#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

class LearnScatter : public test::DeviceTest {};

constexpr float kStep = 1.0f / 64.0f;

/// The untrained scene consists of the points of the log.
Run make_grainy_run() {
    Run run;
    run.sequence =
        make_street_log({.seed = 3, .n_frames = 10, .rows = 32, .columns = 512, .moving_cars = false});
    Random random(8);
    for (Frame& frame : run.sequence.frames)
        for (float& intensity : frame.scan.intensity)
            intensity =
                std::max(std::round((intensity + 0.05f * static_cast<float>(random.sample_normal())) / kStep),
                         0.0f) *
                kStep;
    run.split = split_frames(run.sequence, 5);
    run.config = make_preset("quick");
    run.scene = init_scene(run.sequence, run.split.train, run.config.init);
    return run;
}

TEST_F(LearnScatter, TrainingFramesScatterAlike) {
    relidar::Run run = make_grainy_run();
    run.intensity_scatter = learn_scatter(device(), run);
    ASSERT_EQ(run.intensity_scatter.size(), 1u);
    EXPECT_EQ(run.intensity_scatter[0].step, double(kStep));
    ScanRenderer exact(device(), run.scene, run.config, run.sequence), renderer(device(), run);
    const SimulatedSensor sensor = choose_sensor("native", run.config, run.sequence);
    double real = 0.0, drawn = 0.0, n = 0.0;
    for (const int position : run.split.train) {
        const Frame& frame = run.sequence.frames[std::size_t(position)];
        const RenderedScan likely = exact.render(sensor, frame.time_s),
                           stepped = renderer.render(sensor, frame.time_s),
                           sample = renderer.render(sensor, frame.time_s, {}, 4);
        EXPECT_EQ(sample.image.intensity, renderer.render(sensor, frame.time_s, {}, 4).image.intensity);
        for (std::size_t i = 0; i < likely.image.intensity.size(); ++i) {
            const float rendered = likely.image.intensity[i], value = sample.image.intensity[i];
            ASSERT_EQ(stepped.image.intensity[i], std::round(rendered / kStep) * kStep);
            if (sample.image.drop_prob[i] > 0.5f) continue;
            ASSERT_EQ(value, std::round(value / kStep) * kStep);
            // uses the same rays for both distributions, so that the surfaces are the
            // same
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            real += std::pow(double(frame.scan.intensity[i] - rendered), 2);
            drawn += std::pow(double(value - rendered), 2);
            n += 1.0;
        }
    }
    EXPECT_GT(std::sqrt(real / n), 0.045);
    EXPECT_NEAR(std::sqrt(drawn / n), std::sqrt(real / n), 0.1 * std::sqrt(real / n));
}

TEST_F(LearnScatter, StopsWhereItIsAskedTo) {
    const relidar::Run run = make_grainy_run();
    EXPECT_TRUE(learn_scatter(device(), run, {.stop = [] { return true; }}).empty());
}

}  // namespace
}  // namespace relidar
