// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <cmath>
#include <limits>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

Surfels make_numbered_surfels(std::size_t count, float first) {
    Surfels surfels;
    surfels.resize(count);
    for (std::size_t i = 0; i < count; ++i) surfels.mean[i] = {first + float(i), 0.0f, 0.0f};
    return surfels;
}

Pose at(double x, double y, double yaw_rad = 0.0) {
    return {glm::angleAxis(yaw_rad, glm::dvec3(0, 0, 1)), {x, y, 0.5}};
}

/// Ten frames, a background of 3 surfels, a van of 2 surfels that drives a curve, a car
/// of 4 surfels, and a pedestrian without a model.
SceneWithLog example() {
    SceneWithLog d;
    d.scene.surfels = make_numbered_surfels(3, 0.0f);
    d.scene.surfels.append_surfels(make_numbered_surfels(2, 100.0f));
    d.scene.surfels.append_surfels(make_numbered_surfels(4, 200.0f));
    d.scene.models = {
        {"background", 0, 3, {}}, {"van", 3, 2, {2.6f, 1.1f, 1.1f}}, {"car", 5, 4, {2.1f, 1.1f, 0.85f}}};
    d.scene.instances = {{0, ""}, {1, "van"}, {2, "car"}};
    d.scene.sensor_drop = {1, 1, {0.25f}};
    d.log.lidars[0].sensor.period_s = 0.1;
    d.log.world_offset_m = {1000.0, -50.0, 2.0};
    BoxTrack van{"van", "Van", {5, 2, 2}, {}}, car{"car", "Car", {4, 2, 1.5}, {}},
        walker{"walker", "Pedestrian", {1, 1, 2}, {}};
    for (int i = 0; i < 10; ++i) {
        d.log.frames.push_back({i, 0.1 * i, {}});
        van.world_from_box.append(0.1 * i, at(i, 0.1 * i * i, 0.1 * i));
        car.world_from_box.append(0.1 * i, at(-i, 5.0, kPi));
        walker.world_from_box.append(0.1 * i, at(0.1 * i, 9.0));
    }
    d.log.boxes = {van, car, walker};
    return d;
}

const BoxTrack& box(const SceneWithLog& driving, const std::string& id) { return *find_box(driving.log, id); }

std::vector<std::string> tracks(const SceneWithLog& driving) {
    std::vector<std::string> names;
    for (const ModelInstance& i : driving.scene.instances) names.push_back(i.track);
    return names;
}

/// x of the first surfel of an instance, and the number of its surfels
std::pair<float, std::uint32_t> model_of(const SceneWithLog& driving, std::size_t instance) {
    const SurfelModel& m = driving.scene.models[driving.scene.instances[instance].model];
    return {m.count ? driving.scene.surfels.mean[m.first].x : 0.0f, m.count};
}

void expect_near(const Pose& first, const Pose& second, double tolerance = 1e-12) {
    EXPECT_LT(glm::length(first.translation - second.translation), tolerance);
    EXPECT_LT(std::min(glm::length(first.rotation - second.rotation),
                       glm::length(first.rotation + second.rotation)),
              tolerance);
}

TEST(Edit, ClassesAreSetOnActorsAndOnOtherLabels) {
    const SceneWithLog d = classify_track(classify_track(example(), "van", "bus"), "walker", "cyclist");
    EXPECT_EQ(box(d, "van").category, "bus");
    EXPECT_EQ(box(d, "walker").category, "cyclist") << "it has no model";
    EXPECT_EQ(box(d, "car").category, "Car");
    EXPECT_THROW(classify_track(example(), "tram", "bus"), UsageError);
    EXPECT_THROW(classify_track(example(), "van", ""), UsageError);
}

TEST(Edit, RemovedActorsLeaveWithTheirSurfelsAndBoxes) {
    const SceneWithLog d = remove_track(example(), "van");
    EXPECT_EQ(tracks(d), (std::vector<std::string>{"", "car"}));
    EXPECT_EQ(d.scene.surfels.size(), 7u);
    EXPECT_EQ(model_of(d, 0), std::make_pair(0.0f, 3u));
    EXPECT_EQ(model_of(d, 1), std::make_pair(200.0f, 4u));
    EXPECT_EQ(d.log.boxes.size(), 2u);
    EXPECT_EQ(d.scene.sensor_drop.probability, std::vector<float>{0.25f}) << "the sensor has not changed";
}

