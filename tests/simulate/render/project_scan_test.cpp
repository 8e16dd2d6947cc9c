// SPDX-License-Identifier: Apache-2.0
// Tests scans in a grid: simulated points must be binned like real points. Also tests
// scans that are sampled from drop probabilities, and the scans of a rig.

#include <gtest/gtest.h>
#include <cmath>

#include <relidar/base/error.hpp>

#include "../plates.hpp"
#include "simulate/channels/channel_pairs.hpp"

namespace relidar {
namespace {

RenderedScan scan_of(const Pose& rig_from_sensor, float range_m) {
    const Pose start{{1, 0, 0, 0}, {5.0, 0.0, 0.0}},
        end{glm::angleAxis(0.4, glm::dvec3(0, 0, 1)), {7.0, 1.0, 0.0}};
    RenderedScan scan;
    scan.image.rows = 1;
    scan.image.columns = 2;
    scan.image.origin = {{0.1f, 0.0f, 0.0f}, {0.0f, 0.2f, 0.0f}};
    scan.image.direction = {{1.0f, 0.0f, 0.0f}, glm::normalize(glm::vec3(0.3f, -0.4f, 0.5f))};
    scan.image.range_m = scan.median_range_m = {range_m, 2.0f * range_m};
    scan.mean_range_m = {range_m + 1.0f, 2.0f * range_m - 2.0f};
    scan.image.intensity = {0.25f, 0.5f};
    scan.image.drop_prob = {0.0f, 0.1f};
    scan.weight = {1.0f, 0.9f};
    scan.instance = {0, 2};
    scan.channels = {
        {optional_channels()[0], std::vector<glm::vec3>{{-1.0f, 0.0f, 0.0f}, {0.0f, 0.0f, -1.0f}}}};
    scan.time_offset_s = {-0.05f, 0.04f};
    scan.ring = {3, 1};
    scan.track = mount_track({{0.0, 1.0}, {start, end}}, rig_from_sensor);
    scan.time_s = 0.5;
    scan.world_from_sensor = scan.track.pose_at(0.5);
    return scan;
}

const std::vector<glm::vec3>& get_normals(const RenderedScan& scan) {
    return *find_values<glm::vec3>(scan.channels, "normal");
}

glm::dvec3 compute_world_point(const RenderedScan& scan, std::size_t index) {
    return scan.firing_pose(index) *
           glm::dvec3(scan.image.origin[index] + scan.image.range_m[index] * scan.image.direction[index]);
}

/// The last ray of the second row is fired later than the first ray of its column.
RenderedScan arrange_in_two_rows(RenderedScan scan) {
    const auto twice = []<class T>(std::vector<T>& values) {
        const std::vector<T> once = values;
        values.insert(values.end(), once.begin(), once.end());
    };
    for_basic_channels(RenderedScan(scan), scan,
                       [&](const ChannelInfo&, const auto&, auto& values) { twice(values); });
    twice(scan.image.origin);
    twice(scan.image.direction);
    twice(scan.time_offset_s);
    twice(scan.ring);
    twice(std::get<std::vector<glm::vec3>>(scan.channels[0].values));
    scan.image.rows = 2;
    scan.time_offset_s.back() += 0.01f;
    return scan;
}

TEST(MergeScans, PointsOfRowsStayWhereTheyAre) {
    const Pose mounting{glm::angleAxis(1.2, glm::normalize(glm::dvec3(1, 2, 3))), {1.0, -0.5, 2.0}};
    const RenderedScan scan = arrange_in_two_rows(scan_of(mounting, 10.0f)),
                       merged = merge_scans({scan}, {mounting});
    ASSERT_EQ(merged.image.range_m.size(), 4u);
    for (std::size_t i = 0; i < 4; ++i)
        EXPECT_LT(glm::length(compute_world_point(merged, i) - compute_world_point(scan, i)), 1e-4) << i;
}

TEST(MergeScans, RaysOnActorsAreAdded) {
    std::vector<RenderedScan> scans{scan_of({}, 10.0f), scan_of({}, 20.0f)};
    scans[0].actor_views = {{"van", 10, 20}};
    scans[1].actor_views = {{"car", 1, 2}, {"van", 5, 40}};
    scans[0].unseen_sides = {{"van", BoxSide::rear, 3, false}};
    scans[1].unseen_sides = {{"van", BoxSide::rear, 4, false}, {"van", BoxSide::rear, 5, true}};
    const RenderedScan merged = merge_scans(scans, {Pose{}, Pose{}});
    ASSERT_EQ(merged.actor_views.size(), 2u);
    EXPECT_EQ(merged.actor_views[0].n_rays, 15u) << "of the van";
    EXPECT_EQ(merged.actor_views[0].n_rays_alone, 60u);
    ASSERT_EQ(merged.unseen_sides.size(), 2u);
    EXPECT_EQ(merged.unseen_sides[0].n_rays, 7u);
    EXPECT_EQ(merged.unseen_sides[1].n_rays, 5u) << "on the completed part";
}

TEST(MergeScans, PointsStayWhereTheyAre) {
    const std::vector<Pose> mounting{
        {glm::angleAxis(1.2, glm::normalize(glm::dvec3(1, 2, 3))), {1.0, -0.5, 2.0}},
        {glm::angleAxis(-2.0, glm::dvec3(0, 0, 1)), {0.0, 3.0, 0.5}}};
    const std::vector<RenderedScan> scans{scan_of(mounting[0], 10.0f), scan_of(mounting[1], 20.0f)};
    const RenderedScan merged = merge_scans(scans, mounting);
    ASSERT_EQ(merged.image.range_m.size(), 4u);
    EXPECT_EQ(merged.image.columns, 4);
    for (std::size_t i = 0; i < 4; ++i) {
        const RenderedScan& source = scans[i / 2];
        EXPECT_LT(glm::length(compute_world_point(merged, i) - compute_world_point(source, i % 2)), 1e-4)
            << i;
        const glm::dvec3 normal = merged.firing_pose(i).rotation * glm::dvec3(get_normals(merged)[i]);
        EXPECT_LT(
            glm::length(normal - source.firing_pose(i % 2).rotation * glm::dvec3(get_normals(source)[i % 2])),
            1e-6)
            << i;
        EXPECT_EQ(merged.image.intensity[i], source.image.intensity[i % 2]);
        EXPECT_EQ(merged.instance[i], source.instance[i % 2]);
    }
    EXPECT_EQ(range_spread(merged), (std::vector<float>{1.0f, 2.0f, 1.0f, 2.0f}));
    EXPECT_EQ(merged.ring, (std::vector<std::uint16_t>{3, 1, 7, 5}));
    EXPECT_THROW(merge_scans({}, {}), UsageError);
    EXPECT_THROW(merge_scans(scans, {Pose{}}), UsageError);
}

RenderedScan scan_of(const std::vector<glm::vec3>& points, const std::vector<float>& drop) {
    RenderedScan scan;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::vec3 origin(0.0f, 0.0f, 0.2f);
        scan.image.origin.push_back(origin);
        scan.image.direction.push_back(glm::normalize(points[i] - origin));
        scan.image.range_m.push_back(glm::length(points[i] - origin));
        scan.image.intensity.push_back(0.1f * float(i + 1));
        scan.image.drop_prob.push_back(drop[i]);
        scan.instance.push_back(static_cast<std::int32_t>(i));
    }
    return test::complete(std::move(scan));
}

TEST(ProjectScan, NearestReturnedPointWinsAndOneReturnIsEnough) {
    const RangeImageGrid grid = kitti360_grid();
    const glm::vec3 a(10.0f, 0.0f, -0.5f);
    const RenderedScan projected = project_scan(scan_of({a, 0.9f * a, 0.5f * a}, {0.1f, 0.2f, 0.9f}), grid);
    const std::size_t cell = std::size_t(*project_to_pixel(grid, glm::dvec3(a)));
    EXPECT_NEAR(projected.image.range_m[cell], 0.9f * glm::length(a), 1e-4f);
    EXPECT_NEAR(projected.image.intensity[cell], 0.2f, 1e-6f);
    EXPECT_NEAR(projected.image.drop_prob[cell], 0.1f, 1e-6f);
    EXPECT_EQ(projected.instance[cell], 1) << "the winning point brings its label";
    std::size_t filled = 0;
    for (std::size_t i = 0; i < projected.image.range_m.size(); ++i) {
        filled += projected.image.range_m[i] > 0.0f;
        if (i == cell) continue;
        EXPECT_EQ(projected.image.drop_prob[i], 1.0f);
        EXPECT_EQ(projected.instance[i], -1);
    }
    EXPECT_EQ(filled, 1u);
}

TEST(ProjectScan, WhatHedgesBetweenTwoSurfacesIsBinnedByTheDominantOne) {
    const RangeImageGrid grid = kitti360_grid();
    const glm::vec3 a(10.0f, 0.0f, -0.5f);
    RenderedScan scan = scan_of({a, 0.8f * a}, {0.1f, 0.2f});
    scan.image.range_m[0] *= 0.6f;  // the mean range lies between the surface at `a` and a nearer surface
    scan.mean_range_m[0] = scan.image.range_m[0];
    scan.mean_range_m[1] -= 2.5f;
    const RenderedScan binned = project_scan(scan, grid);
    const std::size_t cell = std::size_t(*project_to_pixel(grid, glm::dvec3(a)));
    EXPECT_EQ(binned.instance[cell], 1) << "0.8 a returns, 0.6 a is thin air";
    EXPECT_NEAR(binned.median_range_m[cell], 0.8f * glm::length(a), 1e-4f);
    EXPECT_NEAR(range_spread(binned)[cell], 2.5f, 1e-2f)
        << "the winner's; the sensor is 0.2 m above the grid's origin";
    EXPECT_NEAR(binned.image.drop_prob[cell], 0.1f, 1e-6f);
}

/// Incidence is normal at azimuth 0 and oblique elsewhere.
RenderedScan make_half_dropped_wall() {
    std::vector<glm::vec3> points;
    for (int row = 0; row < 64; ++row)
        for (int column = 0; column < 256; ++column)
            points.push_back({10.0f, 10.0f * std::tan((128 - column) * 0.008f), 3.2f - 0.1f * float(row)});
    RenderedScan scan = scan_of(points, std::vector<float>(points.size(), 0.5f));
    scan.image.rows = 64;
    scan.image.columns = 256;
    scan.time_s = 1.5;
    return scan;
}

TEST(SampleReturns, DropsAndNoiseAreAsLikelyAsTold) {
    const RenderedScan likely = make_half_dropped_wall();
    const RangeNoiseTable noise{{80.0}, {0.8, 1.0}, {0.2, 0.05}};
    RenderedScan scan = likely, again = likely, other = likely;
    for (float& mean_m : scan.mean_range_m) mean_m += 0.5f;
    sample_returns(scan, noise, {}, 7);
    sample_returns(again, noise, {}, 7);
    sample_returns(other, noise, {}, 8);
    EXPECT_EQ(scan.image.range_m, again.image.range_m);
    EXPECT_NE(scan.image.drop_prob, other.image.drop_prob);
    const std::vector<float> spread_m = range_spread(scan);
    double n = 0.0, square[2] = {0.0, 0.0}, count[2] = {0.0, 0.0};
    for (std::size_t i = 0; i < scan.image.range_m.size(); ++i) {
        ASSERT_TRUE(scan.image.drop_prob[i] == 0.0f || scan.image.drop_prob[i] == 1.0f);
        EXPECT_EQ(scan.image.range_m[i], scan.median_range_m[i]);
        EXPECT_NEAR(spread_m[i], 0.5f, 1e-5f) << "noise spreads nothing";
        if (scan.image.drop_prob[i] == 1.0f) continue;
        const double error = double(scan.image.range_m[i]) - double(likely.image.range_m[i]),
                     cosine = double(likely.image.direction[i].x);
        // skips rays whose incidence or column is close to the border of a bin
        if (std::abs(cosine - 0.8) < 0.02 || i % 256 < 4 || i % 256 > 251 || i < 256 || i >= 63 * 256)
            continue;
        const int oblique = cosine < 0.8;
        n += 1.0;
        count[oblique] += 1.0;
        square[oblique] += error * error;
    }
    EXPECT_NEAR(std::sqrt(square[0] / count[0]), 0.05, 0.005);
    EXPECT_NEAR(std::sqrt(square[1] / count[1]), 0.2, 0.02);
    const double returned =
                     double(std::count(scan.image.drop_prob.begin(), scan.image.drop_prob.end(), 0.0f)),
                 all = double(scan.image.drop_prob.size());
    EXPECT_NEAR(returned, 0.5 * all, 4.0 * std::sqrt(0.25 * all));
}

/// A wall 3 cm before the limit, noise of 5 cm: the share beyond is 1 - Phi(0.6).
TEST(SampleReturns, NoiseDoesNotPassTheLimitOfTheSensor) {
    RenderedScan scan = make_half_dropped_wall();
    const std::size_t n = scan.image.range_m.size();
    scan.image.range_m.assign(n, 9.97f);
    scan.median_range_m = scan.mean_range_m = scan.image.range_m;
    scan.image.drop_prob.assign(n, 0.0f);
    scan.second_returns = {{std::vector<float>(n, 9.97f), std::vector<float>(n, 0.5f)}};
    sample_returns(scan, {{80.0}, {1.0}, {0.05}}, {}, 3, {0.5, 10.0});
    double returned = 0.0, second = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        ASSERT_TRUE(scan.image.drop_prob[i] == 1.0f || scan.image.range_m[i] <= 10.0f);
        ASSERT_LE(scan.second_returns[0].range_m[i], 10.0f);
        ASSERT_EQ(scan.second_returns[0].range_m[i] > 0.0f, scan.second_returns[0].intensity[i] > 0.0f);
        returned += scan.image.drop_prob[i] == 0.0f;
        second += scan.second_returns[0].range_m[i] > 0.0f;
    }
    const double share = 0.5 * std::erfc(-0.6 / std::sqrt(2.0));
    EXPECT_NEAR(returned / double(n), share, 4.0 * std::sqrt(share * (1.0 - share) / double(n)));
    EXPECT_NEAR(second / double(n), share * share, 4.0 * std::sqrt(0.25 / double(n)));
}

