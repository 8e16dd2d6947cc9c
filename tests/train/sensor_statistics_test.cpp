// SPDX-License-Identifier: Apache-2.0

#include <gtest/gtest.h>
#include <algorithm>
#include <cmath>
#include <numeric>

#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"
#include "base/random.hpp"
#include "train/drops/drop_excess.hpp"
#include "train/frames/sensor_drop.hpp"

namespace relidar {
namespace {

constexpr int kColumns = 360, kBlindFrom = 99, kBlindTo = 189;  // columns of beam 1

void add_ray(Frame& frame, int beam, int column, bool returns) {
    const double azimuth = kPi - (column + 0.5) * 2.0 * kPi / kColumns;
    frame.scan.rays.origin.emplace_back(0.0f);
    frame.scan.rays.direction.emplace_back(std::cos(azimuth), std::sin(azimuth), 0.0);
    frame.scan.rays.time_offset_s.push_back(0.0f);
    frame.scan.rays.channel.push_back(static_cast<std::uint16_t>(beam));
    frame.scan.range_m.push_back(returns ? 10.0f : 0.0f);
    frame.scan.intensity.push_back(0.0f);
}

/// Four beams with every `step`-th column. The second beam has no returns in a sector.
/// The third drops every seventh ray. The fourth drops six of 24 rays, like windows.
Log log_of(int n_frames, int step = 1) {
    Log log;
    log.lidars[0].sensor.columns = kColumns;
    log.lidars[0].sensor.beams.resize(4);
    for (int f = 0; f < n_frames; ++f) {
        Frame frame{f, 0.1 * f, {}};
        for (int beam = 0; beam < 4; ++beam)
            for (int column = 0; column < kColumns; column += step) {
                const bool is_blind = beam == 1 && column >= kBlindFrom && column < kBlindTo;
                const bool is_dropped =
                    (beam == 2 && (column * 3 + f * 5) % 7 == 0) || (beam == 3 && column % 24 < 6);
                add_ray(frame, beam, column, !is_blind && !is_dropped);
            }
        log.frames.push_back(std::move(frame));
    }
    return log;
}

RayDropTable table_of(const Log& log) {
    const RayDropTable bins = measure_drops(log, {});
    std::vector<CheckedRay> rays;
    for (const Frame& frame : log.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            const std::size_t bin = bins.index_of(frame.scan.rays.channel[i], frame.scan.rays.direction[i]);
            rays.push_back({.bin = std::uint32_t(bin),
                            .is_dropped = frame.scan.range_m[i] == 0.0f,
                            .range_m = 10.0f,
                            .intensity = 0.3f,
                            .drop_logit = -3.0f});
        }
    return find_drop_excess(bins, rays);
}

float at(const RayDropTable& table, int beam, int column) {
    const double azimuth = kPi - (column + 0.5) * 2.0 * kPi / kColumns;
    return table.probability_of(static_cast<std::uint16_t>(beam),
                                glm::vec3(std::cos(azimuth), std::sin(azimuth), 0.0));
}

TEST(SensorDrop, ABlindSectorIsFoundToItsBordersInTwoSweeps) {
    for (const int n_frames : {2, 40}) {
        const RayDropTable table = table_of(log_of(n_frames));
        for (int column = 0; column < kColumns; ++column) {
            const bool is_blind = column >= kBlindFrom && column < kBlindTo;
            // bins are three columns wide
            const bool is_border = std::abs(column - kBlindFrom) < 3 || std::abs(column - kBlindTo) < 3;
            EXPECT_TRUE(is_border || (at(table, 1, column) > 0.5f) == is_blind)
                << n_frames << " sweeps, column " << column;
            EXPECT_EQ(at(table, 0, column), 0.0f) << "what always returns";
        }
    }
}

TEST(SensorDrop, OccasionalDropsAreNotOfTheSensor) {
    for (const int n_frames : {2, 200}) {
        const RayDropTable table = table_of(log_of(n_frames));
        for (int column = 0; column < kColumns; ++column) EXPECT_EQ(at(table, 2, column), 0.0f) << column;
        EXPECT_GT(at(table, 1, (kBlindFrom + kBlindTo) / 2), n_frames > 2 ? 0.98f : 0.8f);
    }
}

/// Beam b sees a surface at 3 b m. The logit of a drop grows with ln(range^2 /
/// intensity). The scene has not learnt this. The beam at 9 m is blind in a sector.
TEST(SensorDrop, WeakReturnsAreNotOfTheSensor) {
    constexpr int kBeams = 20, kBins = 120, kRaysPerBin = 40, kBlindBeam = 3, kBlindBins = 12;
    Random random(5);
    std::vector<CheckedRay> rays;
    std::vector<int> drops_by_beam(kBeams, 0);
    for (int beam = 1; beam < kBeams; ++beam)
        for (int bin = 0; bin < kBins; ++bin)
            for (int i = 0; i < kRaysPerBin; ++i) {
                const double range_m = 3.0 * beam, intensity = 0.05 + 0.5 * random.sample_uniform();
                const double logit = 2.5 * std::log(range_m * range_m / intensity / 2000.0);
                const bool is_dropped = random.sample_uniform() < 1.0 / (1.0 + std::exp(-logit)) ||
                                        (beam == kBlindBeam && bin < kBlindBins);
                drops_by_beam[std::size_t(beam)] += is_dropped;
                rays.push_back({.bin = std::uint32_t(beam * kBins + bin),
                                .is_dropped = is_dropped,
                                .range_m = float(range_m),
                                .intensity = float(intensity),
                                .drop_logit = -3.0f});
            }
    ASSERT_GT(drops_by_beam[kBeams - 1], 0.9 * kBins * kRaysPerBin) << "blind by its range";
    const RayDropTable table = find_drop_excess({kBeams, kBins, {}}, rays);
    for (int beam = 0; beam < kBeams; ++beam)
        for (int bin = 0; bin < kBins; ++bin) {
            const float p = table.probability[std::size_t(beam * kBins + bin)];
            const bool is_blind = beam == kBlindBeam && bin < kBlindBins;
            EXPECT_NEAR(p, is_blind ? 1.0f : 0.0f, is_blind ? 0.1f : 0.0f) << beam << ", " << bin;
        }
}

TEST(SensorDrop, NothingIsKnownWhereNoRayWasCounted) {
    const RayDropTable table = table_of(log_of(0));
    for (int column = 0; column < kColumns; ++column) EXPECT_EQ(at(table, 1, column), 0.0f);
}

TEST(SensorDrop, OnlyABlindSectorIsBlindInOneSweep) {
    struct Case {
        int n_frames, step;
    };
    // the last case combines a coarse LiDAR with a fine LiDAR
    for (const auto& [n_frames, step] : {Case{1, 1}, Case{2, 1}, Case{40, 1}, Case{3, 4}}) {
        const Log log = log_of(n_frames, step);
        std::vector<int> positions(std::size_t(n_frames), 0);
        std::iota(positions.begin(), positions.end(), 0);
        const RayDropTable observed = measure_drops(log, positions);
        const Frame& frame = log.frames[0];
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
            const int beam = frame.scan.rays.channel[ray],
                      column = int(ray % std::size_t(kColumns / step)) * step;
            // rays without a return in 40 sweeps count as blind
            const bool is_window = beam == 3 && column % 24 < 6 && n_frames == 40;
            const bool in_sector = beam == 1 && column >= kBlindFrom && column < kBlindTo;
            // too few rays to fill the last bin
            if (step > 1 && beam == 1 && kBlindTo - column < 3 * step && column < kBlindTo) continue;
            EXPECT_EQ(is_blind_ray(observed, log, frame, ray), in_sector || is_window)
                << n_frames << " sweeps, beam " << beam << ", column " << column;
        }
    }
}

/// The first LiDAR does not fire in a sector, and gets no return in a different sector.
/// Its highest beam never returns.
Log log_with_sectors() {
    Log log = log_of(0);
    log.lidars.push_back(log.lidars[0]);
    for (int f = 0; f < 6; ++f) {
        Frame frame{f / 2, 0.1 * (f / 2), {}, f % 2};
        for (int beam = 0; beam < 4; ++beam)
            for (int column = 0; column < kColumns; ++column) {
                if (frame.lidar == 0 && column >= 60 && column < 120) continue;
                add_ray(frame, beam, column,
                        frame.lidar == 1 || (beam > 0 && !(column >= 200 && column < 240)));
            }
        log.frames.push_back(std::move(frame));
    }
    return log;
}

TEST(SensorDrop, ASectorWithoutReturnsIsNotSeenWhateverTheSceneHas) {
    const Log log = log_with_sectors();
    const RayDropTable observed = measure_drops(log, {0, 1, 2, 3, 4, 5});
    RayDropTable drops = observed;
    std::ranges::fill(drops.probability, 0.25f);
    drop_unobserved(drops, observed, log);
    for (int beam = 0; beam < 8; ++beam)
        for (int column = 1; column < kColumns; column += 3) {  // the middle of each bin
            const bool is_in = (column >= 60 && column < 120) || (column >= 201 && column < 240);
            EXPECT_EQ(at(drops, beam, column), beam < 4 && is_in ? 1.0f : 0.25f)
                << "beam " << beam << ", column " << column;
        }
}

class LearnScatter : public test::DeviceTest {};

constexpr float kStep = 1.0f / 64.0f;

/// The untrained scene consists of the points of the log.
Run make_grainy_run() {
    Run run;
    run.log = make_street_log({.seed = 3, .n_frames = 10, .rows = 32, .columns = 512, .moving_cars = false});
    Random random(8);
    for (Frame& frame : run.log.frames)
        for (float& intensity : frame.scan.intensity)
            intensity =
                std::max(std::round((intensity + 0.05f * static_cast<float>(random.sample_normal())) / kStep),
                         0.0f) *
                kStep;
    run.split = split_frames(run.log, 5);
    run.config = make_preset("quick");
    run.scene = init_scene(run.log, run.split.train, run.config.init);
    return run;
}

TEST_F(LearnScatter, TrainingFramesScatterAlike) {
    relidar::Run run = make_grainy_run();
    run.intensity_scatter = learn_scatter(device(), run);
    ASSERT_EQ(run.intensity_scatter.size(), 1u);
    EXPECT_EQ(run.intensity_scatter[0].step, double(kStep));
    ScanRenderer exact(device(), run.scene, run.config, run.log), renderer(device(), run);
    const SimulatedSensor sensor = choose_sensor("native", run.config, run.log);
    double real = 0.0, drawn = 0.0, n = 0.0;
    for (const int position : run.split.train) {
        const Frame& frame = run.log.frames[std::size_t(position)];
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
