// SPDX-License-Identifier: Apache-2.0
// Compares the gradients of the device (kernels diff/backward/trace and
// scene/activate_vjp) with the backward pass of the double reference (Eq. 9; M7, M8).
#include <span>

#include "gpu/forced.hpp"

#include "passes.hpp"

namespace relidar {
namespace {

using reference::PixelGradient;
using test::GradientTable;
using test::lanes;
using test::make_random_upstream;
using test::Outputs;
using test::Passes;

struct Way {
    const char* name;
    BackwardOptions options;
    std::uint32_t stored_hits_per_ray = 0;  ///< hits per ray that the forward pass keeps
    HitSortMethod order = HitSortMethod::chunks;
    int list_capacity = 64;
};
constexpr Way kGradientMethods[] = {
    {"atomics", {.reduction = GradientReduction::atomics, .coalesced_atomics = false}},
    {"gather", {.reduction = GradientReduction::gather}},
    {"lists, some too short, some kept hits",
     {.reduction = GradientReduction::gather},
     5,
     HitSortMethod::lists,
     8},
    {"coalesced atomics", {.reduction = GradientReduction::atomics, .coalesced_atomics = true}},
    {"atomics, kept hits", {.reduction = GradientReduction::atomics, .coalesced_atomics = false}, 64},
    {"atomics, some kept hits", {.reduction = GradientReduction::atomics, .coalesced_atomics = false}, 5},
    {"coalesced atomics, some kept hits",
     {.reduction = GradientReduction::atomics, .coalesced_atomics = true},
     5},
    {"gather, some kept hits", {.reduction = GradientReduction::gather}, 5},
    {"lists", {.reduction = GradientReduction::gather}, 64, HitSortMethod::lists},
    {"gather without room for all",
     {.reduction = GradientReduction::gather, .coalesced_atomics = true, .hits_per_ray = 2}}};
/// number of methods in the short test; they include both ways to sum gradients, and hits
/// from lists and from traversal
constexpr std::size_t kFewMethods = 3;

constexpr std::optional<RangeLikelihoodKernel> kKernel = RangeLikelihoodKernel{0.3f};

struct How {
    ProxyShape proxy = ProxyShape::boxes;
    /// If true, the software traversal tests all methods instead of the first
    /// kFewMethods. Used for a single scene of each gradient layout.
    bool tests_all_methods = false;
    /// If true, tests only the first two methods. Used where the method to find hits
    /// makes no difference.
    bool brute_force = false;
    double tolerance = test::kKernelGradient;
    Outputs outputs = Outputs::image;
    std::optional<int> chunk = {};  ///< otherwise the chunk size of the other tests
};

class DeviceGradient : public test::DeviceTest {
protected:
    std::span<const Way> list_variants(const How& options) {
        if (options.brute_force) return std::span(kGradientMethods).first(2);
        // Sums of gradients do not depend on the traversal. All methods are therefore
        // tested with only one traversal.
        const bool tests_all_methods =
            options.tests_all_methods && device().backend() == RayTracingBackend::software;
        return tests_all_methods ? std::span(kGradientMethods)
                                 : std::span(kGradientMethods).first(kFewMethods);
    }

    void expect_agreement(const ImageModel& image, const test::RandomSceneOptions& options, const How& how,
                          const std::string& title) {
        reference::Settings settings;
        settings.image = image;
        settings.image.primitive = options.primitive;
        settings.likelihood_scale_m = 0.3;
        const test::RandomScene scene = test::make_random_scene(options, settings);
        settings.view_origin = scene.view_origin;
        const std::vector<PixelGradient> upstream =
            make_random_upstream(scene.rays.size(), options.seed, how.outputs);
        RendererOptions renderer = test::make_options(image);
        renderer.accel.proxy = how.proxy;
        TraceOptions& trace = renderer.trace;
        if (how.chunk) trace.chunk = *how.chunk;
        const reference::BruteForce brute(scene.world, settings.image, reference::Precision::double_record);
        reference::Gradients expected(scene.world);
        std::vector<reference::RayGradient> d_rays;
        for (std::size_t i = 0; i < scene.rays.size(); ++i)
            d_rays.push_back(reference::backward(scene.world, brute, settings, scene.rays[i], trace.chunk,
                                                 upstream[i], expected));

        if (how.outputs != Outputs::image) trace.likelihood = kKernel;
        for (const Way& method : list_variants(how)) {
            const ForcedBehaviourScope forced(device(), {.brute_force = how.brute_force});
            trace.order = method.order;
            trace.initial_list_capacity = method.list_capacity;
            renderer.keep_hits = method.stored_hits_per_ray;
            Passes passes(device(), settings.image, scene, upstream, renderer, method.options);
            passes.run();
            const test::GatheredHits hits = test::download_gathered_hits(passes);
            EXPECT_EQ(hits.most > hits.capacity, method.options.hits_per_ray == 2) << title;
            expect_rows(image, expected, d_rays, passes.gradients(), title + ", " + method.name, how);
        }
    }

