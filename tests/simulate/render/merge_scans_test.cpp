// SPDX-License-Identifier: Apache-2.0
// Tests merging the scans of a rig into a single scan. Every point must keep its position
// in the world, for any sensor and firing time.

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

#include "simulate/render/channel_pairs.hpp"

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

}  // namespace
}  // namespace relidar
