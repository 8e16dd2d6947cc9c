// SPDX-License-Identifier: Apache-2.0
// Tests placing actors on the ground: on an exact slope, below a roof, next to a wall,
// and on the synthetic street, whose ground height has a closed form.
#include <cmath>

#include <relidar/read/dataset.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/run/run.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using test::Names;

constexpr double kAlong = 0.1, kAcross = -0.05;  // slopes: z = 0.1 x - 0.05 y
const glm::dvec3 kSlopeNormal = glm::normalize(glm::dvec3(-kAlong, -kAcross, 1.0));
const glm::dvec3 kWorldOffset_m{1000.0, -50.0, 200.0};

void add_surfel(Surfels& surfels, const glm::dvec3& mean, const glm::dvec3& normal) {
    const std::size_t i = surfels.size();
    surfels.resize(i + 1);
    const glm::dvec3 up(0.0, 0.0, 1.0), axis = glm::cross(up, normal);
    const glm::dquat q = glm::length(axis) < 1e-9 ? glm::dquat(1, 0, 0, 0)
                                                  : glm::angleAxis(std::acos(normal.z), glm::normalize(axis));
    surfels.mean[i] = mean;
    surfels.rotation[i] = {q.w, q.x, q.y, q.z};
    surfels.opacity_logit[i] = 2.0f;
}

glm::dquat rotation_to_slope() {
    const glm::dvec3 up(0.0, 0.0, 1.0);
    return glm::angleAxis(std::acos(kSlopeNormal.z), glm::normalize(glm::cross(up, kSlopeNormal)));
}

double compute_slope_height(double x, double y) { return kAlong * x + kAcross * y; }

/// The surfels of the slope are 0.25 m apart, with noise of 2 cm. The van drives uphill
/// with its box 0.2 m above the slope.
SceneWithLog make_slope() {
    SceneWithLog d;
    int n = 0;
    for (double x = -20.0; x <= 20.0; x += 0.25)
        for (double y = -10.0; y <= 10.0; y += 0.25)
            add_surfel(d.scene.surfels, {x, y, compute_slope_height(x, y) + 0.02 * std::sin(12.9898 * ++n)},
                       kSlopeNormal);
    const auto background = static_cast<std::uint32_t>(d.scene.surfels.size());
    add_surfel(d.scene.surfels, {0, 0, 0}, {0, 0, 1});
    d.scene.models = {{"background", 0, background, {}}, {"van", background, 1, {2.0f, 1.0f, 0.8f}}};
    d.scene.instances = {{0, ""}, {1, "van"}};
    d.log.world_offset_m = kWorldOffset_m;
    BoxTrack van{"van", "Van", {4.0, 2.0, 1.6}, {}};
    for (int i = 0; i < 5; ++i) {
        const double time_s = 0.1 * i, x = -8.0 + i, z = compute_slope_height(x, 0.0);
        d.log.frames.push_back({i, time_s, {}});
        d.log.world_from_vehicle.append(time_s,
                                        {glm::angleAxis(0.3, glm::dvec3(0, 0, 1)), {x, 0.0, z + 1.8}});
        van.world_from_box.append(time_s, {{1, 0, 0, 0}, glm::dvec3(x, 0.0, z) + 1.0 * kSlopeNormal});
    }
    d.log.boxes = {van};
    return d;
}

/// Replaces the background. The van's surfel is the last one.
void set_background(SceneWithLog& d, Surfels background) {
    const auto n = static_cast<std::uint32_t>(background.size());
    background.append_surfels(d.scene.surfels.slice(d.scene.models[0].count, 1));
    d.scene.surfels = std::move(background);
    d.scene.models[0].count = d.scene.models[1].first = n;
}

NewActorMotion place_on_ground(const SceneWithLog& driving, const GroundPlacement& place,
                               const std::string& track) {
    return stand_on_ground({driving.scene, driving.log}, place, {driving.scene, driving.log}, track);
}

Pose placed(const SceneWithLog& driving, double x, double y, std::optional<double> yaw_rad = {}) {
    NewActorMotion start =
        place_on_ground(driving, {{x + kWorldOffset_m.x, y + kWorldOffset_m.y}, yaw_rad, 3.0}, "van");
    EXPECT_EQ(start.speed_mps, 3.0);
    start.dataset_from_box.translation -= kWorldOffset_m;
    return start.dataset_from_box;
}

