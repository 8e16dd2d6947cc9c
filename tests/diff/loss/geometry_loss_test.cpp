// SPDX-License-Identifier: Apache-2.0
// Compares diff/loss/geometry_loss and diff/loss/normal_vjp with the double reference:
// values, and derivatives against its central differences. Covers images with edges and
// with dropped, unknown and faint pixels, full sweeps and windows, strided targets, and
// the ranges D and D / W.
#include <algorithm>
#include <numeric>
#include <random>

#include <relidar/diff/forward.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>

#include "../../reference/geometry_loss.hpp"
#include "../../reference/loss.hpp"
#include "../../support/device.hpp"
#include "../../support/floats.hpp"
#include "../../support/gradient_check.hpp"

namespace relidar {
namespace {

using reference::RangeImage;

class GeometryTerms : public test::DeviceTest {};

/// Makes rays of a spinning sensor that sees a wavy surface with an edge. A tenth is
/// dropped, unknown or faint. All values are rounded to float.
RangeImage random_image(int rows, int columns, bool circular, bool normalised) {
    std::mt19937_64 random(std::uint64_t(rows * 1000 + columns));
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    std::normal_distribution<double> normal;
    RangeImage image{rows, columns, circular, normalised, {}, {}, {}};
    const double turn = circular ? 6.283185307179586 / columns : 0.01;
    for (int i = 0; i < rows * columns; ++i) {
        const double azimuth = turn * (i % columns), elevation = 0.02 * (i / columns);
        const glm::dvec3 d(std::cos(azimuth) * std::cos(elevation), -std::sin(azimuth) * std::cos(elevation),
                           -std::sin(elevation));
        image.rays.push_back(
            {glm::dvec3(glm::vec3(0.01 * (i % columns), 2.0, 1.0)), glm::dvec3(glm::vec3(d))});
        const double range =
            (i % columns < columns / 2 ? 8.0 : 14.0) + std::sin(3.0 * azimuth) + 0.01 * unit(random);
        reference::Pixel p;
        p.weight = float(unit(random) < 0.05 ? 0.3 : 0.6 + 0.4 * unit(random));
        p.depth = float(normalised ? range * p.weight : range);
        p.normal =
            p.weight * glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)) - 2.0 * d);
        p.normal = glm::dvec3(glm::vec3(p.normal));
        p.distortion = float(0.2 * unit(random));
        p.likelihood = float(unit(random) < 0.1 ? 0.0 : unit(random));
        image.pixels.push_back(p);
        image.returned.push_back(unit(random) < 0.95);
    }
    return image;
}

struct FoundLoss {
    double distortion = 0.0, normal = 0.0, likelihood = 0.0;
    std::vector<shared::RayGradient> upstream;       ///< [n]
    std::vector<shared::GeometryGradient> gradient;  ///< [n]
};

FoundLoss device_terms(Device& device, const RangeImage& image, const LossWeights& weights,
                       std::uint32_t stride) {
    const std::size_t n = image.pixels.size();
    std::vector<shared::RenderedRay> rendered;
    std::vector<shared::RenderedGeometry> geometry;
    std::vector<DeviceRay> rays(n * stride);
    std::vector<DeviceTarget> targets(n * stride);
    double n_returned = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        const reference::Pixel& p = image.pixels[i];
        shared::RenderedRay& ray = rendered.emplace_back();
        ray.depth = float(p.depth), ray.weight = float(p.weight);
        geometry.push_back({.normal = glm::vec3(p.normal),
                            .distortion = float(p.distortion),
                            .moment = 0.0f,
                            .likelihood = float(p.likelihood),
                            .mode = 0.0f});
        rays[i * stride] = {glm::vec3(image.rays[i].origin), glm::vec3(image.rays[i].direction)};
        targets[i * stride] = image.returned[i] ? DeviceTarget{5.0f, 0.5f, 1.0f}
                              : i % 2           ? DeviceTarget{0.0f, 0.5f, 1.0f}
                                                : DeviceTarget{5.0f, 0.5f, 0.0f};
        n_returned += image.returned[i];
    }
    const Array<shared::RenderedRay> r(device, rendered, "rendered");
    const Array<float> terms(device, std::vector<float>(kLossTerms, 0.0f), "terms");
    const Array<DeviceRay> device_rays(device, std::span<const DeviceRay>(rays), "rays");
    const Array<DeviceTarget> device_targets(device, std::span<const DeviceTarget>(targets), "targets");
    RayGeometry q(device, n);
    q.rendered.upload(geometry);
    Array<shared::RayGradient> upstream(device, std::vector<shared::RayGradient>(n), "upstream");
    GeometryLoss loss(device, weights, std::uint32_t(n));
    Stream stream(device);
    const bool is_image = weights.normal > 0.0f;
    const ImageShape shape{is_image ? std::uint32_t(image.rows) : 0,
                           is_image ? std::uint32_t(image.columns) : 0, image.circular};
    loss.compare(stream, {{&device_rays, 0, stride, std::uint32_t(n)}, &r, &upstream, nullptr, &q},
                 {&device_targets, 0, stride, std::uint32_t(n), n_returned, double(n), shape}, terms);
    stream.finish();
    const std::vector<float> t = terms.download();
    return {t[loss_term::distortion], t[loss_term::normal], t[loss_term::likelihood], upstream.download(),
            q.gradient.download()};
}

