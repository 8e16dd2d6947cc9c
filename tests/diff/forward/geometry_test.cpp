// SPDX-License-Identifier: Apache-2.0
// Compares blended normals, distortion and likelihood of the forward pass (M10-M12) with
// the double reference, which sums distortion over all pairs. Covers random scenes with
// instances, chunk sizes, lists, and rays with many hits. The image must be equal bit for
// bit with and without these outputs.
#include <algorithm>

#include <relidar/diff/forward.hpp>

#include "../../support/device.hpp"
#include "../../support/floats.hpp"
#include "../../support/placed.hpp"
#include "../../support/random_scene.hpp"
#include "../../support/tolerances.hpp"

namespace relidar {
namespace {

constexpr std::optional<RangeKernel> kKernel = RangeKernel{0.3f};

class Geometry : public test::DeviceTest {
protected:
    /// Renders the rays of a scene.
    /// @param geometry if not null, receives [n,7]
    std::vector<float> trace(const test::RandomScene& random, const ImageModel& model, int chunk,
                             std::vector<float>* geometry) {
        return trace(random, model,
                     {.chunk = chunk,
                      .geometry = geometry != nullptr,
                      .likelihood = geometry ? kKernel : std::nullopt},
                     geometry);
    }
    std::vector<float> trace(const test::RandomScene& random, const ImageModel& model,
                             const TraceOptions& options, std::vector<float>* geometry) {
        const test::SceneAndPoses placed =
            test::to_scene(test::to_surfels(random.world.surfels), random.world.instances);
        const std::uint32_t n_rays = std::uint32_t(random.rays.size());
        // one more ray than needed, to detect writes beyond the end
        Renderer renderer(device(), placed.scene, model, {.trace = options, .n_rays = n_rays + 1});
        renderer.scene().set_poses(placed.world_from_instance);
        const Array<DeviceRay> rays(
            device(), std::span<const DeviceRay>(to_device_rays(test::to_world_rays(random.rays))), "rays");
        const std::vector<shared::DeviceTarget> measured = test::to_targets(random.rays);
        const Array<shared::DeviceTarget> targets(device(), std::span<const shared::DeviceTarget>(measured),
                                                  "targets");
        RayGeometry* wanted = renderer.rendered().geometry;
        if (wanted)
            wanted->rendered.upload(
                std::vector<shared::RenderedGeometry>(n_rays + 1, {.normal = glm::vec3(-7.0f),
                                                                   .distortion = -7.0f,
                                                                   .moment = -7.0f,
                                                                   .likelihood = -7.0f,
                                                                   .mode = -7.0f}));
        renderer.place(glm::vec3(random.view_origin));
        renderer.record_forward({&rays, 0, 1, n_rays, 0, &targets});
        renderer.stream().finish();
        if (geometry) {
            *geometry = test::floats_of(wanted->rendered.download());
            for (int k = 0; k < 7; ++k, geometry->pop_back())
                EXPECT_EQ(geometry->back(), -7.0f) << "wrote past the end";
        }
        return test::floats_of(renderer.rendered().rendered->download(n_rays));
    }
};

TEST_F(Geometry, AgreesWithDoubleReference) {
    test::RandomSceneOptions few, many;
    few.seed = 24, few.rays = 200;
    many.seed = 25, many.rays = 60, many.background_surfels = 120, many.actor_surfels = 0,
    many.actor_instances = 0, many.opacity_low = 0.02, many.opacity_high = 0.2;
    for (const test::RandomSceneOptions& options : {few, many}) {
        reference::Settings settings;
        settings.likelihood_scale_m = 0.3;
        const test::RandomScene scene = test::make_random_scene(options, settings);
        const reference::BruteForce brute(scene.world, settings.image, reference::Precision::double_record);
        std::vector<float> actual;
        const std::vector<float> image = trace(scene, settings.image, 5, &actual);
        double most = 0.0, likeliest = 0.0;
        for (std::size_t i = 0; i < scene.rays.size(); ++i) {
            const reference::Pixel p = reference::render(scene.world, brute, settings, scene.rays[i], 16);
            const float* q = &actual[7 * i];
            EXPECT_LE(glm::length(glm::dvec3(q[0], q[1], q[2]) - p.normal), 1e-5) << "ray " << i;
            EXPECT_NEAR(q[3], p.distortion, 1e-5 * p.distortion + 1e-7) << "ray " << i;
            EXPECT_NEAR(q[5], p.likelihood, 1e-5) << "ray " << i;
            EXPECT_EQ(q[5] > 0.0f, scene.rays[i].measured_m > 0.0) << "ray " << i;
            most = std::max(most, p.distortion);
            likeliest = std::max(likeliest, p.likelihood);
        }
        EXPECT_GT(most, 0.2) << "the scene has no ray with a spread";
        EXPECT_GT(likeliest, 0.2) << "no ray meets what it measured";
        EXPECT_EQ(trace(scene, settings.image, 5, nullptr), image) << "the image does not depend on it";
        std::vector<float> again;
        trace(scene, settings.image, 64, &again);
        EXPECT_EQ(again, actual) << "nor on the chunk";
        for (const int room : {4, 64}) {
            trace(scene, settings.image,
                  {.chunk = 5,
                   .order = HitOrder::lists,
                   .list_room = room,
                   .geometry = true,
                   .likelihood = kKernel},
                  &again);
            for (std::size_t k = 0; k < again.size(); ++k)
                EXPECT_NEAR(again[k], actual[k], 1e-6f * std::max(1.0f, std::abs(actual[k])));
        }
        EXPECT_EQ(trace(scene, settings.image, {.likelihood = kKernel}, &again), image);
        for (std::size_t k = 0; k < again.size(); ++k)
            EXPECT_EQ(again[k], k % 7 == 5 ? actual[k] : 0.0f) << "the likelihood alone";
    }
}

/// Compares the heaviest surface (M13), for rays whose gaps and weights make the result
/// unambiguous.
TEST_F(Geometry, ModeAgreesWithDoubleReference) {
    constexpr float kGap = 0.3f;
    test::RandomSceneOptions options;
    options.seed = 28, options.rays = 100;
    const reference::Settings settings;
    const test::RandomScene scene = test::make_random_scene(options, settings);
    const reference::BruteForce brute(scene.world, settings.image, reference::Precision::double_record);
    std::vector<float> actual, image = trace(scene, settings.image, 5, nullptr);
    EXPECT_EQ(trace(scene, settings.image, {.chunk = 5, .mode_gap_m = kGap}, &actual), image)
        << "the image does not depend on it";
    std::vector<float> by_lists;
    trace(scene, settings.image, {.order = HitOrder::lists, .mode_gap_m = kGap}, &by_lists);
    for (std::size_t k = 6; k < actual.size(); k += 7) EXPECT_NEAR(by_lists[k], actual[k], 1e-5f);
    int clear = 0, other_than_first = 0;
    for (std::size_t i = 0; i < scene.rays.size(); ++i) {
        std::vector<reference::ShadedHit> hits;
        reference::render(scene.world, brute, settings, scene.rays[i], 16, &hits);
        bool is_clear = !hits.empty();
        for (std::size_t k = 1; k < hits.size(); ++k)
            is_clear = is_clear && std::abs(hits[k].t - hits[k - 1].t - double(kGap)) > 1e-4;
        const std::vector<reference::Surface> all = reference::surfaces(hits, double(kGap));
        const auto heaviest = std::ranges::max_element(all, {}, &reference::Surface::weight);
        for (auto s = all.begin(); s != all.end(); ++s)
            is_clear = is_clear && (s == heaviest || heaviest->weight - s->weight > 1e-5);
        if (!is_clear) continue;
        EXPECT_NEAR(actual[7 * i + 6], heaviest->mean, 1e-5) << "ray " << i;
        ++clear;
        other_than_first += heaviest != all.begin();
    }
    EXPECT_GT(clear, 90);
    EXPECT_GT(other_than_first, 10);
}

/// The kernel finds the targets of a batch by their positions and renders no likelihood
/// if the batch has no targets.
TEST_F(Geometry, LikelihoodOfEveryThirdRay) {
    test::RandomSceneOptions options;
    options.seed = 27, options.rays = 60;
    const test::RandomScene scene = test::make_random_scene(options, {});
    const test::SceneAndPoses placed =
        test::to_scene(test::to_surfels(scene.world.surfels), scene.world.instances);
    Renderer renderer(device(), placed.scene, {}, {.trace = {.likelihood = kKernel}, .n_rays = 60});
    renderer.scene().set_poses(placed.world_from_instance);
    renderer.place(glm::vec3(scene.view_origin));
    const Array<DeviceRay> rays(
        device(), std::span<const DeviceRay>(to_device_rays(test::to_world_rays(scene.rays))), "rays");
    const Array<shared::DeviceTarget> targets(
        device(), std::span<const shared::DeviceTarget>(test::to_targets(scene.rays)), "targets");
    const auto likelihoods = [&](const RayBatch& batch) {
        renderer.record_forward(batch);
        renderer.stream().finish();
        std::vector<float> actual;
        for (const shared::RenderedGeometry& q :
             renderer.rendered().geometry->rendered.download(batch.n_rays))
            actual.push_back(q.likelihood);
        return actual;
    };
    const std::vector<float> all = likelihoods({&rays, 0, 1, 60, 0, &targets}),
                             some = likelihoods({&rays, 1, 3, 20, 0, &targets});
    for (std::size_t k = 0; k < 20; ++k) EXPECT_EQ(some[k], all[1 + 3 * k]) << "ray " << k;
    EXPECT_GT(*std::max_element(some.begin(), some.end()), 0.1f);
    EXPECT_EQ(likelihoods({&rays, 0, 1, 60}), std::vector<float>(60, 0.0f));
}

TEST_F(Geometry, OfARenderer) {
    test::RandomSceneOptions options;
    options.seed = 26, options.rays = 100;
    const reference::Settings settings;
    const test::RandomScene scene = test::make_random_scene(options, settings);
    const reference::BruteForce brute(scene.world, settings.image, reference::Precision::double_record);
    const test::SceneAndPoses placed =
        test::to_scene(test::to_surfels(scene.world.surfels), scene.world.instances);
    for (const bool wanted : {true, false}) {
        Renderer renderer(device(), placed.scene, settings.image, {.trace = {.geometry = wanted}});
        renderer.scene().set_poses(placed.world_from_instance);
        renderer.place(glm::vec3(scene.view_origin));
        const Rendering actual = renderer.forward(test::to_world_rays(scene.rays));
        ASSERT_EQ(actual.normal.size(), wanted ? scene.rays.size() : 0u);
        for (std::size_t i = 0; i < actual.normal.size(); ++i) {
            const reference::Pixel p = reference::render(scene.world, brute, settings, scene.rays[i], 16);
            EXPECT_LE(glm::length(glm::dvec3(actual.normal[i]) - p.normal), 1e-5) << "ray " << i;
        }
    }
}

}  // namespace
}  // namespace relidar