TEST(Edit, ScaledSpeedReachesPlacesEarlier) {
    const SceneWithLog before = example(), fast = scale_speed(before, "van", 2.0);
    const PoseTrack &was = box(before, "van").world_from_box, &is = box(fast, "van").world_from_box;
    const double start_s = was.time_s.front();
    for (const double t : {0.0, 0.1, 0.3})
        expect_near(is.pose_at(start_s + t), was.pose_at(start_s + 2.0 * t));
    EXPECT_NEAR(is.time_s.back() - start_s, 0.5 * (was.time_s.back() - start_s), 1e-12);
    for (const double wrong : {0.0, -1.0, std::nan(""), 1e300})
        EXPECT_THROW((void)scale_speed(before, "van", wrong), UsageError) << wrong;
    EXPECT_THROW((void)scale_speed(before, "vam", 2.0), UsageError);
}

/// The van has labels from 0 to 0.9 s. Delayed by 0.4 s, it is absent from frames 0 to 3,
/// because a track extends half a step before its first pose.
TEST(Edit, SaysHowManyFramesLoseAnActor) {
    const SceneWithLog before = example();
    const BoxTrack van = box(before, "van");
    EXPECT_THAT(describe_absence(van, delay_track(before, "van", 0.4).log),
                test::Names("van ... 4 ... 0 ... 3 ... 0.40 ... 1.30 s"));
    const PoseTrack path{{0.2, 0.5}, {at(0, 0), at(3, 0)}};
    EXPECT_THAT(describe_absence(van, replace_track(before, "van", path).log),
                test::Names("van ... 6 ... 0 ... 9 ... 0.20 ... 0.50 s"));
    EXPECT_EQ(describe_absence(van, delay_track(before, "van", 0.02).log), "");
    EXPECT_EQ(describe_absence(van, move_track(before, "van", at(0, 1)).log), "");
}

/// The log has observed only the left side of its car.
SceneWithLog make_example_seen_from_left() {
    SceneWithLog recorded = example();
    ObservedBoxSurface left_side({4.0, 2.0, 1.5});
    for (double x = -1.95; x < 2.0; x += 0.1)
        for (double z = -0.7; z < 0.75; z += 0.1) left_side.mark_observed({x, 1.0, z}, {0.0, -1.0, 0.0});
    recorded.scene.models[2].surface = left_side;
    for (std::size_t k = 0; k < 4; ++k) recorded.scene.surfels.mean[5 + k] = {-1.5f + float(k), 1.0f, 0.2f};
    return recorded;
}

TEST(Edit, MovingThereAndBackIsTheIdentity) {
    const SceneWithLog recorded = make_example_seen_from_left();
    const std::vector<BoxTrack>& boxes = recorded.log.boxes;
    const Pose there = at(3.7, -1.3, 0.4);
    for (const SceneWithLog& edited : {move_track(recorded, "car", {}),
                                       move_track(move_track(recorded, "car", there), "car", inverse(there)),
                                       delay_track(delay_track(recorded, "car", 0.1), "car", -0.1)}) {
        const SceneWithLog same = complete_actors(edited, boxes);
        EXPECT_EQ(same.scene.surfels.mean, recorded.scene.surfels.mean);
        for (std::size_t b = 0; b < boxes.size(); ++b) {
            EXPECT_EQ(same.log.boxes[b].world_from_box.time_s, boxes[b].world_from_box.time_s);
            for (std::size_t i = 0; i < boxes[b].world_from_box.pose.size(); ++i)
                expect_near(same.log.boxes[b].world_from_box.pose[i], boxes[b].world_from_box.pose[i], 1e-30);
        }
    }
    const SceneWithLog moved = complete_actors(move_track(recorded, "car", at(0, 1e-3)), boxes);
    EXPECT_EQ(moved.scene.surfels.size(), recorded.scene.surfels.size() + 4);
}

