// SPDX-License-Identifier: Apache-2.0
// Compares values and derivatives of losses with the double reference:
// diff/loss/image_loss (Eq. 10, M6) for both depth and both intensity terms, masked rays,
// extreme logits and strided batches; ssim and ssim_vjp; likelihood_loss; surfel_loss,
// the penalty for surfels outside their box.
#include <cmath>
#include <random>

#include <relidar/diff/forward.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/scene/device_scene.hpp>

#include "../../reference/loss.hpp"
#include "../../support/device.hpp"
#include "../../support/floats.hpp"
#include "../../support/gradient_check.hpp"

namespace relidar {
namespace {

struct LossRun {
    std::vector<float> terms;
    std::vector<shared::RayGradient> upstream;
};
/// Computes a loss of rays on the device.
/// @param batch without the address of its targets
/// @param upstream gradients before the loss adds its gradients
LossRun run_loss(Loss& loss, const std::vector<shared::RenderedRay>& rendered,
                 const std::vector<DeviceTarget>& targets, TargetBatch batch,
                 const std::vector<shared::RayGradient>& upstream, Device& device) {
    Stream stream(device);
    const Array<shared::RenderedRay> rays(device, rendered, "rendered");
    const Array<DeviceTarget> measured(device, targets, "targets");
    const Array<float> terms(device, std::vector<float>(kLossTerms, 0.0f), "terms");
    Array<shared::RayGradient> gradients(device, upstream, "upstream");
    batch.targets = &measured;
    loss.add_ray_losses(stream, {{}, &rays, &gradients}, batch, terms);
    stream.submit_and_wait();
    return {terms.download(), gradients.download()};
}

class ImageLossTest : public test::DeviceTest {};

struct Data {
    std::vector<shared::RenderedRay> rendered;
    std::vector<DeviceTarget> targets;
    std::vector<reference::Pixel> pixels;
    std::vector<reference::Target> expected_targets;
};

Data make_random_data(std::size_t count, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    Data d;
    for (std::size_t i = 0; i < count; ++i) {
        const float weight = 0.2f + 0.8f * unit(random), range = 2.0f + 50.0f * unit(random),
                    depth = weight * (range + unit(random) - 0.5f);
        const float spread = i % 7 == 0 ? 80.0f : 3.0f;  // includes extreme logits
        const float hit = spread * (unit(random) - 0.5f), drop = spread * (unit(random) - 0.5f),
                    intensity = unit(random);
        const bool dropped = unit(random) < 0.3f;
        shared::RenderedRay& ray = d.rendered.emplace_back();
        ray.depth = depth;
        ray.weight = weight;
        ray.intensity = intensity;
        ray.hit_logit = hit;
        ray.drop_logit = drop;
        d.targets.push_back({dropped ? 0.0f : range, dropped ? 0.0f : unit(random), 1.0f});
        reference::Pixel p;
        p.depth = depth;
        p.weight = weight;
        p.intensity = intensity;
        p.hit_logit = hit;
        p.drop_logit = drop;
        d.pixels.push_back(p);
        d.expected_targets.push_back({d.targets.back().range_m, d.targets.back().intensity});
    }
    return d;
}

TEST_F(ImageLossTest, AgreesWithReference) {
    for (const std::size_t n : {std::size_t(1), std::size_t(1000), std::size_t(1037)})
        for (const bool normalised : {false, true}) {
            const Data d = make_random_data(n, n);
            const LossWeights weights{.normalised_depth = normalised,
                                      .intensity_delta = normalised ? 0.2f : 0.0f};
            constexpr std::size_t kFloats = sizeof(shared::RayGradient) / sizeof(float);
            std::vector<reference::PixelGradient> expected;
            const reference::LossTerms terms = reference::evaluate_loss(
                d.pixels, d.expected_targets,
                {weights.depth, weights.intensity, weights.drop, weights.intensity_delta},
                normalised ? reference::DepthKind::normalised : reference::DepthKind::blended, &expected);
            ImageLoss loss(device(), weights);
            double returned = 0.0;
            for (const DeviceTarget& t : d.targets) returned += t.range_m > 0.0f;
            shared::RayGradient unwritten;
            for (std::size_t k = 0; k < kFloats; ++k) (&unwritten.depth)[k] = std::nanf("");
            const LossRun run =
                run_loss(loss, d.rendered, d.targets, {nullptr, 0, 1, std::uint32_t(n), returned, double(n)},
                         std::vector<shared::RayGradient>(n + 1, unwritten), device());
            const std::vector<float> g = test::to_floats(run.upstream), &s = run.terms;
            EXPECT_NEAR(s[loss_term::depth], weights.depth * terms.depth, 1e-4 * weights.depth * terms.depth);
            EXPECT_NEAR(s[loss_term::intensity], weights.intensity * terms.intensity,
                        1e-4 * weights.intensity * terms.intensity);
            EXPECT_NEAR(s[loss_term::drop], weights.drop * terms.drop, 1e-4 * weights.drop * terms.drop);
            for (std::size_t i = 0; i < n; ++i) {
                const double row[] = {expected[i].depth,     expected[i].weight,     expected[i].intensity,
                                      expected[i].hit_logit, expected[i].drop_logit, 0.0};
                for (std::size_t k = 0; k < kFloats; ++k)
                    EXPECT_NEAR(g[kFloats * i + k], row[k], 1e-6 * (std::abs(row[k]) + 1.0 / double(n)))
                        << "ray " << i << " lane " << k;
            }
            for (std::size_t k = 0; k < kFloats; ++k)
                EXPECT_TRUE(std::isnan(g[kFloats * n + k])) << "wrote past the end";
        }
}

TEST_F(ImageLossTest, MaskedRaysAreIgnoredAndStrideSelects) {
    Data d = make_random_data(64, 9);
    for (std::size_t i = 0; i < 64; ++i) d.targets[i].weight = i % 4 == 1 ? 1.0f : 0.0f;
    ImageLoss loss(device(), {});
    const auto run = [&](std::uint32_t first) {
        return run_loss(loss, d.rendered, d.targets, {nullptr, first, 4, 16, 16.0, 16.0},
                        std::vector<shared::RayGradient>(16), device());
    };
    const LossRun masked = run(0);  // targets 0, 4, 8, ...
    for (const float x : test::to_floats(masked.upstream)) EXPECT_EQ(x, 0.0f);
    for (const float x : masked.terms) EXPECT_EQ(x, 0.0f);
    EXPECT_GT(run(1).terms[loss_term::drop], 0.0f) << "targets 1, 5, 9, ... have a measured value";
}

const char* get_loss_type_name(const Loss& loss) {
    if (dynamic_cast<const ImageLoss*>(&loss)) return "image";
    if (dynamic_cast<const LikelihoodLoss*>(&loss)) return "likelihood";
    if (dynamic_cast<const ChamferLoss*>(&loss)) return "chamfer";
    if (dynamic_cast<const ActorBoxLoss*>(&loss)) return "surfel";
    return "another";
}

std::vector<std::string> list_made_kernels(Device& device, const LossWeights& weights) {
    std::vector<std::string> names;
    for (const std::unique_ptr<Loss>& loss : make_losses(device, weights, 64))
        names.push_back(get_loss_type_name(*loss));
    return names;
}

TEST_F(ImageLossTest, ComesFirstAndEachOtherLossOnceWhereATermAsksForIt) {
    using Names = std::vector<std::string>;
    const auto of = [&](LossWeights weights, float chamfer) {
        weights.chamfer = chamfer;
        return list_made_kernels(device(), weights);
    };
    EXPECT_EQ(of({.depth = 0.0f, .intensity = 0.0f, .drop = 0.0f}, 0.0f), Names{"image"})
        << "it outputs what others add to";
    EXPECT_EQ(of({}, 0.1f), (Names{"image", "chamfer"}));
    EXPECT_EQ(of({.likelihood = 0.1f}, 0.0f), (Names{"image", "likelihood"}));
    EXPECT_EQ(of({.opacity = 0.1f, .box = 0.1f, .likelihood = 0.1f}, 0.1f),
              (Names{"image", "surfel", "chamfer", "likelihood"}));
}

using reference::Image;

class Ssim : public test::DeviceTest {};

Image make_random_image(int rows, int columns, bool circular, double known_share) {
    std::mt19937_64 random(std::uint64_t(rows * 1000 + columns));
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    Image image{rows, columns, circular, {}, {}, {}};
    for (int i = 0; i < rows * columns; ++i) {
        // Makes half of the image nearly flat, so that its variances are small.
        const double flat = i % columns < columns / 2 ? 0.3 : 0.3 + 0.4 * unit(random);
        image.y.push_back(float(flat));
        image.x.push_back(float(flat + 0.05 * unit(random)));
        image.is_known.push_back(unit(random) < known_share);
    }
    return image;
}

struct Result {
    double ssim = 0.0, l1 = 0.0;
    std::vector<double> d_x;
};

/// Computes the loss on the device. Pixels without a known value are alternately dropped
/// and unknown, and contain invalid values.
Result compute_device_ssim(Device& device, const Image& image, float share, std::uint32_t stride = 1) {
    const std::size_t n = image.x.size();
    std::vector<shared::RenderedRay> rendered;
    std::vector<DeviceTarget> targets(n * stride);
    double n_known_pixels = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        n_known_pixels += image.is_known[i];
        shared::RenderedRay& ray = rendered.emplace_back();
        ray.depth = 10.0f;
        ray.weight = 1.0f;
        ray.intensity = image.is_known[i] ? float(image.x[i]) : 7.0f;
        DeviceTarget& target = targets[i * stride];
        target = i % 2 ? DeviceTarget{0.0f, 5.0f, 1.0f} : DeviceTarget{10.0f, 5.0f, 0.0f};
        if (image.is_known[i]) target = {10.0f, float(image.y[i]), 1.0f};
    }
    const LossWeights weights{.intensity = 1.0f, .intensity_ssim = share};
    ImageLoss loss(device, weights, std::uint32_t(n));
    const ImageShape shape{std::uint32_t(image.rows), std::uint32_t(image.columns), image.circular};
    const LossRun run = run_loss(loss, rendered, targets,
                                 {nullptr, 0, stride, std::uint32_t(n), n_known_pixels, double(n), shape},
                                 std::vector<shared::RayGradient>(n), device);
    Result result{run.terms[loss_term::ssim], run.terms[loss_term::intensity], {}};
    for (const shared::RayGradient& g : run.upstream) result.d_x.push_back(g.intensity);
    return result;
}

TEST_F(Ssim, AgreesWithReference) {
    struct Case {
        int rows, columns;
        bool circular;
        double known_fraction;
        std::uint32_t stride;
    };
    for (const Case& c : {Case{16, 50, true, 0.8, 1}, Case{16, 50, false, 1.0, 3}, Case{1, 40, true, 0.7, 1},
                          Case{3, 7, true, 1.0, 1}, Case{33, 37, true, 0.15, 2}}) {
        const Image image = make_random_image(c.rows, c.columns, c.circular, c.known_fraction);
        std::vector<double> expected;
        const double loss = reference::compute_ssim_loss(image, &expected);
        const Result device_result = compute_device_ssim(device(), image, 1.0f, c.stride);
        EXPECT_NEAR(device_result.ssim, loss, 1e-4 * loss) << c.rows << " x " << c.columns;
        EXPECT_EQ(device_result.l1, 0.0);
        test::GradientTable table;
        table.add_row("image", expected, device_result.d_x);
        EXPECT_EQ(table.groups().at("image").count_missing_rows(), 0u);
        EXPECT_LE(table.compute_worst_error(), test::kKernelGradient) << c.rows << " x " << c.columns;
        for (std::size_t i = 0; i < expected.size(); ++i)
            EXPECT_TRUE(image.is_known[i] || device_result.d_x[i] == 0.0)
                << "pixel " << i << " takes no part";
    }
}

TEST_F(Ssim, SharesTheIntensityTermWithL1) {
    const Image image = make_random_image(8, 20, true, 0.9);
    const Result all = compute_device_ssim(device(), image, 1.0f),
                 none = compute_device_ssim(device(), image, 0.0f),
                 some = compute_device_ssim(device(), image, 0.15f);
    EXPECT_EQ(none.ssim, 0.0);
    EXPECT_NEAR(some.ssim, 0.15 * all.ssim, 1e-6);
    EXPECT_NEAR(some.l1, 0.85 * none.l1, 1e-6);
    for (std::size_t i = 0; i < image.x.size(); ++i)
        EXPECT_NEAR(some.d_x[i], 0.15 * all.d_x[i] + 0.85 * none.d_x[i], 1e-7);
}

class LikelihoodTerm : public test::DeviceTest {};

TEST_F(LikelihoodTerm, AgreesWithReference) {
    constexpr std::size_t kRays = 279, kStride = 3;
    std::mt19937_64 random(9031);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    std::vector<reference::Pixel> pixels(kRays);
    std::vector<reference::Target> expected_targets(kRays);
    std::vector<shared::RenderedRay> rays(kRays);
    std::vector<DeviceTarget> measured(kRays * kStride);
    double n_returned = 0.0;
    for (std::size_t i = 0; i < kRays; ++i) {
        pixels[i].likelihood = float(unit(random) < 0.1 ? 0.0 : unit(random));
        rays[i].likelihood = float(pixels[i].likelihood);
        const bool returned = unit(random) < 0.95;
        expected_targets[i] = {returned ? 5.0 : 0.0, 0.5};
        // a ray without a return is either dropped or unknown
        DeviceTarget& target = measured[i * kStride];
        target = i % 2 ? DeviceTarget{0.0f, 0.5f, 1.0f} : DeviceTarget{5.0f, 0.5f, 0.0f};
        if (returned) target = {5.0f, 0.5f, 1.0f};
        n_returned += returned;
    }
    std::vector<reference::PixelGradient> expected;
    const double term = reference::compute_likelihood_loss(pixels, expected_targets, 0.02, &expected);
    std::vector<shared::RayGradient> others(kRays);
    for (shared::RayGradient& g : others) g.depth = 3.0f;
    const LossWeights weights{.likelihood = 0.7f, .likelihood_floor = 0.02f};
    LikelihoodLoss loss(device(), weights);
    const auto [actual_terms, gradients] =
        run_loss(loss, rays, measured, {nullptr, 0, kStride, std::uint32_t(kRays), n_returned, double(kRays)},
                 others, device());
    for (std::size_t k = 0; k < kLossTerms; ++k)
        EXPECT_NEAR(actual_terms[k], k == loss_term::likelihood ? 0.7 * term : 0.0, 1e-5 * term);
    for (std::size_t i = 0; i < kRays; ++i) {
        const double d = 0.7 * expected[i].likelihood;
        EXPECT_NEAR(gradients[i].likelihood, d, 1e-5 * std::abs(d)) << "ray " << i;
        EXPECT_EQ(gradients[i].depth, 3.0f) << "gradients of other losses stay";
        EXPECT_EQ(gradients[i].weight, 0.0f);
    }
}

class SurfelLossTest : public test::DeviceTest {};

constexpr std::uint32_t kBackground = 70, kActor = 45;

Scene random_scene() {
    std::mt19937_64 random(8);
    std::uniform_real_distribution<float> uniform(-3.0f, 3.0f);
    Scene scene;
    scene.surfels.resize(kBackground + 2 * kActor);
    for (glm::vec3& m : scene.surfels.mean) m = {uniform(random), uniform(random), uniform(random)};
    for (glm::vec4& q : scene.surfels.rotation) q = {1, 0, 0, 0};
    for (glm::vec2& s : scene.surfels.log_scale)
        s = 0.4f * glm::vec2(uniform(random), uniform(random) - 2.0f);
    for (float& o : scene.surfels.opacity_logit) o = 4.0f * uniform(random);
    scene.surfels.opacity_logit[3] = 500.0f;
    scene.surfels.opacity_logit[4] = -500.0f;
    scene.models = {{"background", 0, kBackground},
                    {"a", kBackground, kActor, {2.0f, 0.9f, 0.75f}},
                    {"b", kBackground + kActor, kActor, {1.0f, 0.3f, 0.85f}}};
    scene.instances = {{0, ""}, {2, "b"}, {1, "a"}};
    return scene;
}

TEST_F(SurfelLossTest, AgreesWithReference) {
    Scene scene = random_scene();
    const LossWeights weights{.box = 0.3f};
    const std::size_t n = scene.surfels.size();
    for (const bool all : {true, false}) {
        if (!all) convert_surfels(scene.surfels, PrimitiveType::gaussian, 3.0);
        const bool is_gaussian = !all;
        std::vector<std::uint32_t> touched(n);
        for (std::size_t i = 0; i < n; ++i) touched[i] = i % 3 != 0;
        Stream stream(device());
        DeviceScene on_device(device(), scene);
        SurfelArrays d(device(), std::uint32_t(n), "gradient", scene.surfels.primitive);
        d.fill_zero(stream);
        stream.fill(d.mean, 0x3e800000u);  // 0.25
        const Array<std::uint32_t, shared::TouchedSurfels> rows(device(), touched, "touched");
        const Array<float> terms(device(), std::vector<float>(kLossTerms, 0.0f), "terms");
        ActorBoxLoss loss(device(), weights);
        loss.add_regularisers(stream, on_device, {&d, all ? nullptr : &rows}, terms);
        stream.submit_and_wait();

        double box = 0.0;
        test::GradientTable table;
        const Surfels device_result = d.download();
        for (std::size_t i = 0; i < n; ++i) {
            reference::BoxedSurfel expected, ignored;
            expected.mean = {0.25, 0.25, 0.25};
            const bool write = all || touched[i];
            if (i >= kBackground) {
                const glm::dvec3 h = scene.models[i < kBackground + kActor ? 1 : 2].half_size_m;
                const Surfels& s = scene.surfels;
                reference::BoxedSurfel surfel{{s.mean[i].x, s.mean[i].y, s.mean[i].z},
                                              {s.log_scale[i].x, s.log_scale[i].y}};
                if (is_gaussian) surfel.log_scale_w = s.log_scale_w[i];
                box += reference::compute_box_loss(surfel, {{h.x, h.y, h.z}, 0.2 * glm::length(h)},
                                                   0.3 / (2 * kActor), write ? expected : ignored);
            }
            table.add_row("mean", {expected.mean[0], expected.mean[1], expected.mean[2]},
                          {device_result.mean[i].x, device_result.mean[i].y, device_result.mean[i].z});
            table.add_row("log_scale", {expected.log_scale[0], expected.log_scale[1]},
                          {device_result.log_scale[i].x, device_result.log_scale[i].y});
            if (is_gaussian)
                table.add_row("log_scale_w", {expected.log_scale_w.value_or(0.0)},
                              {device_result.log_scale_w[i]});
        }
        EXPECT_NEAR(terms.download()[loss_term::box], 0.3 * box / (2 * kActor), 1e-5 * box);
        EXPECT_LE(table.compute_worst_error(), test::kKernelGradient);
        for (const auto& [name, group] : table.groups()) EXPECT_EQ(group.count_missing_rows(), 0u) << name;
    }
}

}  // namespace
}  // namespace relidar
