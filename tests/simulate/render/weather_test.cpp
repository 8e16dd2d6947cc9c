// SPDX-License-Identifier: Apache-2.0
// Tests weather on complete scans. Surfaces must be darker according to the formula,
// returns from the air must be marked in every channel, and clear air must not change any
// bit.

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

#include "../plates.hpp"
#include "../street_scene.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

constexpr int kRays = 20'000;
constexpr std::int32_t kNothing = -1, kSurface = 0, kFogEffect = 1;

/// Every tenth ray has no return. Channels of the hits refer to actor 3. Two returns are
/// from two panes.
RenderedScan make_wall_at(float range_m, float intensity, bool two_returns = false, int n_rays = kRays) {
    const auto n = std::size_t(n_rays);
    RenderedScan scan;
    scan.image.direction.assign(n, glm::vec3(1.0f, 0.0f, 0.0f));
    scan.image.range_m.assign(n, range_m);
    scan.image.intensity.assign(n, intensity);
    scan.image.drop_prob.assign(n, 0.25f);
    for (std::size_t i = 0; i < n; i += 10) scan.image.drop_prob[i] = 0.75f;
    scan.instance.assign(n, 3);
    scan.channels = {{{.name = "of_surface", .none = -2.0}, std::vector<float>(n, 7.0f)},
                     {{.name = "of_ray", .of_ray = true, .none = -2.0}, std::vector<float>(n, 7.0f)}};
    if (two_returns) {
        scan.second_returns = {
            {std::vector<float>(n, range_m + 2.0f), std::vector<float>(n, 0.5f * intensity)}};
        for (std::size_t i = 0; i < n; i += 10)
            scan.second_returns[0].range_m[i] = scan.second_returns[0].intensity[i] = 0.0f;
    }
    return test::complete(std::move(scan));
}

struct Applied {
    Weather weather = {};
    WeatherSensorProperties sensor = {};
    IntensityResponse response = {};
    std::vector<std::uint8_t> blind = {};
    std::uint64_t seed = 1;
};
void apply_weather(RenderedScan& scan, const Applied& applied) {
    add_weather(scan, {.weather = applied.weather,
                       .sensor = applied.sensor,
                       .scan = scan,
                       .response = applied.response,
                       .seed = applied.seed,
                       .is_blocked = applied.blind});
}

const std::vector<std::int32_t>& get_sources(const RenderedScan& scan) {
    return *find_values<std::int32_t>(scan.channels, "source");
}

void expect_same(const RenderedScan& first, const RenderedScan& second) {
    EXPECT_EQ(first.image.range_m, second.image.range_m);
    EXPECT_EQ(first.image.intensity, second.image.intensity);
    EXPECT_EQ(first.image.drop_prob, second.image.drop_prob);
    EXPECT_EQ(first.median_range_m, second.median_range_m);
    EXPECT_EQ(first.mean_range_m, second.mean_range_m);
    EXPECT_EQ(first.instance, second.instance);
}

TEST(WeatherOnScans, ClearAirChangesNoBit) {
    const RenderedScan before = make_wall_at(10.0f, 0.5f);
    RenderedScan scan = before;
    apply_weather(scan, {});
    expect_same(scan, before);
    ASSERT_EQ(scan.channels.size(), 3u);
    for (std::size_t i = 0; i < kRays; ++i)
        ASSERT_EQ(get_sources(scan)[i], i % 10 == 0 ? kNothing : kSurface);
}

/// Also a sensor that reports half the brightness for the same surface.
TEST(WeatherOnScans, AWallIsDarkerByTheFormula) {
    for (const double fall : {1.0, 0.5}) {
        RenderedScan scan = make_wall_at(8.0f, 0.8f);
        apply_weather(
            scan, {.weather = {.fog_visibility_m = 150.0}, .response = {.range_m = {8.0}, .factor = {fall}}});
        int n = 0;
        for (std::size_t i = 0; i < kRays; ++i) {
            if (get_sources(scan)[i] != kSurface) continue;
            ++n;
            ASSERT_NEAR(scan.image.intensity[i] / (0.8 * std::exp(-2.0 * std::log(20.0) / 150.0 * 8.0)), 1.0,
                        0.01);
            ASSERT_EQ(scan.image.range_m[i], 8.0f);
            ASSERT_EQ(scan.instance[i], 3);
            ASSERT_EQ(scan.image.drop_prob[i], 0.25f);
            ASSERT_EQ(find_values<float>(scan.channels, "of_surface")->at(i), 7.0f);
        }
        EXPECT_GT(n, kRays / 2);
    }
}

