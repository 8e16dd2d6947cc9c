// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

#include <array>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/log/log.hpp>

namespace relidar {
namespace {

Pose turned(double yaw_rad, glm::dvec3 translation) {
    return {glm::angleAxis(yaw_rad, glm::dvec3(0.0, 0.0, 1.0)), translation};
}

Frame make_frame(int index, double time_s, const std::vector<glm::vec3>& points, float offset_s) {
    Frame frame{index, time_s, {}};
    for (const glm::vec3& p : points) {
        frame.scan.rays.origin.emplace_back(0.0f);
        frame.scan.rays.direction.push_back(glm::normalize(p));
        frame.scan.rays.time_offset_s.push_back(offset_s);
        frame.scan.rays.channel.push_back(0);
        frame.scan.range_m.push_back(glm::length(p));
        frame.scan.intensity.push_back(float(index) + 0.25f);
    }
    frame.scan.rays.rows = 1;
    frame.scan.rays.columns = int(points.size());
    return frame;
}

/// From a sensor that drives and turns. Each sweep has a single return. The tests
/// evaluate sweep 2.
Log drive(bool rolling_shutter) {
    Log s;
    s.rolling_shutter = rolling_shutter;
    for (int i = 0; i < 5; ++i) {
        s.frames.push_back(
            make_frame(i, 0.1 * i, {{10.0f + float(i), 2.0f, 1.0f}}, rolling_shutter ? 0.01f : 0.0f));
        s.world_from_vehicle.append(0.1 * i, turned(0.05 * i, {1.5 * i, 0.1 * i, 0.0}));
    }
    return s;
}

TEST(Neighbours, AreTheNearestTrainingFramesMovedByThePoses) {
    const Log s = drive(false);
    const Scan points = predict_scan(s, 2, {0, 1, 4}, BoxPointMotion::stay);  // frame 3 is held out too
    ASSERT_EQ(points.range_m.size(), 2u);
    const int frames[] = {1, 4};
    for (std::size_t k = 0; k < 2; ++k) {
        const auto f = std::size_t(frames[k]);
        const glm::dvec3 expected =
            inverse(s.world_from_vehicle.pose[2]) *
            (s.world_from_vehicle.pose[f] * glm::dvec3(s.frames[f].scan.return_point(0)));
        EXPECT_LT(glm::distance(glm::dvec3(points.return_point(k)), expected), 1e-5);
        EXPECT_EQ(points.intensity[k], float(frames[k]) + 0.25f);
    }
    EXPECT_EQ(predict_scan(s, 4, {0, 1}, BoxPointMotion::stay).range_m.size(), 1u);
    EXPECT_THROW((void)predict_scan(s, 2, {}, BoxPointMotion::stay), DataError);
}

TEST(Neighbours, FollowTheRollingShutter) {
    const Log s = drive(true);
    const Scan points = predict_scan(s, 2, {1, 3}, BoxPointMotion::stay);
    ASSERT_EQ(points.range_m.size(), 2u);
    for (std::size_t k = 0; k < 2; ++k) {
        const Frame& from = s.frames[k == 0 ? 1 : 3];
        const glm::dvec3 world =
            s.world_from_vehicle.pose_at(from.time_s + 0.01) * glm::dvec3(from.scan.return_point(0));
        const glm::dvec3 predicted_m(points.return_point(k));
        const double azimuth = std::atan2(predicted_m.y, predicted_m.x),
                     t_s = 0.2 - azimuth / (2.0 * kPi) * s.lidars[0].sensor.period_s;
        // tolerance: the azimuth of the point changes while the head turns towards it
        EXPECT_LT(glm::distance(s.world_from_vehicle.pose_at(t_s) * predicted_m, world), 2e-3);
        EXPECT_GT(glm::distance(s.world_from_vehicle.pose_at(0.2) * predicted_m, world), 0.01);
    }
}

TEST(Neighbours, MoveWithTheirBoxes) {
    Log s = drive(false);
    for (Pose& pose : s.world_from_vehicle.pose) pose = {};
    // a box that moves by 1 m per frame and contains the points of frames 1 and 3
    BoxTrack box{"1", "Car", {4.0, 2.0, 2.0}, {}};
    for (int i = 0; i < 5; ++i) box.world_from_box.append(0.1 * i, turned(0.1 * i, {9.5 + i, 2.0, 1.0}));
    s.boxes = {box};
    const Scan still = predict_scan(s, 2, {1, 3}, BoxPointMotion::stay),
               moved = predict_scan(s, 2, {1, 3}, BoxPointMotion::follow);
    ASSERT_EQ(moved.range_m.size(), 2u);
    for (std::size_t k = 0; k < 2; ++k) {
        const std::size_t f = k == 0 ? 1 : 3;
        const glm::dvec3 world(s.frames[f].scan.return_point(0));
        EXPECT_LT(glm::distance(glm::dvec3(still.return_point(k)), world), 1e-5);
        const glm::dvec3 expected =
            box.world_from_box.pose[2] * (inverse(box.world_from_box.pose[f]) * world);
        EXPECT_LT(glm::distance(glm::dvec3(moved.return_point(k)), expected), 1e-5);
    }
    s.boxes[0].world_from_box.time_s.resize(2);  // the box does not exist in sweep 2
    s.boxes[0].world_from_box.pose.resize(2);
    EXPECT_EQ(predict_scan(s, 2, {1, 3}, BoxPointMotion::follow).range_m.size(), 1u);
}

SpinningSensor make_uneven_sensor() {
    SpinningSensor sensor;
    sensor.columns = 180;
    for (const double elevation_deg : {4.0, 1.5, 1.0, -2.0, -9.0})
        sensor.beams.push_back({elevation_deg * kPi / 180.0, 0.01, 0.02, 0.2, 0.03});
    sensor.first_azimuth_rad = kPi - kPi / 180.0;
    return sensor;
}

TEST(BinOntoRays, GivesEachRayItsOwnPoint) {
    std::mt19937 random(3);
    std::uniform_real_distribution<float> uniform(2.0f, 80.0f);
    const RayTable rays = make_rays(make_uneven_sensor());
    Scan points{rays, {}, {}};
    for (std::size_t i = 0; i < rays.size(); ++i) {
        points.range_m.push_back(uniform(random));
        points.intensity.push_back(uniform(random));
    }
    const Scan scan = assign_points(rays, points);
    for (std::size_t i = 0; i < rays.size(); ++i) {
        ASSERT_NEAR(scan.range_m[i], points.range_m[i], 1e-4) << i;
        ASSERT_EQ(scan.intensity[i], points.intensity[i]) << i;
    }
}

TEST(BinOntoRays, BeamsHaveAzimuthOffsetsAndSweepsStartAnywhere) {
    SpinningSensor sensor = make_uneven_sensor();
    for (std::size_t i = 0; i < sensor.beams.size(); ++i)
        sensor.beams[i].azimuth_offset_rad = i % 2 == 0 ? 0.3 : -0.3;
    for (const double first_azimuth_rad : {1.0, -2.0}) {
        sensor.first_azimuth_rad = first_azimuth_rad;
        const RayTable rays = make_rays(sensor);
        const Scan points{rays, ScanArray<float>(rays.size(), 30.0f), ScanArray<float>(rays.size(), 0.5f)};
        const Scan scan = assign_points(rays, points);
        EXPECT_EQ(scan.count_returns(), rays.size());
        for (std::size_t i = 0; i < rays.size(); ++i) ASSERT_NEAR(scan.range_m[i], 30.0, 1e-4) << i;
    }
}

/// A window of 90 degrees that looks backward, over the azimuth of 180 degrees. Points
/// beside the window belong to no ray.
TEST(BinOntoRays, AWindowEnds) {
    const RayTable rays = make_rays(WindowScanSensor{"", 4, 46, 1.25 * kPi, 0.75 * kPi, 0.1, -0.1});
    Scan points{rays, {}, ScanArray<float>(rays.size(), 0.5f)};
    for (std::size_t i = 0; i < rays.size(); ++i) points.range_m.push_back(5.0f + 0.1f * float(i));
    const Scan scan = assign_points(rays, points);
    for (std::size_t i = 0; i < rays.size(); ++i) ASSERT_NEAR(scan.range_m[i], points.range_m[i], 1e-4) << i;
    for (glm::vec3& direction : points.rays.direction) direction.x = -direction.x;  // ahead
    EXPECT_EQ(assign_points(rays, points).count_returns(), 0u);
}

TEST(BinOntoRays, TakesTheNearestAndLeavesOutWhatNoBeamMeets) {
    const RayTable rays = make_rays(make_uneven_sensor());
    const std::size_t ray = 2 * 180 + 77;
    const auto at = [&](double elevation_deg) {
        const double e = elevation_deg * kPi / 180.0;
        return glm::vec3(std::cos(e), 0.0, std::sin(e));
    };
    Scan points{{1, 5, ScanArray<glm::vec3>(5), {}, {}, {}},
                {20.0f, 10.0f, 30.0f, 1000.0f, 1000.0f},
                {0.2f, 0.1f, 0.3f, 0.4f, 0.5f}};
    points.rays.origin = {rays.origin[ray], rays.origin[ray], rays.origin[ray], {}, {}};
    points.rays.direction = {rays.direction[ray], rays.direction[ray], rays.direction[ray], at(5.4),
                             at(-12.8)};
    const Scan scan = assign_points(rays, points);
    // points at 5.4 and -12.8 degrees are farther from any beam than half the beam
    // spacing
    EXPECT_EQ(scan.count_returns(), 1u);
    EXPECT_NEAR(scan.range_m[ray], 10.0, 1e-5);
    EXPECT_EQ(scan.intensity[ray], 0.1f);
    points.rays.direction[3] = at(5.1);
    points.rays.direction[4] = at(-12.2);
    EXPECT_EQ(assign_points(rays, points).count_returns(), 3u);
    EXPECT_THROW((void)assign_points(points.rays, points),
                 DataError);  // the rays have no image order
}

RangeImage image_of(std::vector<float> range_m, std::vector<float> drop_prob) {
    const std::size_t n = range_m.size();
    return {1,
            int(n),
            std::move(range_m),
            std::vector<float>(n, 0.5f),
            std::move(drop_prob),
            std::vector<glm::vec3>(n),
            std::vector<glm::vec3>(n, glm::vec3(1, 0, 0))};
}

TEST(Regions, ScoreTheirRealReturnsWhateverIsDropped) {
    const RangeImage real = image_of({10, 20, 30, 0, 50}, {0, 0, 0, 1, 0}),
                     rendered = image_of({11, 20, 33, 7, 50}, {0, 0.9f, 0.6f, 0, 0});
    const MetricValues row =
        evaluate_regions(rendered, real, make_regions(real, {true, false, true, true, false}));
    EXPECT_EQ(row.at("moving_boxes/pixels"), 2.0);    // pixel 3 has no return
    EXPECT_EQ(row.at("moving_boxes/returned"), 0.5);  // pixel 2 is dropped, but counts
    EXPECT_NEAR(row.at("moving_boxes/depth_medae_m"), 2.0, 1e-12);
    EXPECT_NEAR(row.at("moving_boxes/depth_rmse_m"), std::sqrt(5.0), 1e-12);
    EXPECT_EQ(row.at("moving_boxes/intensity_rmse"), 0.0);
    EXPECT_EQ(row.at("static/pixels"), 2.0);
    EXPECT_EQ(row.at("all/pixels"), 4.0);
    EXPECT_NEAR(row.at("all/depth_mae_m"), 1.0, 1e-12);
    EXPECT_EQ(row.at("range_0_20_m/pixels"), 2.0);  // 20 m belongs to the nearer range
    EXPECT_EQ(row.at("range_20_40_m/pixels"), 1.0);
    EXPECT_EQ(row.at("range_40_80_m/returned"), 1.0);
    const MetricValues none = evaluate_regions(rendered, real, {{"nothing", std::vector<bool>(5)}});
    EXPECT_EQ(none, (MetricValues{{"nothing/pixels", 0.0}}));
    EXPECT_THROW((void)evaluate_regions(rendered, real, {{"short", std::vector<bool>(4)}}), DataError);
}

/// An image of 2 x 4 pixels. Its rays cover a full turn, or are all parallel.
RangeImage make_two_rows(std::vector<float> range_m, bool full_turn) {
    RangeImage image = image_of(std::move(range_m), std::vector<float>(8, 0.0f));
    image.rows = 2;
    image.columns = 4;
    for (std::size_t i = 0; full_turn && i < 8; ++i)
        image.direction[i] = glm::vec3(std::array{1, 0, -1, 0}[i % 4], std::array{0, 1, 0, -1}[i % 4], 0);
    return image;
}

TEST(Regions, EdgesJumpByHalfAMetreAndFivePercent) {
    // Row 0 jumps by 0.5 m, which is not above the limit, and by 0.55 m. A ray of row 1
    // has no return, so its neighbours do not jump to each other.
    const RangeImage real = make_two_rows({10, 10.5f, 11.05f, 11.1f, 10.2f, 0, 30, 31}, false);
    EXPECT_EQ(mask_edges(real), (std::vector<bool>{false, true, true, true, false, false, true, true}));
    // 20.0 and 21.04 m: above 5 % of the nearer range, but not of the farther range
    const std::vector<float> far{20, 21.04f, 21.04f, 21.04f, 21.04f, 21.04f, 21.04f, 21.04f};
    EXPECT_EQ(mask_edges(make_two_rows(far, false)),
              (std::vector<bool>{true, false, false, false, false, false, false, false}));
    const std::vector<float> seam{10, 10, 10, 12, 10, 10, 10, 10};
    EXPECT_FALSE(mask_edges(make_two_rows(seam, false))[0]);
    EXPECT_TRUE(mask_edges(make_two_rows(seam, true))[0]) << "the last column is next to the first";
}

TEST(Regions, ScoreCloudsAndLargeErrors) {
    // Parallel rays along x from the same origin: the points are on a line.
    const RangeImage real = make_two_rows({10, 20, 20, 20, 10, 20, 20, 20}, false);
    RangeImage rendered = real;
    rendered.range_m = {10.04f, 18.9f, 20, 20, 10, 20.1f, 20, 20};
    rendered.drop_prob[4] = 1.0f;
    const MetricValues row = evaluate_regions(rendered, real, make_regions(real, std::vector<bool>(8)));
    EXPECT_EQ(row.at("edges/pixels"), 4.0);
    EXPECT_EQ(row.at("edges/share"), 0.5);
    EXPECT_EQ(row.at("edges/returned"), 0.75);
    EXPECT_NEAR(row.at("edges/above_1m"), 1.0 / 3.0, 1e-12);
    // rendered 10.04, 18.9, 20.1; real 10, 20, 10, 20
    EXPECT_NEAR(row.at("edges/cd_mean_m"), (0.04 + 1.1 + 0.1) / 3.0 + (0.04 + 0.1) / 2.0, 1e-5);
    EXPECT_NEAR(row.at("edges/f_5cm"), 0.4, 1e-12) << "precision 1/3, recall 1/2";
    EXPECT_NEAR(row.at("edges/f_22cm"), 0.8, 1e-12) << "precision 2/3, recall 1";
    EXPECT_EQ(row.at("smooth/share"), 0.5);
    EXPECT_EQ(row.at("smooth/cd_mean_m"), 0.0);
    EXPECT_FALSE(row.contains("static/cd_mean_m"));
    EXPECT_FALSE(evaluate_regions(image_of({10, 20}, {0, 0}), image_of({10, 20}, {0, 0}),
                                  make_regions(image_of({10, 20}, {0, 0}), {false, false}))
                     .contains("edges/pixels"))
        << "an unordered list of rays has no neighbours";
}

TEST(Regions, KnowWhatMoves) {
    Log s = drive(true);
    BoxTrack box{"1", "Car", {4.0, 2.0, 2.0}, {}};  // contains the point of frame 2 at its firing time
    const Pose then = s.world_from_vehicle.pose_at(0.21);
    for (int i = 0; i < 5; ++i)
        box.world_from_box.append(0.1 * i,
                                  {then.rotation, then * glm::dvec3(12.0, 2.0 + 2.0 * (i - 2.1), 1.0)});
    s.boxes = {box};
    EXPECT_EQ(mask_labelled_movers(s, s.frames[2]), std::vector<bool>{true});
    EXPECT_EQ(mask_labelled_movers(s, s.frames[2], {{1.0, 0.0, 0.0, 0.0}, {0.0, 2.0, 0.0}}),
              std::vector<bool>{false});
    EXPECT_EQ(mask_labelled_movers(s, s.frames[4]), std::vector<bool>{false});
    EXPECT_EQ(mask_found_movers(s, s.frames[2]), std::vector<bool>{false}) << "it is labelled";
    s.boxes[0].category = kDiscoveredCategory;
    EXPECT_EQ(mask_found_movers(s, s.frames[2]), std::vector<bool>{true});
    EXPECT_EQ(mask_found_movers(s, s.frames[4]), std::vector<bool>{false});
    EXPECT_EQ(mask_labelled_movers(s, s.frames[2]), std::vector<bool>{false}) << "it is scored on its own";
    s.boxes[0].category = "Car";
    // The labels end before frame 2. The discovery of moving objects has added the later
    // poses, and such poses must not change scores.
    s.boxes[0].n_after = 3;
    EXPECT_EQ(mask_labelled_movers(s, s.frames[2]), std::vector<bool>{false});
}

}  // namespace
}  // namespace relidar
