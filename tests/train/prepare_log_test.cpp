// SPDX-License-Identifier: Apache-2.0
// Tests that several processes (here: threads) that prepare a log together compute the
// same result as a single process, bit by bit.

#include <cmath>
#include <condition_variable>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <relidar/diff/rays.h>
#include <relidar/base/process_group.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"
#include "registration/street_poses.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

class GroupOfThreads {
public:
    explicit GroupOfThreads(int size) : size_(size), turns_of_(std::size_t(size)) {}

    ProcessGroup of(int rank) {
        return {rank, size_, [this, rank](const std::string& own) { return gather(std::size_t(rank), own); }};
    }
    /// By process (rank). Counts only results to which all processes contribute.
    std::vector<std::size_t> shared_bytes() const {
        std::vector<std::size_t> bytes(std::size_t(size_), 0);
        for (const auto& [turn, part] : parts_)
            for (std::size_t rank = 0; rank < part.size(); ++rank)
                bytes[rank] += part.back().empty() ? 0 : part[rank].size();
        return bytes;
    }

private:
    int size_;
    std::vector<std::size_t> turns_of_;  // [ranks] number of exchanges of each rank
    std::mutex mutex_;
    std::condition_variable all_here_;
    std::map<std::size_t, std::vector<std::string>> parts_;  // [rank] by exchange
    std::map<std::size_t, int> n_here_;

    std::string gather(std::size_t rank, const std::string& text) {
        std::unique_lock lock(mutex_);
        const std::size_t exchange_index = turns_of_[rank]++;
        std::vector<std::string>& parts = parts_[exchange_index];
        parts.resize(std::size_t(size_));
        parts[rank] = text;
        ++n_here_[exchange_index];
        all_here_.notify_all();
        all_here_.wait(lock, [&] { return n_here_[exchange_index] == size_; });
        std::string all;
        for (const std::string& part : parts) all += part;
        return all;
    }
};

/// Returns a log whose poses drift, whose moving objects have no labels, and whose beams
/// have offsets.
Log street(const StreetOptions& options) {
    Log street = make_street_log(options);
    street.boxes.clear();
    PoseTrack track = street.world_from_vehicle;
    for (std::size_t k = 0; k < track.pose.size(); ++k)
        track.pose[k].translation.y += 0.3 * std::sin(0.02 * double(k));
    set_trajectory(street, track);
    for (Frame& frame : street.frames)
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
            if (frame.scan.range_m[ray] > 0.0f)
                frame.scan.range_m[ray] += 0.04f * float(frame.scan.rays.channel[ray] % 3);
    return street;
}

std::vector<double> numbers(const Pose& pose) {
    const glm::dquat& q = pose.rotation;
    const glm::dvec3& t = pose.translation;
    return {q.w, q.x, q.y, q.z, t.x, t.y, t.z};
}

void expect_same(const Log& first, const Log& second) {
    for (std::size_t k = 0; k < first.world_from_vehicle.pose.size(); ++k)
        ASSERT_EQ(numbers(first.world_from_vehicle.pose[k]), numbers(second.world_from_vehicle.pose[k]))
            << "pose " << k;
    const std::vector<Beam>&beams = first.lidars[0].sensor.beams, &others = second.lidars[0].sensor.beams;
    for (std::size_t i = 0; i < beams.size(); ++i) {
        EXPECT_EQ(beams[i].range_offset_m, others[i].range_offset_m) << "beam " << i;
        EXPECT_EQ(beams[i].intensity_gain, others[i].intensity_gain) << "beam " << i;
        EXPECT_EQ(beams[i].intensity_offset, others[i].intensity_offset) << "beam " << i;
    }
    EXPECT_EQ(first.lidars[0].range_noise.sigma_m, second.lidars[0].range_noise.sigma_m);
    EXPECT_EQ(first.intensity_response.range_m, second.intensity_response.range_m);
    EXPECT_EQ(first.intensity_response.factor, second.intensity_response.factor);
    EXPECT_EQ(first.intensity_response.incidence, second.intensity_response.incidence);
    ASSERT_EQ(first.boxes.size(), second.boxes.size());
    for (std::size_t i = 0; i < first.boxes.size(); ++i) {
        EXPECT_EQ(first.boxes[i].id, second.boxes[i].id);
        EXPECT_EQ(first.boxes[i].size_m, second.boxes[i].size_m);
        ASSERT_EQ(first.boxes[i].world_from_box.time_s, second.boxes[i].world_from_box.time_s);
        for (std::size_t k = 0; k < first.boxes[i].world_from_box.pose.size(); ++k)
            EXPECT_EQ(numbers(first.boxes[i].world_from_box.pose[k]),
                      numbers(second.boxes[i].world_from_box.pose[k]));
    }
}