TEST(Edit, RefusesNumbersThatAreNotFinite) {
    const double inf = std::numeric_limits<double>::infinity(), nan = std::nan("");
    for (const double wrong : {nan, inf, -inf, 1e30}) {
        EXPECT_THROW((void)move_track(example(), "car", at(wrong, 0)), DataError) << wrong;
        EXPECT_THROW((void)delay_track(example(), "car", wrong), DataError) << wrong;
        EXPECT_THROW((void)copy_track(example(), "car", {at(0, 0), wrong}), DataError) << wrong;
        EXPECT_THROW((void)insert_track(example(), example(), "car", {at(0, wrong), 0.0}), DataError)
            << wrong;
    }
}

TEST(Edit, CopyDoesNotChangeRecordedActor) {
    const SceneWithLog recorded = make_example_seen_from_left();
    const auto complete = [&](SceneWithLog edited) {
        return complete_actors(std::move(edited), recorded.log.boxes);
    };
    const SceneWithLog once = complete(copy_track(recorded, "car", {at(1020, -60), 0.0})),
                       twice = complete(copy_track(once, "car", {at(1030, -60), 0.0})),
                       moved = complete(move_track(recorded, "car", at(0, 1)));
    EXPECT_EQ(model_of(moved, 2).second, 8u) << "four surfels and their mirror images";
    for (const SceneWithLog* edited : {&once, &twice}) {
        EXPECT_EQ(edited->scene.instances[2].model, 2u);
        EXPECT_EQ(model_of(*edited, 2).second, 4u);
        EXPECT_FALSE(edited->scene.models[2].surface->is_completed);
        EXPECT_EQ(model_of(*edited, 3), model_of(moved, 2));
    }
    EXPECT_EQ(twice.scene.instances[4].model, twice.scene.instances[3].model);
    EXPECT_EQ(twice.scene.models.size(), 4u);
}

TEST(Edit, MoveIsInTheFrameOfTheBoxAtEachTime) {
    const SceneWithLog before = example(),
                       after = move_track(example(), "van",
                                          {glm::angleAxis(0.2, glm::dvec3(0, 0, 1)), {1.0, 3.5, 0.25}});
    for (std::size_t i = 0; i < 10; ++i) {
        const Pose& from = box(before, "van").world_from_box.pose[i];
        const double yaw = 0.1 * double(i);  // heading along the curve
        const glm::dvec3 forward(std::cos(yaw), std::sin(yaw), 0.0), left(-std::sin(yaw), std::cos(yaw), 0.0);
        const glm::dvec3 expected = from.translation + forward + 3.5 * left + glm::dvec3(0, 0, 0.25);
        expect_near(box(after, "van").world_from_box.pose[i],
                    {glm::angleAxis(yaw + 0.2, glm::dvec3(0, 0, 1)), expected});
    }
    EXPECT_EQ(after.scene.surfels.mean, before.scene.surfels.mean);
    expect_near(box(after, "car").world_from_box.pose[3], box(before, "car").world_from_box.pose[3], 1e-300);
}

TEST(Edit, RetimedActorsDoTheSameLaterAndAreAbsentOutside) {
    const SceneWithLog before = example(), after = delay_track(example(), "van", 0.4);
    for (const double t : {0.45, 0.6, 0.93})
        expect_near(box(after, "van").world_from_box.pose_at(t),
                    box(before, "van").world_from_box.pose_at(t - 0.4));
    EXPECT_FALSE(box(after, "van").is_observed(0.3));
    EXPECT_TRUE(box(after, "van").is_observed(0.4));
    EXPECT_TRUE(box(after, "van").is_observed(1.3));
    EXPECT_FALSE(box(after, "van").is_observed(1.4));
}

