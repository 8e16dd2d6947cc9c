// SPDX-License-Identifier: Apache-2.0
// Compares optional outputs of the forward pass with the double reference: blended
// normals, the likelihood of the measured range (M12), and the surface with the largest
// weight (M13).
#include <algorithm>
#include <utility>

#include <relidar/diff/forward.hpp>

#include "../../support/device.hpp"
#include "../../support/floats.hpp"
#include "../../support/random_scene.hpp"
#include "../../support/surfels.hpp"
#include "../../support/tolerances.hpp"

namespace relidar {
namespace {

constexpr std::optional<RangeLikelihoodKernel> kKernel = RangeLikelihoodKernel{0.3f};

class OnDemand : public test::DeviceTest {
protected:
    struct Found {
        std::vector<float> image;       ///< [n] all numbers of RenderedRay except its likelihood
        std::vector<float> likelihood;  ///< [n]
        std::vector<float> surfaces;    ///< [n,4] normal and mode, or empty
    };
    Found trace(const test::RandomScene& random, const ImageModel& model, const TraceOptions& options) {
        const test::SceneAndPoses placed = test::to_scene(random.world);
        const std::uint32_t n_rays = std::uint32_t(random.rays.size());
        // adds an extra ray, to detect writes beyond the end
        Renderer renderer(device(), placed.scene, model, {.trace = options, .n_rays = n_rays + 1});
        renderer.scene().upload_poses(placed.world_from_instance);
        const Array<DeviceRay> rays(device(), to_device_rays(test::to_world_rays(random.rays)), "rays");
        const Array<shared::DeviceTarget> targets(device(), test::to_targets(random.rays), "targets");
        const Array<shared::RenderedSurface>* surfaces = renderer.last_batch().surfaces;
        if (surfaces) renderer.stream().fill(*surfaces, 0xc0e00000u);  // -7 as a float
        renderer.update(glm::vec3(random.view_origin));
        renderer.record_forward({&rays, 0, 1, n_rays, 0, &targets});
        renderer.stream().submit_and_wait();
        Found result;
        if (surfaces) {
            result.surfaces = test::to_floats(surfaces->download());
            for (int k = 0; k < 4; ++k, result.surfaces.pop_back())
                EXPECT_EQ(result.surfaces.back(), -7.0f) << "wrote past the end";
        }
        std::vector<shared::RenderedRay> image = renderer.last_batch().rendered->download(n_rays);
        for (shared::RenderedRay& ray : image)
            result.likelihood.push_back(std::exchange(ray.likelihood, 0.0f));
        result.image = test::to_floats(image);
        return result;
    }
};

TEST_F(OnDemand, AgreesWithDoubleReference) {
    test::RandomSceneOptions few, many;
    few.seed = 24;
    few.rays = 200;
    many.seed = 25;
    many.rays = 60;
    many.background_surfels = 120;
    many.actor_surfels = 0;
    many.actor_instances = 0;
    many.opacity_low = 0.02;
    many.opacity_high = 0.2;
    for (const test::RandomSceneOptions& options : {few, many}) {
        reference::Settings settings;
        settings.likelihood_scale_m = 0.3;
        const test::RandomScene scene = test::make_random_scene(options, settings);
        const std::vector<reference::Pixel> pixels = reference::render(scene.world, settings, scene.rays);
        const TraceOptions both{.chunk = 5, .normals = true, .likelihood = kKernel};
        const Found result = trace(scene, settings.image, both);
        double likeliest = 0.0;
        for (std::size_t i = 0; i < scene.rays.size(); ++i) {
            const reference::Pixel& p = pixels[i];
            const float* q = &result.surfaces[4 * i];
            EXPECT_LE(glm::length(glm::dvec3(q[0], q[1], q[2]) - p.normal), 1e-5) << "ray " << i;
            EXPECT_NEAR(result.likelihood[i], p.likelihood, 1e-5) << "ray " << i;
            EXPECT_EQ(result.likelihood[i] > 0.0f, scene.rays[i].measured_m > 0.0) << "ray " << i;
            likeliest = std::max(likeliest, p.likelihood);
        }
        EXPECT_GT(likeliest, 0.2) << "no ray meets what it measured";
        EXPECT_EQ(trace(scene, settings.image, {.chunk = 5}).image, result.image)
            << "the image does not depend on it";
        TraceOptions other = both;
        other.chunk = 64;
        const Found again = trace(scene, settings.image, other);
        EXPECT_EQ(again.surfaces, result.surfaces) << "nor on the chunk";
        EXPECT_EQ(again.likelihood, result.likelihood);
        other.chunk = 5;
        other.order = HitSortMethod::lists;
        for (const int list_capacity : {4, 64}) {
            other.initial_list_capacity = list_capacity;
            const Found lists = trace(scene, settings.image, other);
            for (std::size_t k = 0; k < lists.surfaces.size(); ++k)
                EXPECT_NEAR(lists.surfaces[k], result.surfaces[k], 1e-6f);
            for (std::size_t k = 0; k < lists.likelihood.size(); ++k)
                EXPECT_NEAR(lists.likelihood[k], result.likelihood[k], 1e-6f);
        }
        const Found alone = trace(scene, settings.image, {.likelihood = kKernel});
        EXPECT_EQ(alone.image, result.image);
        EXPECT_EQ(alone.likelihood, result.likelihood);
        EXPECT_TRUE(alone.surfaces.empty());
    }
}

/// Tests the surface with the largest weight (M13). Skips rays for which rounding could
/// select a different surface.
TEST_F(OnDemand, ModeAgreesWithDoubleReference) {
    constexpr float kGap = 0.3f;
    const test::RandomSceneOptions options{.seed = 28, .rays = 100};
    const reference::Settings settings;
    const test::RandomScene scene = test::make_random_scene(options, settings);
    const reference::BruteForce brute(scene.world, settings.image, reference::Precision::double_record);
    const Found with_mode = trace(scene, settings.image, {.chunk = 5, .mode_gap_m = kGap});
    EXPECT_EQ(with_mode.image, trace(scene, settings.image, {.chunk = 5}).image)
        << "the image does not depend on it";
    const std::vector<float>& actual_surfaces = with_mode.surfaces;
    const std::vector<float> by_lists =
        trace(scene, settings.image, {.order = HitSortMethod::lists, .mode_gap_m = kGap}).surfaces;
    for (std::size_t k = 3; k < actual_surfaces.size(); k += 4)
        EXPECT_NEAR(by_lists[k], actual_surfaces[k], 1e-5f);
    int clear = 0, other_than_first = 0;
    for (std::size_t i = 0; i < scene.rays.size(); ++i) {
        std::vector<reference::ShadedHit> hits;
        reference::render(scene.world, brute, settings, scene.rays[i], &hits);
        bool is_clear = !hits.empty();
        for (std::size_t k = 1; k < hits.size(); ++k)
            is_clear = is_clear && std::abs(hits[k].t - hits[k - 1].t - double(kGap)) > 1e-4;
        const std::vector<reference::Surface> all = reference::surfaces(hits, double(kGap));
        const auto heaviest = std::ranges::max_element(all, {}, &reference::Surface::weight);
        for (auto s = all.begin(); s != all.end(); ++s)
            is_clear = is_clear && (s == heaviest || heaviest->weight - s->weight > 1e-5);
        if (!is_clear) continue;
        EXPECT_NEAR(actual_surfaces[4 * i + 3], heaviest->mean, 1e-5) << "ray " << i;
        ++clear;
        other_than_first += heaviest != all.begin();
    }
    EXPECT_GT(clear, 90);
    EXPECT_GT(other_than_first, 10);
}

/// Each ray of a batch must use its own measured range. A batch without targets must not
/// render a likelihood.
TEST_F(OnDemand, LikelihoodOfEveryThirdRay) {
    const test::RandomSceneOptions options{.seed = 27, .rays = 60};
    const test::RandomScene scene = test::make_random_scene(options, {});
    const test::SceneAndPoses placed = test::to_scene(scene.world);
    Renderer renderer(device(), placed.scene, {}, {.trace = {.likelihood = kKernel}, .n_rays = 60});
    renderer.update(placed.world_from_instance, glm::vec3(scene.view_origin));
    const Array<DeviceRay> rays(device(), to_device_rays(test::to_world_rays(scene.rays)), "rays");
    const Array<shared::DeviceTarget> targets(device(), test::to_targets(scene.rays), "targets");
    const auto likelihoods = [&](const RayBatch& batch) {
        renderer.record_forward(batch);
        renderer.stream().submit_and_wait();
        std::vector<float> ray_likelihoods;
        for (const shared::RenderedRay& ray : renderer.last_batch().rendered->download(batch.n_rays))
            ray_likelihoods.push_back(ray.likelihood);
        return ray_likelihoods;
    };
    const std::vector<float> all = likelihoods({&rays, 0, 1, 60, 0, &targets}),
                             some = likelihoods({&rays, 1, 3, 20, 0, &targets});
    for (std::size_t k = 0; k < 20; ++k) EXPECT_EQ(some[k], all[1 + 3 * k]) << "ray " << k;
    EXPECT_GT(*std::max_element(some.begin(), some.end()), 0.1f);
    EXPECT_EQ(likelihoods({&rays, 0, 1, 60}), std::vector<float>(60, 0.0f));
}

TEST_F(OnDemand, OfARenderer) {
    const test::RandomSceneOptions options{.seed = 26, .rays = 100};
    const reference::Settings settings;
    const test::RandomScene scene = test::make_random_scene(options, settings);
    const std::vector<reference::Pixel> pixels = reference::render(scene.world, settings, scene.rays);
    const test::SceneAndPoses placed = test::to_scene(scene.world);
    for (const bool with_normals : {true, false}) {
        Renderer renderer(device(), placed.scene, settings.image, {.trace = {.normals = with_normals}});
        renderer.update(placed.world_from_instance, glm::vec3(scene.view_origin));
        const RenderedRayValues actual = renderer.render_rays(test::to_world_rays(scene.rays));
        ASSERT_EQ(actual.normal.size(), with_normals ? scene.rays.size() : 0u);
        for (std::size_t i = 0; i < actual.normal.size(); ++i)
            EXPECT_LE(glm::length(glm::dvec3(actual.normal[i]) - pixels[i].normal), 1e-5) << "ray " << i;
    }
}

}  // namespace
}  // namespace relidar
