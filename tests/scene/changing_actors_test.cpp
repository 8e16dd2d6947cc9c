// SPDX-License-Identifier: Apache-2.0
// Tests actors that change their shape. Each surfel of such an actor is visible only
// around the time of its frame (docs/method.md M14).

#include <gtest/gtest.h>
#include <cmath>

#include <relidar/diff/forward.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/scene/labels.hpp>

#include "../support/device.hpp"
#include "base/random.hpp"
#include "scene/point_surfels.hpp"

namespace relidar {
namespace {

/// Points of a static wall and of a door that opens suddenly. The actor moves by 10 cm
/// per frame.
std::vector<LidarSample> make_points_of_door() {
    std::vector<LidarSample> samples;
    for (int frame = 0; frame < 20; ++frame)
        for (float x = 0.0f; x < 1.0f; x += 0.1f)
            for (float z = 0.0f; z < 1.0f; z += 0.1f)
                for (const float y : {frame < 10 ? 0.0f : 0.5f, 1.0f})
                    samples.push_back({{x, y, z}, 0.5f, {0.0f, 1.0f, 0.0f}, 0.1f * float(frame), frame});
    return samples;
}

TEST(ChangingSurfels, ADoorIsOpenOnlyWhenItWasOpen) {
    const DeformingActorSurfels actor = make_deforming(make_points_of_door(), {}, 0.0, 8000);
    // Returns the highest visibility (M14) of the surfels at a distance y in a frame.
    const auto visible = [&](double frame, float y) {
        double most = 0.0;
        for (std::size_t i = 0; i < actor.surfels.size(); ++i) {
            const GaitPhaseWindow& gait = actor.surfels.gait[i];
            const double turns = 0.1 * frame / actor.period_m - double(gait.phase), k = gait.sharpness;
            if (std::abs(actor.surfels.mean[i].y - y) < 0.01f)
                most = std::max(most, std::exp(k * k * (std::cos(2.0 * kPi * turns) - 1.0)));
        }
        return most;
    };
    for (const double frame : {0.0, 4.0, 15.0, 19.0}) {
        EXPECT_GT(visible(frame, frame < 10.0 ? 0.0f : 0.5f), 0.99) << frame;
        EXPECT_LT(visible(frame, frame < 10.0 ? 0.5f : 0.0f), 0.02) << frame;
        EXPECT_EQ(visible(frame, 1.0f), 1.0) << "the wall is always visible";
    }
    EXPECT_NEAR(visible(4.5, 0.0f), std::exp(-0.125), 1e-3) << "half a standard deviation";
    EXPECT_EQ(make_deforming({make_points_of_door().front()}, {}, 0.0, 8000).surfels.size(), 0u);
}

/// A limb moves as far as the actor walks. Between two frames, the surfels of both must
/// meet at its exact position.
TEST(ChangingSurfels, ALimbMovesBetweenFrames) {
    std::vector<LidarSample> samples;
    for (int frame = 0; frame < 20; ++frame)
        for (float y = -0.2f; y < 0.21f; y += 0.04f)
            for (float z = -0.2f; z < 0.21f; z += 0.04f)
                samples.push_back(
                    {{0.1f * float(frame), y, z}, 0.5f, {-1.0f, 0.0f, 0.0f}, 0.1f * float(frame), frame});
    const DeformingActorSurfels actor = make_deforming(samples, {}, 0.0, 8000);
    int n_visible = 0;
    for (std::size_t i = 0; i < actor.surfels.size(); ++i) {
        const GaitPhaseWindow& gait = actor.surfels.gait[i];
        const double turns = 0.45 / actor.period_m - double(gait.phase), k = gait.sharpness;
        if (std::exp(k * k * (std::cos(2.0 * kPi * turns) - 1.0)) < 0.8) continue;
        ++n_visible;
        EXPECT_NEAR(actor.surfels.mean[i].x + gait.swing.x * std::sin(2.0 * kPi * turns), 0.45, 0.012) << i;
        EXPECT_EQ(gait.swing.z, 0.0f);
    }
    EXPECT_GT(n_visible, 20);
}

/// The walked distance is constant and cannot drive a motion.
TEST(ChangingSurfels, AnActorThatStandsIsRigid) {
    std::vector<LidarSample> samples = make_points_of_door();
    for (LidarSample& sample : samples) sample.walked_m = 0.0f;
    EXPECT_EQ(make_deforming(samples, {}, 0.0, 8000).period_m, 0.0);
}

/// Evaluates M14 at all phases of the walk.
TEST(ChangingSurfels, FadeBeforeTheySwingOutOfTheBox) {
    constexpr float kAlphaMin = 0.02f;
    Scene scene = wrap_background({});
    Surfels& surfels = scene.surfels;
    surfels.resize(4, {PrimitiveType::surfel, true});
    surfels.mean = {{0.3f, 0.0f, 0.0f}, {-0.1f, 0.0f, 0.8f}, {0.0f, 0.2f, 0.0f}, {0.3f, 0.0f, 0.0f}};
    surfels.gait = {{0.1f, 0.5f, {9.0f, 0.0f, 0.0f}},
                    {0.6f, 3.0f, {-1.0f, 0.0f, 0.5f}},
                    {0.3f, 2.0f, {0.4f, 0.3f, 0.0f}},
                    {0.2f, 0.5f, {9.0f, 0.0f, 0.0f}}};
    surfels.opacity_logit = {2.0f, 0.0f, 4.0f, 2.0f};
    const glm::vec3 half_m(0.6f, 0.5f, 1.0f);
    scene.models = {{"background", 0, 0}, {"walker", 0, 3, half_m, 5.0f}, {"rigid", 3, 1, half_m}};
    const std::vector<GaitPhaseWindow> before = surfels.gait;
    fade_far_swings(scene, kAlphaMin);
    int n_visible = 0;
    for (std::size_t i = 0; i < 3; ++i)
        for (double phase = 0.0; phase < 1.0; phase += 1e-3) {
            const GaitPhaseWindow& gait = surfels.gait[i];
            const double angle = 2.0 * kPi * (phase - double(gait.phase)), k = gait.sharpness,
                         opacity = std::exp(k * k * (std::cos(angle) - 1.0)) /
                                   (1.0 + std::exp(-double(surfels.opacity_logit[i])));
            const glm::dvec3 centre_m =
                glm::dvec3(surfels.mean[i]) + std::sin(angle) * glm::dvec3(gait.swing);
            const glm::dvec3 outside_m = glm::abs(centre_m) - glm::dvec3(half_m) - 0.1;
            if (opacity <= double(kAlphaMin) + 1e-6) continue;
            ++n_visible;
            EXPECT_LE(std::max({outside_m.x, outside_m.y, outside_m.z}), 1e-5) << i << " at " << phase;
        }
    EXPECT_GT(n_visible, 100);
    EXPECT_GT(surfels.gait[0].sharpness, before[0].sharpness);
    EXPECT_EQ(surfels.gait[2].sharpness, before[2].sharpness) << "it stays in the box";
    EXPECT_EQ(surfels.gait[3].sharpness, before[3].sharpness) << "its model does not walk";
}

PoseTrack make_straight_walk(double speed_mps, double jitter_m, double from_s = 0.0) {
    PoseTrack track;
    Random random(3);
    for (double t = from_s; t < from_s + 5.05; t += 0.1) {
        track.time_s.push_back(t);
        track.pose.push_back(
            {glm::dquat(1, 0, 0, 0),
             {speed_mps * t, jitter_m * random.sample_normal(), jitter_m * random.sample_normal()}});
    }
    return track;
}

TEST(WalkedDistance, IsTheWayAndNotTheJitterOfLabels) {
    const WalkedDistanceTrack exact(make_straight_walk(1.4, 0.0));
    for (const double t : {0.0, 0.33, 2.0, 5.0, 6.0}) EXPECT_NEAR(exact.walked_m(t), 1.4 * t, 1e-9) << t;
    const WalkedDistanceTrack labelled(make_straight_walk(1.4, 0.03));
    EXPECT_NEAR(labelled.walked_m(4.5) - labelled.walked_m(0.5), 1.4 * 4.0, 0.15);
    EXPECT_LT(WalkedDistanceTrack(make_straight_walk(0.0, 0.03)).walked_m(5.0), 0.2) << "it stands";
    EXPECT_EQ(WalkedDistanceTrack(PoseTrack{{0.0}, {Pose{}}}).walked_m(3.0), 0.0);
}

/// Makes three walkers and a rigid cyclist.
class Walkers : public test::DeviceTest {
protected:
    static StreetOptions options() {
        return {.seed = 3,
                .n_frames = 40,
                .rows = 64,
                .columns = 1024,
                .speed_mps = 2.0,
                .moving_cars = false,
                .people = true,
                .gait = true};
    }
    static void SetUpTestSuite() {
        log = make_street_log(options());
        split = split_frames(log, 10);
        start.opacity = 0.99;
        start.scale_factor = 0.5;  // opaque and small, as after training
        walking = init_scene(log, split.train, start, {}, &notes);
        start.deform = "";
        rigid = init_scene(log, split.train, start);
    }
    static void TearDownTestSuite() {
        log = {};
        walking = rigid = {};
    }