TEST(Edit, TrajectoriesAreInterpolatedAndEndWithTheirTimes) {
    PoseTrack track{{0.2, 0.7},
                    {{glm::dquat(1, 0, 0, 0), {1010, -50, 2}},
                     {glm::angleAxis(1.0, glm::dvec3(0, 0, 1)), {1020, -45, 2}}}};
    const SceneWithLog d = replace_track(example(), "car", track);
    const BoxTrack& car = box(d, "car");
    expect_near(car.world_from_box.pose_at(0.2), {glm::dquat(1, 0, 0, 0), {10, 0, 0}});
    expect_near(car.world_from_box.pose_at(0.3), {glm::angleAxis(0.2, glm::dvec3(0, 0, 1)), {12, 1, 0}},
                1e-9);
    EXPECT_TRUE(car.is_observed(0.2) && car.is_observed(0.7));
    EXPECT_FALSE(car.is_observed(0.1) || car.is_observed(0.8))
        << "half a sweep beside the ends, no more, however sparse the entries";
    track.time_s[1] = 0.2;
    EXPECT_THROW(replace_track(example(), "car", track), DataError);
    track.time_s[1] = std::nan("");
    EXPECT_THROW(replace_track(example(), "car", track), DataError);
    EXPECT_THROW(replace_track(example(), "car", {{0.0}, {Pose{}}}), DataError);
    EXPECT_THROW(replace_track(example(), "car", {{0.0, 1e9}, {Pose{}, Pose{}}}), DataError);
}

TEST(Edit, CopiesShareTheModelAndDriveStraightOn) {
    const NewActorMotion start{{glm::angleAxis(kPi / 2, glm::dvec3(0, 0, 1)), {1004.0, -48.0, 3.0}}, 8.0};
    const SceneWithLog one = copy_track(example(), "van", start), two = copy_track(one, "van", start);
    EXPECT_EQ(tracks(two), (std::vector<std::string>{"", "van", "car", "van-copy-1", "van-copy-2"}));
    EXPECT_EQ(two.scene.surfels.size(), 9u) << "a model is held once";
    EXPECT_EQ(two.scene.instances[3].model, two.scene.instances[1].model);
    expect_near(box(one, "van-copy-1").world_from_box.pose_at(0.5),
                {start.dataset_from_box.rotation, {4.0, 2.0 + 4.0, 1.0}}, 1e-9);
    EXPECT_EQ(box(one, "van-copy-1").category, "Van");
    const SceneWithLog left = remove_track(two, "van");
    EXPECT_EQ(left.scene.surfels.size(), 9u) << "copies still need it";
    EXPECT_EQ(model_of(left, 2), std::make_pair(100.0f, 2u));
    EXPECT_EQ(remove_track(remove_track(left, "van-copy-1"), "van-copy-2").scene.surfels.size(), 7u);
    EXPECT_EQ(tracks(copy_track(two, "van-copy-1", start)).back(), "van-copy-1-copy-1");
}

TEST(Edit, CopiesHaveOnePosePerSweepOfSeveralLidars) {
    SceneWithLog d = example();
    d.log.lidars.resize(2);
    d.log.frames.clear();
    for (int i = 0; i < 10; ++i)
        for (const int lidar : {0, 1}) d.log.frames.push_back({i, 0.1 * i, {}, lidar});
    EXPECT_EQ(box(copy_track(d, "van", {}), "van-copy-1").world_from_box.time_s,
              box(d, "van").world_from_box.time_s);
}

TEST(Edit, InsertedActorsBringTheirModelAndAFreeName) {
    SceneWithLog other = example();
    other.scene.surfels.mean[3].x = 777.0f;
    const SceneWithLog d =
        insert_track(insert_track(remove_track(example(), "car"), other, "van", {}), other, "car", {});
    EXPECT_EQ(tracks(d), (std::vector<std::string>{"", "van", "van-insert-1", "car"}));
    EXPECT_EQ(model_of(d, 1), std::make_pair(100.0f, 2u));
    EXPECT_EQ(model_of(d, 2), std::make_pair(777.0f, 2u));
    EXPECT_EQ(model_of(d, 3), std::make_pair(200.0f, 4u));
    EXPECT_EQ(box(d, "van-insert-1").size_m, glm::dvec3(5, 2, 2));
}