TEST(PrepareLog, AGroupFindsWhatOneProcessFinds) {
    const Log original_log =
        street({.n_frames = 400, .rows = 16, .columns = 128, .range_noise_m = 0.01, .people = true});
    const Split split = split_frames(original_log, 10);
    Config config;
    config.train.refine_poses = "sensor";
    config.init.unlabelled_movers = UnlabelledMoverPolicy::actors;
    config.sensor.calibrate = "range,intensity";
    Log alone = original_log;
    std::vector<std::string> separate_notes;
    prepare_log(alone, split, config,
                {[&](const std::string& line) { separate_notes.push_back(line); }, {}, {}});
    ASSERT_FALSE(alone.boxes.empty()) << "no mover is discovered";
    ASSERT_NE(alone.lidars[0].sensor.beams[0].range_offset_m, 0.0) << "no beam is calibrated";
    ASSERT_NE(numbers(alone.world_from_vehicle.pose[50]), numbers(original_log.world_from_vehicle.pose[50]));
    constexpr int kSize = 3;
    GroupOfThreads group(kSize);
    std::vector<Log> logs(std::size_t(kSize), original_log);
    std::vector<std::vector<std::string>> reported_lines(std::size_t(kSize), std::vector<std::string>{});
    std::vector<std::thread> processes;
    for (int rank = 0; rank < kSize; ++rank)
        processes.emplace_back([&, rank] {
            const auto report_line = [&, rank](const std::string& line) {
                reported_lines[std::size_t(rank)].push_back(line);
            };
            prepare_log(logs[std::size_t(rank)], split, config,
                        {.report_line = report_line, .stop = {}, .group = group.of(rank)});
        });
    for (std::thread& process : processes) process.join();
    for (const Log& log : logs) expect_same(log, alone);
    EXPECT_EQ(reported_lines[0], separate_notes);
    for (int rank = 1; rank < kSize; ++rank)
        EXPECT_TRUE(reported_lines[std::size_t(rank)].empty()) << "the first one tells";
    for (const std::size_t bytes : group.shared_bytes()) EXPECT_GT(bytes, 1000u) << "a process did nothing";
}

TEST(PrepareLog, WarnsOfPosesThatDoNotFitTheScans) {
    const Log good = street({.n_frames = 40, .rows = 32, .columns = 128, .range_noise_m = 0.01});
    Config config;
    config.train.allow_lost_scans = true;
    config.train.refine_poses = "sensor";
    const Split split = split_frames(good, 10);
    const auto warning_of = [&](Log log) {
        std::string report_text;
        prepare_log(log, split, config,
                    {[&](const std::string& line) { report_text += line + "\n"; }, {}, {}});
        const std::size_t at = report_text.find("warning: ");
        EXPECT_EQ(at != std::string::npos, !log.notes.empty()) << "info shows what training has said";
        return at == std::string::npos ? std::string() : report_text.substr(at);
    };
    EXPECT_EQ(warning_of(good), "");
    Log bad = good;  // drifts sideways, which the walls of the street show
    for (std::size_t k = 0; k < bad.world_from_vehicle.pose.size(); ++k)
        bad.world_from_vehicle.pose[k].translation.y += std::sin(2.0 * kPi * double(k) / 40.0);
    const std::string warning = warning_of(bad);
    EXPECT_THAT(warning, test::Names("poses"));
    EXPECT_THAT(warning, test::Names("w order"));
}

