// SPDX-License-Identifier: Apache-2.0
// Tests walking people, whose limbs move with the walked distance (docs/method.md M14).
// Compares rendered people with the exact street at times that did not train the scene.

#include <relidar/diff/forward.hpp>
#include <relidar/read/dataset.hpp>

#include "base/random.hpp"
#include "scene/changing_actors.hpp"

#include "../support/device.hpp"

namespace relidar {
namespace {

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
