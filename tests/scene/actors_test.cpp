// SPDX-License-Identifier: Apache-2.0
// Tests actors (paper section 3.2, Eq. 4-5). Points of a moving box are expressed in the
// frame of the box. Each box gets a model and an instance, which has the pose of the box
// and is absent outside the time range of the labels.
#include <cmath>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>
#include <relidar/read/dataset.hpp>
#include "gpu/forced.hpp"

#include "../support/device.hpp"

namespace relidar {
namespace {

StreetOptions make_street_options() {
    return {.n_frames = 12, .rows = 24, .columns = 512, .range_noise_m = 0.0};
}

InitOptions make_options_with_actors() {
    InitOptions options;
    options.actor_classes = "Car";
    options.actor_min_points = 20;
    return options;
}

std::vector<int> train_of(const Log& street) { return split_frames(street, 10).train; }

Scene make_scene(const Log& street, const InitOptions& options) {
    return init_scene(street, train_of(street), options);
}

const BoxTrack& box_of(const Log& street, const Scene& scene, std::size_t instance) {
    const BoxTrack* box = find_box(street, scene.instances[instance].track);
    EXPECT_NE(box, nullptr);
    return *box;
}

TEST(Actors, AreMadeOfMovingBoxesInTheirOwnFrame) {
    const Log street = make_street_log(make_street_options());
    const Scene scene = make_scene(street, make_options_with_actors());
    ASSERT_EQ(scene.models.size(), 3u) << "the background and two cars";
    ASSERT_EQ(scene.instances.size(), 3u);
    EXPECT_TRUE(scene.instances[0].track.empty());
    for (std::size_t m = 1; m < scene.models.size(); ++m) {
        const BoxTrack& box = box_of(street, scene, m);
        EXPECT_EQ(scene.models[m].first, scene.models[m - 1].first + scene.models[m - 1].count);
        EXPECT_GT(glm::length(scene.models[m].half_size_m), 2.0f) << "a car has a box";
        for (std::uint32_t i = 0; i < scene.models[m].count; ++i) {
            ASSERT_TRUE(glm::all(glm::lessThanEqual(glm::abs(scene.surfels.mean[scene.models[m].first + i]),
                                                    scene.models[m].half_size_m)));
            const glm::dvec3 p = glm::abs(glm::dvec3(scene.surfels.mean[scene.models[m].first + i]));
            EXPECT_TRUE(glm::all(glm::lessThanEqual(p, 0.5 * box.size_m + 0.11)));
        }
    }
    InitOptions by_kind = make_options_with_actors();
    by_kind.actor_classes = "cyclist, vehicle";
    EXPECT_EQ(make_scene(street, by_kind).models.size(), 3u) << "whatever a dataset calls them";
    InitOptions nothing;
    nothing.actor_classes = "";
    EXPECT_EQ(make_scene(street, nothing).models.size(), 1u) << "no class is wanted: masked instead";
}

TEST(Actors, StandWhereTheirBoxIsAndAreAbsentOutsideItsLabels) {
    Log street = make_street_log(make_street_options());
    street.rolling_shutter = false;
    const Scene scene = make_scene(street, make_options_with_actors());
    ASSERT_GE(scene.instances.size(), 2u);
    const PoseTrack& track = box_of(street, scene, 1).world_from_box;
    const double first = track.time_s.front(), last = track.time_s.back(),
                 middle = 0.37 * first + 0.63 * last;
    const std::vector<InstancePose> placed = pose_instances(scene, street, {middle});
    EXPECT_TRUE(placed[0].present && placed[1].present);
    EXPECT_EQ(placed[0].world_from_model.translation, glm::dvec3(0.0));
    EXPECT_LT(glm::distance(placed[1].world_from_model.translation, track.pose_at(middle).translation),
              1e-12);
    EXPECT_FALSE(pose_instances(scene, street, {last + 1.0})[1].present);
    EXPECT_FALSE(pose_instances(scene, street, {first - 1.0})[1].present);
    EXPECT_TRUE(pose_instances(scene, street, {last + 1.0})[0].present);
}

const SurfelModel& find_model_of_track(const Scene& scene, std::string_view track) {
    const auto instance = std::ranges::find(scene.instances, track, &ModelInstance::track);
    EXPECT_NE(instance, scene.instances.end());
    return scene.models[instance->model];
}

TEST(Actors, AreChosenByClassOrTrack) {
    const Log street = make_street_log(make_street_options());
    InitOptions options = make_options_with_actors();
    options.actor_tracks = "1";
    const Scene one = make_scene(street, options);
    ASSERT_EQ(one.models.size(), 2u);
    EXPECT_EQ(one.instances[1].track, "1");
    options.actor_tracks = "1, 7";
    EXPECT_THROW(make_scene(street, options), UsageError);
    options = make_options_with_actors();
    options.actor_classes = "";
    EXPECT_EQ(list_foreground(street, options).size(), 2u);
    EXPECT_EQ(make_scene(street, options).models.size(), 1u);
    const std::size_t masked = init_background(street, train_of(street), options).size();
    options.mask_others = false;
    EXPECT_TRUE(list_foreground(street, options).empty());
    EXPECT_EQ(make_scene(street, options).models.size(), 1u);
    EXPECT_GT(init_background(street, train_of(street), options).size(), masked + 100);
}

TEST(Actors, OtherBoxesAreMaskedOrPartOfTheBackground) {
    Log street = make_street_log(make_street_options());
    ASSERT_EQ(street.boxes.size(), 2u);
    street.boxes[0].category = "Pedestrian";
    InitOptions options = make_options_with_actors();
    options.actor_classes = "person";
    const Scene masked = make_scene(street, options);
    ASSERT_EQ(masked.instances.size(), 2u);
    EXPECT_EQ(find_unmodelled(masked, street, options).size(), 1u);
    options.mask_others = false;
    const Scene unmasked = make_scene(street, options);
    ASSERT_EQ(unmasked.instances.size(), 2u) << "the actor stays one";
    EXPECT_EQ(unmasked.instances[1].track, "0");
    EXPECT_TRUE(find_unmodelled(unmasked, street, options).empty());
    EXPECT_TRUE(find_unselected(street, options).empty());
    EXPECT_GT(unmasked.models[0].count, masked.models[0].count + 100);
}

TEST(Actors, TrackChosenByNameNeedNotMove) {
    Log street = make_street_log(make_street_options());
    BoxTrack& box = street.boxes[0];
    std::fill(box.world_from_box.pose.begin(), box.world_from_box.pose.end(), box.world_from_box.pose[6]);
    EXPECT_EQ(list_foreground(street, make_options_with_actors()).size(), 1u) << "it stands";
    InitOptions options = make_options_with_actors();
    options.actor_tracks = "0";
    EXPECT_EQ(list_foreground(street, options).size(), 2u);
    box.world_from_box = {{box.world_from_box.time_s[6]}, {box.world_from_box.pose[6]}};
    const Scene scene = make_scene(street, options);
    EXPECT_EQ(scene.instances.size(), 2u) << "one observation is enough";
    EXPECT_TRUE(pose_instances(scene, street, {box.world_from_box.time_s[0]})[1].present);
    EXPECT_FALSE(pose_instances(scene, street, {box.world_from_box.time_s[0] + 0.1})[1].present);
}

TEST(Actors, ArePaddedInTheirBox) {
    const Log street = make_street_log(make_street_options());
    const Scene plain = make_scene(street, make_options_with_actors());
    InitOptions options = make_options_with_actors();
    options.actor_pad_to = 3000;
    const Scene padded = make_scene(street, options);
    ASSERT_LT(find_model_of_track(plain, "0").count, 3000u);
    EXPECT_EQ(find_model_of_track(padded, "0").count, 3000u);
    options.actor_points = 500;
    EXPECT_EQ(find_model_of_track(make_scene(street, options), "0").count, 500u);
    const SurfelModel& car = find_model_of_track(padded, "0");
    int octants[8] = {};
    for (std::uint32_t i = 0; i < car.count; ++i) {
        const glm::vec3 p = padded.surfels.mean[car.first + i];
        EXPECT_TRUE(
            glm::all(glm::lessThanEqual(glm::abs(glm::dvec3(p)), 0.5 * street.boxes[0].size_m + 0.11)));
        ++octants[(p.x > 0) + 2 * (p.y > 0) + 4 * (p.z > 0)];
    }
    for (const int n : octants) EXPECT_GT(n, 150) << "random points fill the whole box";
}

TEST(Actors, BoxesThatHoldNothingAreRefused) {
    for (const double bad : {0.0, -1.0, std::nan("")}) {
        Log street = make_street_log(make_street_options());
        street.boxes[1].size_m.y = bad;
        EXPECT_THROW(init_scene(street, {0, 1}, make_options_with_actors()), DataError);
    }
    Log street = make_street_log(make_street_options());
    street.boxes[0].world_from_box.pose[3].translation.x = std::nan("");
    EXPECT_THROW(init_scene(street, {0, 1}, make_options_with_actors()), DataError);
}

TEST(Actors, OverlappingAndEmptyBoxesBecomeWhatTheyHold) {
    Log street = make_street_log(make_street_options());
    street.boxes.push_back(street.boxes[0]);
    street.boxes.back().id = "twin";
    street.boxes.push_back(street.boxes[0]);
    street.boxes.back().id = "empty";
    for (Pose& pose : street.boxes.back().world_from_box.pose) pose.translation.z += 40.0;
    const Scene scene = make_scene(street, make_options_with_actors());
    EXPECT_EQ(scene.instances.size(), 4u)
        << "background, two cars and the twin; a box without points is no actor";
    EXPECT_EQ(find_model_of_track(scene, "twin").count, find_model_of_track(scene, "0").count);
}

class ActorsOnDevice : public test::DeviceTest {};

TEST_F(ActorsOnDevice, AbsentInstancesAreNotSeenByAnyTraversal) {
    Surfels one;
    one.resize(2);
    for (auto& q : one.rotation) q = {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f};  // normal along x
    std::fill(one.opacity_logit.begin(), one.opacity_logit.end(), 5.0f);
    std::fill(one.sh.begin(), one.sh.end(), 0.0f);
    Scene scene;
    scene.surfels = one;
    scene.models = {{"background", 0, 1}, {"car", 1, 1}};
    scene.instances = {{0, ""}, {1, "car"}, {1, "copy"}};
    const auto at = [](double value, bool present) {
        return InstancePose{Pose{{1, 0, 0, 0}, {value, 0, 0}}, present};
    };
    for (const bool brute_force : {false, true}) {
        const ForcedBehaviourScope forced(device(), {.brute_force = brute_force});
        Renderer renderer(device(), scene, {});
        const WorldRays ray{{{0, 0, 0}}, {{1, 0, 0}}};
        const auto expect_depth = [&](const std::vector<InstancePose>& poses, float depth) {
            renderer.record_poses(poses, glm::vec3(0.0f));
            EXPECT_NEAR(renderer.render_rays(ray).median_depth[0], depth, 1e-5f);
        };
        expect_depth({at(20, true), at(5, true), at(8, true)}, 5.0f);
        expect_depth({at(20, true), at(5, false), at(8, true)}, 8.0f);
        expect_depth({at(20, true), at(5, false), at(8, false)}, 20.0f);
        expect_depth({at(20, true), at(3, true), at(8, false)}, 3.0f);
    }
}

}  // namespace
}  // namespace relidar
