// SPDX-License-Identifier: Apache-2.0
// Tests pose refinement: moved rays (train/move_rays), gradients of the poses
// (train/knot_gradients) against central differences, Adam, and the synthetic street.
#include <algorithm>
#include <cmath>
#include <random>

#include <relidar/base/error.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/train/train.hpp>

#include "../registration/street_poses.hpp"
#include "../support/device.hpp"
#include "support/names.hpp"
#include "train/frames/training_frames.hpp"
#include "train/poses/pose_refiner.hpp"

namespace relidar {
namespace {

class Poses : public test::DeviceTest {};

using test::error_of;
using test::perturb_track;
using test::PoseError;

constexpr double kDegree = kPi / 180.0;

Log street_of(int n_frames, int rows, int columns, bool moving_cars = false) {
    return make_street_log(
        {.n_frames = n_frames, .rows = rows, .columns = columns, .moving_cars = moving_cars});
}

Twist draw_random_twist(std::mt19937_64& random, double sigma_m, double sigma_rad) {
    std::normal_distribution<double> normal(0.0, 1.0 / std::sqrt(3.0));
    Twist twist;
    for (std::size_t i = 0; i < 6; ++i) twist[i] = (i < 3 ? sigma_m : sigma_rad) * normal(random);
    return twist;
}

TrackCorrection draw_random_correction(const PoseTrack& track, std::mt19937_64& random) {
    TrackCorrection correction(track);
    for (int i = 0; i < 3; ++i) {
        for (std::size_t k = 0; k < track.pose.size(); ++k)
            correction.add_gradient(k, 1.0, draw_random_twist(random, 1.0, 1.0));
        correction.run_adam_step({.rate_m = 0.05, .rate_rad = 0.005});
    }
    return correction;
}

double dot(const glm::dvec3& a, const std::vector<float>& b, std::size_t first) {
    return a.x * b[first] + a.y * b[first + 1] + a.z * b[first + 2];
}

TEST_F(Poses, MovedRaysAreThoseOfTheCorrectedTrack) {
    for (const bool rolling : {true, false}) {
        Log street = street_of(5, 8, 64);
        street.rolling_shutter = rolling;
        TrainingFrames frames(device(), street, {0, 1, 3}, {.unknown = {}, .moves_rays = true});
        PoseCorrectedRays rays(device(), frames.all());
        std::mt19937_64 random(7);
        const TrackCorrection correction = draw_random_correction(street.world_from_vehicle, random);
        const PoseTrack corrected = correction.corrected_track();
        Stream stream(device());
        for (std::size_t f = 0; f < frames.all().size(); ++f) {
            rays.move_rays(stream, correction, frames[f]);
            stream.submit_and_wait();
            const std::vector<DeviceRay> moved = frames[f].device_rays().download(frames[f].n_rays);
            const Frame& frame = street.frames[std::size_t(frames[f].position)];
            double farthest = 0.0, base = 0.0;
            for (std::size_t i = 0; i < moved.size(); ++i) {
                const WorldRay expected =
                                   make_world_ray(corrected, frame.time_s, frame.scan.rays, i, rolling),
                               uncorrected = make_world_ray(street.world_from_vehicle, frame.time_s,
                                                            frame.scan.rays, i, rolling);
                farthest = std::max({farthest, glm::length(expected.origin_m - glm::dvec3(moved[i].origin)),
                                     glm::length(expected.direction - glm::dvec3(moved[i].direction))});
                base = std::max(base, glm::length(expected.origin_m - uncorrected.origin_m));
            }
            EXPECT_GT(base, 0.02) << "the correction moves something";
            EXPECT_LT(farthest, 5e-5) << "frame " << f << (rolling ? ", rolling shutter" : "");
        }
    }
}

std::vector<std::size_t> list_frame_ray_ids(const SampledBatch& batch,
                                            const std::vector<DeviceRay>& batch_rays,
                                            const std::vector<DeviceRay>& frame_rays) {
    std::vector<std::size_t> ids;
    for (std::uint32_t k = 0; k < batch.rays.n_rays; ++k) {
        const DeviceRay& ray = batch_rays[batch.rays.first + std::size_t(k) * batch.rays.stride];
        const auto is_same = [&](const DeviceRay& r) {
            return r.direction == ray.direction && r.origin == ray.origin;
        };
        ids.push_back(std::size_t(std::ranges::find_if(frame_rays, is_same) - frame_rays.begin()));
    }
    return ids;
}

/// L = sum a . origin' + b . direction' over the batch, differentiated in double.
TEST_F(Poses, GradientsAreThoseOfDifferences) {
    const Log street = street_of(5, 8, 64);
    TrainingFrames frames(device(), street, {1, 2, 4}, {.unknown = {}, .moves_rays = true});
    PoseCorrectedRays rays(device(), frames.all());
    std::mt19937_64 random(9);
    std::normal_distribution<float> normal;
    TrackCorrection correction = draw_random_correction(street.world_from_vehicle, random);
    Stream stream(device());
    Random draw(5);
    for (const auto& [batch_kind, f] : {std::pair{"rays", 0u}, {"columns", 1u}, {"columns", 2u}}) {
        Config config;
        config.loss.intensity_ssim = batch_kind == std::string("columns") ? 0.15f : 0.0f;
        config.train.rays_per_iteration = 130;
        BatchSampler sampler(device(), config, frames.all());
        rays.move_rays(stream, correction, frames[f]);
        const SampledBatch batch = sampler.draw_batch(stream, frames[f], draw);
        std::vector<float> upstream(6 * std::size_t(batch.rays.n_rays));
        for (float& x : upstream) x = normal(random);
        const Array<float, shared::DeviceRayGradients> d_rays(device(), std::span<const float>(upstream),
                                                              "ray gradients");
        rays.record_sums(stream, frames[f], batch, d_rays);
        stream.submit_and_wait();
        const std::vector<Twist> actual =
            rays.sum_gradients(rays.partial_sums().download(), frames[f].n_knots);
        const std::vector<DeviceRay> batch_rays = batch.rays.rays->download();
        const std::vector<DeviceRay> all = frames[f].device_rays().download(frames[f].n_rays);
        const Frame& frame = street.frames[std::size_t(frames[f].position)];
        const std::vector<std::size_t> ids = list_frame_ray_ids(batch, batch_rays, all);
        const auto loss = [&](const PoseTrack& track) {
            double sum = 0.0;
            for (std::size_t k = 0; k < ids.size(); ++k) {
                const WorldRay w = make_world_ray(track, frame.time_s, frame.scan.rays, ids[k], true);
                sum += dot(w.origin_m, upstream, 6 * k) + dot(w.direction, upstream, 6 * k + 3);
            }
            return sum;
        };
        for (std::size_t k = 0; k < actual.size(); ++k) {
            const std::size_t pose = frames[f].first_knot + k;
            double worst = 0.0, size = 0.0;
            for (std::size_t i = 0; i < 6; ++i) {
                const auto at = [&](double h) {
                    PoseTrack track = correction.corrected_track();
                    Twist twist{};
                    twist[i] = h;
                    track.pose[pose] = apply_twist(track.pose[pose], twist);
                    return loss(track);
                };
                const double expected = (at(1e-4) - at(-1e-4)) / 2e-4;
                worst = std::max(worst, std::abs(expected - actual[k][i]));
                size = std::max(size, std::abs(expected));
            }
            if (size == 0.0) EXPECT_EQ(worst, 0.0);
            else EXPECT_LT(worst, 0.02 * size) << batch_kind << ", pose " << pose;
        }
        EXPECT_GE(actual.size(), 2u);
    }
}

TEST(TrackCorrectionOf, AQuadraticBowl) {
    PoseTrack track;
    std::mt19937_64 random(3);
    std::vector<Twist> target_twists;
    for (int k = 0; k < 8; ++k) {
        track.time_s.push_back(0.1 * k);
        track.pose.push_back(apply_twist({}, draw_random_twist(random, 10.0, 1.0)));
        target_twists.push_back(draw_random_twist(random, 0.05, 0.005));
    }
    TrackCorrection correction(track);
    for (int i = 0; i < 2000; ++i) {
        for (std::size_t k = 0; k < 8; ++k) {
            if (k == 5) continue;  // held out
            Twist g;
            for (std::size_t j = 0; j < 6; ++j) g[j] = correction.correction_at(k)[j] - target_twists[k][j];
            correction.add_gradient(k, 1.0, g);
        }
        correction.run_adam_step({.rate_m = 5e-3 / (1 + 0.05 * i), .rate_rad = 5e-4 / (1 + 0.05 * i)});
    }
    for (std::size_t k = 0; k < 8; ++k)
        for (std::size_t j = 0; j < 6; ++j)
            EXPECT_NEAR(correction.correction_at(k)[j],
                        k == 5 ? 0.5 * (target_twists[4][j] + target_twists[6][j]) : target_twists[k][j],
                        j < 3 ? 1e-3 : 1e-4)
                << k;
    TrackCorrection strict(track);
    for (int i = 0; i < 200; ++i) {
        strict.add_gradient(2, 1.0, {1e-3, 0, 0, 0, 0, 0});
        strict.run_adam_step({.rate_m = 1e-3, .rate_rad = 1e-3, .prior_per_m2 = 0.05});
    }
    EXPECT_NEAR(strict.correction_at(2)[0], -0.01, 1e-3) << "where the prior's pull is the loss's";
}

Config make_refining_config(const std::string& refined, int iterations) {
    Config config = make_preset("quick");
    config.init.voxel_m = 0.2;
    config.train.iterations = iterations;
    config.train.rays_per_iteration = 0;
    config.train.sensor_drop = false;
    config.train.refine_poses = refined;
    return config;
}

std::pair<PoseError, PoseError> measure_errors_of_training(Device& device, const Config& config) {
    Log street = street_of(11, 32, 256);
    const PoseTrack exact = street.world_from_vehicle;
    set_trajectory(street, perturb_track(exact, 0.05, 0.3 * kDegree, 1));
    const Split split = split_frames(street, 0);
    const PoseError before = error_of(street.world_from_vehicle, exact, split.train);
    prepare_log(street, split, config);
    const TrainResult result = train(device, street, split, config);
    return {before, error_of(result.poses.value().world_from_vehicle, exact, split.train)};
}

TEST_F(Poses, OfTheSensorComeNearerByGradients) {
    Config config = make_refining_config("sensor", 50);
    config.train.pose_register = false;
    config.train.pose_rate_m = 1e-2;
    const auto [before, after] = measure_errors_of_training(device(), config);
    EXPECT_LT(after.median_m, 0.6 * before.median_m);
    EXPECT_LT(after.median_deg, 0.6 * before.median_deg);
}

TEST_F(Poses, OfTheSensorComeBack) {
    const PoseError after = measure_errors_of_training(device(), make_refining_config("sensor", 40)).second;
    EXPECT_LT(after.median_m, 0.01);
    EXPECT_LT(after.median_deg, 0.05);
}

/// The other rays do not affect the box and would take most of the time.
void keep_rays_near_boxes(Log& street, double margin_m) {
    for (Frame& frame : street.frames) {
        std::vector<std::size_t> near;
        Scan kept;
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
            const WorldReturn w = locate_return(street, frame, ray);
            if (std::none_of(street.boxes.begin(), street.boxes.end(), [&](const BoxTrack& box) {
                    return box.contains_point(w.point_m, w.time_s, margin_m);
                }))
                continue;
            near.push_back(ray);
            kept.range_m.push_back(frame.scan.range_m[ray]);
            kept.intensity.push_back(frame.scan.intensity[ray]);
        }
        kept.rays = select_rays(frame.scan.rays, near);
        frame.scan = std::move(kept);
    }
}

TEST_F(Poses, OfTheActorsComeBack) {
    Log street = make_street_log({.n_frames = 7, .rows = 32, .columns = 512});
    const std::vector<BoxTrack> exact = street.boxes;
    keep_rays_near_boxes(street, 1.5);
    for (BoxTrack& box : street.boxes) box.world_from_box = perturb_track(box.world_from_box, 0.1, 0.0, 3);
    Config config = make_refining_config("actors", 160);
    config.train.pose_rate_m = 1e-3;
    config.init.actor_min_points = 20;
    config.init.scale_factor = 0.8;  // uses larger surfels without holes, because a car has few points
    const TrainResult result = train(device(), street, split_frames(street, 0), config);
    ASSERT_TRUE(result.poses);
    const std::vector<int> all{0, 1, 2, 3, 4, 5, 6};
    for (std::size_t b = 0; b < exact.size(); ++b) {
        const PoseError before = error_of(street.boxes[b].world_from_box, exact[b].world_from_box, all),
                        after = error_of(result.poses->boxes[b].world_from_box, exact[b].world_from_box, all);
        EXPECT_LT(after.median_m, 0.5 * before.median_m);
    }
}

TEST_F(Poses, AreKeptWhereNoneIsRefined) {
    const Log street = street_of(4, 8, 64, true);
    EXPECT_FALSE(train(device(), street, split_frames(street, 0), make_refining_config("none", 2)).poses);
    Config config;
    EXPECT_THROW(set_value(config, "train.refine_poses", "sensors"), UsageError);
    std::vector<std::string> notes;
    TrainSession session;
    session.note = [&](const std::string& note) { notes.push_back(note); };
    config = make_refining_config("actors", 2);
    config.init.actor_classes = "";
    config.init.mask_others = false;
    train(device(), street, split_frames(street, 0), config, {}, session);
    ASSERT_EQ(notes.size(), 1u);
    EXPECT_THAT(notes[0], test::Names("train.refine_poses=actors"));
}

/// If the pose followed the scene of its own sweep, it would move away from the others.
TEST_F(Poses, OfASingleSweepStays) {
    const Log street = street_of(4, 8, 64, true);
    std::vector<std::string> notes;
    TrainSession session;
    session.note = [&](const std::string& note) { notes.push_back(note); };
    const auto poses = [&](const std::string& held_out) {
        return train(device(), street, split_frames(street, 0, held_out), make_refining_config("sensor", 2),
                     {}, session)
            .poses;
    };
    EXPECT_FALSE(poses("0:2,3"));
    EXPECT_THAT(notes, testing::Contains(test::Names("sweep")));
    notes.clear();
    EXPECT_TRUE(poses("0:2"));
    EXPECT_THAT(notes, testing::Not(testing::Contains(test::Names("sweep"))));
}

}  // namespace
}  // namespace relidar