TEST(Edit, ModelsKeepTheirBox) {
    const SceneWithLog after_removal = remove_track(example(), "van"),
                       inserted = insert_track(remove_track(example(), "car"), example(), "car", {});
    for (const SceneWithLog* d : {&after_removal, &inserted}) {
        const Scene unshared_scene = unshare_models(d->scene);
        for (const Scene* scene : {&d->scene, &unshared_scene})
            EXPECT_EQ(scene->models[scene->instances.back().model].half_size_m, glm::vec3(2.1f, 1.1f, 0.85f));
    }
    Scene twice = example().scene;
    twice.instances.push_back({2, "car-copy-1"});
    EXPECT_EQ(unshare_models(twice).models[3].half_size_m, glm::vec3(2.1f, 1.1f, 0.85f));
}

TEST(Edit, KeepsOneSide) {
    const SceneWithLog street = remove_actors(example());
    EXPECT_EQ(tracks(street), std::vector<std::string>{""});
    EXPECT_EQ(street.scene.surfels.size(), 3u);
    EXPECT_EQ(street.log.boxes.size(), 1u) << "boxes without a model are not edited";
    const SceneWithLog cars = remove_background(example());
    EXPECT_EQ(tracks(cars), (std::vector<std::string>{"", "van", "car"}));
    EXPECT_EQ(model_of(cars, 0).second, 0u);
    EXPECT_EQ(model_of(cars, 1), std::make_pair(100.0f, 2u));
    EXPECT_EQ(model_of(cars, 2), std::make_pair(200.0f, 4u));
    EXPECT_EQ(cars.scene.surfels.size(), 6u);
}

TEST(Edit, UnknownTracksNameTheNearest) {
    const auto message = [](const std::string& track) {
        return error_message<UsageError>([&] { move_track(example(), track, {}); });
    };
    EXPECT_THAT(message("vam"), test::Names("\"van\" ... van, car"));
    EXPECT_THAT(message("walker"), test::Names("background"));
    EXPECT_THAT(message("walker"), test::Names("init.actor_tracks = van,car,walker"));
    EXPECT_THAT(message(""), test::Names("track")) << "the background is no track";
    EXPECT_THAT(error_message<UsageError>([] { remove_track(remove_actors(example()), "van"); }),
                test::Names("actors"));
    const std::string stranger =
        error_message<UsageError>([] { insert_track(example(), example(), "bus", {}); });
    EXPECT_THAT(stranger, test::Names("(actors")) << "nothing resembles it: " << stranger;
    SceneWithLog boxless = example();
    boxless.log.boxes.clear();
    EXPECT_THAT(error_message<DataError>([&] { move_track(boxless, "van", {}); }), test::Names("box"));
}

using EditedRun = TemporaryFolder;

TEST_F(EditedRun, IsSavedAndLoadedLikeAnyOther) {
    for (const SceneWithLog& d :
         {copy_track(example(), "van", {}), remove_background(example()), remove_actors(example())}) {
        relidar::Run run{folder / "run", make_preset("quick"), d.log, {{0}, {1}},
                         d.scene,        {{"/a", "--copy"}}};
        for (glm::vec4& q : run.scene.surfels.rotation) q = {1, 0, 0, 0};
        run.log.lidars[0].sensor.beams = {{0.0}};
        run.log.lidars[0].sensor.columns = 4;
        for (const Frame& f : run.log.frames) run.log.world_from_vehicle.append(f.time_s, {});
        save_run(run);
        const relidar::Run read = load_run(run.folder);
        EXPECT_EQ(tracks({read.scene, read.log}), tracks(d));
        EXPECT_EQ(read.scene.surfels.mean, d.scene.surfels.mean);
    }
}