TEST(WeatherOnScans, WhatReturnsFromTheAirSaysSo) {
    RenderedScan scan = make_wall_at(25.0f, 0.3f);
    std::vector<std::uint8_t> blind(kRays, 0);
    for (std::size_t i = 0; i < kRays; i += 4) blind[i] = 1;
    apply_weather(scan, {.weather = {.fog_visibility_m = 50.0}, .blind = blind});
    int fog = 0;
    for (std::size_t i = 0; i < kRays; ++i) {
        const std::int32_t source = get_sources(scan)[i];
        EXPECT_EQ(find_values<float>(scan.channels, "of_ray")->at(i), 7.0f);
        if (blind[i] != 0) {
            ASSERT_EQ(source, i % 10 == 0 ? kNothing : kSurface);
            ASSERT_EQ(scan.image.range_m[i], 25.0f);
            ASSERT_NEAR(scan.image.intensity[i], source == kSurface ? 0.3 * 0.05 : 0.3, 1e-6);
        } else if (source == kFogEffect) {
            ++fog;
            ASSERT_LT(scan.image.range_m[i], 25.0f);
            ASSERT_EQ(scan.image.range_m[i], scan.median_range_m[i]);
            ASSERT_EQ(scan.image.range_m[i], scan.mean_range_m[i]);
            ASSERT_EQ(scan.image.drop_prob[i], 0.0f) << "of rays that had no return, too";
            ASSERT_EQ(scan.instance[i], -1);
            ASSERT_EQ(find_values<float>(scan.channels, "of_surface")->at(i), -2.0f);
        }
    }
    EXPECT_GT(fog, kRays / 2);
}

/// 40 m of fog in both directions let 2e-2 of the light pass; the wall has a power of
/// 3e-3.
TEST(WeatherOnScans, WhatIsTooWeakIsDropped) {
    WeatherSensorProperties sensor;
    sensor.min_range_m = 39.9;  // excludes returns of the fog
    RenderedScan scan = make_wall_at(40.0f, 0.3f);
    apply_weather(scan, {.weather = {.fog_visibility_m = 20.0}, .sensor = sensor});
    for (std::size_t i = 0; i < kRays; ++i) {
        ASSERT_EQ(get_sources(scan)[i], kNothing);
        ASSERT_GE(scan.image.drop_prob[i], 0.5f);
    }
}

TEST(WeatherOnScans, SecondReturnsSayWhyTheyAreThere) {
    // The power of the fog is mostly between the first surface and ten times the second.
    RenderedScan scan = make_wall_at(20.0f, 0.07f, true);
    apply_weather(scan, {.weather = {.fog_visibility_m = 200.0}});
    ASSERT_EQ(scan.channels.back().info.name, "source");
    const auto& second = std::get<std::vector<std::int32_t>>(scan.channels.back().second);
    int behind_fog = 0;
    for (std::size_t i = 0; i < kRays; ++i) {
        const float range_m = scan.second_returns[0].range_m[i];
        ASSERT_EQ(second[i] == kNothing, range_m == 0.0f);
        ASSERT_TRUE(second[i] != kSurface || range_m == 20.0f || range_m == 22.0f);
        behind_fog += get_sources(scan)[i] == kFogEffect && second[i] == kSurface && range_m == 22.0f;
        ScanChannel of_points{scan.channels.back().info, std::vector<std::int32_t>{}};
        append_return(of_points, scan.channels.back(), i, 2);
        ASSERT_EQ(std::get<std::vector<std::int32_t>>(of_points.values)[0], second[i]);
    }
    EXPECT_GT(behind_fog, kRays / 2);
    RenderedScan one = make_wall_at(20.0f, 0.3f);
    const RenderedScan merged = merge_scans({one, scan, one}, {Pose{}, Pose{}, Pose{}});
    const auto& of_rig = std::get<std::vector<std::int32_t>>(merged.channels.back().second);
    ASSERT_EQ(of_rig.size(), std::size_t(3 * kRays));
    ASSERT_EQ(merged.second_returns[0].range_m.size(), std::size_t(3 * kRays));
    for (std::size_t i = 0; i < kRays; ++i) {
        ASSERT_EQ(of_rig[kRays + i], second[i]);
        ASSERT_EQ(merged.second_returns[0].range_m[kRays + i], scan.second_returns[0].range_m[i]);
        ASSERT_EQ(of_rig[2 * kRays + i], kNothing);
        ASSERT_EQ(merged.second_returns[0].range_m[2 * kRays + i], 0.0f);
    }
}

