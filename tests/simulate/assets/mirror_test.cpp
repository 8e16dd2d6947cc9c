// SPDX-License-Identifier: Apache-2.0
// Tests mirror images of surfels. Compares covariances and harmonics with their
// definitions, and renders complete cars from both sides.
#include <relidar/run/edit.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/render.hpp>

#include "../../reference/surfel.hpp"
#include "../../support/device.hpp"
#include "../../support/surfels.hpp"
#include "car.hpp"

namespace relidar {
namespace {

const glm::dmat3 kMirror(glm::dvec3(1, 0, 0), glm::dvec3(0, -1, 0), glm::dvec3(0, 0, 1));

Surfels make_surfels_anywhere(std::size_t count) {
    return make_random_surfels(count, glm::vec3(-1.0f), glm::vec3(1.0f), 3);
}

glm::dmat3 compute_covariance(const Surfels& surfels, std::size_t index) {
    const glm::vec4 q = surfels.rotation[index];
    const glm::dmat3 axes = glm::mat3_cast(glm::normalize(glm::dquat(q[0], q[1], q[2], q[3])));
    glm::dvec3 sigma(std::exp(surfels.log_scale[index].x), std::exp(surfels.log_scale[index].y), 0.0);
    if (properties_of(surfels.primitive).third_scale) sigma.z = std::exp(surfels.log_scale_w[index]);
    const glm::dmat3 scaled(sigma.x * axes[0], sigma.y * axes[1], sigma.z * axes[2]);
    return scaled * glm::transpose(scaled);
}

double difference(const glm::dmat3& first, const glm::dmat3& second) {
    double most = 0.0;
    for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) most = std::max(most, std::abs(first[c][r] - second[c][r]));
    return most;
}

TEST(Mirror, CovarianceIsMirrored) {
    Surfels discs = make_surfels_anywhere(50), ellipsoids = discs;
    convert_surfels(ellipsoids, PrimitiveType::gaussian, 0.3);
    for (const Surfels* surfels : {&discs, &ellipsoids}) {
        const Surfels other = mirror_surfels(*surfels);
        for (std::size_t i = 0; i < surfels->size(); ++i) {
            EXPECT_EQ(other.mean[i], glm::vec3(kMirror * glm::dvec3(surfels->mean[i])));
            EXPECT_LT(
                difference(compute_covariance(other, i), kMirror * compute_covariance(*surfels, i) * kMirror),
                1e-9);
        }
    }
}

TEST(Mirror, HarmonicsAreThoseOfTheMirroredDirection) {
    const Surfels surfels = make_surfels_anywhere(20);
    const std::vector<reference::Surfel> here = test::to_reference(surfels),
                                         there = test::to_reference(mirror_surfels(surfels));
    std::mt19937 random(9);
    std::normal_distribution<double> normal;
    for (std::size_t i = 0; i < here.size(); ++i) {
        for (int k = 0; k < 20; ++k) {
            const glm::dvec3 direction =
                glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
            const glm::dvec3 expected = reference::evaluate_sh(here[i], direction, 3);
            const glm::dvec3 mirrored_value = reference::evaluate_sh(there[i], kMirror * direction, 3);
            EXPECT_LT(glm::length(mirrored_value - expected), 1e-12);
            EXPECT_GT(glm::length(reference::evaluate_sh(here[i], kMirror * direction, 3) - expected), 1e-6);
        }
    }
}

TEST(Mirror, AMovingSurfelSwingsToTheOtherSide) {
    Surfels surfels = make_surfels_anywhere(1);
    surfels.bends = true;
    surfels.gait.assign(1, {0.25f, 1.0f, glm::vec3(1.0f, 2.0f, 3.0f)});
    EXPECT_EQ(mirror_surfels(surfels).gait[0].swing, glm::vec3(1.0f, -2.0f, 3.0f));
}

TEST(Mirror, TwiceIsNoChange) {
    const Surfels surfels = make_surfels_anywhere(5), twice = mirror_surfels(mirror_surfels(surfels));
    EXPECT_EQ(twice.mean, surfels.mean);
    EXPECT_EQ(twice.rotation, surfels.rotation);
    EXPECT_EQ(twice.sh, surfels.sh);
}

RayTable make_rays_from_the_right(double y) {
    RayTable rays;
    rays.rows = 40;
    rays.columns = 80;
    for (int row = 0; row < rays.rows; ++row) {
        for (int column = 0; column < rays.columns; ++column) {
            const glm::dvec3 from(0.7, -8.0 * y, 1.2), to(-1.6 + 0.04 * column, -0.9 * y, -0.5 + 0.025 * row);
            rays.origin.push_back(glm::vec3(from));
            rays.direction.push_back(glm::vec3(glm::normalize(to - from)));
            rays.time_offset_s.push_back(0.0f);
            rays.channel.push_back(0);
        }
    }
    return rays;
}

class MirroredCar : public test::DeviceTest {
protected:
    RenderedScan seen(const relidar::Run& run, const RayTable& rays) {
        const PoseTrack stands{{0.5}, {Pose{{1, 0, 0, 0}, run.log.world_offset_m}}};
        const std::string track = run.scene.instances[1].track;
        return ScanRenderer(device(), run.scene, run.config, run.log)
            .render({.rays = rays, .name = "rays"}, {0.5, stands, ActorTracksByName{{track, stands}}});
    }
};

TEST_F(MirroredCar, LooksFromTheUnseenSideAsItDoesFromTheSeenOne) {
    const Surfels left = make_random_surfels(600, {-1.2f, 0.85f, -0.4f}, {1.2f, 0.95f, 0.4f}, 1);
    Surfels guessed = left;  // adds surfels that training left on the unobserved side
    guessed.append_surfels(make_random_surfels(100, {-1.2f, -0.95f, -0.4f}, {1.2f, -0.85f, 0.4f}, 2));
    const ActorAsset asset = extract_asset(run_of(guessed, {}), "7", from_outside(left.mean, 8.0));
    EXPECT_EQ(asset.facts.mirrored, left.size());
    EXPECT_EQ(asset.facts.surfels, 2 * left.size()) << "guesses have made room";
    const RenderedScan expected = seen(asset.run, make_rays_from_the_right(-1.0)),
                       actual = seen(asset.run, make_rays_from_the_right(1.0));
    ASSERT_EQ(actual.weight.size(), expected.weight.size());
    std::size_t met = 0;
    for (std::size_t i = 0; i < actual.weight.size(); ++i) {
        EXPECT_NEAR(actual.weight[i], expected.weight[i], 1e-3) << i;
        EXPECT_NEAR(actual.image.intensity[i], expected.image.intensity[i], 1e-3) << i;
        EXPECT_NEAR(actual.image.drop_prob[i], expected.image.drop_prob[i], 1e-3) << i;
        if (expected.weight[i] < 0.1f) continue;
        EXPECT_NEAR(actual.mean_range_m[i], expected.mean_range_m[i], 0.01f) << i;
        ++met;
    }
    EXPECT_GT(met, 500u);
}

TEST_F(MirroredCar, KeepsWhatWasSeen) {
    const Surfels left = make_random_surfels(600, {-1.2f, 0.85f, -0.4f}, {1.2f, 0.95f, 0.4f}, 1);
    const Surfels surfels = extract_asset(run_of(left, {}), "7", from_outside(left.mean)).run.scene.surfels;
    for (std::size_t i = 0; i < left.size(); ++i) {
        const auto it = std::ranges::find(surfels.mean, left.mean[i]);
        ASSERT_NE(it, surfels.mean.end()) << i;
        const auto k = std::size_t(it - surfels.mean.begin());
        EXPECT_EQ(surfels.rotation[k], left.rotation[i]);
        EXPECT_TRUE(std::equal(left.sh.begin() + std::ptrdiff_t(i * kShFloats),
                               left.sh.begin() + std::ptrdiff_t((i + 1) * kShFloats),
                               surfels.sh.begin() + std::ptrdiff_t(k * kShFloats)));
    }
}

Surfels left_plate() {
    const Surfels all = make_plates();
    std::vector<std::uint32_t> left;
    for (std::uint32_t i = 0; i < all.size(); ++i)
        if (std::abs(all.mean[i].y - 0.95f) < 1e-3f) left.push_back(i);
    return all.reorder(left);
}

relidar::Run train_small_run(const Surfels& car, const std::string& category) {
    relidar::Run run = run_of(car, {});
    run.log.boxes[0].category = category;
    ObservedBoxSurface surface(kCarSize_m);
    for (const glm::vec3& p : car.mean)
        surface.mark_observed(glm::dvec3(p), {0.0, p.y > 0.0f ? -1.0 : 1.0, 0.0});
    run.scene.models[1].surface = surface;
    return run;
}

TEST_F(MirroredCar, AMovedCarReturnsRaysOfTheUnseenSideAtTheMirroredPlane) {
    const relidar::Run run = train_small_run(left_plate(), "Car");
    relidar::Run edited = run;
    const Pose ahead{{1, 0, 0, 0}, {1, 0, 0}};
    edited.set_driving_scene(move_track(edited.driving_scene(), "7", ahead));
    const RayTable rays = make_rays_from_the_right(1.0);
    const RenderedScan before = seen(run, rays), after = seen(edited, rays);
    for (std::size_t i = 0; i < rays.direction.size(); ++i) {
        const auto range_to = [&](float y_m) { return (y_m - rays.origin[i].y) / rays.direction[i].y; };
        ASSERT_NEAR(after.median_range_m[i], range_to(-0.95f), 0.01f) << i;
        if (before.median_range_m[i] > 0.0f) {
            ASSERT_NEAR(before.median_range_m[i], range_to(0.95f), 0.01f) << "the inside of the left plate";
        }
    }
    EXPECT_EQ(seen(edited, make_rays_from_the_right(-1.0)).median_range_m,
              seen(run, make_rays_from_the_right(-1.0)).median_range_m);
    const ObservedBoxSurface& surface = *edited.scene.models[1].surface;
    EXPECT_EQ(list_unseen_sides(surface.covered_sides()), "front, rear, top");
    relidar::Run again = edited;
    again.set_driving_scene(move_track(again.driving_scene(), "7", ahead));
    EXPECT_EQ(again.scene.surfels.size(), edited.scene.surfels.size()) << "completed once";
}

TEST_F(MirroredCar, ASideStaysUnseenIfNoSurfelIsMirrored) {
    Surfels inside = left_plate();
    ObservedBoxSurface surface(kCarSize_m);
    for (const glm::vec3& p : inside.mean) surface.mark_observed(glm::dvec3(p), {0.0, -1.0, 0.0});
    for (glm::vec3& mean : inside.mean) mean = glm::vec3(0.0f);
    EXPECT_EQ(mirror_unobserved(inside, surface), 0u);
    EXPECT_FALSE(surface.is_completed);
    EXPECT_EQ(inside.size(), left_plate().size());
}

TEST_F(MirroredCar, OnlyASymmetricVehicleIsCompleted) {
    const auto count_after_copy = [](relidar::Run run) {
        run.set_driving_scene(copy_track(run.driving_scene(), "7", {}));
        return run.scene.surfels.size();
    };
    EXPECT_GT(count_after_copy(train_small_run(left_plate(), "Car")), left_plate().size());
    EXPECT_EQ(count_after_copy(train_small_run(left_plate(), "Pedestrian")), left_plate().size());
    // The rear half of the right side was seen too, 0.4 m nearer to the centre.
    Surfels lopsided = left_plate(), right = mirror_surfels(left_plate());
    std::vector<std::uint32_t> rear;
    for (std::uint32_t i = 0; i < right.size(); ++i) {
        if (right.mean[i].x < -0.1f) rear.push_back(i);
        right.mean[i] *= 0.55f / 0.95f;
    }
    lopsided.append_surfels(right.reorder(rear));
    EXPECT_EQ(count_after_copy(train_small_run(lopsided, "Car")), lopsided.size());
}

}  // namespace
}  // namespace relidar
