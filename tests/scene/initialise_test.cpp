// SPDX-License-Identifier: Apache-2.0
// Tests the initialisation of the background with a synthetic street.

#include <gtest/gtest.h>
#include <cmath>
#include <numeric>
#include <random>

#include <relidar/base/error.hpp>
#include <relidar/scene/scene.hpp>

#include "../support/rig_street.hpp"
#include "base/random.hpp"
#include "scene/point_surfels.hpp"

namespace relidar {
namespace {

StreetOptions make_small_street() {
    return {.n_frames = 12, .rows = 24, .columns = 256, .range_noise_m = 0.0};
}

glm::vec3 normal_of(const glm::vec4& quaternion) {
    const glm::vec4 u = glm::normalize(quaternion);  // w, x, y, z
    return {2 * (u.y * u.w + u.x * u.z), 2 * (u.z * u.w - u.x * u.y), 1 - 2 * (u.y * u.y + u.z * u.z)};
}

TEST(Initialise, GroundSurfelsLieOnTheGroundAndFaceUp) {
    const Log street = make_street_log(make_small_street());
    const Surfels surfels = init_background(street, split_frames(street, 10).train, {.max_scale_m = 0.5});
    ASSERT_GT(surfels.size(), 5000u);
    float ground = 1e9f;
    for (const glm::vec3& p : surfels.mean) ground = std::min(ground, p.z);
    std::size_t n = 0, upright = 0;
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        if (surfels.mean[i].z > ground + 0.02f || glm::length(glm::vec2(surfels.mean[i])) > 12.0f) continue;
        ++n;
        upright += std::abs(normal_of(surfels.rotation[i]).z) > 0.98f;
    }
    ASSERT_GT(n, 500u);
    EXPECT_GT(double(upright), 0.95 * double(n));
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        EXPECT_TRUE(std::isfinite(surfels.log_scale[i].x));
        EXPECT_LE(std::exp(surfels.log_scale[i].x), 0.5f * 1.0001f);
        EXPECT_NEAR(1.0f / (1.0f + std::exp(-surfels.opacity_logit[i])), 0.1f, 1e-6f);
    }
}

/// Returns the surfels of one scan of a LiDAR at the origin.
Surfels initialise_scan(int n_beams, double top_rad, int columns, double incidence,
                        const InitOptions& options,
                        const std::function<float(const glm::vec3& direction)>& range_m,
                        const std::function<float(const glm::vec3& direction)>& intensity) {
    Log log;
    SpinningSensor& sensor = log.lidars[0].sensor;
    for (int b = 0; b < n_beams; ++b) sensor.beams.push_back({.elevation_rad = top_rad - 0.01 * b});
    sensor.columns = columns;
    log.rolling_shutter = false;
    log.world_from_vehicle = {{0.0}, {{}}};
    log.intensity_response.incidence = incidence;
    Frame frame{0, 0.0, {make_rays(sensor), {}, {}}};
    for (const glm::vec3& d : frame.scan.rays.direction) {
        frame.scan.range_m.push_back(range_m(d));
        frame.scan.intensity.push_back(intensity(d));
    }
    log.frames.push_back(frame);
    return init_background(log, {0}, options);
}

/// Flat ground of a single albedo, from a height of 2 m. Its intensity is 0.4 (0.3 + 0.7
/// cos), which SH degree 1 represents exactly.
TEST(Initialise, IntensityFallsWithIncidenceFromTheStart) {
    const Surfels surfels = initialise_scan(
        64, -0.5, 720, 0.7, {}, [](const glm::vec3& d) { return -2.0f / d.z; },
        [](const glm::vec3& d) { return 0.4f * (0.3f - 0.7f * d.z); });
    std::vector<float> worst;
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        const float* sh = surfels.sh.data() + i * 48;
        for (const glm::vec3 d : {glm::vec3(0, 0, -1), glm::normalize(glm::vec3(1, 2, -1)),
                                  glm::normalize(glm::vec3(-3, 1, -0.5f))}) {
            const float value =
                0.5f + 0.28209479f * sh[0] + 0.48860251f * (-d.y * sh[1] + d.z * sh[2] - d.x * sh[3]);
            worst.push_back(std::abs(value - 0.4f * (0.3f - 0.7f * d.z)));
        }
    }
    std::sort(worst.begin(), worst.end());
    EXPECT_LT(worst[worst.size() * 95 / 100], 0.02f) << "normals of a few rays are not quite upright";
}

/// Returns the mean of |n . d| over the surfels of a scan, where d is the direction to
/// the surfel and n is the normal.
double compute_mean_facing(const std::function<float(const glm::vec3& direction)>& range_m, double flatness) {
    InitOptions options;
    options.normal_neighbours = 24;
    options.flatness = flatness;
    const Surfels surfels =
        initialise_scan(48, -0.1, 628, 0.0, options, range_m, [](const glm::vec3&) { return 0.5f; });
    double sum = 0.0;
    for (std::size_t i = 0; i < surfels.size(); ++i)
        sum += double(std::abs(glm::dot(normal_of(surfels.rotation[i]), glm::normalize(surfels.mean[i]))));
    return sum / double(surfels.size());
}

