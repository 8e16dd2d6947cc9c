// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cmath>
#include <map>

#include <relidar/base/error.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"
#include "support/same_surfels.hpp"
#include "train/frames/frame_data.hpp"

namespace relidar {
namespace {

StreetOptions make_small_street() { return {.n_frames = 11, .rows = 16, .columns = 256}; }

class Train : public test::DeviceTest {
protected:
    Train() {
        config.init.voxel_m = 0.4;
        config.train.iterations = 60;
        config.train.rays_per_iteration = 0;
        config.train.log_every = 10;
    }
    TrainResult train_street() { return train(device(), street, split, config); }
    RenderedScan render_held_out(const Scene& scene, bool is_log_lidar = false) {
        const Frame& frame = street.frames[std::size_t(split.test[0])];
        return ScanRenderer(device(), scene, config, street)
            .render({frame.scan.rays, std::nullopt, is_log_lidar}, frame.time_s);
    }

    double measure_held_out_error(const Scene& scene) {
        const RangeImage real = measured_image(config, street.frames[std::size_t(split.test[0])].scan);
        return evaluate(render_held_out(scene).image, real).at("strict/depth_mae_m");
    }

    Log street = make_street_log(make_small_street());
    Split split = split_frames(street, 10);
    Config config = make_preset("quick");
};
class TrainEither : public Train, public testing::WithParamInterface<PrimitiveType> {};
std::vector<PrimitiveType> list_all_primitives() {
    std::vector<PrimitiveType> all;
    for (const PrimitiveProperties& kind : kPrimitives) all.push_back(kind.primitive);
    return all;
}
INSTANTIATE_TEST_SUITE_P(Primitives, TrainEither, testing::ValuesIn(list_all_primitives()));

TEST_P(TrainEither, LearnsTheStreet) {
    config.image.primitive = GetParam();
    const TrainResult result = train_street();
    ASSERT_GE(result.log.size(), 6u);
    EXPECT_TRUE(std::isinf(result.log.front().eta_s)) << "the pace is not known yet";
    for (std::size_t i = 1; i < result.log.size(); ++i) {
        const TrainProgress &first = result.log.front(), &line = result.log[i];
        const double pace_s = (line.seconds - first.seconds) / (line.iteration - first.iteration);
        EXPECT_NEAR(line.eta_s, (60 - line.iteration) * pace_s, 1e-9 + 1e-6 * line.seconds);
    }
    EXPECT_LT(result.log.back().loss, 0.7 * result.log.front().loss);
    EXPECT_EQ(result.log.back().iteration, 60);
    EXPECT_FALSE(result.interrupted);
    EXPECT_EQ(result.scene.surfels.primitive, GetParam());
    config.train.iterations = 1;
    config.train.mean_rate = config.train.rotation_rate = config.train.scale_rate =
        config.train.opacity_rate = config.train.sh_rate = 1e-12;
    const TrainResult untrained = train_street();
    EXPECT_LT(measure_held_out_error(result.scene), 0.9 * measure_held_out_error(untrained.scene));
}

/// The first step of Adam equals the learning rate for any gradient. The rate must be
/// proportional to 4 x the diagonal of a car's box.
TEST_F(Train, MeansLearnAtTheExtentOfTheirOwnModel) {
    config.train.iterations = 1;
    config.densify.strategy = DensifyStrategy::adaptive;
    config.init.actor_min_points = 10;
    const Scene before = init_scene(street, split.train, config.init);
    const Scene after = train_street().scene;
    ASSERT_EQ(after.surfels.size(), before.surfels.size());
    ASSERT_GE(before.models.size(), 3u) << "the background and two cars";
    for (const SurfelModel& model : before.models) {
        const double extent_m = model.half_size_m.x > 0.0f ? 8.0 * double(glm::length(model.half_size_m))
                                                           : scene_extent_m(before);
        double farthest_m = 0.0;
        for (std::uint32_t i = model.first; i < model.first + model.count; ++i)
            for (int axis = 0; axis < 3; ++axis)
                farthest_m = std::max(farthest_m, std::abs(double(after.surfels.mean[i][axis]) -
                                                           double(before.surfels.mean[i][axis])));
        const double rate_m = config.train.mean_rate_final * extent_m;
        EXPECT_NEAR(farthest_m, rate_m, 0.02 * rate_m + 4e-6) << model.name;
    }
}

TEST_P(TrainEither, SurfelsGrowToSoManyTimesTheirFirstSizeAtMost) {
    config.image.primitive = GetParam();
    config.train.scale_rate = 0.1;
    config.train.max_growth = 1.3;
    const auto trained = [&](int iterations) {
        config.train.iterations = iterations;
        return train_street().scene.surfels;
    };
    const Surfels first = trained(0), last = trained(20);
    ASSERT_EQ(first.size(), last.size());
    std::size_t at_the_bound = 0;
    for (std::size_t i = 0; i < last.size(); ++i) {
        const bool has_three = properties_of(first.primitive).third_scale;
        const float began = std::max(
            {first.log_scale[i].x, first.log_scale[i].y, has_three ? first.log_scale_w[i] : -100.0f});
        const float ended =
            std::max({last.log_scale[i].x, last.log_scale[i].y, has_three ? last.log_scale_w[i] : -100.0f});
        EXPECT_LE(ended - began, std::log(1.3f) + 1e-5f);
        at_the_bound += ended - began > std::log(1.29f);
    }
    EXPECT_GT(at_the_bound, last.size() / 100);
}

/// With a single drop logit per ray, hit logits must stay 0.
TEST_F(Train, SingleDropLogitStartsAsTwoAndLeavesHitLogits) {
    config.init.hit_margin = 2.1;
    const auto trained = [&](bool single, int iterations) {
        config.image.single_drop_logit = single;
        config.train.iterations = iterations;
        return train_street();
    };
    const RangeImage two = render_held_out(trained(false, 0).scene).image,
                     one = render_held_out(trained(true, 0).scene).image;
    ASSERT_EQ(one.drop_prob.size(), two.drop_prob.size());
    for (std::size_t i = 0; i < one.drop_prob.size(); ++i)
        EXPECT_NEAR(one.drop_prob[i], two.drop_prob[i], 1e-5f);

    const TrainResult result = trained(true, 40);
    const std::vector<float>& sh = result.scene.surfels.sh;
    float lowest_drop = sh[2 * kShCoefficients], highest_drop = lowest_drop;
    for (std::size_t i = 0; i < result.scene.surfels.size(); ++i) {
        const float* hit = sh.data() + i * kShFloats + kShCoefficients;
        ASSERT_NEAR(0.5f + 0.28209479f * hit[0], 0.0f, 1e-6f);
        for (int k = 1; k < kShCoefficients; ++k) ASSERT_EQ(hit[k], 0.0f);
        lowest_drop = std::min(lowest_drop, hit[kShCoefficients]);
        highest_drop = std::max(highest_drop, hit[kShCoefficients]);
    }
    EXPECT_GT(highest_drop - lowest_drop, 0.1f) << "all start equal";
    const auto drop_term = [](const TrainProgress& progress) { return progress.terms[2]; };
    EXPECT_LT(drop_term(result.log.back()), 0.8 * drop_term(result.log.front()));
}

/// Without memory for the hits, training must fail instead of becoming nondeterministic.
TEST_F(Train, DeterministicTrainingRepeatsItself) {
    StreetOptions options = make_small_street();
    options.n_frames = 5;
    street = make_street_log(options);
    split = split_frames(street, 10);
    const Config small = config;
    for (const ShDirection direction : {ShDirection::surfel, ShDirection::ray}) {
        config = small;
        config.image.sh_direction = direction;
        config.init.actor_min_points = 10;
        config.train.iterations = 20;
        config.train.deterministic = true;
        config.loss.likelihood = 0.01f;
        const TrainResult first = train_street(), second = train_street();
        EXPECT_GT(first.scene.models.size(), 1u);
        test::expect_same_surfels(first.scene.surfels, second.scene.surfels);
        ASSERT_EQ(first.log.size(), second.log.size());
        for (std::size_t i = 0; i < first.log.size(); ++i)
            EXPECT_NEAR(first.log[i].loss, second.log[i].loss, 1e-5 * first.log[i].loss)
                << "the log's sums use atomics";
    }
}

TEST_F(Train, StopsWhenAskedAndKeepsTheScene) {
    int calls = 0;
    const TrainResult result =
        train(device(), street, split, config, [&](const TrainProgress&) { return ++calls < 2; });
    EXPECT_TRUE(result.interrupted);
    EXPECT_EQ(result.log.back().iteration, 10);
    EXPECT_GT(result.scene.surfels.size(), 100u);
    for (const glm::vec3& p : result.scene.surfels.mean) ASSERT_TRUE(std::isfinite(p.x + p.y + p.z));
}

TEST_F(Train, ActorsBeatMasking) {
    StreetOptions options = make_small_street();
    options.rows = 32;
    options.columns = 512;
    street = make_street_log(options);
    const Frame& frame = street.frames[std::size_t(split.test[0])];
    std::map<std::string, double> error;
    config.init.actor_min_points = 20;
    config.train.rays_per_iteration = 4096;
    // a car has a few hundred points, so a factor of 0.4 would leave holes between its
    // surfels
    config.init.scale_factor = 0.8;
    for (const std::string classes : {"Car", ""}) {
        config.init.actor_classes = classes;
        const TrainResult result = train_street();
        EXPECT_EQ(result.scene.models.size(), classes.empty() ? 1u : 3u);
        const RenderedScan scan = render_held_out(result.scene);
        std::vector<double> errors;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            const WorldRay w =
                make_world_ray(street.world_from_vehicle, frame.time_s, frame.scan.rays, i, true);
            const glm::dvec3 p = w.origin_m + double(frame.scan.range_m[i]) * w.direction;
            if (is_in_moving_box(street.boxes, p, frame.time_s + frame.scan.rays.time_offset_s[i], -0.05))
                errors.push_back(std::abs(scan.image.range_m[i] - frame.scan.range_m[i]));
        }
        ASSERT_GT(errors.size(), 20u);
        std::nth_element(errors.begin(), errors.begin() + std::ptrdiff_t(errors.size() / 2), errors.end());
        error[classes] = errors[errors.size() / 2];
    }
    EXPECT_LT(error["Car"], 0.15);
    EXPECT_LT(3.0 * error["Car"], error[""]);
}

struct MaskedReturns {
    double cars = 0, masked_cars = 0, rest = 0, masked_rest = 0;