void expect_on_slope(const Pose& pose, double x, double y, double yaw_rad) {
    EXPECT_NEAR(pose.translation.x, x, 1e-9);
    EXPECT_NEAR(pose.translation.y, y, 1e-9);
    const glm::dvec3 ground(x, y, compute_slope_height(x, y));
    EXPECT_NEAR(glm::dot(kSlopeNormal, pose.translation - ground), 1.0, 0.02)
        << "half a height of 0.8 m and 0.2 m above the ground";
    const glm::dvec3 up = pose.rotation * glm::dvec3(0, 0, 1), ahead = pose.rotation * glm::dvec3(1, 0, 0);
    EXPECT_GT(glm::dot(up, kSlopeNormal), std::cos(0.01)) << up.x << " " << up.y << " " << up.z;
    EXPECT_NEAR(std::remainder(std::atan2(ahead.y, ahead.x) - yaw_rad, 2.0 * kPi), 0.0, 1e-6);
}

TEST(Ground, GivesHeightAndTiltOfASlope) {
    const SceneWithLog d = make_slope();
    expect_on_slope(placed(d, 6.0, 3.0, 2.0), 6.0, 3.0, 2.0);
    expect_on_slope(placed(d, -4.0, -5.0, -1.0), -4.0, -5.0, -1.0);
    expect_on_slope(placed(d, 6.0, 3.0), 6.0, 3.0, 0.3);  // same heading as the recording vehicle
}

TEST(Ground, PathFollowsAHill) {
    const auto hill = [](double value) { return 0.004 * value * value; };  // slope 0.16 after 20 m
    SceneWithLog d = make_slope();
    for (std::uint32_t i = 0; i < d.scene.models[0].count; ++i) {
        glm::vec3& mean = d.scene.surfels.mean[i];
        mean.z += float(hill(mean.x) - compute_slope_height(mean.x, mean.y));
        d.scene.surfels.rotation[i] = {1, 0, 0, 0};
    }
    for (int i = 0; i < 5; ++i) d.log.frames[std::size_t(i)].time_s = i;
    GroundPlacement placement{{kWorldOffset_m.x - 16.0, kWorldOffset_m.y}, 0.0, 10.0};
    placement.clearance_m = 0.0;
    const NewActorMotion start = place_on_ground(d, placement, "van");
    ASSERT_EQ(start.dataset_path.pose.size(), 5u);
    const SceneWithLog edited = copy_track(d, "van", start);
    const BoxTrack* copy = find_box(edited.log, "van-copy-1");
    ASSERT_NE(copy, nullptr);
    for (int i = 0; i < 4; ++i) {
        const Pose pose = copy->world_from_box.pose_at(i);
        const double x = -16.0 + 10.0 * i, climb = 0.008 * x;
        EXPECT_NEAR(pose.translation.x, x, 1e-9);
        // A plane that is fitted to 4.5 m of a parabola is 0.7 cm above the middle of the
        // parabola on average.
        EXPECT_NEAR(pose.translation.z, hill(x) + 0.8 * std::sqrt(1.0 + climb * climb), 0.03) << i;
        const glm::dvec3 ahead = pose.rotation * glm::dvec3(1, 0, 0);
        EXPECT_NEAR(ahead.z / std::hypot(ahead.x, ahead.y), climb, 0.01) << i;
    }
    // The last pose is at x = 24 m, but the hill ends at 20 m.
    EXPECT_NEAR(start.unseen_m, 10.0, 1e-9);
}

TEST(Ground, IsAsFarBelowAnActorAsItIsKnownToBe) {
    const SceneWithLog d = make_slope();
    const SceneWithLog alone = remove_background(d);  // an asset does not contain any ground
    EXPECT_NEAR(ground_clearance({d.scene, d.log}, "van").value_or(-1.0), 0.2, 0.02);
    EXPECT_FALSE(ground_clearance({alone.scene, alone.log}, "van"));
    EXPECT_THROW(ground_clearance({d.scene, d.log}, "nobody"), UsageError);
    for (const double clearance_m : {0.0, 0.5}) {
        GroundPlacement placement{{6.0 + kWorldOffset_m.x, 3.0 + kWorldOffset_m.y}, 0.0};
        placement.clearance_m = clearance_m;
        const NewActorMotion start =
            stand_on_ground({d.scene, d.log}, placement, {alone.scene, alone.log}, "van");
        const glm::dvec3 above = start.dataset_from_box.translation - kWorldOffset_m -
                                 glm::dvec3(6.0, 3.0, compute_slope_height(6.0, 3.0));
        EXPECT_NEAR(glm::dot(kSlopeNormal, above), 0.8 + clearance_m, 0.02);
    }
}