TEST(Initialise, WhatIsNoSurfaceFacesTheSensor) {
    std::mt19937 random(5);
    const auto leaves = [&](const glm::vec3&) {
        return std::uniform_real_distribution<float>(6.0f, 8.0f)(random);
    };
    const auto road = [](const glm::vec3& direction) { return -2.0f / direction.z; };
    EXPECT_GT(compute_mean_facing(leaves, 0.04), 0.95);
    EXPECT_LT(compute_mean_facing(leaves, 1.0), 0.8) << "they follow their points, which say nothing";
    EXPECT_NEAR(compute_mean_facing(road, 0.04), compute_mean_facing(road, 1.0), 0.03);
    EXPECT_LT(compute_mean_facing(road, 0.04), 0.5);
}

std::size_t count_in_moving_boxes(const Log& street, const Surfels& surfels) {
    std::size_t n = 0;
    for (const glm::vec3& p : surfels.mean) {
        bool inside = false;
        for (const Frame& frame : street.frames)
            inside = inside || is_in_moving_box(street.boxes, glm::dvec3(p), frame.time_s, -0.1);
        n += inside && p.z > surfels.mean[0].z - 1e9f;
    }
    return n;
}

/// No surfel may be removed as moving, neither for a spinning LiDAR nor without beams.
TEST(Initialise, AStreetThatStandsStillStays) {
    const std::string rig =
        test::write_rig(std::filesystem::path(testing::TempDir()) / "relidar_initialise_rig");
    const Log street = make_street_log({.n_frames = 6, .moving_cars = false, .rig = rig});
    const std::size_t n_lidars = street.lidars.size();
    // tests each LiDAR separately, then all LiDARs together
    for (std::size_t lidar = 0; lidar <= n_lidars; ++lidar) {
        std::vector<int> train;
        for (std::size_t i = 0; i < street.frames.size(); ++i)
            if (lidar == n_lidars || street.frames[i].lidar == int(lidar)) train.push_back(int(i));
        InitOptions options;
        const std::size_t all = init_background(street, train, options).size();
        options.unlabelled_movers = UnlabelledMoverPolicy::removed;
        EXPECT_GT(double(init_background(street, train, options).size()), 0.98 * double(all))
            << "LiDAR " << lidar;
    }
}

/// The lower beams of a VLP-32C are up to 9 degrees apart. The ground between two beams
/// is nearer than the return of the upper beam, which did not pass through this ground.
TEST(Initialise, UnevenBeamsDoNotSeeThroughTheGround) {
    const std::filesystem::path rig = std::filesystem::path(testing::TempDir()) / "relidar_uneven_beams.json";
    std::ofstream(rig) << R"({"sensors": [{"name": "top", "sensor": "vlp-32c"}]})";
    const Log street = make_street_log({.n_frames = 12, .moving_cars = false, .rig = rig.string()});
    std::vector<int> train(street.frames.size());
    std::iota(train.begin(), train.end(), 0);
    InitOptions options;
    const std::size_t all = init_background(street, train, options).size();
    options.unlabelled_movers = UnlabelledMoverPolicy::removed;
    EXPECT_GT(double(init_background(street, train, options).size()), 0.99 * double(all));
    EXPECT_TRUE(discover_tracks(street, train).empty());
}

TEST(Initialise, MovingBoxesAreLeftOutAndUnlabelledMoversRemoved) {
    StreetOptions longer = make_small_street();
    longer.n_frames = 20;  // long enough to observe the surfaces that a car hid
    const Log street = make_street_log(longer);
    const std::vector<int> train = split_frames(street, 10).train;
    InitOptions options;
    const std::size_t labelled = count_in_moving_boxes(street, init_background(street, train, options));
    Log unlabelled = street;
    unlabelled.boxes.clear();
    const std::size_t left_in = count_in_moving_boxes(street, init_background(unlabelled, train, options));
    options.unlabelled_movers = UnlabelledMoverPolicy::removed;
    const std::size_t removed = count_in_moving_boxes(street, init_background(unlabelled, train, options));
    EXPECT_GT(left_in, labelled + 50u) << "the cars leave a trail where nothing is done about it";
    EXPECT_LT(double(removed - std::min(removed, labelled)), 0.35 * double(left_in - labelled))
        << left_in << " in boxes without removal, " << removed << " with, " << labelled << " with labels";
}

TEST(Initialise, HeldOutFramesDoNotMatter) {
    Log street = make_street_log(make_small_street());
    const Split split = split_frames(street, 10);
    const Surfels before = init_background(street, split.train, {});
    for (const int position : split.test)
        for (float& range : street.frames[std::size_t(position)].scan.range_m) range *= 0.5f;
    const Surfels after = init_background(street, split.train, {});
    EXPECT_EQ(before.mean, after.mean);
    EXPECT_EQ(before.sh, after.sh);
}

TEST(Initialise, NothingToStartFromIsAnError) {
    Log street = make_street_log(make_small_street());
    for (Frame& frame : street.frames) std::fill(frame.scan.range_m.begin(), frame.scan.range_m.end(), 0.0f);
    EXPECT_THROW(init_background(street, split_frames(street, 10).train, {}), DataError);
}

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
