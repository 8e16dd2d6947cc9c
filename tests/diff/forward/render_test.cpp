// SPDX-License-Identifier: Apache-2.0
// Compares the forward pass (Eq. 2-4; M4, M5), with chunks and with lists, with the
// double reference on random scenes.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>
#include "scene/benchmark_street.hpp"

#include "../../support/device.hpp"
#include "../../support/random_scene.hpp"
#include "../../support/surfels.hpp"
#include "../../support/tolerances.hpp"

namespace relidar {
namespace {

class Forward : public test::DeviceTest {};

RenderedRayValues render_once(Device& device, const Scene& scene, const ImageModel& model,
                              const WorldRays& rays, const RendererOptions& options = {}) {
    Renderer renderer(device, scene, model, options);
    renderer.update(glm::vec3(0.0f));
    return renderer.render_rays(rays);
}

double compute_normalised_error(const std::vector<float>& actual, const std::vector<double>& expected) {
    double error = 0.0, power = 0.0;
    for (std::size_t i = 0; i < expected.size(); ++i) {
        error += (actual[i] - expected[i]) * (actual[i] - expected[i]);
        power += expected[i] * expected[i];
    }
    return error / power;
}

struct Expected {
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) std::vector<double> name;
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
    std::vector<double> transmittance, median_depth;
    std::vector<std::uint32_t> hits;
    std::vector<std::int32_t> instance;
};

Expected render_reference(const test::RandomScene& scene, const reference::Settings& settings) {
    Expected e;
    for (const reference::Pixel& p : reference::render(scene.world, settings, scene.rays)) {
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) e.name.push_back(p.name);
        RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
        e.transmittance.push_back(p.transmittance);
        e.median_depth.push_back(p.median_depth);
        e.hits.push_back(p.hits);
        e.instance.push_back(std::int32_t(p.instance));
    }
    return e;
}

/// Method to find and sort hits. Hit lists are long enough for all rays, or only for some
/// rays.
struct Way {
    ProxyShape proxy;
    HitSortMethod order;
    int list_capacity = 64;
};
constexpr Way kHitMethods[] = {{ProxyShape::triangles, HitSortMethod::chunks},
                               {ProxyShape::boxes, HitSortMethod::chunks},
                               {ProxyShape::triangles, HitSortMethod::lists},
                               {ProxyShape::boxes, HitSortMethod::lists},
                               {ProxyShape::boxes, HitSortMethod::lists, 4}};

TEST_F(Forward, AgreesWithDoubleReference) {
    using enum ShDirection;
    for (const auto& [direction, primitive] : {std::pair{ray, PrimitiveType::surfel},
                                               {surfel, PrimitiveType::surfel},
                                               {surfel, PrimitiveType::gaussian}}) {
        reference::Settings settings{.image = {.sh_direction = direction, .primitive = primitive}};
        // With SH along the surfel, the first instance of a model determines the
        // direction, so the actor has a single instance.
        const test::RandomSceneOptions options{.seed = 21,
                                               .background_surfels = 24,
                                               .actor_surfels = 20,
                                               .actor_instances = direction == ShDirection::ray ? 2 : 1,
                                               .rays = 300,
                                               .primitive = primitive};
        const test::RandomScene scene = test::make_random_scene(options, settings);
        settings.view_origin = scene.view_origin;
        const Expected e = render_reference(scene, settings);
        const auto on_actors =
            std::ranges::count_if(e.instance, [](std::int32_t label) { return label > 0; });
        EXPECT_TRUE(on_actors >= 10 && on_actors <= 290)
            << on_actors << " of 300 rays meet an actor first: the scene does not test labels";
        test::SceneAndPoses placed = test::to_scene(scene.world);
        for (const auto& [proxy, order, room] : kHitMethods) {
            Renderer renderer(device(), placed.scene, settings.image,
                              {.accel = {.proxy = proxy},
                               .trace = {.chunk = 5, .order = order, .initial_list_capacity = room}});
            renderer.update(placed.world_from_instance, glm::vec3(scene.view_origin));
            const RenderedRayValues r = renderer.render_rays(test::to_world_rays(scene.rays));
            EXPECT_EQ(r.hits, e.hits);
            EXPECT_EQ(r.instance, e.instance);
#define RELIDAR_VALUES(name, built, value, input, slope, meaning) \
    EXPECT_LE(compute_normalised_error(r.name, e.name), test::kKernelNmse) << #name;
            RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
            EXPECT_LE(compute_normalised_error(r.transmittance, e.transmittance), test::kKernelNmse);
            EXPECT_LE(compute_normalised_error(r.median_depth, e.median_depth), test::kKernelNmse);
        }
    }
}

