// SPDX-License-Identifier: Apache-2.0
// Actors (paper section 3.2, Eq. 4-5): points of a moving box in the frame of the box, one model and instance each, placed where the
// box is at a time and absent outside its labels; and rendered there, in the order of docs: a moved box costs no bottom level.
#include <algorithm>
#include <cmath>

#include <relidar/dataset.hpp>
#include <relidar/forward.hpp>
#include <relidar/scene.hpp>

#include "../support/device.hpp"

namespace relidar {
namespace {

SyntheticOptions street_options() {
    SyntheticOptions options;
    options.n_frames = 12;
    options.rows = 24;
    options.columns = 512;
    options.range_noise_m = 0.0;
    return options;
}

InitialiseOptions with_actors() {
    InitialiseOptions options;
    options.actor_classes = "Car";
    options.actor_min_points = 20;
    return options;
}

TEST(Actors, AreMadeOfMovingBoxesInTheirOwnFrame) {
    const Sequence street = make_synthetic_street(street_options());
    const Scene scene = initialise_scene(street, split_frames(street, 10).train, with_actors());
    ASSERT_EQ(scene.models.size(), 3u) << "the background and two cars";
    ASSERT_EQ(scene.instances.size(), 3u);
    EXPECT_TRUE(scene.instances[0].track.empty());
    for (std::size_t m = 1; m < scene.models.size(); ++m) {
        const auto box = std::find_if(street.boxes.begin(), street.boxes.end(), [&](const BoxTrack& b) { return b.id == scene.instances[m].track; });
        ASSERT_NE(box, street.boxes.end());
        EXPECT_EQ(scene.models[m].first, scene.models[m - 1].first + scene.models[m - 1].count);
        EXPECT_GT(glm::length(scene.models[m].half_size_m), 2.0f) << "a car has a box";
        for (std::uint32_t i = 0; i < scene.models[m].count; ++i) {
            ASSERT_TRUE(glm::all(glm::lessThanEqual(glm::abs(scene.surfels.mean[scene.models[m].first + i]), scene.models[m].half_size_m)));
            const glm::dvec3 p = glm::abs(glm::dvec3(scene.surfels.mean[scene.models[m].first + i]));
            EXPECT_LE(p.x, 0.5 * box->size_m.x + 0.11);
            EXPECT_LE(p.y, 0.5 * box->size_m.y + 0.11);
            EXPECT_LE(p.z, 0.5 * box->size_m.z + 0.11);
        }
    }
    EXPECT_EQ(initialise_scene(street, split_frames(street, 10).train, {}).models.size(), 1u) << "no class is wanted: masked instead";
}

TEST(Actors, StandWhereTheirBoxIsAndAreAbsentOutsideItsLabels) {
    Sequence street = make_synthetic_street(street_options());
    street.rolling_shutter = false;
    const Scene scene = initialise_scene(street, split_frames(street, 10).train, with_actors());
    ASSERT_GE(scene.instances.size(), 2u);
    const auto box = std::find_if(street.boxes.begin(), street.boxes.end(), [&](const BoxTrack& b) { return b.id == scene.instances[1].track; });
    const double first = box->world_from_box.time_s.front(), last = box->world_from_box.time_s.back(), middle = 0.37 * first + 0.63 * last;
    const std::vector<InstancePose> placed = place_instances(scene, street, middle);
    EXPECT_TRUE(placed[0].present && placed[1].present);
    EXPECT_EQ(placed[0].world_from_model.translation, glm::dvec3(0.0));
    EXPECT_LT(glm::length(placed[1].world_from_model.translation - box->world_from_box.at(middle).translation), 1e-12);
    EXPECT_FALSE(place_instances(scene, street, last + 1.0)[1].present);
    EXPECT_FALSE(place_instances(scene, street, first - 1.0)[1].present);
    EXPECT_TRUE(place_instances(scene, street, last + 1.0)[0].present);
}

class ActorsOnDevice : public test::DeviceTest {};

TEST_F(ActorsOnDevice, AbsentInstancesAreNotSeenByAnyTraversal) {
    Surfels one;
    one.resize(2);
    for (auto& q : one.rotation) q = {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f};   // normal along x
    std::fill(one.opacity_logit.begin(), one.opacity_logit.end(), 5.0f);
    std::fill(one.sh.begin(), one.sh.end(), 0.0f);
    Scene scene;
    scene.surfels = one;
    scene.models = {{"background", 0, 1}, {"car", 1, 1}};
    scene.instances = {{0, ""}, {1, "car"}, {1, "copy"}};
    const auto at = [](double x, bool present) { return InstancePose{Pose{{1, 0, 0, 0}, {x, 0, 0}}, present}; };
    for (const bool brute_force : {false, true}) {
        Renderer renderer(device(), scene, {}, {}, {.brute_force = brute_force});
        const WorldRays ray{{{0, 0, 0}}, {{1, 0, 0}}};
        renderer.place({at(20, true), at(5, true), at(8, true)});
        EXPECT_NEAR(renderer.trace(ray, glm::vec3(0.0f)).median_depth[0], 5.0f, 1e-5f);
        renderer.place({at(20, true), at(5, false), at(8, true)});
        EXPECT_NEAR(renderer.trace(ray, glm::vec3(0.0f)).median_depth[0], 8.0f, 1e-5f);
        renderer.place({at(20, true), at(5, false), at(8, false)});
        EXPECT_NEAR(renderer.trace(ray, glm::vec3(0.0f)).median_depth[0], 20.0f, 1e-5f);
        renderer.place({at(20, true), at(3, true), at(8, false)});
        EXPECT_NEAR(renderer.trace(ray, glm::vec3(0.0f)).median_depth[0], 3.0f, 1e-5f);
    }
}

}  // namespace
}  // namespace relidar
