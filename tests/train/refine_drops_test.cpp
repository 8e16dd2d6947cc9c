// SPDX-License-Identifier: Apache-2.0
// Tests the ray-drop network on a street whose sensor is weak downwards. Surfels cannot
// represent this effect while the vehicle drives past.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <filesystem>
#include <numeric>
#include <set>
#include <string>

#include <relidar/base/arrays.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "support/names.hpp"
#include "train/drops/stripes.hpp"

namespace relidar {
namespace {

constexpr float kReach_m = 9.0f;

bool is_weak(const glm::vec3& direction) { return direction.z < 0.0f; }
/// Directions at the border are still blurred after few training steps.
bool is_well_inside(const glm::vec3& direction) { return direction.z < -0.02f; }

/// Rays that point down have no returns beyond 9 m.
Log make_weak_street() {
    Log street = make_street_log(
        {.seed = 5, .n_frames = 11, .rows = 32, .columns = 512, .range_noise_m = 0.01, .speed_mps = 10.0});
    for (Frame& frame : street.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
            if (is_weak(frame.scan.rays.direction[i]) && frame.scan.range_m[i] > kReach_m)
                frame.scan.range_m[i] = 0.0f;
    return street;
}

Run trained(Device& device, Log street) {
    Run run;
    run.log = std::move(street);
    run.split = split_frames(run.log, 5);
    run.config = make_preset("quick");
    run.config.train.iterations = 80;
    run.config.train.rays_per_iteration = 4096;
    run.config.train.refine_poses = "none";
    // Discs that face the sensor would reduce the effect.
    run.config.init.flatness = 1.0;
    // only the network can learn the effect
    run.config.train.sensor_drop = false;
    run.config.image.sh_degree = 0;
    run.scene = train(device, run.log, run.split, run.config).scene;
    // a run with a different flatness cannot be saved
    run.config.init.flatness = make_preset("quick").init.flatness;
    return run;
}

const Run& make_weak_run(Device& device) {
    static const Run run = [&] {
        Run made = trained(device, make_weak_street());
        made.config.refine.epochs = 16;
        made.config.refine.rate = 0.01;
        return made;
    }();
    return run;
}

/// The first share is for weak beams that hit a surface near or beyond their maximum
/// range, the second for all remaining pixels.
std::pair<double, double> measure_accuracies(Device& device, const Run& run) {
    ScanRenderer renderer(device, run);
    double n[2] = {0.0, 0.0}, right[2] = {0.0, 0.0};
    for (const int position : run.split.test) {
        const Frame& frame = run.log.frames[std::size_t(position)];
        const RenderedScan scan = renderer.render(choose_sensor("native", run.config, run.log), frame.time_s);
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            const bool is_far = scan.median_range_m[i] > 0.8f * kReach_m && scan.weight[i] > 0.9f;
            const bool of_weak = is_far && is_well_inside(frame.scan.rays.direction[i]);
            n[of_weak] += 1.0;
            right[of_weak] += (scan.image.drop_prob[i] > 0.5f) == !(frame.scan.range_m[i] > 0.0f);
        }
    }
    return {right[1] / n[1], right[0] / n[0]};
}

class RefineDrops : public test::DeviceTest {
protected:
    const std::filesystem::path& folder() { return scratch_.path; }

private:
    ScratchFolder scratch_;
};

TEST_F(RefineDrops, NetworkKnowsWhatTheSensorDoesOnHeldOutFrames) {
    relidar::Run run = make_weak_run(device());
    const auto [weak_before, others_before] = measure_accuracies(device(), run);
    run.drop_network = train_drops(device(), run);
    const auto [weak_after, others_after] = measure_accuracies(device(), run);
    EXPECT_LT(1.0 - weak_after, 0.65 * (1.0 - weak_before));
    EXPECT_GT(others_after, others_before) << "what training has not finished is corrected, too";
    run.config.refine.enabled = false;
    EXPECT_EQ(measure_accuracies(device(), run).first, weak_before) << "not asked for";
}

double compute_exact_accuracy(ScanRenderer& renderer, const StreetOptions& options, const Run& run,
                              const SimulatedSensor& sensor) {
    double n = 0.0, right = 0.0;
    for (const int position : run.split.test) {
        const double time_s = run.log.frames[std::size_t(position)].time_s;
        const RenderedScan scan = renderer.render(sensor, time_s);
        const Scan exact = cast_street_rays(options, sensor.rays, run.log.lidar_track(0), time_s);
        for (std::size_t i = 0; i < exact.range_m.size(); ++i, n += 1.0)
            right += (scan.image.drop_prob[i] > 0.5f) == !sensor.limits.contains(exact.range_m[i]);
    }
    return right / n;
}

TEST_F(RefineDrops, AnotherSensorIsNotWorse) {
    const StreetOptions options{
        .seed = 6, .n_frames = 11, .rows = 32, .columns = 512, .speed_mps = 4.0, .people = true};
    relidar::Run run = trained(device(), make_street_log(options));
    run.config.refine.epochs = 6;
    const SimulatedSensor sensor = choose_sensor("VLP-32C", run.config, run.log);
    ScanRenderer renderer(device(), run);
    const double before = compute_exact_accuracy(renderer, options, run, sensor);
    renderer.use_network(train_drops(device(), run));
    ASSERT_TRUE(renderer.has_network_for(sensor));
    EXPECT_GT(compute_exact_accuracy(renderer, options, run, sensor), before);
}

/// Mean drop probability of the rays of even (0) or odd (1) beams that hit a car in the
/// held-out frames.
double measure_car_drops(Device& device, const Run& run, const SimulatedSensor& sensor, int parity) {
    ScanRenderer renderer(device, run);
    double n = 0.0, sum = 0.0;
    for (const int position : run.split.test) {
        const RenderedScan scan = renderer.render(sensor, run.log.frames[std::size_t(position)].time_s);
        for (std::size_t i = 0; i < scan.instance.size(); ++i) {
            if (scan.instance[i] <= 0 || scan.ring[i] % 2 != parity || scan.weight[i] < 0.9f) continue;
            n += 1.0;
            sum += double(scan.image.drop_prob[i]);
        }
    }
    EXPECT_GT(n, 50.0);
    return sum / n;
}

/// Cars are so dark that half of the rays return: those of even beams. Surfels cannot
/// represent this, because beams of both kinds hit each of them.
TEST_F(RefineDrops, BeamsThatAreTooWeakForCarsDropThere) {
    relidar::Run run = make_weak_run(device());
    run.config.refine.epochs = 1;
    run.config.refine.rate = 1e-9;  // the network itself corrects nothing
    for (std::size_t m = 1; m < run.scene.models.size(); ++m) {
        const SurfelModel& car = run.scene.models[m];
        const auto first = run.scene.surfels.sh.begin() + std::ptrdiff_t(std::size_t(car.first) * kShFloats);
        for (std::size_t i = 0; i < std::size_t(car.count) * kShFloats; ++i)
            if (i % kShFloats >= 16) first[std::ptrdiff_t(i)] = 0.0f;  // equal hit and drop logits
    }
    SimulatedSensor sensor = choose_sensor("native", run.config, run.log);
    ScanRenderer renderer(device(), run);
    for (Frame& frame : run.log.frames) {
        const RenderedScan scan = renderer.render(sensor, frame.time_s);
        for (std::size_t i = 0; i < scan.instance.size(); ++i)
            if (scan.instance[i] > 0) frame.scan.range_m[i] = scan.ring[i] % 2 == 1 ? 0.0f : 10.0f;
    }
    EXPECT_NEAR(measure_car_drops(device(), run, sensor, 1), 0.5, 0.1);
    run.drop_network = train_drops(device(), run);
    // Rays of even beams all return, so their values are negative, those of odd beams
    // positive. In the optimum, the derivative by the error that all beams share is 0.
    // Then the sum of the values is 0, because the prior is the same for each beam.
    const std::vector<float>& logits = run.drop_network.actor_logits;
    ASSERT_EQ(logits.size(), run.log.count_beams());
    double sum = 0.0, size = 0.0;
    for (std::size_t beam = 0; beam < logits.size(); ++beam) {
        const double towards_drop = beam % 2 == 1 ? logits[beam] : -logits[beam];
        EXPECT_GE(towards_drop, 0.0) << beam;
        sum += logits[beam];
        size += towards_drop;
    }
    EXPECT_GT(size, 0.0);
    EXPECT_NEAR(sum, 0.0, 0.01 * size);
    // Few rays of each beam hit the cars, so the prior keeps the values small.
    EXPECT_GT(measure_car_drops(device(), run, sensor, 1), 0.2 + measure_car_drops(device(), run, sensor, 0));
    sensor.is_log_lidar = false;
    EXPECT_NEAR(measure_car_drops(device(), run, sensor, 1), measure_car_drops(device(), run, sensor, 0), 0.1)
        << "a sensor with other lasers";
}

TEST_F(RefineDrops, ANetworkOfCellsRefinesImagesOfTheirGridAlone) {
    relidar::Run run = make_weak_run(device());
    run.config.sensor.grid = "kitti360";
    run.config.refine.image = "grid";
    run.config.refine.epochs = 1;
    run.drop_network = train_drops(device(), run);
    EXPECT_EQ(run.drop_network.image, "kitti360");
    ScanRenderer renderer(device(), run);
    const SimulatedSensor grid = make_sensor(run.config, run.log),
                          native = choose_sensor("native", run.config, run.log);
    EXPECT_TRUE(renderer.has_network_for(grid));
    EXPECT_FALSE(renderer.has_network_for(native));
    renderer.add_channels("surfel_drop_prob");
    const RenderedScan refined = renderer.render(grid, 0.5);
    renderer.use_network({});
    EXPECT_FALSE(renderer.has_network_for(grid));
    const RenderedScan plain = renderer.render(grid, 0.5);
    EXPECT_EQ(*find_values<float>(refined.channels, "surfel_drop_prob"), plain.image.drop_prob);
    EXPECT_NE(refined.image.drop_prob, plain.image.drop_prob);
    EXPECT_EQ(refined.image.range_m, plain.image.range_m);
}

void train_until(Device& device, const Run& run, int step, const std::filesystem::path& folder,
                 const Checkpoint* start = nullptr) {
    int done = 0;
    RayDropTrainingSession session;
    session.step = [&](const RayDropTrainProgress& p) { done = p.step; };
    session.stop = [&] { return done >= step; };
    session.checkpoints = folder;
    session.start = start;
    EXPECT_TRUE(train_drops(device, run, session).empty());
    EXPECT_EQ(done, step);
}

Checkpoint newest(const std::filesystem::path& folder) {
    std::optional<Checkpoint> checkpoint =
        load_newest(folder, [](const std::string& line) { ADD_FAILURE() << line; });
    if (!checkpoint) throw DataError("no checkpoint in " + folder.string());
    return std::move(*checkpoint);
}

TEST_F(RefineDrops, GoesOnFromACheckpointWithTheSameBits) {
    relidar::Run run = make_weak_run(device());
    run.config.refine.epochs = 4;
    run.config.refine.frames = 3;
    const std::filesystem::path checkpoints = folder() / "checkpoints";
    const RayDropNetwork expected = train_drops(device(), run);
    const int of_epoch = run.config.refine.frames;
    train_until(device(), run, 2 * of_epoch + 1, checkpoints);
    EXPECT_EQ(list_checkpoints(checkpoints).size(), 2u);
    const Checkpoint half = newest(checkpoints);
    EXPECT_EQ(half.iteration, 2 * of_epoch + 1);
    EXPECT_EQ(read_checkpoint(list_checkpoints(checkpoints).front()).iteration, 2 * of_epoch);

    run.folder = folder() / "run";
    save_run(run);
    relidar::Run loaded = load_run(run.folder);
    copy_scans(loaded, loaded.split.train, run.log);
    check_drop_resume(half, loaded);
    const RayDropNetwork resumed = train_drops(device(), loaded, {.start = &half});
    EXPECT_EQ(resumed.parameters, expected.parameters);
    EXPECT_EQ(resumed.running, expected.running);
    EXPECT_EQ(resumed.normalisation, expected.normalisation);

    train_until(device(), run, 3 * of_epoch, checkpoints, &half);
    const Checkpoint later = newest(checkpoints);
    EXPECT_EQ(train_drops(device(), run, {.start = &later}).parameters, expected.parameters);
}

TEST_F(RefineDrops, ACheckpointOfSomethingElseIsRefusedByName) {
    relidar::Run run = make_weak_run(device());
    run.config.refine.epochs = 1;
    run.config.refine.frames = 3;
    train_until(device(), run, 2, folder());
    const Checkpoint checkpoint = newest(folder());
    const auto message = [&](const relidar::Run& other) {
        try {
            train_drops(device(), other, {.start = &checkpoint});
        } catch (const Error& error) {
            return fmt::format("{} {}", int(error.code()), error.what());
        }
        return std::string("nothing thrown");
    };
    relidar::Run other = run;
    other.config.refine.rate = 0.5;
    EXPECT_THAT(message(other), test::Names("2 ... step 2 ... refine.rate ... 0.5 ... 0.01"));
    read_drop_settings(checkpoint, other.config);
    EXPECT_EQ(other.config.refine.rate, run.config.refine.rate);
    other.config.train.log_every = 7;
    other.config.train.checkpoint_minutes = 3.0;
    other.config.refine.enabled = false;
    check_drop_resume(checkpoint, other);
    other = run;
    other.scene.surfels.sh[5] += 0.001f;
    EXPECT_THAT(message(other), test::Names("3 ... step 2 ... scene"));
    other = run;
    other.log.frames[std::size_t(run.split.train[3])].scan.range_m[7] += 0.5f;
    EXPECT_THAT(message(other), test::Names("scans"));
    Checkpoint of_surfels = checkpoint;
    std::erase_if(of_surfels.arrays, [](const NamedArray& array) { return array.name == "moment2"; });
    EXPECT_THROW(train_drops(device(), run, {.start = &of_surfels}), DataError);
}

TEST_F(RefineDrops, StopGivesNothingAndBadLogsAreRefused) {
    relidar::Run run = make_weak_run(device());
    int n_stop_calls = 0;
    EXPECT_TRUE(train_drops(device(), run, {.stop = [&] { return ++n_stop_calls > 15; }}).empty());
    EXPECT_TRUE(train_drops(device(), run, {.stop = [] { return true; }}).empty());
    const auto message = [&] { return get_data_error_message([&] { train_drops(device(), run); }); };
    for (Frame& frame : run.log.frames) {
        frame.scan.rays.rows = 1;
        frame.scan.rays.columns = int(frame.scan.rays.size());
    }
    EXPECT_THAT(message(), test::Names("rows"));
    run.log = make_weak_street();
    for (Frame& frame : run.log.frames)
        for (float& range_m : frame.scan.range_m) range_m = std::max(range_m, 1.0f);
    EXPECT_THAT(message(), test::Names("dropped"));
}

TEST(Stripes, HaveTheRaysOfTheirPixels) {
    RayTable all = make_street_log({.n_frames = 1, .rows = 16, .columns = 1000}).frames[0].scan.rays;
    std::vector<float> number(all.size());
    std::iota(number.begin(), number.end(), 0.0f);
    std::copy(number.begin(), number.end(), all.time_offset_s.begin());
    for (const std::size_t of_frame : {0u, 1u, 2u, 14u, 15u, 31u}) {
        const ImageStripes stripes(3, all, of_frame);
        const RayTable some = stripes.stripe_rays(all);
        EXPECT_EQ(some.rows, 16);
        EXPECT_EQ(some.columns, 5 * ImageStripes::kStripeColumns);
        EXPECT_EQ(to_vector(some.time_offset_s), stripes.stripe_values(number)) << "frame " << of_frame;
    }
}

TEST(Stripes, OfAllFramesSeeEveryColumn) {
    const Log street = make_street_log({.n_frames = 1, .rows = 4, .columns = 1000});
    const RayTable& all = street.frames[0].scan.rays;
    std::vector<float> number(all.size());
    for (std::size_t i = 0; i < number.size(); ++i) number[i] = float(i);
    std::set<float> sampled_indices;
    for (std::size_t of_frame = 0; of_frame < 8; ++of_frame)
        for (const float i : ImageStripes(3, all, of_frame).stripe_values(number)) sampled_indices.insert(i);
    EXPECT_EQ(sampled_indices.size(), all.size());
}

TEST(Stripes, OfASmallImageAreAllOfIt) {
    const Log street = make_street_log({.n_frames = 1, .rows = 16, .columns = 128});
    const RayTable& all = street.frames[0].scan.rays;
    for (const int share : {0, 1, 3})
        EXPECT_EQ(ImageStripes(share, all, 1).stripe_rays(all).size(), all.size()) << share;
    EXPECT_LT(choose_interval(all), 2);
}

}  // namespace

}  // namespace relidar
