// SPDX-License-Identifier: Apache-2.0
// Checks walking actors, whose limbs move (kernels diff/accel/proxies,
// diff/accel/bvh_refit).
#include <cstring>
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
        Scene scene = wrap_background(surfels);
        scene.models.clear();
        scene.instances.clear();
        std::uint32_t first = 0;
        for (const std::uint32_t count : {900u, 300u, 400u, 0u, 100u, 300u}) {
            scene.instances.push_back({std::uint32_t(scene.models.size()), ""});
            scene.models.push_back({"model " + std::to_string(scene.models.size()), first, count});
            first += count;
        }
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
    struct Placed {
        DeviceScene scene;
        Bvh bvh;
        Stream stream;
        void place(double turns) {
            scene.stage_poses(stream, list_poses_at_phase(scene.layout(), turns));
            scene.activate(stream, {}, glm::vec3(0.0f));
        }
        Placed(Device& device, const Scene& s) : scene(device, s), bvh(device, scene), stream(device) {
            place(0.0);
            bvh.build_trees(stream, scene, {});
            stream.submit_and_wait();
        }
        HostBvhCopy at(double turns, const std::vector<SurfelRange>& ranges) {
            place(turns);
            bvh.refit_trees(stream, scene, {}, ranges);
            stream.submit_and_wait();
            return bvh.download_bvh();
        }
    };
    Placed some(device(), scene), all(device(), scene);
    const HostBvhCopy before = some.bvh.download_bvh();
    // Runs several launches in a row, because no launch may leave data behind that
    // changes the next launch.
    for (const double turns : {0.3, 0.7, 0.0, 0.45}) {
        const HostBvhCopy a = some.at(turns, walkers), b = all.at(turns, {{0, kSurfels}});
        ASSERT_EQ(a.nodes.size(), b.nodes.size());
        EXPECT_EQ(std::memcmp(a.nodes.data(), b.nodes.data(), a.nodes.size() * sizeof(shared::BvhNode)), 0)
            << turns << " turns";
        EXPECT_EQ(a.boxes, b.boxes) << turns << " turns";
        EXPECT_EQ(
            std::memcmp(a.top_nodes.data(), b.top_nodes.data(), a.top_nodes.size() * sizeof(shared::BvhNode)),
            0);
    }
    Surfels elsewhere = scene.surfels;
    for (glm::vec3& mean : elsewhere.mean) mean += glm::vec3(50.0f, 0.0f, 0.0f);
    some.scene.surfel_parameters().upload(elsewhere);
    const HostBvhCopy after = some.at(0.0, walkers);
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
