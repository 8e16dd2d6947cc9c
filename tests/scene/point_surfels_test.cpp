// SPDX-License-Identifier: Apache-2.0
// Tests surfels that are computed from the points of scan lines. Discs must reach across
// the gaps between lines and lie in the surface, or stay round.
#include "scene/point_surfels.hpp"

#include <gtest/gtest.h>

#include "base/random.hpp"

namespace relidar {
namespace {

constexpr double kSpacing = 0.1;  // spacing of the points on a line, metres

InitOptions make_standard_options() {
    InitOptions options;
    options.normal_neighbours = 24;
    options.flatness = 0.04;
    options.max_gap_m = 1.0;
    return options;
}

/// Returns the points of lines along y at several x, with heights and noise of 1 mm. The
/// sensor views the lines from the side and from above.
std::vector<LidarSample> make_lines_at(const std::vector<double>& places,
                                       const std::function<double(double)>& height) {
    Random random(1);
    std::vector<LidarSample> samples;
    for (const double x : places)
        for (int k = -20; k <= 20; ++k) {
            const glm::dvec3 noise(0.001 * random.sample_normal(), 0.001 * random.sample_normal(),
                                   0.001 * random.sample_normal());
            samples.push_back(
                {glm::vec3(glm::dvec3(x, kSpacing * k, height(x)) + noise), 0.5f, {0.8f, 0.0f, -0.6f}});
        }
    return samples;
}

Surfels make_surfels(const std::vector<LidarSample>& samples,
                     const InitOptions& options = make_standard_options()) {
    return make_surfels(samples, options, 0.0);
}
double level(double) { return 0.0; }

std::vector<double> places(int count, double apart) {
    std::vector<double> x;
    for (int k = 0; k < count; ++k) x.push_back(apart * (k - count / 2));
    return x;
}

/// Shape of a surfel: standard deviations along x and y in point spacings, and the
/// normal.
struct Disc {
    double along_x = 0.0, along_y = 0.0;
    glm::dvec3 normal;
};

Disc make_disc_at(const Surfels& surfels, const glm::vec3& place) {
    std::size_t nearest = 0;
    for (std::size_t i = 1; i < surfels.size(); ++i)
        if (glm::distance(surfels.mean[i], place) < glm::distance(surfels.mean[nearest], place)) nearest = i;
    const glm::vec4& q = surfels.rotation[nearest];
    const glm::dmat3 axes = glm::mat3_cast(glm::dquat(q.x, q.y, q.z, q.w));
    const glm::dvec2 scale = glm::exp(glm::dvec2(surfels.log_scale[nearest])) / kSpacing;
    Disc disc;
    disc.along_x = std::hypot(scale.x * axes[0].x, scale.y * axes[1].x);
    disc.along_y = std::hypot(scale.x * axes[0].y, scale.y * axes[1].y);
    disc.normal = axes[2];
    return disc;
}

TEST(PointSurfels, ReachAcrossGapsBetweenLines) {
    for (const double apart : {0.35, 0.5, 0.7}) {
        const Disc disc = make_disc_at(make_surfels(make_lines_at(places(7, apart), level)), {});
        EXPECT_NEAR(disc.along_x, apart / kSpacing, 0.05 * apart / kSpacing) << apart;
        EXPECT_NEAR(disc.along_y, 1.0, 0.4) << apart;
        EXPECT_GT(std::abs(disc.normal.z), 0.999) << apart;
    }
}

TEST(PointSurfels, AreRoundByThemselves) {
    InitOptions options = make_standard_options();
    options.max_gap_m = 0.0;
    const Surfels surfels = make_surfels(make_lines_at(places(7, 0.5), level), options);
    for (const glm::vec2& scale : surfels.log_scale) EXPECT_EQ(scale.x, scale.y);
}

/// Each cell has a random point in its inner half, like points averaged over voxels.
TEST(PointSurfels, AreRoundWherePointsAreEven) {
    Random random(2);
    std::vector<LidarSample> samples;
    for (int i = -20; i <= 20; ++i)
        for (int j = -20; j <= 20; ++j) {
            const double x = i + random.sample_uniform(-0.25, 0.25),
                         y = j + random.sample_uniform(-0.25, 0.25);
            samples.push_back({glm::vec3(kSpacing * x, kSpacing * y, 0.001 * random.sample_normal()),
                               0.5f,
                               {0.8f, 0.0f, -0.6f}});
        }
    const Surfels surfels = make_surfels(samples);
    double stretched = 0.0;
    for (const glm::vec2& scale : surfels.log_scale) stretched += scale.x != scale.y ? 1.0 : 0.0;
    EXPECT_LT(stretched / double(samples.size()), 0.02);
}

/// Lines are so far apart that the 24 nearest neighbours of a point belong to one line.
/// Only a wider search shows that the ground is level.
TEST(PointSurfels, OneLineAsksFartherForItsSurface) {
    InitOptions options = make_standard_options();
    options.max_gap_m = 2.0;
    const std::vector<LidarSample> samples = make_lines_at(places(5, 1.5), level);
    const Disc disc = make_disc_at(make_surfels(samples, options), {});
    EXPECT_GT(std::abs(disc.normal.z), 0.999);
    EXPECT_NEAR(disc.along_x, 15.0, 1.0);
    options.max_gap_m = 0.0;
    EXPECT_LT(std::abs(make_disc_at(make_surfels(samples, options), {}).normal.z), 0.9);
}

TEST(PointSurfels, DoNotReachToAnotherSurface) {
    // the next line to the right is 0.5 m higher
    const auto steps = [](double value) { return value > 0.1 ? 0.5 : 0.0; };
    const std::vector<LidarSample> samples =
        make_lines_at({-0.6, -0.5, -0.4, -0.3, -0.2, -0.1, 0.0, 0.5, 0.6}, steps);
    const Disc disc = make_disc_at(make_surfels(samples), {});
    EXPECT_LT(disc.along_x, 1.6);
}

/// No ray observed the space above the uppermost line, so training could not correct the
/// disc.
TEST(PointSurfels, DoNotReachBeyondTheLastLine) {
    const Surfels surfels = make_surfels(make_lines_at({-1.5, -1.0, -0.5, 0.0}, level));
    EXPECT_LT(make_disc_at(surfels, {}).along_x, 1.6);
    EXPECT_NEAR(make_disc_at(surfels, {-0.5f, 0.0f, 0.0f}).along_x, 5.0, 0.5);
}

TEST(PointSurfels, DoNotReachFartherThanTheyMay) {
    std::vector<double> x;
    // a gap of six spacings
    for (int k = 0; k < 8; ++k) {
        x.push_back(-kSpacing * k);
        x.push_back(0.6 + kSpacing * k);
    }
    EXPECT_NEAR(make_disc_at(make_surfels(make_lines_at(x, level)), {}).along_x, 6.0, 0.5);
    InitOptions options = make_standard_options();
    options.max_gap_m = 0.5;
    EXPECT_LT(make_disc_at(make_surfels(make_lines_at(x, level), options), {}).along_x, 1.6);
}

}  // namespace
}  // namespace relidar
