// SPDX-License-Identifier: Apache-2.0
#include "score/evaluation/actor_scores.hpp"

#include <algorithm>

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>
#include <relidar/score/evaluation.hpp>

namespace relidar {
namespace {

Config native() {
    Config config = make_preset("quick");
    config.sensor.grid = "native";
    return config;
}

class ActorScoresOf : public testing::Test {
protected:
    static void SetUpTestSuite() {
        street = make_street_log({.seed = 3,
                                  .n_frames = 6,
                                  .rows = 64,
                                  .columns = 1024,
                                  .range_noise_m = 0.01,
                                  .speed_mps = 5.0,
                                  .people = true,
                                  .gait = true});
    }
    static void TearDownTestSuite() { street = {}; }

    inline static Log street;
    const Frame& frame = street.frames[3];
    const RangeImage real = measured_image(native(), frame.scan);

    FrameActorScores compute_all_scores(const RangeImage& rendered) const {
        return score_actors(rendered, rendered.range_m, real, street, timing_of(frame));
    }
    MetricValues scores(const RangeImage& rendered) const { return compute_all_scores(rendered).metrics; }
};

TEST_F(ActorScoresOf, OfTheScanItselfAreTheBest) {
    const MetricValues scores_of_real = scores(real);
    EXPECT_EQ(scores_of_real.at("actors/people_f1"), 1.0);
    EXPECT_EQ(scores_of_real.at("actors/people_cd_m"), 0.0);
    EXPECT_EQ(scores_of_real.at("actors/people_3cm"), 1.0);
}

TEST_F(ActorScoresOf, KnowWhatIsFiveCentimetresOffAndWhatIsLost) {
    RangeImage off = real;
    for (float& range_m : off.range_m)
        if (range_m > 0.0f) range_m += 0.05f;
    const MetricValues farther = scores(off);
    EXPECT_GT(farther.at("actors/people_cd_m"), 0.04);
    EXPECT_LT(farther.at("actors/people_cd_m"), 0.1) << "no point is farther from its own one, both ways";
    EXPECT_LT(farther.at("actors/people_3cm"), 0.7);
    EXPECT_GT(farther.at("actors/people_f1"), 0.9);
    RangeImage lost = real;
    std::fill(lost.drop_prob.begin(), lost.drop_prob.end(), 1.0f);
    const MetricValues none = scores(lost);
    EXPECT_EQ(none.at("actors/people_f1"), 0.0);
    EXPECT_FALSE(none.contains("actors/people_cd_m"));
}

TEST_F(ActorScoresOf, RangesThatAreTooLongHaveThisBias) {
    RangeImage longer = real;
    for (std::size_t i = 0; i < longer.range_m.size(); ++i)
        if (real.range_m[i] > 0.0f) longer.range_m[i] += i % 3 == 0 ? 0.5f : 0.05f;
    const FrameActorScores actor_scores = compute_all_scores(longer);
    EXPECT_NEAR(actor_scores.metrics.at("actors/vehicles_bias_m"), 0.05, 1e-5);
    EXPECT_NEAR(actor_scores.metrics.at("actors/people_above_30cm"), 1.0 / 3.0, 0.02);
    std::size_t n_well_sampled = 0;
    for (const ActorScore& actor : actor_scores.actors) {
        if (actor.metrics.at("points_real") < 100.0) continue;
        ++n_well_sampled;
        EXPECT_NEAR(actor.metrics.at("range_medae_m"), 0.05, 1e-5) << actor.track;
        EXPECT_NEAR(actor.metrics.at("range_bias_m"), 0.05, 1e-5) << actor.track;
        EXPECT_NEAR(actor.metrics.at("range_above_30cm"), 1.0 / 3.0, 0.06) << actor.track;
    }
    EXPECT_GE(n_well_sampled, 3u);
}

TEST_F(ActorScoresOf, APointWhereACarWasIsInItsTail) {
    const Frame& last = street.frames.back();
    const BoxTrack* fastest = nullptr;
    const auto path_m = [&](const BoxTrack& box) {
        return glm::distance(box.world_from_box.pose_at(last.time_s).translation,
                             box.world_from_box.pose.front().translation);
    };
    for (const BoxTrack& box : street.boxes)
        if (box.is_observed(last.time_s) && (!fastest || path_m(box) > path_m(*fastest))) fastest = &box;
    ASSERT_TRUE(fastest);
    ASSERT_GT(path_m(*fastest), 0.5 * fastest->size_m.x + 0.5) << "it must have left the place";
    const Pose sensor_from_world =
        inverse(street.world_from_vehicle.mounted_pose_at(last.time_s, street.lidars[0].vehicle_from_sensor));
    const glm::dvec3 earlier = sensor_from_world * fastest->world_from_box.pose.front().translation;
    RangeImage ghost = measured_image(native(), last.scan);
    const RangeImage measured = ghost;
    const auto angle_to = [&](const glm::vec3& direction) {
        return -glm::dot(glm::dvec3(direction), glm::normalize(earlier));
    };
    const std::size_t ray =
        std::size_t(std::ranges::min_element(ghost.direction, {}, angle_to) - ghost.direction.begin());
    ghost.range_m[ray] = float(glm::length(earlier));
    ghost.drop_prob[ray] = 0.0f;
    const FrameActorScores actor_scores =
        score_actors(ghost, ghost.range_m, measured, street, timing_of(last));
    const auto actor = std::ranges::find(actor_scores.actors, fastest->id, &ActorScore::track);
    ASSERT_NE(actor, actor_scores.actors.end());
    EXPECT_EQ(actor->metrics.at("tail"), actor->metrics.at("tail_real") + 1.0);
}

TEST_F(ActorScoresOf, SeveralFramesAreWeightedByTheirPoints) {
    const std::vector<std::vector<ActorScore>> frames = {
        {{"a", "Car", {{"points", 8}, {"points_real", 10}, {"range_above_30cm", 0.5}, {"tail", 2}}},
         {"b", "Van", {{"points", 5}, {"points_real", 5}, {"range_above_30cm", 0.25}, {"tail", 0}}}},
        {{"a", "Car", {{"points", 30}, {"points_real", 30}, {"range_above_30cm", 0.1}, {"tail", 1}}},
         {"c", "Van", {{"points", 0}, {"points_real", 0}, {"tail", 4}}}}};
    const std::vector<ActorScore> all = average_scores(frames);
    ASSERT_EQ(all.size(), 3u);
    EXPECT_EQ(all[0].track, "b") << "the highest share of large errors is first";
    EXPECT_EQ(all[1].category, "Car");
    EXPECT_EQ(all[1].metrics.at("points_real"), 40.0);
    EXPECT_EQ(all[1].metrics.at("tail"), 3.0);
    EXPECT_NEAR(all[1].metrics.at("range_above_30cm"), 0.2, 1e-12);
    EXPECT_EQ(all[2].track, "c") << "a box without errors is last";
}

TEST_F(ActorScoresOf, NumbersOfPointsAreComparedOverLabelledVehicles) {
    const auto make = [](const char* category, double points, double n_real) {
        return ActorScore{category, category, {{"points", points}, {"points_real", n_real}}};
    };
    EXPECT_FALSE(median_points_error({make("Pedestrian", 30, 20), make("Car", 5, 9)}))
        << "people and boxes with few points do not count";
    ActorScore discovered = make("Car", 900, 100);
    discovered.is_discovered = true;
    const std::optional<double> error =
        median_points_error({make("Car", 80, 100), make("Van", 150, 100), make("Truck", 103, 100),
                             make("Cyclist", 900, 100), discovered});
    EXPECT_NEAR(error.value(), 0.2, 1e-12);
}

TEST_F(ActorScoresOf, TakePointsAtTheMomentOfTheirFiring) {
    const Pose mounted = street.lidars[0].vehicle_from_sensor;
    PoseTrack world_from_sensor = street.world_from_vehicle;
    for (Pose& pose : world_from_sensor.pose) pose = pose * mounted;
    std::size_t n_people = 0;
    for (const BoxTrack& box : street.boxes) {
        if (parse_kind(box.category) != ObjectKind::person || !box.is_observed(frame.time_s)) continue;
        ++n_people;
        std::size_t expected = 0;
        const glm::dvec3 half = 0.5 * box.size_m + 0.1;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            const WorldRay ray = make_world_ray(world_from_sensor, frame.time_s, frame.scan.rays, i, true);
            const double t_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
            const glm::dvec3 p = inverse(box.world_from_box.pose_at(t_s)) *
                                 (ray.origin_m + double(frame.scan.range_m[i]) * ray.direction);
            expected += glm::all(glm::lessThanEqual(glm::abs(p), half)) && p.z >= 0.15 - 0.5 * box.size_m.z;
        }
        const MovingBoxPoints points = points_in_box(real, real.range_m, real, street, timing_of(frame), box);
        EXPECT_NEAR(double(points.real_m.size()), double(expected), 2.0)
            << box.id << ": a point at the edge may fall to either side";
    }
    EXPECT_EQ(n_people, 3u);
}

}  // namespace
}  // namespace relidar
