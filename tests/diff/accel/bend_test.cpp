// SPDX-License-Identifier: Apache-2.0
// Checks walking actors, whose limbs move (kernels diff/accel/proxies,
// diff/accel/bvh_refit).
#include <random>
#include <vector>

#include <relidar/diff/forward.hpp>

#include "../../support/device.hpp"
#include "../traversal/cases.hpp"
#include "bvh_walk.hpp"
#include "diff/accel/bvh.hpp"

namespace relidar {
namespace {

class Bend : public test::DeviceTest {
protected:
    static constexpr std::uint32_t kFirstWalker = 1200, kSurfels = 2000;

    /// Makes actors in front of a background. The second actor and the last two actors
    /// walk, which means that their limbs move. A further actor has no surfels.
    static Scene make_walkers(PrimitiveType primitive) {
        test::TraversalCase random_case = test::make_random_case(3, kSurfels, 0);
        if (primitive == PrimitiveType::gaussian) random_case = test::to_gaussians(random_case, 4);
        Surfels surfels = random_case.surfels;
        surfels.add_still_gait();
        std::mt19937 random(6);
        std::uniform_real_distribution<float> u(-1.0f, 1.0f);
        for (GaitPhaseWindow& gait : surfels.gait)
            gait = {u(random), 0.8f * u(random), glm::vec3(u(random), u(random), u(random))};
        Scene scene = test::make_scene_of_sizes(surfels, {900, 300, 400, 0, 100, 300});
        for (const std::size_t m : {2u, 4u, 5u}) scene.models[m].stride_m = 1.4f;
        return scene;
    }
    static std::vector<InstancePose> list_poses_at_phase(const Scene& scene, double turns) {
        std::vector<InstancePose> placed(scene.instances.size());
        for (InstancePose& pose : placed) pose.phase = turns;
        return placed;
    }
};

TEST_F(Bend, FitsTheTreesOfThoseThatWalkAndNoOthers) {
    const Scene scene = make_walkers(PrimitiveType::surfel);
    const std::vector<SurfelRange> walkers{{kFirstWalker, 400}, {kFirstWalker + 400, 400}};
    test::DeviceBvh some(device(), scene), all(device(), scene);
    const auto refit_at = [&](test::DeviceBvh& built, double turns, const SurfelRanges& ranges) {
        built.scene.stage_poses(built.stream, list_poses_at_phase(scene, turns));
        return built.refit(ranges);
    };
    for (test::DeviceBvh* built : {&some, &all}) {
        built->scene.stage_poses(built->stream, list_poses_at_phase(scene, 0.0));
        built->build();
    }
    const HostBvhCopy before = some.bvh.download_bvh();
    // Runs several launches in a row, because no launch may leave data behind that
    // changes the next launch.
    for (const double turns : {0.3, 0.7, 0.0, 0.45}) {
        const HostBvhCopy a = refit_at(some, turns, walkers), b = refit_at(all, turns, {{0, kSurfels}});
        EXPECT_TRUE(test::are_equal(a.nodes, b.nodes)) << turns << " turns";
        EXPECT_EQ(a.boxes, b.boxes) << turns << " turns";
        EXPECT_TRUE(test::are_equal(a.top_nodes, b.top_nodes)) << turns << " turns";
    }
    Surfels elsewhere = scene.surfels;
    for (glm::vec3& mean : elsewhere.mean) mean += glm::vec3(50.0f, 0.0f, 0.0f);
    some.scene.surfel_parameters().upload(elsewhere);
    const HostBvhCopy after = refit_at(some, 0.0, walkers);
    for (std::uint32_t i = 0; i < kSurfels; ++i) {  // surfels outside the requested range must not change
        if (test::compute_surfel_box(before, i).empty()) continue;
        EXPECT_EQ(after.boxes[6 * i] == before.boxes[6 * i], i < kFirstWalker) << "surfel " << i;
    }
}

TEST_F(Bend, RendersAsPlacedAnew) {
    for (const PrimitiveType primitive : {PrimitiveType::surfel, PrimitiveType::gaussian}) {
        const Scene scene = make_walkers(primitive);
        ImageModel model;
        model.primitive = primitive;
        const WorldRays rays = test::make_random_case(3, 400, 1).rays;
        for (const ProxyShape proxy : {ProxyShape::triangles, ProxyShape::boxes}) {
            Renderer moved(device(), scene, model, {.accel = {.proxy = proxy}}),
                anew(device(), scene, model, {.accel = {.proxy = proxy}});
            moved.update(list_poses_at_phase(scene, 0.0), glm::vec3(0.0f));
            const RenderedRayValues start = moved.render_rays(rays);
            bool differs = false;
            for (const double turns : {0.25, 0.6}) {
                moved.record_poses(list_poses_at_phase(scene, turns), glm::vec3(0.0f));
                anew.update(list_poses_at_phase(scene, turns), glm::vec3(0.0f));
                const RenderedRayValues a = moved.render_rays(rays), b = anew.render_rays(rays);
                EXPECT_EQ(a.hits, b.hits);
                EXPECT_EQ(a.depth, b.depth);
                differs = differs || a.depth != start.depth;
            }
            EXPECT_TRUE(differs) << "nobody walked";
        }
    }
}

}  // namespace
}  // namespace relidar