/// A bare tunnel does not show how far the vehicle drove.
TEST(PrepareLog, SaysWhichMotionTheScansDoNotShow) {
    PoseTrack track;
    for (int k = 0; k < 8; ++k) track.append(0.1 * k, {{1.0, 0.0, 0.0, 0.0}, {0.3 * k, 0.0, 1.5}});
    const std::vector<street::StreetShape> walls{{.centre = {0, 3, 2}, .half = {200, 0.2, 2}},
                                                 {.centre = {0, -3, 2}, .half = {200, 0.2, 2}},
                                                 {.centre = {0, 0, 4.2}, .half = {200, 4, 0.2}}};
    const Log tunnel = test::record_drive(track, walls, 360);
    for (const bool has_poses : {true, false}) {
        Config config;
        config.train.refine_poses = "sensor";
        if (!has_poses) config.dataset.poses = kNoPoses;
        Log log = tunnel;
        std::string text;
        prepare_log(log, split_frames(log, 0), config,
                    {[&](const std::string& line) { text += line + "\n"; }, {}, {}});
        EXPECT_THAT(text, test::Names("forward (frames 0, 1, 2"));
        EXPECT_EQ(text.find("warning: ") != std::string::npos, !has_poses) << text;
        EXPECT_EQ(log.notes.empty(), has_poses);
    }
}

TEST(PrepareLog, TheBodyThatCarriesTheLidarTrainsNothing) {
    Log log = make_street_log({.n_frames = 12, .rows = 32, .columns = 256, .moving_cars = false});
    const auto is_on_carrier = [](const glm::vec3& d) { return d.x < -0.9f && std::abs(d.z) < 0.2f; };
    for (Frame& frame : log.frames)
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
            if (is_on_carrier(frame.scan.rays.direction[ray])) frame.scan.range_m[ray] = 0.5f;
    relidar::Run run;
    run.config.train.refine_poses = "none";
    run.split = split_frames(log, 4);
    const Frame held_out = log.frames[std::size_t(run.split.test[0])];
    std::string report;
    prepare_log(log, run.split, run.config, {[&](const std::string& line) { report += line; }, {}, {}});
    EXPECT_THAT(report, test::Names("% of the returns are on the body ... 0.5 m"));
    EXPECT_EQ(log.frames[std::size_t(run.split.test[0])].scan.range_m, held_out.scan.range_m);
    run.log = std::move(log);
    const Frame& trained = run.log.frames[std::size_t(run.split.train[0])];
    // Scans that are read again later still have the returns of the body.
    for (const Frame& frame : {trained, held_out}) {
        const TrainingRays rays = make_training_rays(run, frame);
        for (std::size_t ray = 0; ray < rays.targets.size(); ++ray) {
            const bool is_body = is_on_carrier(frame.scan.rays.direction[ray]);
            if (is_body || frame.scan.range_m[ray] > 0.0f) {
                ASSERT_EQ(rays.targets[ray].weight, is_body ? 0.0f : 1.0f);
            }
        }
    }
    // The rays to the body have not observed the space behind it, although rays above and
    // below it have returns from there.
    const PoseTrack& track = run.log.world_from_vehicle;
    const Pose& first = track.pose.front();
    const auto observed_behind = [&] {
        const ObservedVoxelSet seen = observe_coverage(run.log, track, run.split.train, 80.0);
        return seen.observed_fraction(first * glm::dvec3(-7, 0, 0), first * glm::dvec3(-8.5, 0, 0));
    };
    EXPECT_LT(observed_behind(), 0.1);
    run.log.lidars[0].own_body = {};
    EXPECT_GT(observed_behind(), 0.9);
}

class PlaceHeldOut : public test::DeviceTest {};