    static const SurfelModel& model_of(const Scene& scene, const std::string& track) {
        return *std::ranges::find(scene.models, track, &SurfelModel::name);
    }
    /// Returns the errors of the rendered surface in metres, for all rays that hit a
    /// walker.
    std::vector<double> errors(const Scene& scene, const Log& at, const Frame& frame, const Scan& exact,
                               const std::string& track) {
        const BoxTrack& box = *find_box(at, track);
        const PoseTrack world_from_sensor = at.lidar_track(frame.lidar);
        WorldRays rays;
        std::vector<double> truth;
        for (std::size_t i = 0; i < exact.range_m.size(); ++i) {
            if (!(exact.range_m[i] > 0.0f)) continue;
            const WorldRay ray = make_world_ray(world_from_sensor, frame.time_s, frame.scan.rays, i, true);
            const glm::dvec3 point = ray.origin_m + double(exact.range_m[i]) * ray.direction;
            const glm::dvec3 local = inverse(box.world_from_box.pose_at(frame.time_s)) * point;
            if (!box.contains_point(point, frame.time_s, 0.05) || local.z < -0.5 * box.size_m.z + 0.2)
                continue;
            rays.origin.emplace_back(ray.origin_m);
            rays.direction.emplace_back(ray.direction);
            truth.push_back(double(exact.range_m[i]));
        }
        Renderer renderer(device(), scene, {}, {.n_rays = static_cast<std::uint32_t>(rays.size())});
        // moves the scene to a different phase of the stride first
        renderer.record_poses(pose_instances(scene, log, timing_of(log.frames[0])), glm::vec3(0.0f));
        renderer.record_poses(pose_instances(scene, at, timing_of(frame)),
                              glm::vec3(world_from_sensor.pose_at(frame.time_s).translation));
        const RenderedRayValues r = renderer.render_rays(rays);
        std::vector<double> off;
        for (std::size_t i = 0; i < truth.size(); ++i)
            off.push_back(std::abs(double(r.median_depth[i]) - truth[i]));
        return off;
    }
    static double share_within(const std::vector<double>& errors, double most_m) {
        return double(std::ranges::count_if(errors, [&](double e) { return e < most_m; })) /
               double(errors.size());
    }