/// Points 10 m away and 0.2 m apart give normals with an accuracy of 1e-5. Rows are sums
/// over four neighbours, which may cancel.
constexpr double kTolerance = 10.0 * test::kKernelGradient;

/// Adds a row for every pixel with the central differences of the reference.
void add_differences(RangeImage image, const FoundLoss& device_result, test::GradientTable& table) {
    const auto terms = [&] { return normal_terms(image, image_normals(image)); };
    for (std::size_t i = 0; i < image.pixels.size(); ++i) {
        const shared::RayGradient& u = device_result.upstream[i];
        const shared::GeometryGradient& g = device_result.gradient[i];
        const auto add = [&](const char* name, double* x, int n, const std::vector<double>& actual) {
            table.add_row(name, test::central_differences(x, n, terms), actual);
        };
        add("depth", &image.pixels[i].depth, 1, {u.depth});
        add("weight", &image.pixels[i].weight, 1, {u.weight});
        add("normal", &image.pixels[i].normal.x, 3, {g.normal.x, g.normal.y, g.normal.z});
        add("origin", &image.rays[i].origin.x, 3, {g.point.x, g.point.y, g.point.z});
        add("direction", &image.rays[i].direction.x, 3,
            {g.range * g.point.x, g.range * g.point.y, g.range * g.point.z});
    }
}

TEST_F(GeometryTerms, AgreeWithReference) {
    struct Case {
        int rows, columns;
        bool circular, normalised;
        std::uint32_t stride;
    };
    for (const Case& c : {Case{8, 60, true, true, 1}, Case{7, 25, false, true, 3},
                          Case{6, 40, true, false, 2}, Case{12, 9, false, false, 1}}) {
        const RangeImage image = random_image(c.rows, c.columns, c.circular, c.normalised);
        const auto normals = image_normals(image);
        const auto n_normals =
            std::count_if(normals.begin(), normals.end(), [](const auto& n) { return n.has_value(); });
        EXPECT_GT(n_normals, 20) << "the image tests little";
        EXPECT_LT(n_normals, 0.9 * (c.rows - 2) * c.columns) << "the rules for edges are not tested";
        const std::vector<double> expected = normal_terms(image, normals);
        double distortion = 0.0, n_returned = 0.0;
        for (std::size_t i = 0; i < image.pixels.size(); ++i) {
            distortion += image.returned[i] ? image.pixels[i].distortion : 0.0;
            n_returned += image.returned[i];
        }
        LossWeights weights;
        weights.distortion = 0.5f, weights.normal = 1.0f, weights.normalised_depth = c.normalised;
        const FoundLoss device_result = device_terms(device(), image, weights, c.stride);
        EXPECT_NEAR(device_result.distortion, 0.5 * distortion / n_returned, 1e-6);
        EXPECT_NEAR(device_result.normal, std::accumulate(expected.begin(), expected.end(), 0.0), 1e-5);
        test::GradientTable table;
        add_differences(image, device_result, table);
        table.print("normal consistency");
        for (const auto& [name, group] : table.groups()) {
            EXPECT_LE(group.worst_error(), name == "normal" ? test::kKernelGradient : kTolerance) << name;
            EXPECT_EQ(group.missing_rows(), 0u) << name;
            EXPECT_GT(group.nonzero_rows(), 20u) << name;
        }
        for (std::size_t i = 0; i < image.pixels.size(); ++i)
            EXPECT_FLOAT_EQ(device_result.gradient[i].distortion,
                            image.returned[i] ? float(0.5 / n_returned) : 0.0f);
    }
}