/// Threads process blocks of 4096 rays.
TEST(WeatherOnScans, TheSameSeedIsTheSameOnAnyNumberOfThreads) {
    const Weather weather{.fog_visibility_m = 100.0, .rain_mm_h = 20.0};
    RenderedScan a = make_wall_at(40.0f, 0.1f), b = a, other = a,
                 by_one = make_wall_at(40.0f, 0.1f, false, 4096);
    apply_weather(a, {.weather = weather, .seed = 7});
    apply_weather(b, {.weather = weather, .seed = 7});
    apply_weather(other, {.weather = weather, .seed = 8});
    apply_weather(by_one, {.weather = weather, .seed = 7});
    expect_same(a, b);
    EXPECT_EQ(get_sources(a), get_sources(b));
    EXPECT_NE(a.image.range_m, other.image.range_m);
    for (std::size_t i = 0; i < by_one.weight.size(); ++i) {
        ASSERT_EQ(a.image.range_m[i], by_one.image.range_m[i]);
        ASSERT_EQ(a.image.intensity[i], by_one.image.intensity[i]);
        ASSERT_EQ(get_sources(a)[i], get_sources(by_one)[i]);
    }
}

class RenderedWeather : public test::StreetTest {
protected:
    RenderedWeather() : StreetTest({.n_frames = 3}) {}
};

/// Without intensities, the air would be brighter than all surfaces.
TEST_F(RenderedWeather, NeedsALogWithIntensities) {
    ScanRenderer renderer(device(), scene, config, log);
    IntensityScatterModel scatter{.nodes = {{.first = 0, .count = 2}}, .values = {0.0f, 0.0f}};
    renderer.use_scatter({scatter});
    EXPECT_THROW(renderer.set_weather({.fog_visibility_m = 30.0}), UsageError);
    EXPECT_NO_THROW(renderer.set_weather({}));
    scatter.values.back() = 0.1f;
    renderer.use_scatter({scatter});
    EXPECT_NO_THROW(renderer.set_weather({.fog_visibility_m = 30.0}));
}

/// In fog of 1 km, less than 0.5 % of the rays of a VLP-16 return from the air.
TEST_F(RenderedWeather, DoesNotDependOnTheFormatOfIntensities) {
    std::vector<double> in_fog;
    for (const double step : {0.0, 1.0 / 255.0, 0.01}) {
        Log rounded = log;
        const IntensityScatterModel scatter{
            .nodes = {{.first = 0, .count = 2}}, .values = {0.0f, 0.5f}, .step = step};
        for (Frame& frame : rounded.frames)
            for (std::size_t i = 0; i < frame.scan.intensity.size(); ++i)
                frame.scan.intensity[i] = scatter.quantise(frame.scan.intensity[i]);
        ScanRenderer renderer(device(), init_scene(rounded, {0, 1, 2}, {}), config, rounded);
        renderer.use_scatter({scatter});
        const auto find_share_of_fog = [&](double visibility_m) {
            renderer.set_weather({.fog_visibility_m = visibility_m});
            const RenderedScan scan =
                renderer.render(choose_sensor("VLP-16:900x10", config, rounded), rounded.frames[1].time_s);
            return double(std::ranges::count(get_sources(scan), kFogEffect)) / double(scan.ring.size());
        };
        EXPECT_LT(find_share_of_fog(1000.0), 0.005) << step;
        in_fog.push_back(find_share_of_fog(200.0));
    }
    EXPECT_GT(std::ranges::min(in_fog), 0.005);
    EXPECT_LT(std::ranges::max(in_fog), 1.5 * std::ranges::min(in_fog));
}

