// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "base/random.hpp"
#include "read/datasets/street/street.hpp"

namespace relidar {
namespace {

double compute_distance_to_segment(const glm::dvec3& point, const glm::dvec3& first,
                                   const glm::dvec3& second) {
    const double along = glm::clamp(
        glm::dot(point - first, second - first) / glm::dot(second - first, second - first), 0.0, 1.0);
    return glm::distance(point, first + along * (second - first));
}

/// The limb hangs from its joint and swings forward by the angle swing sin(stride).
TEST(Gait, LimbsAreMetWhereTheySwing) {
    const street::SwingingLimb limb{{0.1, 0.3, 0.2}, 0.7, 0.08, 0.5, 0.4, 0.5};
    street::MovingStreetActor walker;
    walker.start_m = {3.0, -2.0, 5.0};
    walker.yaw_rad = 0.7;
    walker.speed_mps = 1.3;
    walker.stride_m = 1.4;
    walker.limbs = {limb};
    street::SyntheticStreet street;
    street.cars = {walker};
    const street::StreetCaster caster(street);
    Random random(5);
    int hits = 0;
    for (int i = 0; i < 4000; ++i) {
        const double t_s = random.sample_uniform(0.0, 3.0);
        const double pitch =
            limb.swing_rad * std::sin(2.0 * kPi * walker.speed_mps * t_s / walker.stride_m + limb.phase_rad);
        const glm::dvec3 ahead(std::cos(walker.yaw_rad), std::sin(walker.yaw_rad), 0.0),
            left(-ahead.y, ahead.x, 0.0), up(0.0, 0.0, 1.0);
        const glm::dvec3 box = walker.start_m + walker.speed_mps * t_s * ahead;
        const glm::dvec3 joint = box + limb.joint_m.x * ahead + limb.joint_m.y * left + limb.joint_m.z * up;
        const glm::dvec3 end = joint + limb.length_m * (std::sin(pitch) * ahead - std::cos(pitch) * up);
        const auto somewhere = [&] {
            return glm::dvec3(random.sample_normal(), random.sample_normal(), random.sample_normal());
        };
        const glm::dvec3 origin = box + 4.0 * glm::normalize(somewhere());
        const glm::dvec3 aim = glm::mix(joint, end, random.sample_uniform()) + 0.05 * somewhere();
        const WorldRay ray{origin, glm::normalize(aim - origin)};
        double t = 0.0, gap = 1.0;
        for (int step = 0; step < 400 && gap > 1e-9 && t < 8.0; ++step, t += gap)
            gap = compute_distance_to_segment(origin + t * ray.direction, joint, end) - limb.radius_m;
        if (gap > 1e-9 && gap < 1e-3) continue;  // nearly touches the limb
        const std::optional<street::StreetHit> hit = caster.find_first_hit(ray, t_s, 20.0);
        const bool on_limb = hit && std::abs(glm::distance(origin + hit->range_m * ray.direction, box)) < 2.0;
        ASSERT_EQ(on_limb, gap <= 1e-9) << i;
        if (!on_limb) continue;
        ++hits;
        ASSERT_NEAR(hit->range_m, t, 1e-6) << i;
    }
    EXPECT_GT(hits, 1500);
}

/// One of two people on the same path has half the speed, but must have the same steps.
TEST(Gait, GoesByDistance) {
    const StreetOptions options{.n_frames = 9, .people = true, .gait = true};
    const Log street = make_street_log(options);
    const std::size_t walker = 3;
    SyntheticCar slow{walker, street.boxes[walker]};
    for (double& t_s : slow.track.world_from_box.time_s) t_s *= 2.0;
    const BoxTrack& box = street.boxes[walker];
    const glm::dvec3 at = box.world_from_box.pose[4].translation;
    constexpr int kSide = 60;
    RayTable rays;  // all fired at the same time
    rays.rows = rays.columns = kSide;
    constexpr std::size_t kRays = std::size_t(kSide) * kSide;
    for (int i = 0; i < int(kRays); ++i)
        rays.direction.emplace_back(glm::normalize(
            glm::dvec3(3.0, -0.6 + 1.2 * (i % kSide) / kSide, -1.0 + 2.0 * (i / kSide) / kSide)));
    rays.origin.assign(kRays, glm::vec3(0.0f));
    rays.time_offset_s.assign(kRays, 0.0f);
    rays.channel.assign(kRays, 0);
    const Pose sensor{glm::dquat(1, 0, 0, 0), at - glm::dvec3(3.0, 0.0, 0.0)};
    const auto cast_ranges = [&](const SyntheticCar& car, double time_s) {
        return cast_street_rays(options, {car}, rays, PoseTrack{{time_s}, {sensor}}, time_s).range_m;
    };
    const std::vector<float> at_normal_speed = to_vector(cast_ranges({walker, box}, 0.4)),
                             at_half_speed = to_vector(cast_ranges(slow, 0.8));
    int n_walker_returns = 0;
    for (std::size_t i = 0; i < at_normal_speed.size(); ++i) {
        n_walker_returns += at_normal_speed[i] > 2.0f && at_normal_speed[i] < 4.0f;
        ASSERT_NEAR(at_normal_speed[i], at_half_speed[i], 1e-4) << i;
    }
    EXPECT_GT(n_walker_returns, 200);
    EXPECT_NE(at_normal_speed, to_vector(cast_ranges({walker, box}, 0.6))) << "he walks on";
}

}  // namespace
}  // namespace relidar