/// With a single drop logit, the stored hit logits must have no effect. The drop
/// probability (M6) becomes a sigmoid, and a ray without hits is dropped.
TEST_F(Forward, SingleDropLogitAgreesWithDoubleReference) {
    for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
        reference::Settings settings{.image = {.sh_direction = direction, .single_drop_logit = true}};
        const test::RandomSceneOptions options{.seed = 22, .actor_instances = 1, .rays = 100};
        const test::RandomScene scene = test::make_random_scene(options, settings);
        settings.view_origin = scene.view_origin;
        const Expected e = render_reference(scene, settings);
        const test::SceneAndPoses placed = test::to_scene(scene.world);
        Renderer renderer(device(), placed.scene, settings.image, {.trace = {.chunk = 5}});
        renderer.update(placed.world_from_instance, glm::vec3(scene.view_origin));
        const RenderedRayValues r = renderer.render_rays(test::to_world_rays(scene.rays));
        EXPECT_EQ(r.hit_logit, std::vector<float>(scene.rays.size(), 0.0f));
        EXPECT_LE(compute_normalised_error(r.drop_logit, e.drop_logit), test::kKernelNmse);
        EXPECT_LE(compute_normalised_error(r.depth, e.depth), test::kKernelNmse);
        const RenderedRayValues empty =
            render_once(device(), wrap_background({}), settings.image, {{{0, 0, 0}}, {{1, 0, 0}}});
        EXPECT_GT(empty.drop_logit[0], empty.hit_logit[0]);
    }
}

/// Thin 3D Gaussians must render like surfels, and thick Gaussians must differ. Normals
/// face the rays within 50 degrees.
TEST_F(Forward, ThinGaussiansApproachSurfels) {
    const test::RandomSceneOptions options{.seed = 23, .rays = 200};
    const test::RandomScene random = test::make_random_scene(options, {});
    const test::SceneAndPoses placed = test::to_scene(random.world);
    const WorldRays rays = test::to_world_rays(random.rays);
    const auto rendered = [&](const Scene& scene) {
        ImageModel model;
        model.primitive = scene.surfels.primitive;
        Renderer renderer(device(), scene, model);
        renderer.update(placed.world_from_instance, glm::vec3(0.0f));
        return renderer.render_rays(rays);
    };
    const RenderedRayValues flat = rendered(placed.scene);
    const std::vector<double> depth(flat.depth.begin(), flat.depth.end()),
        weight(flat.weight.begin(), flat.weight.end());
    std::vector<double> error;
    // the smallest thickness corresponds to at least 1.5e-6 m
    for (const double thickness : {1.0, 0.1, 1e-3, 1e-5}) {
        Scene thin = placed.scene;
        convert_surfels(thin.surfels, PrimitiveType::gaussian, thickness);
        const RenderedRayValues r = rendered(thin);
        error.push_back(
            std::max(compute_normalised_error(r.depth, depth), compute_normalised_error(r.weight, weight)));
        std::printf("thickness %g: error %.2e\n", thickness, error.back());
    }
    EXPECT_GT(error[0], 1e3 * test::kKernelNmse);
    EXPECT_LT(error[1], 0.1 * error[0]);
    EXPECT_LT(error[2], test::kKernelNmse);
    EXPECT_LT(error[3], test::kKernelNmse);
}