TEST(Ground, IsNeitherARoofNorAWallNorWhatIsFaint) {
    SceneWithLog d = make_slope();
    Surfels others;
    for (double x = 2.0; x <= 10.0; x += 0.1)
        for (double y = -1.0; y <= 7.0; y += 0.1) {
            add_surfel(others, {x, y, compute_slope_height(x, y) + 6.0}, {0, 0, 1});  // a bridge
            if (y > 4.0) add_surfel(others, {x, 4.0, compute_slope_height(x, 4.0) + (y - 4.0)}, {0, 1, 0});
            add_surfel(others, {x, y, compute_slope_height(x, y) + 0.8}, {0, 0, 1});  // haze
            others.opacity_logit.back() = -6.0f;
        }
    Surfels all = d.scene.surfels.slice(0, d.scene.models[0].count);
    all.append_surfels(others);
    set_background(d, std::move(all));
    expect_on_slope(placed(d, 6.0, 3.0, 0.0), 6.0, 3.0, 0.0);
}

TEST(Ground, IsNotTiltedByAFewSurfelsOfWhatStoodThere) {
    SceneWithLog d = make_slope();
    // surfels of rings of a distant sweep at intervals of 1 m or more, and of the side of
    // a passing car
    Surfels rings;
    for (const double x : {-2.0, -1.0, 0.6, 1.2})
        for (const double y : {-0.9, -0.6, -0.3, 0.0}) add_surfel(rings, {x, y, 0.0}, {0, 0, 1});
    add_surfel(rings, {0.6, 0.3, 0.07}, {0, 0, 1});
    add_surfel(rings, {0.6, 0.5, 0.16}, {0, 0, 1});
    set_background(d, std::move(rings));
    const Pose pose = placed(d, 0.0, 0.0, 0.0);
    EXPECT_NEAR(pose.translation.z, 0.8, 0.02)
        << "no ground where it drove itself: the box's bottom lies on the plane";
    EXPECT_GT((pose.rotation * glm::dvec3(0, 0, 1)).z, std::cos(0.02))
        << "least squares over all of them would tilt it by 0.06";
}

/// Replaces the surfels of the slope below a car by those of its roof and its bonnet.
void park_car(SceneWithLog& d, double x_m, double y_m) {
    const std::uint32_t n = d.scene.models[0].count;
    Surfels background;
    const auto is_below = [&](const glm::vec3& p) {
        return std::abs(p.x - x_m) < 2.2 && std::abs(p.y - y_m) < 1.0;
    };
    for (std::size_t i = 0; i < n; ++i)
        if (!is_below(d.scene.surfels.mean[i])) background.append_surfels(d.scene.surfels.slice(i, 1));
    for (double x = x_m - 2.0; x <= x_m + 2.0; x += 0.1)
        for (double y = y_m - 0.8; y <= y_m + 0.8; y += 0.1)
            add_surfel(background, {x, y, compute_slope_height(x, y) + (x > x_m + 1.0 ? 0.8 : 1.4)},
                       kSlopeNormal);
    set_background(d, std::move(background));
}

