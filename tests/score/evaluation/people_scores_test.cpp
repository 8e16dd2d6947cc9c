// SPDX-License-Identifier: Apache-2.0
// Tests the scores of people for three scans: an exact copy, one with an offset of 5 cm,
// and one without people. Compares their points with those of each ray at its firing
// time.
#include "score/evaluation/people.hpp"

#include <gtest/gtest.h>

#include <relidar/log/dataset.hpp>
#include <relidar/score/evaluation.hpp>

namespace relidar {
namespace {

Config native() {
    Config config = make_preset("quick");
    config.sensor.grid = "native";
    return config;
}

class PeopleScores : public testing::Test {
protected:
    const Sequence street = make_synthetic_street({.seed = 3,
                                                   .n_frames = 6,
                                                   .rows = 64,
                                                   .columns = 1024,
                                                   .range_noise_m = 0.01,
                                                   .speed_mps = 5.0,
                                                   .people = true,
                                                   .gait = true});
    const Frame& frame = street.frames[3];
    const RangeImage real = real_image(native(), frame.scan);

    MetricRow scores(const RangeImage& rendered) const {
        return people_scores(rendered, rendered.range_m, real, street, moment_of(frame));
    }
};

TEST_F(PeopleScores, OfTheScanItselfAreTheBest) {
    const MetricRow own = scores(real);
    EXPECT_EQ(own.at("actors/people_f1"), 1.0);
    EXPECT_EQ(own.at("actors/people_cd_m"), 0.0);
    EXPECT_EQ(own.at("actors/people_3cm"), 1.0);
}

TEST_F(PeopleScores, KnowWhatIsFiveCentimetresOffAndWhatIsLost) {
    RangeImage off = real;
    for (float& range_m : off.range_m)
        if (range_m > 0.0f) range_m += 0.05f;
    const MetricRow farther = scores(off);
    EXPECT_GT(farther.at("actors/people_cd_m"), 0.04);
    EXPECT_LT(farther.at("actors/people_cd_m"), 0.1) << "no point is farther from its own one, both ways";
    EXPECT_LT(farther.at("actors/people_3cm"), 0.7);
    EXPECT_GT(farther.at("actors/people_f1"), 0.9);
    RangeImage lost = real;
    std::fill(lost.drop_prob.begin(), lost.drop_prob.end(), 1.0f);
    const MetricRow none = scores(lost);
    EXPECT_EQ(none.at("actors/people_f1"), 0.0);
    EXPECT_FALSE(none.contains("actors/people_cd_m"));
}

TEST_F(PeopleScores, TakePointsAtTheMomentOfTheirFiring) {
    const Pose mounted = street.lidars[0].vehicle_from_sensor;
    PoseTrack world_from_sensor = street.world_from_vehicle;
    for (Pose& pose : world_from_sensor.pose) pose = pose * mounted;
    std::size_t n_people = 0;
    for (const BoxTrack& box : street.boxes) {
        if (object_kind(box.category) != ObjectKind::person || !box.present(frame.time_s)) continue;
        ++n_people;
        std::size_t expected = 0;
        const glm::dvec3 half = 0.5 * box.size_m + 0.1;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            const WorldRay ray = world_ray(world_from_sensor, frame.time_s, frame.scan.rays, i, true);
            const double t_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
            const glm::dvec3 p = inverse(box.world_from_box.at(t_s)) *
                                 (ray.origin_m + double(frame.scan.range_m[i]) * ray.direction);
            expected += glm::all(glm::lessThanEqual(glm::abs(p), half)) && p.z >= 0.15 - 0.5 * box.size_m.z;
        }
        const PeoplePoints points = people_points(real, real.range_m, real, street, moment_of(frame), box);
        EXPECT_NEAR(double(points.real_m.size()), double(expected), 2.0)
            << box.id << ": a point at the edge may fall to either side";
    }
    EXPECT_EQ(n_people, 3u);
}

}  // namespace
}  // namespace relidar
