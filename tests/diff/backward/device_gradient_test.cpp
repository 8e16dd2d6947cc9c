// SPDX-License-Identifier: Apache-2.0
// Compares the gradients of the device (kernels diff/backward/trace and
// scene/activate_vjp) with the backward pass of the double reference (Eq. 9; M7, M8).
#include <cmath>
#include <span>

#include "gpu/forced.hpp"

#include "passes.hpp"

namespace relidar {
namespace {

using test::GradientTable;
using test::lanes;
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

struct GradientCase {
    const char* name;
    ImageModel image;
    test::RandomSceneOptions scene;
    ProxyShape proxy = ProxyShape::boxes;
    /// If true, the software traversal tests all methods instead of the first
    /// kFewMethods. Used for a single scene of each gradient layout.
    bool tests_all_methods = false;
    /// If true, tests only the first two methods. Used where the method to find hits
    /// makes no difference.
    bool brute_force = false;
    double tolerance = 1.0;  ///< as a multiple of test::kKernelGradient
    Outputs outputs = Outputs::image;
    std::optional<int> chunk = {};  ///< otherwise the chunk size of the other tests
};
void PrintTo(const GradientCase& c, std::ostream* out) { *out << c.name; }

constexpr ImageModel kAlongRay{.sh_direction = ShDirection::ray},
    kAlongSurfel{.sh_direction = ShDirection::surfel};

const test::RandomSceneOptions kTransparent{.background_surfels = 80,
                                            .actor_surfels = 0,
                                            .actor_instances = 0,
                                            .rays = 40,
                                            .opacity_low = 0.02,
                                            .opacity_high = 0.2},
    kOpaque{.wide_surfels = 2, .opacity_low = 0.5, .opacity_high = 0.98},
    // more rays hit a 3D Gaussian than a surfel
    kGaussians{
        .background_surfels = 24, .actor_surfels = 8, .rays = 30, .primitive = PrimitiveType::gaussian};

test::RandomSceneOptions with_seed(test::RandomSceneOptions options, std::uint64_t seed,
                                   int actor_instances) {
    options.seed = seed;
    options.actor_instances = actor_instances;
    return options;
}

// Tolerances of moving models: a kernel rotates the origin of the ray, which is 8 m away,
// in float. This adds a rounding error of 1e-6 m.
//
// Opaque surfels: single precision rounds an opacity near 0.99 by up to 6e-8, which is
// 6e-6 of 1 - alpha. Eq. 9 divides by 1 - alpha, and the transmittance carries this error
// to the surfels behind the wall. Their gradients are small, so that the fourth digit is
// not reliable.
//
// 3D Gaussians: single precision rounds points 10 m away to 1e-6 m. This is 3e-5 standard
// deviations of the thinnest Gaussian (0.03 m) and affects every gradient of alpha.
//
// Likelihood (M12): in gradient rows with small values, contributions of many hits
// cancel, so that rounding errors of exp and division become visible. These errors are up
// to 3 and 2.5 units in the last place on a GPU, and half a unit on a CPU.
const GradientCase kGradientCases[] = {
    {.name = "ShAlongRay",
     .image = kAlongRay,
     .scene = {.seed = 31, .rays = 60},
     .proxy = ProxyShape::triangles,
     .tests_all_methods = true},
    {.name = "ShAlongSurfel",
     .image = kAlongSurfel,
     .scene = {.seed = 32, .actor_instances = 1, .rays = 60},
     .tests_all_methods = true},
    {.name = "LongLists",
     .image = kAlongSurfel,
     .scene = with_seed(kTransparent, 33, 0),
     .tests_all_methods = true},
    {.name = "OpaqueBruteForce",
     .image = kAlongRay,
     .scene = with_seed(kOpaque, 34, 2),
     .brute_force = true,
     .tolerance = 10.0},
    {.name = "OpaqueChunk2BruteForce",
     .image = kAlongRay,
     .scene = with_seed(kOpaque, 34, 2),
     .brute_force = true,
     .tolerance = 10.0,
     .chunk = 2},
    {.name = "GaussiansShAlongRay",
     .image = kAlongRay,
     .scene = with_seed(kGaussians, 36, 2),
     .proxy = ProxyShape::triangles,
     .tolerance = 3.0},
    {.name = "GaussiansShAlongSurfel",
     .image = kAlongSurfel,
     .scene = with_seed(kGaussians, 37, 1),
     .tests_all_methods = true,
     .tolerance = 3.0},
    {.name = "Moving",
     .image = kAlongRay,
     .scene = {.seed = 38, .rays = 60, .moving = true},
     .proxy = ProxyShape::triangles,
     .tolerance = 3.0},
    {.name = "MovingLikelihood",
     .image = kAlongSurfel,
     .scene = {.seed = 38, .rays = 60, .moving = true},
     .tolerance = 3.0,
     .outputs = Outputs::likelihood,
     .chunk = 4},
    // An ablation of the paper: the hit logits count as 0 and have no gradient.
    {.name = "SingleDropLogitAlongRay",
     .image = {.sh_direction = ShDirection::ray, .single_drop_logit = true},
     .scene = {.seed = 31, .rays = 60}},
    {.name = "SingleDropLogitAlongSurfel",
     .image = {.sh_direction = ShDirection::surfel, .single_drop_logit = true},
     .scene = {.seed = 32, .actor_instances = 1, .rays = 60}},
    {.name = "ImageAndLikelihood",
     .image = kAlongRay,
     .scene = {.seed = 72, .rays = 60},
     .proxy = ProxyShape::triangles,
     .tests_all_methods = true,
     .tolerance = 2.0,
     .outputs = Outputs::all},
    {.name = "ImageAndLikelihoodLongLists",
     .image = kAlongSurfel,
     .scene = with_seed(kTransparent, 73, 0),
     .tolerance = 2.0,
     .outputs = Outputs::all},
    {.name = "ImageAndLikelihoodOpaqueBruteForce",
     .image = kAlongRay,
     .scene = {.seed = 37,
               .actor_surfels = 0,
               .actor_instances = 0,
               .wide_surfels = 2,
               .rays = 40,
               .opacity_low = 0.5,
               .opacity_high = 0.98},
     .brute_force = true,
     .tolerance = 10.0,
     .outputs = Outputs::all,
     .chunk = 2},
    {.name = "Likelihood",
     .image = kAlongRay,
     .scene = {.seed = 64, .rays = 60},
     .tolerance = 2.0,
     .outputs = Outputs::likelihood},
    {.name = "LikelihoodLongLists",
     .image = kAlongRay,
     .scene = with_seed(kTransparent, 65, 0),
     .outputs = Outputs::likelihood},
    {.name = "LikelihoodOfGaussians",
     .image = kAlongSurfel,
     .scene = with_seed(kGaussians, 66, 1),
     .tolerance = 3.0,
     .outputs = Outputs::likelihood}};

class DeviceGradient : public test::DeviceTest, public testing::WithParamInterface<GradientCase> {
protected:
    std::span<const Way> methods() {
        if (GetParam().brute_force) return std::span(kGradientMethods).first(2);
        // Sums of gradients do not depend on the traversal. All methods are therefore
        // tested with only one traversal.
        if (GetParam().tests_all_methods && device().backend() == RayTracingBackend::software)
            return kGradientMethods;
        return std::span(kGradientMethods).first(kFewMethods);
    }