TEST_F(Forward, SceneOfAnotherPrimitiveIsRefused) {
    Scene scene = wrap_background(test::to_surfels(test::make_random_scene({}, {}).world.surfels));
    ImageModel gaussians;
    gaussians.primitive = PrimitiveType::gaussian;
    const WorldRays ray{{{0, 0, 0}}, {{1, 0, 0}}};
    EXPECT_THROW(render_once(device(), scene, gaussians, ray), UsageError);
    convert_surfels(scene.surfels, PrimitiveType::gaussian, 1.0);
    EXPECT_THROW(render_once(device(), scene, {}, ray), UsageError);
    EXPECT_NO_THROW(render_once(device(), scene, gaussians, ray));
}

/// A faint surfel in front of a wall must not determine the instance label of the ray. If
/// the faint surfel is the only surfel, it determines the label.
TEST_F(Forward, LabelIsThatOfTheSurfaceNotOfAFloater) {
    Surfels surfels;
    surfels.resize(2);
    for (auto& q : surfels.rotation) q = {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f};  // normal along x
    surfels.opacity_logit = {4.0f, -1.5f};
    std::fill(surfels.sh.begin(), surfels.sh.end(), 0.0f);
    Scene scene;
    scene.surfels = surfels;
    scene.models = {{"background", 0, 1}, {"floater", 1, 1}};
    scene.instances = {{0, ""}, {1, "floater"}};
    Renderer renderer(device(), scene, {});
    const WorldRays ray{{{0, 0, 0}}, {{1, 0, 0}}};
    const auto at = [](double value, bool present) {
        return InstancePose{Pose{{1, 0, 0, 0}, {value, 0, 0}}, present};
    };
    renderer.record_poses({at(9, true), at(3, true)}, glm::vec3(0.0f));
    EXPECT_EQ(renderer.render_rays(ray).instance[0], 0);
    renderer.record_poses({at(9, false), at(3, true)}, glm::vec3(0.0f));
    EXPECT_EQ(renderer.render_rays(ray).instance[0], 1);
    renderer.record_poses({at(9, false), at(3, false)}, glm::vec3(0.0f));
    EXPECT_EQ(renderer.render_rays(ray).instance[0], -1);
}

TEST_F(Forward, EmptySceneIsBackground) {
    const RenderedRayValues r = render_once(device(), wrap_background({}), {}, {{{0, 0, 0}}, {{1, 0, 0}}});
    EXPECT_EQ(r.hits[0], 0u);
    EXPECT_EQ(r.drop_logit[0], 1.0f);
    EXPECT_EQ(r.transmittance[0], 1.0f);
    EXPECT_EQ(r.depth[0], 0.0f);
}

/// Returns copies of some surfels. Each copy has an invalid value in a different
/// parameter.
Surfels make_poisoned_copies(const Surfels& good, float bad) {
    const bool is_gaussian = good.primitive == PrimitiveType::gaussian;
    Surfels extra = test::take(good, is_gaussian ? std::vector<std::uint32_t>{0, 1, 2, 3, 4, 5}
                                                 : std::vector<std::uint32_t>{0, 1, 2, 3, 4});
    extra.mean[0].x = bad;
    extra.rotation[1].y = bad;
    extra.log_scale[2].x = bad;
    extra.opacity_logit[3] = -std::abs(bad);
    extra.sh[4 * kShFloats] = std::isfinite(bad) ? std::nanf("") : bad;
    if (is_gaussian) extra.log_scale_w[5] = bad;
    if (std::isnan(bad)) extra.rotation[1] = glm::vec4(0.0f);
    return extra;
}