/// A cube of 2 m passes a LiDAR at the origin at 10 m on the left. The LiDAR has 200
/// beams from -30 to 30 degrees and 3600 columns.
SceneWithLog make_passing_cube(std::uint32_t n_surfels) {
    SceneWithLog d;
    d.scene.surfels.resize(n_surfels);
    d.scene.models = {{"background", 0, 0, {}}, {"cube", 0, n_surfels, {1, 1, 1}}};
    d.scene.instances = {{0, ""}, {1, "cube"}};
    SpinningSensor& sensor = d.log.lidars[0].sensor;
    for (int i = 0; i < 200; ++i) sensor.beams.push_back({(30.0 - 60.0 * (i + 0.5) / 200.0) * kPi / 180.0});
    sensor.columns = 3600;
    BoxTrack cube{"cube", "Car", {2, 2, 2}, {}};
    for (int i = 0; i < 11; ++i) {
        d.log.frames.push_back({i, 0.1 * i, {}});
        d.log.world_from_vehicle.append(0.1 * i, {});
        cube.world_from_box.append(0.1 * i, {{1, 0, 0, 0}, {double(i) * 4.0 - 20.0, 10.0, 0.0}});
    }
    d.log.boxes = {cube};
    return d;
}

TEST(ActorDetail, CountsTheRaysThatMeetTheBoxWhereItIsNearest) {
    const ActorModelResolution detail = model_resolution(make_passing_cube(500), "cube");
    EXPECT_DOUBLE_EQ(detail.nearest_m, 10.0);
    EXPECT_NEAR(detail.time_s, 0.5, 1e-12);
    EXPECT_EQ(detail.surfels, 500u);
    // The near face of 2 x 2 m at 9 m hides the remaining faces.
    double expected = 0.0;
    for (int column = 0; column < 3600; ++column) {
        const double azimuth = (column + 0.5) * 2.0 * kPi / 3600.0 - kPi;
        if (std::abs(azimuth) < std::atan(1.0 / 9.0))
            expected += 2.0 * std::atan(std::cos(azimuth) / 9.0) / (60.0 * kPi / 180.0 / 200.0);
    }
    EXPECT_NEAR(double(detail.rays), expected, 0.02 * expected);
}

TEST(ActorDetail, OfGivenRaysThoseAreCountedWhoseLinesMeetTheBox) {
    const glm::vec3 ahead(1.0f, 0.0f, 0.0f), across(0.0f, 1.0f, 0.0f);
    const std::vector<glm::vec3> direction{ahead, ahead, ahead, -ahead, across}, origin{{0.0f, 0.0f, 0.0f},
                                                                                        {0.0f, 0.9f, 0.0f},
                                                                                        {0.0f, 1.1f, 0.0f},
                                                                                        {0.0f, 0.0f, 0.0f},
                                                                                        {10.0f, -3.0f, 0.0f}};
    const Pose box_from_sensor = inverse(Pose{make_rotation(0.5 * kPi, 0.0, 0.0), {10.0, 0.0, 0.0}});
    const ActorModelResolution detail =
        model_resolution(origin, direction, box_from_sensor, {2.0, 2.0, 1.0}, 7);
    EXPECT_EQ(detail.rays, 3u) << "two ahead and one from the side; one passes by, one goes the other way";
    EXPECT_DOUBLE_EQ(detail.nearest_m, 10.0);
    EXPECT_EQ(detail.surfels, 7u);
    EXPECT_EQ(model_resolution(origin, direction, {}, {30.0, 30.0, 30.0}, 7).rays, 5u) << "from within";
}

TEST(ActorDetail, IsSparseWhereFewSurfelsMeetManyRays) {
    const std::size_t rays = model_resolution(make_passing_cube(1), "cube").rays;
    EXPECT_TRUE(model_resolution(make_passing_cube(std::uint32_t(rays / 10)), "cube").is_too_coarse());
    EXPECT_FALSE(model_resolution(make_passing_cube(std::uint32_t(rays)), "cube").is_too_coarse());
}

TEST(ActorDetail, OfOneThatIsNeverThereNothingIsClaimed) {
    SceneWithLog d = make_passing_cube(5);
    for (double& t : d.log.boxes[0].world_from_box.time_s) t += 100.0;
    EXPECT_EQ(model_resolution(d, "cube").rays, 0u);
    EXPECT_FALSE(model_resolution(d, "cube").is_too_coarse());
    EXPECT_THROW(model_resolution(d, "van"), UsageError);
}

}  // namespace

}  // namespace relidar
