// SPDX-License-Identifier: Apache-2.0
// Tests that channel values stay with their rays in beams with several sub-rays, in grids
// and in rigs. Includes user-defined channels.
#include <set>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

#include "../plates.hpp"
#include "../street_scene.hpp"
#include "simulate/render/footprint.hpp"

namespace relidar {
namespace {

// difference between the codes of consecutive rays, which exceeds the number of channels
constexpr int kStep = 14;
constexpr const char *kLabel = "my_label", *kShare = "my_share", *kVector = "my_way";

const std::vector<std::int32_t>& get_labels(const RenderedScan& scan) {
    return *find_values<std::int32_t>(scan.channels, kLabel);
}
const std::vector<float>& get_shares(const RenderedScan& scan) {
    return *find_values<float>(scan.channels, kShare);
}
const std::vector<glm::vec3>& list_ways(const RenderedScan& scan) {
    return *find_values<glm::vec3>(scan.channels, kVector);
}

/// Values are 14 ray + channel. All rays have a return and almost the same origin.
RenderedScan make_marked_scan(int count, int first = 0) {
    RenderedScan scan;
    std::vector<std::int32_t> label;
    std::vector<float> share;
    std::vector<glm::vec3> vectors;
    for (int i = 0; i < count; ++i) {
        const auto code = float(kStep * (first + i));
        scan.image.direction.push_back(glm::normalize(glm::vec3(1.0f, 0.05f * float(first + i), 0.0f)));
        scan.image.range_m.push_back(code + 1.0f);
        scan.median_range_m.push_back(code + 2.0f);
        scan.mean_range_m.push_back(code + 3.0f);
        scan.image.intensity.push_back(code + 4.0f);
        scan.image.drop_prob.push_back(1e-6f * (code + 5.0f));
        scan.weight.push_back(code + 6.0f);
        scan.instance.push_back(int(code) + 7);
        scan.time_offset_s.push_back(code + 8.0f);
        label.push_back(int(code) + 9);
        share.push_back(code + 10.0f);
        vectors.emplace_back(code + 11.0f, code + 12.0f, code + 13.0f);
    }
    scan.channels = {
        {{.name = kLabel, .none = -5.0}, label}, {{.name = kShare}, share}, {{.name = kVector}, vectors}};
    return test::complete(std::move(scan));
}

void expect_marks(const RenderedScan& scan, std::size_t index, int ray) {
    const auto code = float(kStep * ray);
    EXPECT_NEAR(scan.image.range_m[index], code + 1.0f, 1e-3f) << index;
    EXPECT_NEAR(scan.median_range_m[index], code + 2.0f, 1e-3f) << index;
    EXPECT_NEAR(scan.mean_range_m[index], code + 3.0f, 1e-3f) << index;
    EXPECT_EQ(scan.image.intensity[index], code + 4.0f) << index;
    EXPECT_EQ(scan.image.drop_prob[index], 1e-6f * (code + 5.0f)) << index;
    EXPECT_EQ(scan.weight[index], code + 6.0f) << index;
    EXPECT_EQ(scan.instance[index], int(code) + 7) << index;
    EXPECT_EQ(get_labels(scan)[index], int(code) + 9) << index;
    EXPECT_EQ(get_shares(scan)[index], code + 10.0f) << index;
    EXPECT_EQ(list_ways(scan)[index], glm::vec3(code + 11.0f, code + 12.0f, code + 13.0f)) << index;
}

TEST(Channels, AMergedScanHasThemOfEachRay) {
    const RenderedScan merged = merge_scans({make_marked_scan(2), make_marked_scan(3, 2)}, {Pose{}, Pose{}});
    for (int ray = 0; ray < 5; ++ray) expect_marks(merged, std::size_t(ray), ray);
}

TEST(Channels, WhatOneScanOfARigHasAloneIsNothingInTheOthers) {
    RenderedScan bare = make_marked_scan(2);
    bare.channels.clear();
    for (const bool first : {true, false}) {
        const RenderedScan merged = first ? merge_scans({bare, make_marked_scan(1)}, {Pose{}, Pose{}})
                                          : merge_scans({make_marked_scan(1), bare}, {Pose{}, Pose{}});
        const std::size_t ray_with_channels = first ? 2 : 0;
        for (std::size_t i = 0; i < 3; ++i) {
            EXPECT_EQ(get_labels(merged)[i], i == ray_with_channels ? 9 : -5) << i;
            EXPECT_EQ(list_ways(merged)[i],
                      i == ray_with_channels ? glm::vec3(11.0f, 12.0f, 13.0f) : glm::vec3(0.0f))
                << i;
        }
    }
    RenderedScan other = make_marked_scan(2);
    other.channels[0].values = std::vector<float>(2);
    EXPECT_THROW(merge_scans({make_marked_scan(2), other}, {Pose{}, Pose{}}), UsageError);
    other.channels[0].values = std::vector<std::int32_t>(1);
    EXPECT_THROW(merge_scans({other}, {Pose{}}), DataError) << "of another length";
    other = make_marked_scan(2);
    other.channels[1].info.name = "range";
    EXPECT_THROW(merge_scans({other}, {Pose{}}), DataError) << "a basic channel's name";
}

TEST(Channels, ACellHasThemOfItsRay) {
    const RangeImageGrid grid = kitti360_grid();
    const RenderedScan scan = make_marked_scan(5), binned = project_scan(scan, grid);
    std::set<std::size_t> filled_cells;
    for (std::size_t ray = 0; ray < 5; ++ray) {
        const std::optional<int> cell =
            project_to_pixel(grid, glm::dvec3(scan.median_range_m[ray] * scan.image.direction[ray]));
        ASSERT_TRUE(cell && filled_cells.insert(std::size_t(*cell)).second);
        expect_marks(binned, std::size_t(*cell), int(ray));
        EXPECT_EQ(binned.time_offset_s[std::size_t(*cell)], float(kStep * int(ray)) + 8.0f);
    }
    for (std::size_t cell = 0; cell < binned.weight.size(); ++cell) {
        if (filled_cells.contains(cell)) continue;
        ASSERT_EQ(get_labels(binned)[cell], -5);
        ASSERT_EQ(get_shares(binned)[cell], 0.0f);
    }
}

/// The five sub-rays hit the same surface.
TEST(Channels, ABeamHasThemOfTheSubRayNearestToItsMiddle) {
    RenderedScan parts = make_marked_scan(5);
    parts.median_range_m.assign(5, 10.0f);
    parts.image.intensity.assign(5, 0.5f);
    parts.channels.push_back({{.name = "my_drop", .join = ChannelMergeRule::drop},
                              std::vector<float>{0.0f, 0.1f, 0.2f, 0.3f, 0.9f}});
    parts.channels.push_back({{.name = "my_light", .join = ChannelMergeRule::intensity},
                              std::vector<float>{5.0f, 1.0f, 2.0f, 3.0f, 4.0f}});
    parts.channels.push_back({{.name = "my_range", .join = ChannelMergeRule::range},
                              std::vector<float>{5.0f, 1.0f, 2.0f, 3.0f, 9.0f}});
    SensorConfig config;
    config.sub_rays = 5;
    RayTable ray{1, 1, {{0, 0, 0}}, {{1, 0, 0}}, {0.0f}, {0}};
    const auto first_of = [](const RenderedScan& scan, const char* name) {
        return find_values<float>(scan.channels, name)->at(0);
    };
    for (const bool replaced : {false, true}) {
        RenderedScan joined = join_sub_rays(parts, ray, config);
        if (replaced) {
            RenderedScan old = join_sub_rays(parts, ray, config);
            for (auto& [info, values, second] : old.channels)
                std::visit([](auto& v) { v.assign(1, {}); }, values);
            old.weight = {0.0f};
            old.instance = {-1};
            replace_rays(old, {0}, joined);
            joined = old;
        }
        EXPECT_EQ(joined.weight[0], 6.0f);
        EXPECT_EQ(joined.instance[0], 7);
        EXPECT_NEAR(joined.image.range_m[0], 29.0f, 1e-3f);
        EXPECT_NEAR(joined.mean_range_m[0], 31.0f, 1e-3f);
        EXPECT_EQ(get_labels(joined)[0], 9);
        EXPECT_EQ(get_shares(joined)[0], 10.0f);
        EXPECT_EQ(list_ways(joined)[0], glm::vec3(11.0f, 12.0f, 13.0f));
        EXPECT_NEAR(first_of(joined, "my_drop"), 0.3f, 1e-6f) << "the mean over all";
        EXPECT_NEAR(first_of(joined, "my_light"), 3.0f, 1e-6f);
        EXPECT_NEAR(first_of(joined, "my_range"), 4.0f, 1e-5f);
    }
}

class RenderedChannels : public test::StreetTest {
protected:
    RenderedChannels() : StreetTest({.n_frames = 4}) {
        for (const std::string& name : optional_names())
            config.render.channels += (config.render.channels.empty() ? "" : ",") + name;
    }
    RenderedScan scan(const std::string& sensor = "native") {
        ScanRenderer renderer(device(), scene, config, log);
        renderer.use_observed(
            observe_coverage(log, log.world_from_vehicle, {0, 1, 2, 3}, config.dataset.max_range_m));
        return renderer.render(choose_sensor(sensor, config, log), log.frames[1].time_s);
    }
};

TEST_F(RenderedChannels, AllThatCanBeAskedForAreThere) {
    for (const int sub_rays : {1, 5}) {
        config.sensor.sub_rays = sub_rays;
        config.sensor.divergence_mrad = 3.0;
        for (const char* sensor : {"native", "kitti360", "VLP-16"}) {
            const RenderedScan rendered = scan(sensor);
            std::vector<std::string> names, expected = optional_names();
            for (const ScanChannel& channel : rendered.channels) {
                names.push_back(channel.info.name);
                EXPECT_EQ(count_values(channel.values), rendered.image.range_m.size()) << channel.info.name;
                EXPECT_FALSE(channel.info.meaning.empty());
            }
            std::ranges::sort(names);
            std::ranges::sort(expected);
            EXPECT_EQ(names, expected) << sensor;
        }
    }
}

TEST_F(RenderedChannels, AreWantedByName) {
    config.render.channels = "normal,sprad";
    EXPECT_THROW(ScanRenderer(device(), scene, config, log), UsageError);
    config.render.channels.clear();
    ScanRenderer renderer(device(), scene, config, log);
    renderer.add_channels("spread");
    renderer.add_channels("spread");
    EXPECT_EQ(renderer.render(make_sensor(config, log), 0.1).channels.size(), 1u);
    config.image.primitive = PrimitiveType::gaussian;
    scene.surfels.resize(scene.surfels.size(), PrimitiveType::gaussian);
    EXPECT_THROW(ScanRenderer(device(), scene, config, log).add_channels("normal"), UsageError);
}

}  // namespace
}  // namespace relidar