    void expect_rows(const reference::Gradients& expected, const DeviceGradients& actual,
                     const std::string& title) {
        const GradientCase& c = GetParam();
        GradientTable table;
        test::add_surfel_rows(table, expected.surfels, actual.surfels.download());
        const std::vector<float> rays = actual.rays.download();
        for (std::size_t i = 0; i < expected.rays.size(); ++i) {
            const reference::RayGradient& d = expected.rays[i];
            table.add_row("ray origin", lanes(d.origin, 3), lanes(rays.data() + 6 * i, 3));
            table.add_row("ray direction", lanes(d.direction, 3), lanes(rays.data() + 6 * i + 3, 3));
        }
        table.print(title + " on " + device().info().name);
        for (const auto& [name, group] : table.groups()) {
            EXPECT_LE(group.compute_worst_error(), c.tolerance * test::kKernelGradient)
                << name << ", " << title;
            EXPECT_EQ(group.count_missing_rows(), 0u) << name << ", " << title;
            const bool constant = (name == "sh hit" && c.image.single_drop_logit) ||
                                  (name.starts_with("sh ") && c.outputs == Outputs::likelihood);
            EXPECT_EQ(group.count_nonzero_rows() == 0u, constant) << name << ", " << title;
        }
    }
};

INSTANTIATE_TEST_SUITE_P(Cases, DeviceGradient, testing::ValuesIn(kGradientCases),
                         [](const auto& tested) { return std::string(tested.param.name); });

TEST_P(DeviceGradient, EqualsTheReference) {
    const GradientCase& c = GetParam();
    const test::GradientProblem problem(c.image, c.scene, c.outputs);
    const reference::Gradients expected = problem.gradients();
    RendererOptions renderer = test::make_options(c.image);
    renderer.accel.proxy = c.proxy;
    TraceOptions& trace = renderer.trace;
    if (c.chunk) trace.chunk = *c.chunk;
    if (c.outputs != Outputs::image) trace.likelihood = kKernel;
    for (const Way& method : methods()) {
        const ForcedBehaviourScope forced(device(), {.brute_force = c.brute_force});
        trace.order = method.order;
        trace.initial_list_capacity = method.list_capacity;
        renderer.keep_hits = method.stored_hits_per_ray;
        Passes passes(device(), problem, renderer, method.options);
        passes.run();
        const test::GatheredHits hits = test::download_gathered_hits(passes);
        EXPECT_EQ(hits.most > hits.capacity, method.options.hits_per_ray == 2) << method.name;
        expect_rows(expected, passes.gradients(), std::string(c.name) + ", " + method.name);
    }
}

class LikelihoodGradient : public test::DeviceTest {};

/// Tests two surfels that are 30 cm apart, at 80 m and at 3 m. The measured range of the
/// ray is the range of the second surfel. In closed form the likelihood is S = w_0 k +
/// w_1 with k = 1 / (1 + (0.3 / s)^2).
TEST_F(LikelihoodGradient, TwoSurfelsInClosedForm) {
    for (const double start : {3.0, 79.0}) {
        const double t[] = {double(float(start)), double(float(start + 0.3))}, opacity[] = {0.6, 0.5};
        test::RandomScene scene;
        for (int i : {0, 1}) {
            reference::Surfel s;
            s.mean = {t[i], 0.0, 0.0};
            s.rotation = {0.70710678118654752, 0.0, 0.70710678118654752, 0.0};
            s.opacity_logit = std::log(opacity[i] / (1.0 - opacity[i]));
            scene.world.surfels.push_back(s);
        }
        scene.world.instances = {{0, 2, {}}};
        scene.rays = {{{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, t[1]}};
        std::vector<reference::PixelGradient> upstream(1);
        upstream[0].likelihood = 1.0;
        RendererOptions options = test::make_options({});
        options.trace.likelihood = RangeLikelihoodKernel{0.1f};
        test::Passes passes(device(), {}, scene, upstream, options);
        passes.run();
        const double scale = double(0.1f), d = (t[0] - t[1]) / scale, k = 1.0 / (1.0 + d * d), w0 = 0.6,
                     w1 = 0.4 * 0.5;
        const double slope = -2.0 * d / scale * k * k, resolved = 1.2e-7 * start;
        EXPECT_NEAR(passes.renderer.last_batch().rendered->download()[0].likelihood, w0 * k + w1,
                    1e-6 + w0 * slope * resolved);
        const Surfels device_result = passes.gradients().surfels.download();
        EXPECT_NEAR(device_result.mean[0].x, w0 * slope, 1e-6 + resolved * w0 / (scale * scale))
            << "the nearer one is drawn to the range";
        EXPECT_NEAR(device_result.mean[1].x, 0.0, 1e-6 + 2.0 * w1 * resolved / (scale * scale))
            << "the other is there";
        // S = s_0 k + (1 - s_0) s_1, where s_0 and s_1 are the opacities
        EXPECT_NEAR(device_result.opacity_logit[0], (k - 0.5) * 0.6 * 0.4, 1e-6 + slope * resolved);
        EXPECT_NEAR(device_result.opacity_logit[1], 0.4 * 0.5 * 0.5, 1e-6);
    }
}

}  // namespace
}  // namespace relidar