TEST(Ground, IsNotAParkedCarInThePath) {
    for (const bool is_labelled : {false, true}) {
        SceneWithLog d = make_slope();
        park_car(d, 4.0, 2.0);
        if (is_labelled) {
            const Pose pose{rotation_to_slope(), {4.0, 2.0, compute_slope_height(4.0, 2.0) + 0.75}};
            d.log.boxes.push_back({"parked", "Car", {4.2, 1.8, 1.5}, {{0.0, 0.4}, {pose, pose}}});
        }
        // stands on the road below the parked car
        expect_on_slope(placed(d, 4.0, 2.0, 0.0), 4.0, 2.0, 0.0);
        for (const double yaw_rad : {0.0, kPi, 0.5}) {
            const glm::dvec2 ahead(std::cos(yaw_rad), std::sin(yaw_rad)),
                from = glm::dvec2(4.0, 2.0) - 8.0 * ahead;
            const NewActorMotion motion =
                place_on_ground(d, {from + glm::dvec2(kWorldOffset_m), yaw_rad, 40.0}, "van");
            ASSERT_EQ(motion.dataset_path.pose.size(), 5u);
            for (const Pose& pose : motion.dataset_path.pose) {
                const glm::dvec3 p = pose.translation - kWorldOffset_m;
                expect_on_slope({pose.rotation, p}, p.x, p.y, yaw_rad);
            }
        }
    }
}

/// Surfels of the background that are at most half_m from a place in the dataset's world.
template <class Visit>
void visit_near(const SceneWithLog& d, const glm::dvec2& dataset_m, const glm::dvec2& half_m,
                const Visit& visit) {
    for (std::size_t i = 0; i < d.scene.models[0].count; ++i) {
        const glm::dvec3 p = glm::dvec3(d.scene.surfels.mean[i]) + d.log.world_offset_m;
        if (glm::all(glm::lessThan(glm::abs(glm::dvec2(p) - dataset_m), half_m))) visit(i, p.z);
    }
}

/// The road of the street is at z = 0. The parked cars stand 1.1 m from the kerb. The log
/// does not observe the road below the car whose roof has most surfels.
constexpr double kParkedY_m = -3.3;

SceneWithLog make_street_scene(int n_frames) {
    SceneWithLog d;
    d.log = make_street_log({.n_frames = n_frames, .rows = 32, .columns = 512});
    InitOptions options;
    options.actor_min_points = 10;
    d.scene = init_scene(d.log, split_frames(d.log, 0).train, options);
    return d;
}

TEST(Ground, HasNoStepAtAParkedCarOfTheStreet) {
    SceneWithLog d = make_street_scene(12);
    std::size_t most = 0;
    glm::dvec2 parked_m(0.0);
    for (double x = -12.0; x <= 12.0; x += 0.5) {
        std::size_t n_roof = 0;
        visit_near(d, {x, kParkedY_m}, {1.0, 0.8},
                   [&](std::size_t, double z) { n_roof += z > 1.2 && z < 1.6; });
        if (n_roof > most) parked_m = {x, kParkedY_m};
        most = std::max(most, n_roof);
    }
    ASSERT_GT(most, 30u) << "no car is parked here";
    visit_near(d, parked_m, {4.0, 1.8}, [&](std::size_t i, double z) {
        if (z < 0.3) d.scene.surfels.opacity_logit[i] = -20.0f;
    });
    const PoseTrack path{{0.0, 3.0},
                         {{.translation = {parked_m - glm::dvec2(12.0, 0.0), 0.0}},
                          {.translation = {parked_m + glm::dvec2(12.0, 0.0), 0.0}}}};
    const SceneWithLogView view{d.scene, d.log};
    const BoxTrack& car = d.log.boxes.front();
    const NewActorMotion motion = follow_ground(view, path, 0.0, view, car.id);
    for (const Pose& pose : motion.dataset_path.pose)
        EXPECT_NEAR(pose.translation.z, 0.5 * car.size_m.z, 0.05) << pose.translation.x - parked_m.x;
    EXPECT_GT(motion.unseen_m, 1.0) << "nothing hides the road";
}

std::vector<std::string> ids_of(const Notes& notes) {
    std::vector<std::string> ids;
    for (const Note& note : notes) ids.push_back(note.id);
    return ids;
}

