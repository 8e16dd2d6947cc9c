// SPDX-License-Identifier: Apache-2.0
// Compares the original scene with a scene whose actors are baked into the background by
// freeze_scene().
#include <cmath>
#include <random>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>

#include "../../support/device.hpp"
#include "../traversal/cases.hpp"

namespace relidar {
namespace {

class Freeze : public test::DeviceTest {
protected:
    /// Makes a background and three actors, two of which walk, with harmonics of degree
    /// 3.
    static Scene make_some_actors(PrimitiveType primitive) {
        constexpr std::uint32_t kSurfels = 1500;
        test::TraversalCase random_case = test::make_random_case(5, kSurfels, 0);
        if (primitive == PrimitiveType::gaussian) random_case = test::to_gaussians(random_case, 4);
        Scene scene = wrap_background(random_case.surfels);
        std::mt19937 random(7);
        std::uniform_real_distribution<float> u(-1.0f, 1.0f);
        for (float& v : scene.surfels.sh) v = 0.2f * u(random);
        scene.surfels.add_still_gait();
        for (GaitPhaseWindow& gait : scene.surfels.gait)
            gait = {u(random), u(random), 0.3f * glm::vec3(u(random), u(random), u(random))};
        scene.models = {{"background", 0, 900}};
        for (std::uint32_t k = 0; k < 3; ++k) {
            scene.models.push_back({std::to_string(k), 900 + 200 * k, 200});
            scene.models.back().stride_m = k == 1 ? 0.0f : 1.3f;
            scene.instances.push_back({k + 1, std::to_string(k)});
        }
        return scene;
    }
    static std::vector<InstancePose> make_some_poses() {
        std::vector<InstancePose> placed(4);
        const glm::dquat turns[] = {make_rotation(0.7, 0.2, -0.4), make_rotation(-2.1, 0.0, 0.0),
                                    make_rotation(1.4, -0.8, 2.0)};
        for (std::size_t k = 1; k < 4; ++k)
            placed[k] = {{turns[k - 1], {0.5 * double(k), -0.3, 0.2}}, true, 0.0, 0.37 * double(k)};
        return placed;
    }
    void expect_equal(const RenderedRayValues& first, const RenderedRayValues& second,
                      const std::string& description) {
        ASSERT_EQ(first.size(), second.size());
        // allows a few different rays, because rounding can make a surfel visible or
        // invisible
        std::size_t n_hit = 0, n_off = 0;
        for (std::size_t i = 0; i < first.size(); ++i) {
            n_hit += first.hits[i] > 0;
            const auto off = [&](const std::vector<float>& x, const std::vector<float>& y) {
                return !(std::abs(x[i] - y[i]) <= 2e-4f * (1.0f + std::abs(x[i])));
            };
            n_off += off(first.depth, second.depth) || off(first.intensity, second.intensity) ||
                     off(first.hit_logit, second.hit_logit) || off(first.drop_logit, second.drop_logit) ||
                     off(first.transmittance, second.transmittance);
        }
        EXPECT_GT(n_hit, first.size() / 3) << description;
        EXPECT_LE(n_off, first.size() / 100) << description;
    }
};

TEST_F(Freeze, RendersAsThePlacedScene) {
    const WorldRays rays = test::make_random_case(5, 1500, 2000).rays;
    for (const PrimitiveType primitive : {PrimitiveType::surfel, PrimitiveType::gaussian})
        for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
            const ImageModel model{.sh_direction = direction, .primitive = primitive};
            const Scene scene = make_some_actors(primitive);
            std::vector<InstancePose> placed = make_some_poses();
            for (const bool one_is_absent : {false, true}) {
                placed[2].present = !one_is_absent;
                const Surfels frozen = freeze_scene(scene, placed);
                EXPECT_EQ(frozen.size(), one_is_absent ? 1300u : 1500u);
                EXPECT_FALSE(frozen.bends);
                const glm::vec3 view(0.2f, -0.1f, 0.3f);
                Renderer moving(device(), scene, model), still(device(), wrap_background(frozen), model);
                moving.update(placed, view);
                still.update(view);
                expect_equal(moving.render_rays(rays), still.render_rays(rays),
                             std::string(properties_of(primitive).name) +
                                 (direction == ShDirection::ray ? ", a ray" : ", a surfel"));
            }
        }
}

TEST_F(Freeze, WantsAPoseForEachInstance) {
    EXPECT_THROW(freeze_scene(make_some_actors(PrimitiveType::surfel), std::vector<InstancePose>(3)),
                 DataError);
}

}  // namespace
}  // namespace relidar
