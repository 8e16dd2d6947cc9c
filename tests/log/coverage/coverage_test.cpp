// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/coverage.hpp>

#include <algorithm>

#include <gtest/gtest.h>

#include "base/random.hpp"

namespace relidar {
namespace {

using Cell = std::tuple<int, int, int>;

struct Segment {
    glm::dvec3 from_m, to_m;
};

/// Clips a segment to the six planes of a cell.
double measure_length_within(const Segment& segment, const Cell& cell) {
    const glm::dvec3 low(std::get<0>(cell), std::get<1>(cell), std::get<2>(cell)),
        d = segment.to_m - segment.from_m;
    double begin = 0.0, end = 1.0;
    for (int axis = 0; axis < 3; ++axis) {
        const double a = (low[axis] - segment.from_m[axis]) / d[axis],
                     b = (low[axis] + 1.0 - segment.from_m[axis]) / d[axis];
        begin = std::max(begin, std::min(a, b));
        end = std::min(end, std::max(a, b));
    }
    return std::max(end - begin, 0.0) * glm::length(d);
}

std::vector<Segment> make_random_segments(int count, std::uint64_t seed) {
    Random random(seed);
    const auto draw_point = [&] {
        return glm::dvec3(random.sample_uniform(-12.0, 12.0), random.sample_uniform(-12.0, 12.0),
                          random.sample_uniform(-9.0, 9.0));
    };
    std::vector<Segment> segments;
    for (int i = 0; i < count; ++i) {
        const glm::dvec3 from = draw_point();
        segments.push_back({from, draw_point()});
    }
    return segments;
}

TEST(Coverage, SharesAreThoseOfCellsThatWereCrossed) {
    const std::vector<Segment> segments = make_random_segments(40, 1);
    ObservedVoxelSet coverage;
    std::set<Cell> crossed;
    for (const Segment& segment : segments) {
        coverage.add_segment(segment.from_m, segment.to_m);
        for (int x = -13; x < 13; ++x)
            for (int y = -13; y < 13; ++y)
                for (int z = -10; z < 10; ++z)
                    if (measure_length_within(segment, {x, y, z}) > 0.0) crossed.insert({x, y, z});
    }
    std::size_t n_cells = 0;
    for (const ObservedVoxelSet::VoxelBlock& block : coverage.list_blocks())
        for (const std::uint16_t word : block.cells) n_cells += std::size_t(__builtin_popcount(word));
    EXPECT_EQ(n_cells, crossed.size());
    for (const Segment& segment : segments)
        EXPECT_NEAR(coverage.observed_fraction(segment.from_m, segment.to_m), 1.0, 1e-12);
    int n_partly = 0;
    for (const Segment& segment : make_random_segments(60, 2)) {
        double within_m = 0.0;
        for (const Cell& cell : crossed) within_m += measure_length_within(segment, cell);
        const double expected = within_m / glm::distance(segment.from_m, segment.to_m);
        EXPECT_NEAR(coverage.observed_fraction(segment.from_m, segment.to_m), expected, 1e-9);
        n_partly += expected > 0.01 && expected < 0.99;
    }
    EXPECT_GT(n_partly, 50);
}

TEST(Coverage, AlongAnAxisAndAtRestCellsAreFoundToo) {
    ObservedVoxelSet coverage;
    coverage.add_segment({0.5, 0.5, 0.5}, {4.5, 0.5, 0.5});
    EXPECT_DOUBLE_EQ(coverage.observed_fraction({0.5, 0.2, 0.5}, {4.9, 0.2, 0.5}), 1.0);
    EXPECT_DOUBLE_EQ(coverage.observed_fraction({2.5, 0.5, 0.5}, {2.5, 0.5, 4.5}), 0.125);
    EXPECT_EQ(coverage.observed_fraction({2.5, 0.5, 0.5}, {2.5, 0.5, 0.5}), 0.0);
    const double nan = std::numeric_limits<double>::quiet_NaN();
    coverage.add_segment({nan, 0.0, 0.0}, {1.0, 0.0, 0.0});
    coverage.add_segment({0.0, 0.0, 0.0}, {1e300, 0.0, 0.0});
    EXPECT_EQ(coverage.list_blocks().size(), 1u);
    EXPECT_EQ(coverage.observed_fraction({0.0, 0.0, nan}, {1.0, 0.0, 0.0}), 0.0);
}

/// Makes a LiDAR at 2 m with beams at 20, 0, -20 and -40 degrees and 360 columns.
Log make_sweep(const std::array<float, 4>& range_m) {
    Log log;
    SpinningSensor& sensor = log.lidars[0].sensor;
    for (const double degrees : {20.0, 0.0, -20.0, -40.0}) sensor.beams.push_back({degrees * kPi / 180.0});
    sensor.columns = 360;
    log.world_from_vehicle = {{0.0}, {Pose{{1, 0, 0, 0}, {0, 0, 2.0}}}};
    Frame frame;
    frame.scan.rays = make_rays(sensor);
    for (const std::uint16_t channel : frame.scan.rays.channel)
        frame.scan.range_m.push_back(range_m[channel]);
    frame.scan.intensity.assign(frame.scan.rays.size(), 0.0f);
    log.frames.push_back(std::move(frame));
    log.rolling_shutter = false;
    return log;
}

ObservedVoxelSet observe(const std::array<float, 4>& range_m) {
    const Log log = make_sweep(range_m);
    return observe_coverage(log, log.world_from_vehicle, {0}, 80.0);
}

double seen(const ObservedVoxelSet& coverage, double elevation_deg, double from_m, double to_m) {
    const double e = elevation_deg * kPi / 180.0;
    const glm::dvec3 sensor(0.0, 0.0, 2.0),
        direction(std::cos(e) * std::cos(0.01), std::cos(e) * std::sin(0.01), std::sin(e));
    return coverage.observed_fraction(sensor + from_m * direction, sensor + to_m * direction);
}

TEST(Coverage, AScanHasLookedAsFarAsItsReturns) {
    const ObservedVoxelSet coverage = observe({30.0f, 20.0f, 5.8f, 3.1f});  // a wall and flat ground
    EXPECT_GT(seen(coverage, 20.0, 0.5, 29.5), 0.99);
    EXPECT_LT(seen(coverage, 20.0, 32.0, 60.0), 0.01) << "behind the wall";
    EXPECT_GT(seen(coverage, 10.0, 0.5, 19.5), 0.99) << "between two beams, as far as the nearer sees";
    EXPECT_LT(seen(coverage, 10.0, 22.0, 60.0), 0.05);
    EXPECT_LT(seen(coverage, -20.0, 8.0, 40.0), 0.01) << "under the ground";
    EXPECT_LT(seen(coverage, 60.0, 5.0, 60.0), 0.01) << "above all beams";
}

TEST(Coverage, ADroppedRayTellsWhatItsNeighboursTell) {
    ObservedVoxelSet coverage = observe({0.0f, 0.0f, 5.8f, 3.1f});  // no surface above the ground
    EXPECT_GT(seen(coverage, 20.0, 0.5, 79.0), 0.99) << "the sky";
    EXPECT_LT(seen(coverage, 20.0, 82.0, 120.0), 0.01) << "beyond its range";
    coverage = observe({30.0f, 0.0f, 5.8f, 3.1f});
    EXPECT_GT(seen(coverage, 0.0, 0.5, 5.5), 0.99);
    EXPECT_LT(seen(coverage, 0.0, 8.0, 40.0), 0.05) << "a black car";
    coverage = observe({30.0f, 20.0f, 0.0f, 0.0f});
    EXPECT_LT(seen(coverage, -40.0, 3.0, 40.0), 0.01) << "the vehicle's own roof";
}

}  // namespace
}  // namespace relidar
