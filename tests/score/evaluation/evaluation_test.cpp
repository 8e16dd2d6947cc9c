// SPDX-License-Identifier: Apache-2.0
#include <relidar/score/evaluation.hpp>

#include <algorithm>
#include <cmath>
#include <numeric>

#include <relidar/base/error.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/scene/scene.hpp>

#include "../../support/device.hpp"

namespace relidar {
namespace {

constexpr int kFrames = 35;  // more than twice the number of frames that are evaluated simultaneously

class EvaluationOf : public test::DeviceTest {
protected:
    void SetUp() override {
        test::DeviceTest::SetUp();
        run.log = make_street_log({.n_frames = kFrames, .rows = 8, .columns = 64});
        run.config = make_preset("quick");
        run.config.refine.enabled = false;
        run.split = split_frames(run.log, 0);
        run.config.init.voxel_m = 0.5;
        run.scene = init_scene(run.log, run.split.train, run.config.init);
        positions.resize(kFrames);
        std::iota(positions.begin(), positions.end(), 0);
    }

    void expect_forgotten(const Evaluation& evaluation, const std::vector<ScoredFrame>& frames) {
        ASSERT_EQ(evaluation.frames.size(), std::size_t(kFrames));
        ASSERT_EQ(frames.size(), std::size_t(kFrames));
        for (std::size_t i = 0; i < frames.size(); ++i) {
            EXPECT_EQ(frames[i].frame, int(i));
            EXPECT_EQ(frames[i].real.range_m.size(), 512u);
            EXPECT_EQ(frames[i].rendered.image.range_m.size(), 512u);
            const std::size_t n_stored_pixels = i == std::size_t(kFrames) / 2 ? 512 : 0;
            EXPECT_EQ(evaluation.frames[i].real.range_m.size(), n_stored_pixels) << i;
            EXPECT_EQ(evaluation.frames[i].rendered.image.range_m.size(), n_stored_pixels) << i;
            EXPECT_EQ(evaluation.frames[i].rendered.median_range_m.capacity() > 0,
                      n_stored_pixels > 0 && !frames[i].rendered.median_range_m.empty());
            EXPECT_EQ(evaluation.frames[i].rendered.trace_ms, frames[i].rendered.trace_ms);
        }
    }