TEST(Placement, NotesGapsAndOverlaps) {
    const SceneWithLog d = make_slope();
    const auto notes_of = [](const SceneWithLog& edited, const std::string& track) {
        return check_placement({edited.scene, edited.log}, {track});
    };
    EXPECT_EQ(notes_of(d, "van"), Notes{}) << "0.2 m above the slope";
    const SceneWithLog high = move_track(d, "van", {{1, 0, 0, 0}, {0.0, 0.0, 0.2}});
    EXPECT_EQ(ids_of(notes_of(high, "van")), std::vector<std::string>{"floating"});
    EXPECT_THAT(notes_of(high, "van").at(0).text, Names("van ... 0.4"));
    // The copy stands 5 m ahead of the start of the van, which drives 1 m per frame: its
    // 4 m long box reaches the copy in frame 2 and is 1 m inside the copy in the last.
    const Pose start = d.log.boxes[0].world_from_box.pose[0];
    NewActorMotion ahead{{start.rotation, start.translation + glm::dvec3(6.5, 0.0, 0.65) + kWorldOffset_m}};
    const SceneWithLog crash = copy_track(d, "van", ahead);
    const Notes notes = notes_of(crash, "van-copy-1");
    ASSERT_EQ(ids_of(notes), std::vector<std::string>{"overlap"});
    EXPECT_THAT(notes[0].text, Names("van-copy-1 ... van ... 0.30 ... 0.40"));
    EXPECT_EQ(ids_of(check_placement({crash.scene, crash.log}, {"van-copy-1", "van"})),
              std::vector<std::string>{"overlap"})
        << "one note for two placed actors";
    SceneWithLog parked = d;  // a car at the start of the van, with a label at the end
    BoxTrack car = d.log.boxes[0];
    car.id = "parked";
    car.world_from_box = {{car.world_from_box.time_s.back()}, {start}};
    parked.log.boxes.push_back(car);
    EXPECT_EQ(ids_of(notes_of(parked, "van")), std::vector<std::string>{"overlap"});
}

/// The true share of the van's box without 0.1 m at its sides that is in the solid of
/// park_car(), more than 0.3 m above the ground: the mean over a grid of points.
double share_in_parked_car(const Pose& world_from_box, double car_x_m, double car_y_m) {
    constexpr int kSteps = 40;
    int n = 0, n_inside = 0;
    for (int i = 0; i < kSteps * kSteps * kSteps; ++i) {
        const glm::dvec3 cell(i % kSteps, i / kSteps % kSteps, i / (kSteps * kSteps));
        const glm::dvec3 p =
            world_from_box * (((cell + 0.5) / double(kSteps) - 0.5) * glm::dvec3(3.8, 1.8, 1.6));
        const double height_m = p.z - compute_slope_height(p.x, p.y);
        if (height_m < 0.3) continue;
        ++n;
        n_inside += std::abs(p.x - car_x_m) < 2.0 && std::abs(p.y - car_y_m) < 0.8 &&
                    height_m < (p.x > car_x_m + 1.0 ? 0.8 : 1.4);
    }
    return double(n_inside) / n;
}

TEST(Placement, NotesTheShareInTheBackground) {
    SceneWithLog d = make_slope();
    park_car(d, 4.0, 2.0);
    Surfels background = d.scene.surfels.slice(0, d.scene.models[0].count);
    for (double x = -20.0; x < 20.0; x += 1.0)
        for (double y = -10.0; y < 10.0; y += 1.0) {
            add_surfel(background, {x, y, compute_slope_height(x, y) + 1.0}, {1, 0, 0});  // noise
            for (const double z : {0.5, 0.6, 0.7, 0.8}) {                                 // haze
                add_surfel(background, {x, y, compute_slope_height(x, y) + z}, {1, 0, 0});
                background.opacity_logit.back() = -2.0f;
            }
        }
    set_background(d, std::move(background));
    for (const glm::dvec2& place : {glm::dvec2(4.0, 2.0), glm::dvec2(5.0, 2.6), glm::dvec2(6.0, 1.2),
                                    glm::dvec2(4.0, -4.0), glm::dvec2(-7.0, -5.0)}) {
        const NewActorMotion start =
            place_on_ground(d, {glm::dvec2(kWorldOffset_m) + place, 0.2, 0.0, /*clearance_m=*/0.0}, "van");
        const SceneWithLog edited = copy_track(d, "van", start);
        const Pose pose{start.dataset_from_box.rotation, start.dataset_from_box.translation - kWorldOffset_m};
        const double share = share_in_parked_car(pose, 4.0, 2.0);
        std::string text;
        for (const Note& note : check_placement({edited.scene, edited.log}, {"van-copy-1"}))
            if (note.id == "background") text = note.text;
        EXPECT_EQ(text.empty(), share == 0.0) << place.x << " " << share << " " << text;
        if (text.empty()) continue;
        EXPECT_NEAR(0.01 * std::stod(text.substr(text.find("fills ") + 6)), share, 0.06) << place.x;
    }
}