    void expect_rows(const ImageModel& image, const reference::Gradients& expected,
                     const std::vector<reference::RayGradient>& d_rays, const DeviceGradients& actual,
                     const std::string& title, const How& options) {
        GradientTable table;
        test::add_surfel_rows(table, expected.surfels, actual.surfels.download());
        const std::vector<float> rays = actual.rays.download();
        for (std::size_t i = 0; i < d_rays.size(); ++i) {
            table.add_row("ray origin", lanes(d_rays[i].origin, 3), lanes(rays.data() + 6 * i, 3));
            table.add_row("ray direction", lanes(d_rays[i].direction, 3), lanes(rays.data() + 6 * i + 3, 3));
        }
        table.print(title + " on " + device().info().name);
        for (const auto& [name, group] : table.groups()) {
            EXPECT_LE(group.compute_worst_error(), options.tolerance) << name << ", " << title;
            EXPECT_EQ(group.count_missing_rows(), 0u) << name << ", " << title;
            const bool constant = (name == "sh hit" && image.single_drop_logit) ||
                                  (name.starts_with("sh ") && options.outputs == Outputs::likelihood);
            EXPECT_EQ(group.count_nonzero_rows() == 0u, constant) << name << ", " << title;
        }
    }
};

TEST_F(DeviceGradient, ShAlongRayWithInstances) {
    expect_agreement({.sh_direction = ShDirection::ray}, {.seed = 31, .rays = 60},
                     {.proxy = ProxyShape::triangles, .tests_all_methods = true},
                     "triangles, SH along the ray, 3 instances");
}

TEST_F(DeviceGradient, ModelsThatMoveWhileRaysAreFired) {
    const test::RandomSceneOptions options{.seed = 38, .rays = 60, .moving = true};
    // A kernel rotates the origin of the ray, which is 8 m away, in float. This adds a
    // rounding error of 1e-6 m.
    const double tolerance = 3.0 * test::kKernelGradient;
    expect_agreement({.sh_direction = ShDirection::ray}, options,
                     {.proxy = ProxyShape::triangles, .tolerance = tolerance}, "models that move");
    expect_agreement({.sh_direction = ShDirection::surfel}, options,
                     {.tolerance = tolerance, .outputs = Outputs::likelihood, .chunk = 4},
                     "likelihood, models that move");
}

TEST_F(DeviceGradient, ShAlongSurfelWithInstance) {
    expect_agreement({.sh_direction = ShDirection::surfel}, {.seed = 32, .actor_instances = 1, .rays = 60},
                     {.tests_all_methods = true}, "boxes, SH along sensor -> mean, 2 instances");
}

TEST_F(DeviceGradient, ViewOriginAndLongLists) {
    expect_agreement({.sh_direction = ShDirection::surfel},
                     {.seed = 33,
                      .background_surfels = 80,
                      .actor_surfels = 0,
                      .actor_instances = 0,
                      .rays = 40,
                      .opacity_low = 0.02,
                      .opacity_high = 0.2},
                     {.tests_all_methods = true}, "transparent, long lists");
}

TEST_F(DeviceGradient, OpaqueWithClampsBruteForce) {
    const test::RandomSceneOptions options{
        .seed = 34, .wide_surfels = 2, .opacity_low = 0.5, .opacity_high = 0.98};
    // Single precision rounds an opacity near 0.99 by up to 6e-8, which is 6e-6 of 1 -
    // alpha. Eq. 9 divides by 1 - alpha, and the transmittance carries this error to the
    // surfels behind the wall. Their gradients are small, so that the fourth digit is not
    // reliable.
    const double tolerance = 10.0 * test::kKernelGradient;
    expect_agreement({.sh_direction = ShDirection::ray}, options,
                     {.brute_force = true, .tolerance = tolerance}, "brute force, opaque");
    expect_agreement({.sh_direction = ShDirection::ray}, options,
                     {.brute_force = true, .tolerance = tolerance, .chunk = 2},
                     "brute force, opaque, chunk 2");
}

TEST_F(DeviceGradient, Gaussians) {
    // more rays hit a 3D Gaussian than a surfel
    test::RandomSceneOptions options{.seed = 36,
                                     .background_surfels = 24,
                                     .actor_surfels = 8,
                                     .rays = 30,
                                     .primitive = PrimitiveType::gaussian};
    // Single precision rounds points 10 m away to 1e-6 m. This is 3e-5 standard
    // deviations of the thinnest Gaussian (0.03 m) and affects every gradient of alpha.
    const double tolerance = 3.0 * test::kKernelGradient;
    expect_agreement({.sh_direction = ShDirection::ray}, options,
                     {.proxy = ProxyShape::triangles, .tolerance = tolerance},
                     "3D Gaussians, icosahedra, SH along the ray, 3 instances");
    options.seed = 37;
    options.actor_instances = 1;
    expect_agreement({.sh_direction = ShDirection::surfel}, options,
                     {.tests_all_methods = true, .tolerance = tolerance},
                     "3D Gaussians, boxes, SH along sensor -> mean, 2 instances");
}

/// Tests the variant with a single drop logit per ray (an ablation of the paper). The hit
/// logits then count as 0 and have no gradient. Uses the first two scenes again.
TEST_F(DeviceGradient, SingleDropLogit) {
    test::RandomSceneOptions options{.seed = 31, .rays = 60};
    expect_agreement({.sh_direction = ShDirection::ray, .single_drop_logit = true}, options, {},
                     "one drop logit, SH along the ray");
    options.seed = 32;
    options.actor_instances = 1;
    expect_agreement({.sh_direction = ShDirection::surfel, .single_drop_logit = true}, options, {},
                     "one drop logit, SH along sensor -> mean");
}

/// Tests the image and the likelihood (M12) together, with few hits per chunk and long
/// hit lists. The tolerance is the same as in DeviceGradient.Likelihood, which tests the
/// likelihood without the image.
TEST_F(DeviceGradient, ImageAndLikelihood) {
    test::RandomSceneOptions options{.seed = 72, .rays = 60};
    expect_agreement({.sh_direction = ShDirection::ray}, options,
                     {.proxy = ProxyShape::triangles,
                      .tests_all_methods = true,
                      .tolerance = 2.0 * test::kKernelGradient,
                      .outputs = Outputs::all},
                     "image and likelihood, SH along the ray");
    options.seed = 73;
    options.rays = 40;
    options.background_surfels = 80;
    options.actor_instances = 0;
    options.actor_surfels = 0;
    options.opacity_low = 0.02;
    options.opacity_high = 0.2;
    expect_agreement({.sh_direction = ShDirection::surfel}, options,
                     {.tolerance = 2.0 * test::kKernelGradient, .outputs = Outputs::all},
                     "image and likelihood, transparent, long lists");
    options.seed = 37;
    options.background_surfels = 40;
    options.opacity_low = 0.5;
    options.opacity_high = 0.98;
    options.wide_surfels = 2;
    expect_agreement(
        {.sh_direction = ShDirection::ray}, options,
        {.brute_force = true, .tolerance = 10.0 * test::kKernelGradient, .outputs = Outputs::all, .chunk = 2},
        "image and likelihood, opaque with clamps");
}

/// Tests only the likelihood (M12). In gradient rows with small values, contributions of
/// many hits cancel, so that rounding errors of exp and division become visible. These
/// errors are up to 3 and 2.5 units in the last place on a GPU, and half a unit on a CPU.
TEST_F(DeviceGradient, Likelihood) {
    test::RandomSceneOptions options{.seed = 64, .rays = 60};
    expect_agreement({.sh_direction = ShDirection::ray}, options,
                     {.tolerance = 2.0 * test::kKernelGradient, .outputs = Outputs::likelihood},
                     "likelihood, SH along the ray");
    options.seed = 65;
    options.rays = 40;
    options.background_surfels = 80;
    options.actor_instances = 0;
    options.actor_surfels = 0;
    options.opacity_low = 0.02;
    options.opacity_high = 0.2;
    expect_agreement({.sh_direction = ShDirection::ray}, options, {.outputs = Outputs::likelihood},
                     "likelihood, transparent, long lists");
    options = {.seed = 66,
               .background_surfels = 24,
               .actor_surfels = 8,
               .actor_instances = 1,
               .rays = 30,
               .primitive = PrimitiveType::gaussian};
    expect_agreement({.sh_direction = ShDirection::surfel}, options,
                     {.tolerance = 3.0 * test::kKernelGradient, .outputs = Outputs::likelihood},
                     "likelihood, 3D Gaussians");
}

}  // namespace
}  // namespace relidar