    relidar::Run run;
    std::vector<int> positions;
};

TEST_F(EvaluationOf, ManyFramesIsThatOfEach) {
    ScanRenderer renderer(device(), run);
    std::vector<ScoredFrame> reported_frames;
    const auto see = [&](ScoredFrame& frame) {
        reported_frames.push_back(frame);
        frame.metrics["own"] = frame.frame;
    };
    std::vector<double> progress_values;
    const Evaluation evaluation = evaluate_frames(
        renderer, run.config, run.log, positions,
        [&](std::string_view, double done) { progress_values.push_back(done); }, see);
    expect_forgotten(evaluation, reported_frames);
    EXPECT_EQ(progress_values.size(), std::size_t(kFrames) + 1);
    EXPECT_TRUE(std::is_sorted(progress_values.begin(), progress_values.end()) &&
                progress_values.back() == 1.0);
    EXPECT_DOUBLE_EQ(evaluation.mean.at("own"), 0.5 * (kFrames - 1))
        << "metrics that are added where a frame is seen count";
    double sum = 0.0;
    for (int i = 0; i < kFrames; ++i) {
        const ScoredFrame alone = score_frame(renderer, run.config, run.log, run.log.frames[std::size_t(i)]);
        EXPECT_GT(alone.metrics.size(), 20u);
        for (const auto& [name, value] : alone.metrics) {
            const double actual = evaluation.frames[std::size_t(i)].metrics.at(name);
            EXPECT_TRUE(actual == value || (std::isnan(actual) && std::isnan(value)))
                << "frame " << i << ", " << name;
        }
        sum += alone.metrics.at("strict/depth_rmse_m");
    }
    EXPECT_NEAR(evaluation.mean.at("strict/depth_rmse_m"), sum / kFrames, 1e-9);
}

TEST_F(EvaluationOf, ALogWithoutIntensitiesHasNoScoresOfThem) {
    const auto count = [&] {
        ScanRenderer renderer(device(), run);
        const Evaluation evaluation = evaluate_frames(renderer, run.config, run.log, {3});
        return std::ranges::count_if(
            evaluation.mean, [](const auto& m) { return m.first.find("intensity") != std::string::npos; });
    };
    EXPECT_GT(count(), 0);
    std::ranges::fill(run.log.frames[3].scan.intensity, 0.0f);
    EXPECT_EQ(count(), 0);
}

TEST_F(EvaluationOf, AStandingSensorShowsItsRepeatability) {
    EXPECT_EQ(find_repeat(run.log, 3), std::nullopt) << "the sensor moves";
    Log log = make_street_log({.n_frames = 3, .rows = 8, .columns = 64, .speed_mps = 0.0});
    EXPECT_EQ(find_repeat(log, 0), 1);
    EXPECT_EQ(find_repeat(log, 2), std::nullopt) << "it is the last frame";
    // The rays of both frames are equal, and only cars move. So the next scan is its own
    // projection, apart from rounding.
    log.boxes.clear();
    const auto image_of = [&](std::size_t i) { return measured_image(run.config, log.frames[i].scan); };
    const RangeImage real = image_of(0);
    const MetricValues expected =
        evaluate_regions(image_of(1), real, {{"edges_repeat", mask_edges(real), true}});
    EXPECT_GT(expected.at("edges_repeat/pixels"), 20.0);
    const Evaluation evaluation = evaluate_baseline("nearest", run.config, log, {{1, 2}, {0}});
    for (const auto& [name, value] : expected)
        EXPECT_NEAR(evaluation.mean.at(name), value, 1e-4 * (1.0 + value)) << name;
    log.frames[1].scan = {};
    EXPECT_FALSE(
        evaluate_baseline("nearest", run.config, log, {{2}, {0}}).mean.contains("edges_repeat/pixels"));
}

TEST_F(EvaluationOf, ABaselineForgetsImagesToo) {
    run.split = {positions, positions};
    std::vector<ScoredFrame> reported_frames;
    const Evaluation evaluation =
        evaluate_baseline("nearest", run.config, run.log, run.split, {},
                          [&](const ScoredFrame& frame) { reported_frames.push_back(frame); });
    expect_forgotten(evaluation, reported_frames);
    EXPECT_EQ(evaluation.title, "baseline nearest");
}

/// Returns the index of the error bin that counts a ray. Bin 4 counts missed returns.
std::size_t find_error_bin(bool is_missed, double error_m) {
    if (is_missed) return 4;
    if (error_m < 0.05) return 0;
    if (error_m < 0.2) return 1;
    return error_m < 1.0 ? 2 : 3;
}

TEST_F(EvaluationOf, CountsErrorsByRange) {
    ScanRenderer renderer(device(), run);
    std::vector<ScoredFrame> reported_frames;
    evaluate_frames(renderer, run.config, run.log, {3, 20}, {},
                    [&](const ScoredFrame& frame) { reported_frames.push_back(frame); });
    double all = 0.0;
    for (const ScoredFrame& frame : reported_frames) {
        constexpr double kEdges_m[] = {0, 10, 20, 30, 40, 60, 80};
        for (std::size_t r = 0; r < 6; ++r) {
            std::array<double, 5> expected{};
            for (std::size_t i = 0; i < frame.real.range_m.size(); ++i) {
                const double real_m = frame.real.range_m[i], rendered_m = frame.rendered.image.range_m[i];
                const double off_m = std::abs(rendered_m - real_m);
                if (real_m <= kEdges_m[r] || real_m > kEdges_m[r + 1]) continue;
                const bool is_missed = frame.rendered.image.drop_prob[i] >= 0.5f || rendered_m <= 0.0;
                expected[find_error_bin(is_missed, off_m)] += 1.0;
                all += 1.0;
            }
            EXPECT_EQ(frame.range_errors.rays[r], expected) << "range " << r;
        }
    }
    EXPECT_GT(all, 500.0);
}

}  // namespace
}  // namespace relidar
