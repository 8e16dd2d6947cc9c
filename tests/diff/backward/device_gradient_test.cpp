// SPDX-License-Identifier: Apache-2.0
// Compares the gradients of the device (kernels diff/backward/trace and
// scene/activate_vjp) with the backward pass of the double reference (Eq. 9; M7, M8).
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

}  // namespace
}  // namespace relidar