Run train_small_run(Device& device) {
    relidar::Run run;
    run.log = make_street_log({.seed = 7, .n_frames = 12, .rows = 32, .columns = 512, .range_noise_m = 0.01});
    run.split = split_frames(run.log, 4);
    run.config = make_preset("quick");
    run.config.train.iterations = 60;
    run.config.train.rays_per_iteration = 4096;
    run.config.train.refine_poses = "none";
    run.scene = train(device, run.log, run.split, run.config).scene;
    run.config.train.refine_poses = "sensor";
    return run;
}

Run move_run(Device& device, const Twist& off) {
    static const Run trained = train_small_run(device);
    Run run = trained;
    for (const int k : run.split.test) {
        Pose& pose = run.log.world_from_vehicle.pose[std::size_t(k)];
        pose = apply_twist(pose, off);
    }
    return run;
}

TEST_F(PlaceHeldOut, FindsWhereTheyWereAndMovesNothingElse) {
    const PoseTrack exact =
        make_street_log({.seed = 7, .n_frames = 12, .rows = 2, .columns = 8}).world_from_vehicle;
    const Twist off{0.03, -0.02, 0.02, 1e-3, -2e-3, 2e-3};
    relidar::Run run = move_run(device(), off);
    const relidar::Run before = run;
    const HeldOutPoseReport placed = register_held_out(device(), run);
    ASSERT_EQ(placed.scans, run.split.test.size());
    EXPECT_TRUE(run.held_out_placed);
    EXPECT_EQ(placed.placed, placed.scans);
    const double off_m = glm::length(glm::dvec3(off[0], off[1], off[2]));
    EXPECT_NEAR(placed.median_m, off_m, 0.006);
    for (const int k : run.split.test) {
        const auto i = std::size_t(k);
        const Twist left = compute_twist(exact.pose[i], run.log.world_from_vehicle.pose[i]);
        EXPECT_LT(glm::length(glm::dvec3(left[0], left[1], left[2])), 0.006) << "frame " << k;
        EXPECT_LT(glm::length(glm::dvec3(left[3], left[4], left[5])), 5e-4) << "frame " << k;
    }
    for (const int k : run.split.train)
        EXPECT_EQ(run.log.world_from_vehicle.pose[std::size_t(k)].translation,
                  before.log.world_from_vehicle.pose[std::size_t(k)].translation);
    relidar::Run again = before;
    register_held_out(device(), again);
    for (const int k : run.split.test)
        EXPECT_EQ(again.log.world_from_vehicle.pose[std::size_t(k)].translation,
                  run.log.world_from_vehicle.pose[std::size_t(k)].translation);
}

TEST_F(PlaceHeldOut, DoesNothingWhereItIsNotAskedForOrStopped) {
    relidar::Run run = move_run(device(), {0.03, 0.0, 0.0, 0.0, 0.0, 0.0});
    const std::vector<Pose> before = run.log.world_from_vehicle.pose;
    const auto stays = [&] {
        for (std::size_t k = 0; k < before.size(); ++k)
            if (run.log.world_from_vehicle.pose[k].translation != before[k].translation) return false;
        return true;
    };
    int n_stop_calls = 0;
    EXPECT_EQ(register_held_out(device(), run, {{}, [&] { return ++n_stop_calls > 1; }}).scans, 0u);
    EXPECT_TRUE(stays()) << "stopped at the second scan";
    EXPECT_FALSE(run.held_out_placed);
    run.config.train.place_held_out = false;
    EXPECT_EQ(register_held_out(device(), run).scans, 0u);
    EXPECT_TRUE(stays());
    EXPECT_TRUE(run.held_out_placed) << "it was asked, and there was nothing to do";
    run.config.train.place_held_out = true;
    run.config.train.pose_register = false;
    EXPECT_EQ(register_held_out(device(), run).scans, 0u);
    EXPECT_TRUE(stays());
}

}  // namespace

}  // namespace relidar