void expect_unharmed(Device& device, const Surfels& good, const WorldRays& rays) {
    Surfels poisoned = good;
    for (const float bad : {std::nanf(""), HUGE_VALF, -HUGE_VALF, 1e38f})
        poisoned.append_surfels(make_poisoned_copies(good, bad));
    for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
        const ImageModel model{.sh_direction = direction, .primitive = good.primitive};
        const RenderedRayValues expected = render_once(device, wrap_background(good), model, rays);
        const RenderedRayValues actual = render_once(device, wrap_background(poisoned), model, rays);
        EXPECT_EQ(actual.hits, expected.hits);
        EXPECT_EQ(actual.depth, expected.depth);
        EXPECT_EQ(actual.intensity, expected.intensity);
    }
}

TEST_F(Forward, PoisonedSurfelsNeverReachTheImage) {
    test::RandomSceneOptions options;
    options.seed = 4;
    reference::Settings settings;
    const test::RandomScene scene = test::make_random_scene(options, settings);
    Surfels good = test::to_surfels(scene.world.surfels), thick = good;
    convert_surfels(thick, PrimitiveType::gaussian, 0.5);
    for (const Surfels& sound : {good, thick})
        expect_unharmed(device(), sound, test::to_world_rays(scene.rays));
}

std::filesystem::path get_shared_folder() {
    const char* text = std::getenv("RELIDAR_SHARED");
    return text ? std::filesystem::path(text)
                : std::filesystem::path(RELIDAR_SOURCE_DIR).parent_path() / "shared";
}

const NamedArray& find(const std::vector<NamedArray>& arrays, const std::string& name) {
    for (const NamedArray& a : arrays)
        if (a.name == name) return a;
    throw std::runtime_error("no array " + name);
}

/// At least 99.9 % of the rays must equal the image that a different implementation
/// rendered of the street of 100k surfels.
TEST_F(Forward, StreetEqualsImageByOthers) {
    const std::filesystem::path file = get_shared_folder() / "bench" / "peer_render_A100k_kitti.npz";
    if (!std::filesystem::exists(file)) GTEST_SKIP() << file << " is not there";
    const std::vector<NamedArray> arrays = read_npz(file);
    const std::vector<float> dirs = find(arrays, "dirs").to_floats(),
                             origin = find(arrays, "origin").to_floats();
    WorldRays rays;
    for (std::size_t i = 0; i < dirs.size() / 3; ++i) {
        rays.origin.push_back({origin[0], origin[1], origin[2]});
        rays.direction.push_back({dirs[3 * i], dirs[3 * i + 1], dirs[3 * i + 2]});
    }
    Surfels street = make_street_surfels(100000);
    street = street.reorder(kd_tree_order(street.mean));
    const RenderedRayValues r =
        render_once(device(), wrap_background(street), {}, rays, {.trace = {.chunk = 64}});
    const std::vector<float> depth = find(arrays, "depth").to_floats();
    const std::pair<std::vector<float>, const std::vector<float>*> channels[] = {
        {find(arrays, "intensity").to_floats(), &r.intensity},
        {find(arrays, "weight").to_floats(), &r.weight},
        {find(arrays, "hit_logit").to_floats(), &r.hit_logit},
        {find(arrays, "drop_logit").to_floats(), &r.drop_logit},
        {find(arrays, "T").to_floats(), &r.transmittance}};
    std::size_t equal = 0;
    for (std::size_t i = 0; i < rays.size(); ++i)
        equal += std::abs(r.depth[i] - depth[i]) <= 1e-3f &&
                 std::ranges::all_of(
                     channels, [&](const auto& c) { return std::abs((*c.second)[i] - c.first[i]) <= 1e-4f; });
    std::printf("%zu of %zu rays differ from the image by others\n", rays.size() - equal, rays.size());
    EXPECT_GE(double(equal), 0.999 * double(rays.size()));
}

}  // namespace
}  // namespace relidar