TEST(SampleReturns, WhatCannotReturnDoesNotAndWhatMustDoes) {
    RenderedScan scan = make_half_dropped_wall();
    for (std::size_t i = 0; i < scan.image.drop_prob.size(); ++i)
        scan.image.drop_prob[i] = i % 2 ? 1.0f : 0.0f;
    const std::vector<float> before = scan.image.drop_prob, ranges_m = scan.image.range_m;
    sample_returns(scan, {}, {}, 3);
    EXPECT_EQ(scan.image.drop_prob, before);
    EXPECT_EQ(scan.image.range_m, ranges_m) << "no noise is known";
}

TEST(ProjectScan, RealAndSimulatedPointsAreBinnedAlike) {
    Scan real;
    std::vector<glm::vec3> points;
    for (int i = 0; i < 500; ++i)
        points.push_back({12.0f * std::cos(0.0123f * i), 12.0f * std::sin(0.0123f * i), -0.004f * i + 0.2f});
    const RenderedScan simulated = scan_of(points, std::vector<float>(points.size(), 0.0f));
    real.rays.rows = 1;
    real.rays.columns = 500;
    real.rays.origin = to_scan_array(simulated.image.origin);
    real.rays.direction = to_scan_array(simulated.image.direction);
    real.range_m = to_scan_array(simulated.image.range_m);
    real.intensity = to_scan_array(simulated.image.intensity);
    Config config;
    config.sensor.grid = "kitti360";
    const RangeImage image = measured_image(config, real);
    const RenderedScan projected = project_scan(simulated, kitti360_grid());
    for (std::size_t i = 0; i < image.range_m.size(); ++i) {
        EXPECT_NEAR(image.range_m[i], projected.image.range_m[i], 1e-5f);
        EXPECT_EQ(image.drop_prob[i], projected.image.drop_prob[i]);
    }
}

}  // namespace

}  // namespace relidar