    void add_frame(const Log& street, const Frame& frame, const IgnoredMeasurements& unknown,
                   const std::vector<BoxTrack>& boxes) {
        std::vector<DeviceRay> rays;
        std::vector<DeviceTarget> targets;
        make_frame_arrays(street, frame, unknown, rays, targets);
        for (std::size_t i = 0; i < rays.size(); ++i) {
            if (!(targets[i].range_m > 0.0f)) continue;
            const glm::dvec3 p =
                glm::dvec3(rays[i].origin) + double(targets[i].range_m) * glm::dvec3(rays[i].direction);
            const bool car = is_in_moving_box(boxes, p, frame.time_s, 0.0);
            (car ? cars : rest) += 1;
            (car ? masked_cars : masked_rest) += targets[i].weight == 0.0f;
        }
    }
};

TEST(Targets, RaysOfMovingBoxesAreUnknown) {
    const Log street = make_street_log(make_small_street());
    MaskedReturns n;
    for (const Frame& frame : street.frames) n.add_frame(street, frame, {}, street.boxes);
    ASSERT_GT(n.cars, 50);
    EXPECT_GE(n.masked_cars, 0.99 * n.cars);
    EXPECT_LE(n.masked_rest, 0.05 * n.rest);
}

TEST(Targets, RaysOnMovingCarsAreUnknownUnlessTheyAreActors) {
    Log street = make_street_log(make_small_street());
    const std::vector<BoxTrack> original_boxes = street.boxes;
    const std::size_t n_labels = street.frames.size() - 4;
    for (BoxTrack& box : street.boxes) {
        box.world_from_box.time_s.resize(n_labels);
        box.world_from_box.pose.resize(n_labels);
    }
    const auto masked_share = [&](std::size_t frame, bool are_actors) {
        IgnoredMeasurements unknown;
        if (are_actors) unknown.actors = {street.boxes[0].id, street.boxes[1].id};
        MaskedReturns n;
        n.add_frame(street, street.frames[frame], unknown, original_boxes);
        EXPECT_GT(n.cars, 5.0) << "the cars must be seen";
        return n.masked_cars / n.cars;
    };
    EXPECT_EQ(masked_share(n_labels - 1, true), 0.0) << "actors are known";
    EXPECT_GE(masked_share(n_labels - 1, false), 0.95);
    EXPECT_EQ(masked_share(n_labels + 1, false), 0.0) << "nobody knows where it is";
}

/// A vehicle body hides the ground to the left and below.
bool is_hidden(const RayTable& rays, std::size_t index) {
    const glm::vec3& d = rays.direction[index];
    return d.z < -0.1f && std::abs(std::atan2(d.y, d.x) - 1.5f) < 0.3f;
}

void hide_returns(Log& street) {
    for (Frame& frame : street.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
            if (is_hidden(frame.scan.rays, i)) frame.scan.range_m[i] = frame.scan.intensity[i] = 0.0f;
}

TEST_F(Train, SensorDropIsLearntApartFromTheScene) {
    hide_returns(street);
    config.train.sensor_drop = true;
    config.init.scale_factor = 0.8;  // large surfels, because the points are sparse
    const TrainResult result = train_street();
    ASSERT_FALSE(result.scene.sensor_drop.empty());
    const Frame& frame = street.frames[std::size_t(split.test[0])];
    const RenderedScan log_sensor_scan = render_held_out(result.scene, true),
                       other = render_held_out(result.scene);
    std::size_t hidden = 0, dropped = 0, visible_to_other = 0;
    for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
        if (!is_hidden(frame.scan.rays, i) || other.weight[i] < 0.9f) continue;
        ++hidden;
        dropped += log_sensor_scan.image.drop_prob[i] > 0.5f;
        visible_to_other += other.image.drop_prob[i] < 0.5f;
    }
    ASSERT_GT(hidden, 50u);
    EXPECT_GT(double(dropped), 0.8 * double(hidden));
    EXPECT_GT(double(visible_to_other), 0.8 * double(hidden)) << "another sensor has no such blind spot";
}

TEST_F(Train, ABlindSectorOfOneSweepIsRenderedBlind) {
    StreetOptions options = make_small_street();
    options.n_frames = 2;
    options.columns = 1024;
    street = make_street_log(options);
    split = {{0}, {0}};
    hide_returns(street);
    config.train.sensor_drop = true;
    const Frame& frame = street.frames[0];
    const RenderedScan scan = render_held_out(train_street().scene, true);
    std::size_t hidden = 0, dropped = 0, ground = 0, returned = 0;
    for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
        if (is_hidden(frame.scan.rays, i)) {
            ++hidden;
            dropped += scan.image.drop_prob[i] >= 0.5f;
        }
        if (frame.scan.range_m[i] > 0.0f && frame.scan.rays.direction[i].z < -0.1f) {
            ++ground;
            returned += scan.image.drop_prob[i] < 0.5f;
        }
    }
    EXPECT_GT(double(dropped), 0.97 * double(hidden)) << "discs around the sector reach into it";
    EXPECT_GT(double(returned), 0.95 * double(ground));
}