class GroundOfBlocks : public TemporaryFolder {};

TEST_F(GroundOfBlocks, IsFoundInTheirFiles) {
    SceneWithLog full_slope = make_slope();
    park_car(full_slope, -10.0, -5.0);
    const std::uint32_t n = full_slope.scene.models[0].count;
    const auto block_file = folder / "model.safetensors";
    save_model(block_file, wrap_background(full_slope.scene.surfels.slice(0, n)));
    SceneWithLog d = full_slope;
    d.scene.surfels = full_slope.scene.surfels.slice(n, 1);
    d.scene.models[0].count = 0;
    d.scene.models[1].first = 0;
    d.scene.blocks.push_back({block_file, n, glm::vec3(-20, -10, -3), glm::vec3(20, 10, 3)});
    expect_on_slope(placed(d, 6.0, 3.0, 2.0), 6.0, 3.0, 2.0);
    const NewActorMotion in_car =
        place_on_ground(d, {glm::dvec2(kWorldOffset_m) + glm::dvec2(-10.0, -5.0), 0.0}, "van");
    const SceneWithLog edited = copy_track(d, "van", in_car);
    EXPECT_EQ(ids_of(check_placement({edited.scene, edited.log}, {"van-copy-1"})),
              std::vector<std::string>{"background"});
}

std::string refusal(const SceneWithLog& driving, const glm::dvec2& dataset_m,
                    const std::string& track = "van") {
    return error_message<UsageError>([&] { (void)place_on_ground(driving, {dataset_m}, track); });
}

TEST(Ground, SaysWhereThereIsNone) {
    const SceneWithLog d = make_slope();
    EXPECT_THAT(refusal(d, {1040.0, -50.0}), Names("van ... 1040,-50"));
    EXPECT_THAT(refusal(d, {1040.0, -50.0}), Names("20.0 m away"));
    EXPECT_NE(refusal(d, {1022.0, -50.0}), "") << "half of the van would hang over the edge";
    EXPECT_THAT(refusal(remove_background(d), {1000.0, -50.0}), Names("horizontal"));
    EXPECT_THAT(refusal(d, {1000.0, -50.0}, "vam"), Names("\"van\""));
}

TEST(Ground, BelowACarThatHidItIsWhereTheCarStands) {
    SceneWithLog d = make_slope();
    const auto n = static_cast<std::size_t>(d.scene.models[0].count);
    Surfels remaining_surfels;  // no surfels within 4.5 m of the van's start
    for (std::size_t i = 0; i < n; ++i)
        if (std::hypot(d.scene.surfels.mean[i].x + 8.0f, d.scene.surfels.mean[i].y) > 4.5f)
            remaining_surfels.append_surfels(d.scene.surfels.slice(i, 1));
    set_background(d, std::move(remaining_surfels));
    const Pose there = d.log.boxes[0].world_from_box.pose.front();
    const Pose pose = placed(d, there.translation.x, there.translation.y, 0.0);
    EXPECT_LT(glm::distance(pose.translation, there.translation), 0.1);
    EXPECT_NE(refusal(d, {kWorldOffset_m.x - 8.0, kWorldOffset_m.y + 1.6}), "");
}

TEST(Ground, OfTheStreetIsWhereItsCarsDrive) {
    const SceneWithLog d = make_street_scene(6);
    ASSERT_FALSE(d.log.boxes.empty());
    const BoxTrack& car = d.log.boxes.front();
    const glm::dvec3 there = car.world_from_box.pose.front().translation + d.log.world_offset_m;
    for (const glm::dvec2 beside : {glm::dvec2(0.0, 0.0), glm::dvec2(-6.0, 3.0), glm::dvec2(8.0, 0.0)}) {
        const Pose pose = place_on_ground(d, {glm::dvec2(there) + beside}, car.id).dataset_from_box;
        EXPECT_NEAR(pose.translation.z, there.z, 0.03) << beside.x << "," << beside.y;
        EXPECT_GT((pose.rotation * glm::dvec3(0, 0, 1)).z, std::cos(0.015)) << beside.x << "," << beside.y;
    }
}

}  // namespace
}  // namespace relidar
