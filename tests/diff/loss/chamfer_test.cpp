// SPDX-License-Identifier: Apache-2.0
// Checks the Chamfer loss (diff/loss/chamfer_points, chamfer_boxes, chamfer_nearest,
// chamfer and chamfer_vjp).
#include <cmath>
#include <functional>
#include <limits>
#include <random>

#include <relidar/diff/forward.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>

#include "../../reference/loss.hpp"
#include "../../support/device.hpp"
#include "../../support/floats.hpp"
#include "../../support/gradient_check.hpp"

namespace relidar {
namespace {

constexpr std::size_t kRayFloats = sizeof(shared::RayGradient) / sizeof(float);

class Chamfer : public test::DeviceTest {};

constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Clouds {
    ImageShape image;
    std::vector<DeviceRay> rays;
    std::vector<float> simulated, measured;
};

/// Makes a sweep of a spinning sensor that drives in front of a rough wall. All
/// coordinates are multiples of 1/1024, so that host and device compute the same points
/// even if the device fuses multiplications and additions.
Clouds make_lattice_scan(std::uint32_t rows, std::uint32_t columns, float missing) {
    std::mt19937_64 random(rows * 977 + columns);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    Clouds c{{rows, columns, true}, {}, {}, {}};
    const auto on = [](float value, float steps) { return std::round(value * steps) / steps; };
    for (std::uint32_t i = 0; i < rows * columns; ++i) {
        const float azimuth = 6.2831853f * float(i % columns) / float(columns),
                    elevation = -0.4f * std::pow(float(i / columns) / float(rows), 1.7f);
        c.rays.push_back({{on(float(i % columns) / float(columns), 1024), 0, 0},
                          {on(std::cos(azimuth), 64), on(std::sin(azimuth), 64), on(elevation, 64)},
                          0.0f});
        const float range = on(6.0f + 3.0f * std::sin(5.0f * azimuth) + unit(random), 16);
        c.simulated.push_back(unit(random) < missing ? 0.0f : range);
        c.measured.push_back(unit(random) < missing ? 0.0f : on(range + 0.5f * unit(random) - 0.25f, 16));
    }
    return c;
}

struct FoundChamfer {
    std::array<std::vector<std::uint32_t>, 2> nearest;
    double loss = 0.0;
    std::vector<float> upstream;  ///< [n,kRayFloats]
};

struct Setting {
    bool normalised = false;
    bool image = true;
    std::uint32_t stride = 1;
    float weight = 1.0f;  ///< W of every rendered ray
};

FoundChamfer compute_device_chamfer(Device& device, const Clouds& clouds, const Setting& setting = {}) {
    const std::size_t n = clouds.rays.size();
    std::vector<shared::RenderedRay> rendered;
    std::vector<DeviceRay> rays(n * setting.stride);
    std::vector<DeviceTarget> targets(n * setting.stride);
    for (std::size_t i = 0; i < n; ++i) {
        const bool dropped = clouds.simulated[i] == 0.0f;
        shared::RenderedRay& ray = rendered.emplace_back();
        ray.depth = clouds.simulated[i] * (setting.normalised ? setting.weight : 1.0f);
        ray.weight = setting.weight;
        ray.intensity = 0.5f;
        ray.hit_logit = dropped ? 0.0f : 1.0f;
        ray.drop_logit = dropped ? 1.0f : 0.0f;
        rays[i * setting.stride] = clouds.rays[i];
        targets[i * setting.stride] = {clouds.measured[i], 0.5f, 1.0f};
    }
    const LossWeights weights{.chamfer = 1.0f, .normalised_depth = setting.normalised};
    ChamferLoss loss(device, weights, std::uint32_t(n));
    Stream stream(device);
    const Array<shared::RenderedRay> r(device, rendered, "rendered");
    const Array<float> terms(device, std::vector<float>(kLossTerms, 0.0f), "terms");
    const Array<DeviceRay> device_rays(device, rays, "rays");
    const Array<DeviceTarget> t(device, targets, "targets");
    Array<shared::RayGradient> upstream(device, n, "upstream");
    stream.fill(upstream);
    loss.add_ray_losses(
        stream, {{&device_rays, 0, setting.stride, std::uint32_t(n)}, &r, &upstream},
        {&t, 0, setting.stride, std::uint32_t(n), 0, 0, setting.image ? clouds.image : ImageShape{}}, terms);
    stream.submit_and_wait();
    return {loss.nearest_points(), terms.download()[loss_term::chamfer],
            test::to_floats(upstream.download())};
}

/// Returns points as the device computes them, relative to the origin of the first ray. A
/// ray without a return gives an infinite point.
std::vector<glm::vec3> points(const Clouds& clouds, const std::vector<float>& range) {
    std::vector<glm::vec3> result;
    for (std::size_t i = 0; i < range.size(); ++i)
        result.push_back(range[i] > 0.0f ? clouds.rays[i].origin - clouds.rays[0].origin +
                                               range[i] * clouds.rays[i].direction
                                         : glm::vec3(kInfinity));
    return result;
}

/// Uses the kernel's order of operations, because distances are compared for equality.
float compute_squared_distance_of(const glm::vec3& first, const glm::vec3& second) {
    const glm::vec3 d = first - second;
    return (d.x * d.x + d.y * d.y) + d.z * d.z;
}

void expect_nearest(const std::vector<glm::vec3>& queries, const std::vector<glm::vec3>& cloud,
                    const std::vector<std::uint32_t>& device_result, const char* description) {
    ASSERT_EQ(device_result.size(), queries.size());
    for (std::size_t i = 0; i < queries.size(); ++i) {
        float best = kInfinity;
        if (std::isfinite(queries[i].x))
            for (const glm::vec3& p : cloud)
                if (std::isfinite(p.x)) best = std::min(best, compute_squared_distance_of(queries[i], p));
        if (best == kInfinity) EXPECT_EQ(device_result[i], ~0u) << description << " " << i;
        else
            EXPECT_EQ(compute_squared_distance_of(queries[i], cloud.at(device_result[i])), best)
                << description << " " << i;
    }
}

void expect_exact(const Clouds& clouds, const FoundChamfer& device_result, const std::string& description) {
    const std::vector<glm::vec3> simulated = points(clouds, clouds.simulated),
                                 measured = points(clouds, clouds.measured);
    expect_nearest(simulated, measured, device_result.nearest[0], (description + ", simulated").c_str());
    expect_nearest(measured, simulated, device_result.nearest[1], (description + ", measured").c_str());
}

TEST_F(Chamfer, NearestNeighboursAreExact) {
    for (const auto& [rows, columns] : {std::pair{16u, 200u}, {33u, 61u}, {1u, 300u}, {64u, 3u}, {5u, 1u}})
        for (const float missing : {0.0f, 0.3f, 0.97f}) {
            const Clouds c = make_lattice_scan(rows, columns, missing);
            expect_exact(c, compute_device_chamfer(device(), c),
                         std::to_string(rows) + " x " + std::to_string(columns));
        }
}

TEST_F(Chamfer, CloudsWithoutImageOrderAreExactToo) {
    Clouds c = make_lattice_scan(16, 200, 0.2f);
    std::mt19937_64 random(6);
    for (std::size_t i = c.rays.size() - 1; i > 0; --i) {
        const std::size_t k = random() % (i + 1);
        std::swap(c.rays[i], c.rays[k]);
        std::swap(c.simulated[i], c.simulated[k]);
        std::swap(c.measured[i], c.measured[k]);
    }
    for (const bool image : {false, true})
        expect_exact(c, compute_device_chamfer(device(), c, {.image = image}),
                     image ? "shuffled image" : "shuffled list");
    const Clouds ordered = make_lattice_scan(16, 100, 0.2f);
    expect_exact(ordered, compute_device_chamfer(device(), ordered, {.image = false, .stride = 3}),
                 "every third ray");
}

TEST_F(Chamfer, DegenerateClouds) {
    const Clouds scan = make_lattice_scan(8, 40, 0.0f);
    const auto expect = [&](const char* description, const std::function<void(Clouds&)>& change) {
        Clouds c = scan;
        change(c);
        const FoundChamfer device_result = compute_device_chamfer(device(), c);
        expect_exact(c, device_result, description);
        const bool empty =
            c.simulated == std::vector<float>(320, 0.0f) || c.measured == std::vector<float>(320, 0.0f);
        EXPECT_EQ(device_result.loss == 0.0, empty || c.simulated == c.measured) << description;
        for (const float x : device_result.upstream)
            EXPECT_TRUE(std::isfinite(x) && (!empty || x == 0.0f)) << description;
    };
    const std::vector<float> none(320, 0.0f);
    std::vector<float> one = none, far = none;
    one[77] = 5.0f;
    far[300] = 4096.0f;
    expect("nothing simulated", [&](Clouds& clouds) { clouds.simulated = none; });
    expect("nothing measured", [&](Clouds& clouds) { clouds.measured = none; });
    expect("nothing at all", [&](Clouds& clouds) { clouds.simulated = clouds.measured = none; });
    expect("one point simulated", [&](Clouds& clouds) { clouds.simulated = one; });
    expect("one point each, far apart", [&](Clouds& clouds) {
        clouds.simulated = one;
        clouds.measured = far;
    });
    expect("outliers", [&](Clouds& clouds) { clouds.simulated[5] = clouds.measured[211] = 4096.0f; });
    expect("equal clouds", [&](Clouds& clouds) { clouds.measured = clouds.simulated; });
    expect("all points in one place", [&](Clouds& clouds) {
        for (DeviceRay& ray : clouds.rays) ray = clouds.rays[0];
        clouds.simulated.assign(320, 3.0f);
        clouds.measured.assign(320, 4.0f);
    });
}

TEST_F(Chamfer, UnknownDroppedAndThinRaysAreNoPoints) {
    const Clouds c = make_lattice_scan(4, 20, 0.0f);
    const FoundChamfer thin = compute_device_chamfer(device(), c, {.weight = 0.05f}),
                       solid = compute_device_chamfer(device(), c, {.weight = 0.2f});
    EXPECT_EQ(thin.nearest[0], std::vector<std::uint32_t>(80, ~0u)) << "hardly any weight";
    EXPECT_EQ(thin.loss, 0.0);
    EXPECT_NE(solid.nearest[0][0], ~0u);
    Clouds broken = c;
    broken.simulated[7] = std::numeric_limits<float>::quiet_NaN();
    const FoundChamfer device_result = compute_device_chamfer(device(), broken);
    EXPECT_EQ(device_result.nearest[0][7], ~0u);
    for (const std::uint32_t i : device_result.nearest[1]) EXPECT_NE(i, 7u);
    EXPECT_TRUE(std::isfinite(device_result.loss));
}

TEST_F(Chamfer, AgreesWithReference) {
    for (const bool normalised : {false, true}) {
        Clouds c = make_lattice_scan(16, 120, 0.2f);
        std::mt19937_64 random(1);
        std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
        std::vector<reference::ChamferRay> rays;
        for (std::size_t i = 0; i < c.rays.size(); ++i) {
            c.rays[i].direction = glm::normalize(c.rays[i].direction);
            // avoids ties, so that the pairs are unambiguous
            if (c.simulated[i] > 0.0f) c.simulated[i] += 0.3f * unit(random);
            rays.push_back({c.rays[i].origin, c.rays[i].direction, c.simulated[i], c.measured[i]});
        }
        const float weight = 0.6f;
        std::vector<double> d_range;
        const double loss = reference::compute_chamfer_loss(rays, &d_range);
        const FoundChamfer device_result =
            compute_device_chamfer(device(), c, {.normalised = normalised, .weight = weight});
        EXPECT_NEAR(device_result.loss, loss, 1e-4 * loss);
        // The error is relative to the norm of all rows, because differences of points 10
        // m away are accurate only to 1e-6 m.
        std::vector<double> expected, actual;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            const float* row = &device_result.upstream[kRayFloats * i];
            expected.insert(expected.end(), {normalised ? d_range[i] / weight : d_range[i],
                                             normalised ? -d_range[i] * c.simulated[i] / weight : 0.0});
            actual.insert(actual.end(), {row[0], row[1]});
            EXPECT_EQ(d_range[i] != 0.0, row[0] != 0.0f) << "ray " << i;
            for (std::size_t k = 2; k < 5; ++k) EXPECT_EQ(row[k], 0.0f);
        }
        EXPECT_EQ(compute_device_chamfer(device(), c, {.normalised = normalised, .weight = weight}).upstream,
                  device_result.upstream)
            << "the same bits every time";
        test::GradientTable table;
        table.add_row("depth and weight", expected, actual);
        EXPECT_GT(table.groups().begin()->second.find_largest_row(), 0.0);
        EXPECT_LE(table.compute_worst_error(), test::kKernelGradient);
    }
}

}  // namespace
}  // namespace relidar