/// Distortion alone does not need an image order, and no other output gets a gradient.
TEST_F(GeometryTerms, DistortionIsARaysOwn) {
    const RangeImage image = random_image(4, 30, false, true);
    LossWeights weights;
    weights.distortion = 1.0f;
    const FoundLoss device_result = device_terms(device(), image, weights, 1);
    EXPECT_GT(device_result.distortion, 0.01);
    EXPECT_EQ(device_result.normal, 0.0);
    EXPECT_EQ(device_result.likelihood, 0.0);
    for (const float x : test::floats_of(device_result.upstream)) EXPECT_EQ(x, 0.0f);
    for (const shared::GeometryGradient& g : device_result.gradient) {
        EXPECT_EQ(g.normal, glm::vec3(0.0f));
        EXPECT_EQ(g.point, glm::vec3(0.0f));
        EXPECT_EQ(g.likelihood, 0.0f);
    }
}

/// Likelihood alone and combined with two other terms. Values and derivatives must match
/// the double reference, and must be 0 for dropped and unknown rays.
TEST_F(GeometryTerms, LikelihoodAgreesWithReference) {
    for (const bool alone : {true, false}) {
        const RangeImage image = random_image(9, 31, false, true);
        std::vector<reference::Target> targets;
        for (const bool returned : image.returned) targets.push_back({returned ? 5.0 : 0.0, 0.5});
        std::vector<reference::PixelGradient> expected;
        const double term = reference::likelihood_loss(image.pixels, targets, 0.02, &expected);
        LossWeights weights;
        weights.likelihood = 0.7f, weights.likelihood_floor = 0.02f;
        if (!alone) weights.distortion = 0.5f, weights.normal = 0.5f, weights.normalised_depth = true;
        const FoundLoss device_result = device_terms(device(), image, weights, 3);
        EXPECT_NEAR(device_result.likelihood, 0.7 * term, 1e-5 * term);
        EXPECT_EQ(device_result.distortion > 0.0 && device_result.normal > 0.0, !alone);
        for (std::size_t i = 0; i < expected.size(); ++i) {
            const double d = 0.7 * expected[i].likelihood;
            EXPECT_NEAR(device_result.gradient[i].likelihood, d, 1e-5 * std::abs(d)) << "ray " << i;
        }
    }
}

/// The image normals of an inclined plane must equal its normal. The edge rule must not
/// reject ground that is seen at a grazing angle.
TEST_F(GeometryTerms, APlaneHasItsOwnNormalFarAway) {
    const glm::dvec3 up(0.0, 0.0, 1.0);
    RangeImage image{20, 10, false, true, {}, {}, {}};
    for (int i = 0; i < 200; ++i) {
        const double azimuth = -0.004 * (i % 10), elevation = -0.02 - 0.006 * (19 - i / 10);
        const glm::dvec3 d(std::cos(azimuth) * std::cos(elevation), std::sin(azimuth) * std::cos(elevation),
                           std::sin(elevation));
        image.rays.push_back({{0.0, 0.0, 1.7}, d});
        reference::Pixel p;
        // up to 85 m, with steps of up to 26 m between rows
        p.weight = 1.0, p.depth = 1.7 / -d.z, p.normal = up;
        image.pixels.push_back(p);
        image.returned.push_back(true);
    }
    const auto normals = image_normals(image);
    int n = 0;
    for (const auto& normal : normals) n += normal && glm::length(*normal - up) < 1e-6;
    EXPECT_EQ(n, 18 * 8);
    LossWeights weights;
    weights.normal = 1.0f, weights.normalised_depth = true;
    const FoundLoss device_result = device_terms(device(), image, weights, 1);
    EXPECT_LT(device_result.normal, 1e-4);
    int with_normal = 0;
    for (std::size_t i = 0; i < 200; ++i) with_normal += device_result.gradient[i].normal.z != 0.0f;
    EXPECT_EQ(with_normal, n);
}

}  // namespace
}  // namespace relidar