/// Fog stands still, snow falls at 1 m/s, and rain at up to 9.65 m/s.
TEST_F(RenderedWeather, HasTheVelocityOfTheAir) {
    config.render.channels = "velocity";
    ScanRenderer renderer(device(), scene, config, log);
    const glm::dvec3 driven_m =
        log.world_from_vehicle.pose[2].translation - log.world_from_vehicle.pose[0].translation;
    const glm::dvec3 sensor_mps = driven_m / (log.frames[2].time_s - log.frames[0].time_s);
    for (const Weather& weather :
         {Weather{.fog_visibility_m = 60.0}, Weather{.rain_mm_h = 500.0}, Weather{.snow_mm_h = 2.0}}) {
        renderer.set_weather(weather);
        const RenderedScan scan = renderer.render(choose_sensor("native", config, log), log.frames[1].time_s);
        const std::vector<float>& velocity = *find_values<float>(scan.channels, "velocity");
        int n = 0;
        for (std::size_t i = 0; i < velocity.size(); ++i) {
            const auto source = ReturnCause(get_sources(scan)[i]);
            if (source == ReturnCause::surface || source == ReturnCause::nothing) continue;
            ++n;
            const glm::dvec3 d = scan.firing_pose(i).rotation * glm::dvec3(scan.image.direction[i]);
            const double falls = -(double(velocity[i]) + glm::dot(d, sensor_mps));  // speed times d.z
            if (source == ReturnCause::rain) {
                ASSERT_GT(falls * (d.z > 0.0 ? 1.0 : -1.0), -0.01);
                ASSERT_LT(std::abs(falls), 9.65 * std::abs(d.z) + 0.01);
            } else {
                ASSERT_NEAR(falls, source == ReturnCause::snow ? d.z : 0.0, 0.01);
            }
        }
        EXPECT_GT(n, 50) << format_weather(weather);
    }
}

TEST_F(RenderedWeather, IsThatOfTheNextScan) {
    ScanRenderer renderer(device(), scene, config, log);
    const auto render = [&](const std::string& sensor, std::optional<std::uint64_t> sample = {}) {
        return renderer.render(choose_sensor(sensor, config, log), log.frames[1].time_s, {}, sample);
    };
    const RenderedScan clear = render("native"), clear_sample = render("native", 3);
    EXPECT_EQ(find_values<std::int32_t>(clear.channels, "source"), nullptr);
    renderer.set_weather({.fog_visibility_m = 30.0});
    EXPECT_THROW(renderer.set_weather({.snow_mm_h = -1.0}), UsageError);
    const RenderedScan fog = render("native"), again = render("native"), sample = render("native", 3),
                       grid = render("kitti360");
    expect_same(fog, again);
    EXPECT_NE(fog.image.range_m, sample.image.range_m);
    for (const RenderedScan* scan : {&fog, &sample, &grid})
        EXPECT_GT(std::ranges::count(get_sources(*scan), kFogEffect), 100);
    for (std::size_t i = 0; i < fog.image.range_m.size(); ++i) {
        ASSERT_EQ(get_sources(fog)[i] == kNothing,
                  !is_ray_returned(fog.image.drop_prob[i], fog.image.range_m[i]));
        ASSERT_TRUE(get_sources(fog)[i] != kSurface || fog.image.intensity[i] <= clear.image.intensity[i]);
    }
    renderer.set_weather({});
    expect_same(render("native"), clear);
    expect_same(render("native", 3), clear_sample);
    renderer.add_channels("source");
    const RenderedScan said = render("native");
    expect_same(said, clear);
    for (std::size_t i = 0; i < said.image.range_m.size(); ++i)
        ASSERT_EQ(get_sources(said)[i],
                  is_ray_returned(said.image.drop_prob[i], said.image.range_m[i]) ? kSurface : kNothing);
}

}  // namespace
}  // namespace relidar