TEST_F(Train, NothingToTrainOnIsAnError) {
    EXPECT_THROW(train(device(), street, Split{}, config), DataError);
}

class Losses : public test::DeviceTest {};

TEST_F(Losses, EveryTermIsLogged) {
    const Log street = make_street_log({.n_frames = 5, .rows = 16, .columns = 256});
    for (const std::string batch : {"columns", "rays"}) {
        Config config = make_preset("quick");
        config.init.voxel_m = 0.4;
        config.init.actor_min_points = 20;
        config.init.max_scale_m = 2.0;
        config.loss.intensity_ssim = batch == "columns" ? 0.15f : 0.0f;
        config.loss.chamfer = 0.01f;
        config.loss.box = config.loss.likelihood = 0.01f;
        config.loss.box_scale_share = 0.01f;  // so that some surfel is too large
        config.train.iterations = 3;
        config.train.rays_per_iteration = 1024;
        const TrainResult result = train(device(), street, split_frames(street, 0), config);
        ASSERT_GT(result.scene.models.size(), 1u) << "an actor";
        for (std::size_t k = 0; k < kLossTerms; ++k) {
            const double term = result.log.back().terms[k];
            const bool off = k == loss_term::custom || (batch == "rays" && k == loss_term::ssim);
            EXPECT_TRUE(std::isfinite(term) && (term > 0.0) != off);
        }
    }
}

}  // namespace

}  // namespace relidar