    inline static Log log;
    inline static Split split;
    inline static InitOptions start;
    inline static Scene walking, rigid;
    inline static std::vector<std::string> notes;
};

TEST_F(Walkers, PeopleAndCyclistsChangeAndTheBackgroundDoesNot) {
    for (const char* track : {"0", "1", "3"}) {
        const std::vector<Pose>& poses = find_box(log, track)->world_from_box.pose;
        EXPECT_GT(double(model_of(walking, track).stride_m),
                  0.8 * glm::distance(poses.front().translation, poses.back().translation))
            << track << ": the motion repeats after the recorded distance";
    }
    EXPECT_TRUE(std::ranges::count(notes, "3 (Cyclist) changes its shape from frame to frame"));
    EXPECT_FALSE(rigid.surfels.bends);
    for (std::size_t i = 0; i < model_of(walking, "background").count; ++i) {
        ASSERT_EQ(walking.surfels.gait[i].sharpness, 0.0f);
        ASSERT_EQ(walking.surfels.gait[i].swing, glm::vec3(0.0f));
    }
}

TEST_F(Walkers, LieWhereTheyAreAtMomentsThatWereHeldOut) {
    std::vector<double> bent, stiff;
    for (const int position : split.test) {
        const Frame& frame = log.frames[std::size_t(position)];
        const Scan exact = cast_street_rays(options(), frame.scan.rays, log.lidar_track(0), frame.time_s);
        for (const char* track : {"0", "1"}) {
            for (const double e : errors(walking, log, frame, exact, track)) bent.push_back(e);
            for (const double e : errors(rigid, log, frame, exact, track)) stiff.push_back(e);
        }
    }
    ASSERT_GT(bent.size(), 300u);
    EXPECT_GT(share_within(bent, 0.03), share_within(stiff, 0.03) + 0.04);
    EXPECT_LT(share_within(stiff, 0.3), share_within(bent, 0.3)) << "rays that miss or meet the other leg";
}

/// The phase depends on distance, in the exact street too.
TEST_F(Walkers, StepByDistance) {
    const std::string walker = "0";
    Log slow = log;
    BoxTrack& box = *std::ranges::find(slow.boxes, walker, &BoxTrack::id);
    for (double& t : box.world_from_box.time_s) t *= 2.0;
    const auto at =
        std::size_t(std::ranges::find(walking.models, walker, &SurfelModel::name) - walking.models.begin());
    const Frame& frame = log.frames[30];
    const double before = pose_instances(walking, log, SweepTiming{log.frames[15].time_s})[at].phase;
    const double phase = pose_instances(walking, slow, timing_of(frame))[at].phase;
    EXPECT_NEAR(phase, before, 0.03) << "turns, half way";
    const Scan exact = cast_street_rays(options(), {{std::stoul(walker), box}}, frame.scan.rays,
                                        log.lidar_track(0), frame.time_s);
    EXPECT_GT(share_within(errors(walking, slow, frame, exact, walker), 0.03),
              share_within(errors(rigid, slow, frame, exact, walker), 0.03) + 0.05);
}

}  // namespace

}  // namespace relidar
