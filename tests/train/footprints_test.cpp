// SPDX-License-Identifier: Apache-2.0
// Beams of a step as several rays: where those go (split_beams), what is made of them (join_beams), and that split_beams_vjp and
// join_beams_vjp are the derivatives.
#include "train/footprints.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include <relidar/dataset.hpp>
#include <relidar/error.hpp>
#include <relidar/sensor.hpp>
#include <relidar/train.hpp>

#include "../support/device.hpp"
#include "gpu/stream.hpp"
#include "render/footprint.hpp"

namespace relidar {
namespace {

class FootprintsOfBeams : public test::DeviceTest {};

constexpr int kParts = 5;
constexpr double kUnexplained = 0.01;

/// A part of a footprint, in double precision.
struct Part {
    double depth, weight, intensity, hit_logit, drop_logit, likelihood;
};

/// What a loss sees of a beam, the equations of M14.
Part joined(const std::vector<Part>& parts) {
    Part beam{};
    double shares = 0.0, ranges = 0.0;
    const double mean = 1.0 / double(parts.size());
    for (const Part& p : parts) {
        const double share = kUnexplained * p.weight + p.likelihood;
        shares += share;
        ranges += share * p.depth / p.weight;
        beam.weight += mean * p.weight;
        beam.intensity += mean * p.intensity;
        beam.hit_logit += mean * p.hit_logit;
        beam.drop_logit += mean * p.drop_logit;
        beam.likelihood += mean * p.likelihood;
    }
    beam.depth = beam.weight * ranges / shares;
    return beam;
}

/// Footprints of random parts on a device.
struct RandomParts {
    std::vector<Part> parts;
    Array<shared::RenderedRay> rendered;
    Array<shared::RayGradient> upstream;
    RayGeometry geometry;
    RayBatch batch;

