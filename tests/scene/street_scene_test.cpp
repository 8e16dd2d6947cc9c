// SPDX-License-Identifier: Apache-2.0
// Compares the benchmark street and its rays with numbers that
// ../shared/bench/scene_gen.py printed with numpy 1.24.2: street(n, refine=...) and
// rays(kind). Means, rotations and SH are equal bit for bit. The logarithms of scale and
// opacity cause errors of about 2e-7.
#include <gtest/gtest.h>

#include <cmath>

#include <relidar/base/error.hpp>
#include "scene/benchmark_street.hpp"

namespace relidar {
namespace {

struct StreetSurfel {
    std::size_t index;
    glm::vec3 mean;
    glm::vec4 rotation;
    glm::vec2 scale;
    double opacity;
    float sh_first[3], sh_last[3];  // coefficients 0 and 15 of the channels
};

struct Sums {
    double mean_abs, rotation_abs, scale, opacity, sh_abs;
    double sh_weighted;  // sum of (index + 1) * value over the [3,16] entries of each surfel
};

Sums compute_sums(const Surfels& surfels) {
    Sums sums{};
    for (const glm::vec3& v : surfels.mean)
        sums.mean_abs += std::abs(double(v.x)) + std::abs(double(v.y)) + std::abs(double(v.z));
    for (const glm::vec4& q : surfels.rotation)
        for (int k = 0; k < 4; ++k) sums.rotation_abs += std::abs(double(q[k]));
    for (const glm::vec2& v : surfels.log_scale) sums.scale += std::exp(double(v.x)) + std::exp(double(v.y));
    for (const float x : surfels.opacity_logit) sums.opacity += 1.0 / (1.0 + std::exp(-double(x)));
    for (std::size_t i = 0; i < surfels.sh.size(); ++i) {
        sums.sh_abs += std::abs(double(surfels.sh[i]));
        sums.sh_weighted += double(i % kShFloats + 1) * double(surfels.sh[i]);
    }
    return sums;
}

void expect_sample(const Surfels& surfels, const StreetSurfel& expected) {
    const std::size_t i = expected.index;
    EXPECT_EQ(surfels.mean[i], expected.mean);
    EXPECT_EQ(surfels.rotation[i], expected.rotation);
    for (int axis = 0; axis < 2; ++axis)
        EXPECT_NEAR(std::exp(double(surfels.log_scale[i][axis])) / double(expected.scale[axis]), 1.0, 1e-6);
    EXPECT_NEAR(1.0 / (1.0 + std::exp(-double(surfels.opacity_logit[i]))), expected.opacity, 1e-6);
    for (int channel = 0; channel < 3; ++channel) {
        EXPECT_EQ(surfels.sh[i * kShFloats + std::size_t(channel * 16)], expected.sh_first[channel]);
        EXPECT_EQ(surfels.sh[i * kShFloats + std::size_t(channel * 16 + 15)], expected.sh_last[channel]);
    }
}

void expect_sums(const Surfels& surfels, const Sums& expected) {
    const Sums actual = compute_sums(surfels);
    EXPECT_NEAR(actual.mean_abs / expected.mean_abs, 1.0, 1e-9);
    EXPECT_NEAR(actual.rotation_abs / expected.rotation_abs, 1.0, 1e-9);
    EXPECT_NEAR(actual.scale / expected.scale, 1.0, 1e-6);
    EXPECT_NEAR(actual.opacity / expected.opacity, 1.0, 1e-6);
    EXPECT_NEAR(actual.sh_abs / expected.sh_abs, 1.0, 1e-9);
    EXPECT_NEAR(actual.sh_weighted / expected.sh_weighted, 1.0, 1e-9);
}

const StreetSurfel kFirstOf1000{0,
                                {68.3377914f, 8.55495834f, 0.714409709f},
                                {-0.536881626f, 0.581468642f, -0.429807872f, -0.434646487f},
                                {0.118451133f, 0.123938195f},
                                0.339413583,
                                {0.645263671875f, -0.073486328125f, -1.383056640625f},
                                {0.0703125f, 0.04296875f, 0.05078125f}};
const StreetSurfel kLastOf1000{999,
                               {65.5324249f, -8.33455467f, -0.019092001f},
                               {0.494429827f, 0.0104154749f, 0.0382775925f, 0.868311882f},
                               {0.295972884f, 0.132527739f},
                               0.336544931,
                               {-0.590087890625f, 3.05859375f, -1.75537109375f},
                               {-0.0703125f, 0.0078125f, 0.0234375f}};

TEST(Street, FamilyAOf1000) {
    const Surfels s = make_street_surfels(1000);
    s.check_lengths();
    expect_sample(s, kFirstOf1000);
    expect_sample(s, kLastOf1000);
    expect_sums(s, {50157.65320637668, 1531.3510222060395, 361.5212205052376, 545.7502571195364,
                    6202.326904296875, -30476.231201171875});
}

TEST(Street, FamilyBScalesWithTheCount) {
    const Surfels s = make_street_surfels(1000, 20261120, true);
    StreetSurfel first = kFirstOf1000, last = kLastOf1000;
    first.scale = {1.1845113f, 1.23938191f};
    last.scale = {2.95972896f, 1.32527745f};
    expect_sample(s, first);
    expect_sample(s, last);
    EXPECT_NEAR(compute_sums(s).scale / 3615.2122008800507, 1.0, 1e-6);
}

TEST(Street, OtherSeedsAndEmpty) {
    EXPECT_NE(make_street_surfels(10, 1).mean[0], make_street_surfels(10, 2).mean[0]);
    EXPECT_EQ(make_street_surfels(0).size(), 0u);
}

void expect_rays(const RayTable& table, int rows, int columns, const glm::vec3& first, const glm::vec3& last,
                 double sum) {
    EXPECT_EQ(table.rows, rows);
    EXPECT_EQ(table.columns, columns);
    ASSERT_EQ(table.size(), std::size_t(rows) * std::size_t(columns));
    EXPECT_EQ(table.origin.size(), table.size());
    EXPECT_EQ(table.time_offset_s.size(), table.size());
    EXPECT_EQ(table.channel.size(), table.size());
    EXPECT_EQ(table.origin.back(), glm::vec3(0.0f, -2.0f, 1.8f));
    EXPECT_EQ(table.channel.back(), rows - 1);
    for (int axis = 0; axis < 3; ++axis) {
        EXPECT_NEAR(double(table.direction.front()[axis]), double(first[axis]), 1e-7);
        EXPECT_NEAR(double(table.direction.back()[axis]), double(last[axis]), 1e-7);
    }
    double actual = 0.0;
    for (const glm::vec3& d : table.direction)
        actual += std::abs(double(d.x)) + std::abs(double(d.y)) + std::abs(double(d.z));
    EXPECT_NEAR(actual / sum, 1.0, 1e-9);
}

TEST(Street, Rays) {
    expect_rays(make_street_rays("waymo"), 64, 2650,
                {-0.9992325901985168f, 0.0011845974950119853f, 0.03915081545710564f},
                {-0.9540110230445862f, -0.0011309869587421417f, -0.2997693419456482f}, 236127.60035995278);
    expect_rays(make_street_rays("kitti"), 66, 1030,
                {-0.9995039701461792f, 0.0030485864263027906f, 0.03134468197822571f},
                {-0.9085315465927124f, -0.0027711116708815098f, -0.417807012796402f}, 97603.03340174304);
    EXPECT_EQ(make_street_rays(4, 8, 10.0, -10.0).size(), 32u);
    EXPECT_THROW(make_street_rays("ouster"), UsageError);
    EXPECT_THROW(make_street_rays(0, 8, 10.0, -10.0), UsageError);
}

}  // namespace
}  // namespace relidar