    RandomParts(Device& device, std::uint32_t n_beams)
        : rendered(device, kParts * n_beams, "parts"),
          upstream(device, kParts * n_beams, "gradients"),
          geometry(device, kParts * n_beams) {
        std::mt19937 random(7);
        const auto draw = [&](double low, double high) { return low + (high - low) * double(random()) / double(random.max()); };
        std::vector<shared::RenderedRay> rays;
        std::vector<shared::RenderedGeometry> geometries;
        for (std::uint32_t i = 0; i < kParts * n_beams; ++i) {
            const double weight = draw(0.05, 1.0);
            parts.push_back({weight * draw(5.0, 30.0), weight, draw(0.0, 1.0), draw(-2.0, 2.0), draw(-2.0, 2.0), weight * draw(0.0, 1.0)});
            const Part& p = parts.back();
            rays.push_back({float(p.depth), float(p.weight), float(p.intensity), float(p.hit_logit), float(p.drop_logit), 0.0f, 0.0f, 1,
                            0});
            geometries.push_back({glm::vec3(0.0f), 0.0f, 0.0f, float(p.likelihood), 0.0f});
        }
        rendered.upload(rays);
        geometry.rendered.upload(geometries);
        batch.n_rays = kParts * n_beams;
    }
    RenderedBatch view() { return {batch, &rendered, &upstream, nullptr, &geometry}; }
    std::vector<Part> of_beam(std::size_t i) const {
        return {parts.begin() + std::ptrdiff_t(kParts * i), parts.begin() + std::ptrdiff_t(kParts * (i + 1))};
    }
};

Array<DeviceRay> on_device(Device& device, const std::vector<DeviceRay>& rays) {
    return {device, std::span<const DeviceRay>(rays), "rays"};
}

constexpr float kRange_m = 12.5f;

Array<shared::DeviceTarget> same_targets(Device& device, std::size_t n) {
    const std::vector<shared::DeviceTarget> targets(n, {kRange_m, 0.5f, 1.0f});
    return {device, std::span<const shared::DeviceTarget>(targets), "targets"};
}

/// Rays that point everywhere.
std::vector<DeviceRay> random_rays(std::size_t n) {
    std::mt19937 random(3);
    std::normal_distribution<float> normal;
    std::vector<DeviceRay> rays;
    for (std::size_t i = 0; i < n; ++i)
        rays.push_back({{normal(random), normal(random), normal(random)},
                        glm::normalize(glm::vec3(normal(random), normal(random), normal(random)))});
    return rays;
}

TEST_F(FootprintsOfBeams, PartsLieWhereARendererCastsThem) {
    const std::vector<DeviceRay> beams = random_rays(40);
    RayTable table;
    for (const DeviceRay& ray : beams) {
        table.origin.push_back(ray.origin);
        table.direction.push_back(ray.direction);
        table.time_offset_s.push_back(0.0f);
        table.channel.push_back(0);
    }
    const Array<DeviceRay> rays = on_device(device(), beams);
    const Array<shared::DeviceTarget> targets = same_targets(device(), 40);
    for (const int n : {5, 9}) {
        const RayTable expected = split_rays(table, n, 0.009);
        Footprints footprints(device(), n, 40, kUnexplained);
        Stream stream(device());
        const RayBatch parts = footprints.split(stream, {&rays, 1, 3, 13, 0, &targets}, 0.009);   // beams 1, 4, ... 37
        stream.finish();
        ASSERT_EQ(parts.n_rays, 13u * unsigned(n));
        const std::vector<DeviceRay> found = parts.rays->download(parts.n_rays);
        for (std::size_t k = 0; k < found.size(); ++k) {
            const std::size_t at = (1 + 3 * (k / std::size_t(n))) * std::size_t(n) + k % std::size_t(n);
            EXPECT_LT(glm::distance(found[k].direction, glm::vec3(expected.direction[at])), 1e-6f);
            EXPECT_EQ(found[k].origin, glm::vec3(expected.origin[at]));
        }
        for (const shared::DeviceTarget& target : parts.targets->download(parts.n_rays)) EXPECT_EQ(target.range_m, kRange_m);
    }
}

TEST_F(FootprintsOfBeams, BeamsAreJoinedAsTheEquationsSay) {
    RandomParts parts(device(), 50);
    Footprints footprints(device(), kParts, 50, kUnexplained);
    Stream stream(device());
    const Array<DeviceRay> rays = on_device(device(), random_rays(50));
    const Array<shared::DeviceTarget> targets = same_targets(device(), 50);
    const RayBatch beams{&rays, 0, 1, 50, 0, &targets};
    footprints.split(stream, beams, 0.001);
    const RenderedBatch result = footprints.join(stream, beams, parts.view());
    stream.finish();
    const std::vector<shared::RenderedRay> rendered = result.rendered->download(50);
    const std::vector<shared::RenderedGeometry> geometry = result.geometry->rendered.download(50);
    for (std::size_t i = 0; i < 50; ++i) {
        const Part expected = joined(parts.of_beam(i));
        EXPECT_NEAR(rendered[i].depth, expected.depth, 1e-5 * expected.depth);
        EXPECT_NEAR(rendered[i].weight, expected.weight, 1e-6);
        EXPECT_NEAR(rendered[i].intensity, expected.intensity, 1e-6);
        EXPECT_NEAR(rendered[i].hit_logit, expected.hit_logit, 1e-6);
        EXPECT_NEAR(rendered[i].drop_logit, expected.drop_logit, 1e-6);
        EXPECT_NEAR(geometry[i].likelihood, expected.likelihood, 1e-6);
    }
}

TEST_F(FootprintsOfBeams, GradientsAreThoseOfFiniteDifferences) {
    constexpr std::uint32_t kBeams = 20;
    RandomParts parts(device(), kBeams);
    Footprints footprints(device(), kParts, kBeams, kUnexplained);
    Stream stream(device());
    const Array<DeviceRay> rays = on_device(device(), random_rays(kBeams));
    const Array<shared::DeviceTarget> targets = same_targets(device(), kBeams);
    const RayBatch beams{&rays, 0, 1, kBeams, 0, &targets};
    footprints.split(stream, beams, 0.001);
    const RenderedBatch result = footprints.join(stream, beams, parts.view());
    stream.finish();
    // a loss that is linear in what beams render
    const shared::RayGradient d{0.3f, -1.2f, 0.7f, 0.4f, -0.9f};
    const float d_likelihood = 1.7f;
    result.upstream->upload(std::vector<shared::RayGradient>(kBeams, d));
    result.geometry->gradient.upload(
        std::vector<shared::GeometryGradient>(kBeams, {glm::vec3(0.0f), 0.0f, glm::vec3(0.0f), 0.0f, d_likelihood}));
    footprints.spread(stream, parts.view());
    stream.finish();
    const auto loss = [&](const std::vector<Part>& of_beam) {
        const Part b = joined(of_beam);
        return d.depth * b.depth + d.weight * b.weight + d.intensity * b.intensity + d.hit_logit * b.hit_logit +
               d.drop_logit * b.drop_logit + double(d_likelihood) * b.likelihood;
    };
    const std::vector<shared::RayGradient> found = parts.upstream.download(kParts * kBeams);
    const std::vector<shared::GeometryGradient> found_geometry = parts.geometry.gradient.download(kParts * kBeams);
    for (std::size_t k = 0; k < parts.parts.size(); ++k) {
        const auto difference = [&](double Part::*value) {
            std::vector<Part> of_beam = parts.of_beam(k / kParts);
            constexpr double kStep = 1e-5;
            of_beam[k % kParts].*value += kStep;
            const double above = loss(of_beam);
            of_beam[k % kParts].*value -= 2.0 * kStep;
            return (above - loss(of_beam)) / (2.0 * kStep);
        };
        const auto expect_near = [](double value, double expected) {
            EXPECT_NEAR(value, expected, 1e-4 * std::max(1.0, std::abs(expected)));
        };
        expect_near(found[k].depth, difference(&Part::depth));
        expect_near(found[k].weight, difference(&Part::weight));
        expect_near(found[k].intensity, difference(&Part::intensity));
        expect_near(found[k].hit_logit, difference(&Part::hit_logit));
        expect_near(found[k].drop_logit, difference(&Part::drop_logit));
        expect_near(found_geometry[k].likelihood, difference(&Part::likelihood));
    }
}

TEST_F(FootprintsOfBeams, GradientsOfRaysAreSummed) {
    Footprints footprints(device(), kParts, 4, kUnexplained);
    Stream stream(device());
    const Array<DeviceRay> rays = on_device(device(), random_rays(4));
    const Array<shared::DeviceTarget> targets = same_targets(device(), 4);
    footprints.split(stream, {&rays, 0, 1, 4, 0, &targets}, 0.001);
    std::vector<float> d_parts(6 * kParts * 4);
    for (std::size_t i = 0; i < d_parts.size(); ++i) d_parts[i] = float(i * i % 101);
    const Array<float> d_rays(device(), std::span<const float>(d_parts), "gradients of rays");
    footprints.sum_ray_gradients(stream, d_rays);
    stream.finish();
    const std::vector<float> found = d_rays.download(24);
    for (std::size_t k = 0; k < 24; ++k) {
        float expected = 0.0f;
        for (std::size_t p = 0; p < kParts; ++p) expected += d_parts[6 * (k / 6 * kParts + p) + k % 6];
        EXPECT_EQ(found[k], expected);
    }
}

Sequence small_street() { return make_synthetic_street({.n_frames = 4, .rows = 8, .columns = 128}); }

Config few_steps(int sub_rays, double divergence_mrad) {
    Config config = make_preset("quick");
    config.init.voxel_m = 0.6;
    config.train.iterations = 20;
    config.train.rays_per_iteration = 300;
    config.train.refine_poses = "sensor,actors";
    config.train.pose_register = false;
    config.train.sensor_drop = config.refine.enabled = false;
    config.train.sub_rays = sub_rays;
    config.sensor.divergence_mrad = divergence_mrad;
    return config;
}

/// Beams that are as thin as rays train as rays do, poses and all, up to the order of sums; thick ones do not.
TEST_F(FootprintsOfBeams, ThinBeamsTrainAsRaysDo) {
    const Sequence street = small_street();
    const Split split = split_frames(street, 0);
    const auto losses = [&](int sub_rays, double divergence_mrad) {
        std::vector<double> values;
        const Config config = few_steps(sub_rays, divergence_mrad);
        for (const auto& line : train(device(), street, split, config, [](const TrainProgress&) { return true; }).log)
            values.push_back(line.loss);
        return values;
    };
    const std::vector<double> rays = losses(1, 0.0), thin = losses(5, 1e-4), thick = losses(5, 30.0);
    ASSERT_EQ(rays.size(), thin.size());
    ASSERT_GE(rays.size(), 1u);
    for (std::size_t i = 0; i < rays.size(); ++i) EXPECT_NEAR(thin[i], rays[i], 2e-3 * rays[i]);
    EXPECT_GT(std::abs(thick.back() - rays.back()), 1e-2 * rays.back());
}

TEST_F(FootprintsOfBeams, ABeamOfUnknownWidthIsRefused) {
    const Sequence street = small_street();   // its rays are ideal
    try {
        train(device(), street, split_frames(street, 0), few_steps(5, 0.0), [](const TrainProgress&) { return true; });
        FAIL();
    } catch (const UsageError& e) {
        EXPECT_STREQ(e.what(),
                     "setting train.sub_rays: nothing is known of the divergence of the log's beams, expected sensor.divergence_mrad");
    }
}

/// Rays of second returns begin behind the first surface: there a footprint is wider than a cone from there has it.
TEST_F(FootprintsOfBeams, RaysOfSecondReturnsAreRefused) {
    const Sequence street = small_street();
    Config config = few_steps(5, 2.0);
    config.train.second_returns = true;
    EXPECT_THROW(train(device(), street, split_frames(street, 0), config, [](const TrainProgress&) { return true; }), UsageError);
}

TEST_F(FootprintsOfBeams, OnlyFiveOrNineParts) {
    try {
        const Footprints footprints(device(), 4, 1, kUnexplained);
        FAIL();
    } catch (const UsageError& e) {
        EXPECT_STREQ(e.what(), "setting train.sub_rays: found 4, expected 1, 5 or 9");
    }
}

}  // namespace
}  // namespace relidar
