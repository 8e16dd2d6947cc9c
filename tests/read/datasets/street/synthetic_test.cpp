// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <gtest/gtest.h>

#include "base/random.hpp"
#include "read/datasets/street/street.hpp"
#include "support/logs.hpp"
#include "support/rig_street.hpp"

namespace relidar {
namespace {

using test::Names;

namespace fs = std::filesystem;

StreetOptions small() { return {.n_frames = 5, .rows = 16, .columns = 256}; }

RayTable make_one_ray(const glm::vec3& direction) {
    RayTable rays;
    rays.rows = rays.columns = 1;
    rays.origin = {{0, 0, 0}};
    rays.direction = {direction};
    rays.time_offset_s = {0.0f};
    rays.channel = {0};
    return rays;
}

TEST(Synthetic, GroundLiesAtHeightOverSineOfTheElevation) {
    const StreetOptions options = small();
    // The origin of relidar's world is the sensor in the middle frame, at a height of 1.8
    // m.
    const PoseTrack level{{0.2}, {Pose{}}};
    for (const double elevation : {-0.8, -0.5, -0.4}) {
        const glm::vec3 d(0.0f, std::cos(elevation), std::sin(elevation));
        const Scan scan = cast_street_rays(options, make_one_ray(d), level, 0.2);
        EXPECT_NEAR(scan.range_m[0], 1.8 / std::sin(-elevation), 1e-5);
        EXPECT_GT(scan.intensity[0], 0.05f);
    }
    EXPECT_EQ(cast_street_rays(options, make_one_ray({0, 0, 1}), level, 0.2).range_m[0], 0.0f);
}

std::vector<SyntheticCar> make_street_cars(const StreetOptions& options) {
    std::vector<SyntheticCar> cars;
    for (const BoxTrack& box : make_street_log(options).boxes) cars.push_back({cars.size(), box});
    return cars;
}

TEST(Synthetic, StreetCastAgainWithItsOwnCarsIsTheSame) {
    const StreetOptions options = small();
    const Log street = make_street_log(options);
    const RayTable rays = make_rays(street.lidars[0].sensor);
    const Scan plain = cast_street_rays(options, rays, street.world_from_vehicle, 0.3),
               again =
                   cast_street_rays(options, make_street_cars(options), rays, street.world_from_vehicle, 0.3);
    std::size_t on_cars = 0;
    const Scan without = cast_street_rays(options, {}, rays, street.world_from_vehicle, 0.3);
    for (std::size_t i = 0; i < rays.size(); ++i) {
        ASSERT_NEAR(plain.range_m[i], again.range_m[i], 1e-4);
        on_cars += std::abs(plain.range_m[i] - without.range_m[i]) > 0.01f;
    }
    EXPECT_GT(on_cars, 20u) << "the cars must be seen";
}

/// The sensor at the height of a car's body, 0.6 m above the ground.
const PoseTrack kLowSensor{{0.2}, {Pose{{1, 0, 0, 0}, {0, 0, -1.2}}}};
/// In the middle frame, the centre of the leading car is 12 m ahead of the sensor.
constexpr double kRear_m = 12.0 - 0.5 * 4.3;

TEST(Synthetic, EditedCarsAreMetWhereTheirTracksPutThem) {
    const auto range_ahead = [](const std::vector<SyntheticCar>& cars, double time_s) {
        return cast_street_rays(small(), cars, make_one_ray({1, 0, 0}), kLowSensor, time_s).range_m[0];
    };
    std::vector<SyntheticCar> cars{make_street_cars(small())[0]};
    for (Pose& pose : cars[0].track.world_from_box.pose) pose.translation.x -= 4.0;
    EXPECT_NEAR(range_ahead(cars, 0.2), kRear_m - 4.0, 1e-4);
    for (double& time_s : cars[0].track.world_from_box.time_s) time_s += 1.0;
    EXPECT_EQ(range_ahead(cars, 0.2), range_ahead({}, 0.2)) << "later: not there yet";
    EXPECT_NEAR(range_ahead(cars, 1.2), kRear_m - 4.0, 1e-4);
    cars[0].shapes_of = 2;
    EXPECT_THROW(range_ahead(cars, 0.2), DataError);
}

TEST(Synthetic, MovingCarIsMetWhereItsSpeedPutsIt) {
    const auto range_of = [](const RayTable& rays, double time_s) {
        return cast_street_rays(small(), rays, kLowSensor, time_s).range_m[0];
    };
    constexpr double t = 0.05, kSpeed_mps = 1.05 * 8.0;  // faster than the sensor
    RayTable ahead = make_one_ray({1, 0, 0});
    EXPECT_NEAR(range_of(ahead, 0.2), kRear_m, 1e-5);
    EXPECT_NEAR(range_of(ahead, 0.2 + t), kRear_m + kSpeed_mps * t, 1e-5);
    ahead.time_offset_s[0] = float(t);
    EXPECT_NEAR(range_of(ahead, 0.2), kRear_m + kSpeed_mps * t, 1e-5);
}

TEST(Synthetic, SameSeedSameLog) {
    const Log a = make_street_log(small()), b = make_street_log(small());
    StreetOptions other = small();
    other.seed = 2;
    const Log c = make_street_log(other);
    for (std::size_t f = 0; f < a.frames.size(); ++f) {
        EXPECT_EQ(a.frames[f].scan.range_m, b.frames[f].scan.range_m);
        EXPECT_EQ(a.frames[f].scan.intensity, b.frames[f].scan.intensity);
    }
    EXPECT_NE(a.frames[0].scan.range_m, c.frames[0].scan.range_m);
}

TEST(Synthetic, LogAgreesWithTheCastUpToNoiseAndDrops) {
    StreetOptions options = small();
    options.range_noise_m = 0.0;
    const Log log = make_street_log(options);
    EXPECT_NEAR(glm::length(log.world_from_vehicle.pose[2].translation), 0.0, 1e-12);
    for (const Frame& frame : log.frames) {
        const Scan exact = cast_street_rays(options, frame.scan.rays, log.world_from_vehicle, frame.time_s);
        std::size_t agree = 0;
        for (std::size_t i = 0; i < exact.range_m.size(); ++i) {
            const bool hit = exact.range_m[i] > 0.0f, measured = frame.scan.range_m[i] > 0.0f;
            agree += hit == measured;
            if (!hit || !measured) continue;
            ASSERT_FLOAT_EQ(exact.range_m[i], frame.scan.range_m[i]);
        }
        EXPECT_GT(agree, exact.range_m.size() * 9 / 10);
        EXPECT_LT(exact.count_returns(), exact.range_m.size());
    }
}

TEST(Synthetic, TakesPosesFromAFileAndBoxesGoAlong) {
    const test::LogFolder files("relidar_synthetic_poses");
    const fs::path& folder = files.folder;
    save_street(small(), folder);
    const Log exact = files.load();
    const fs::path file = folder / "poses.txt";
    {
        std::ofstream out(file);
        out.precision(17);
        // The positions are equal except that the world of the street is offset by 0.5 m
        // to the left.
        for (const Pose& pose : exact.world_from_vehicle.pose) {
            const glm::dmat4 m = to_matrix(pose);
            const glm::dvec3 t = pose.translation + exact.world_offset_m + glm::dvec3(0.0, 0.5, 0.0);
            for (int r = 0; r < 3; ++r)
                out << m[0][r] << ' ' << m[1][r] << ' ' << m[2][r] << ' ' << t[r] << (r == 2 ? '\n' : ' ');
        }
    }
    const Log moved = files.load({.poses_file = file});
    const auto expect_moved = [](const PoseTrack& from, const PoseTrack& to) {
        ASSERT_EQ(from.pose.size(), to.pose.size());
        for (std::size_t k = 0; k < from.pose.size(); ++k)
            EXPECT_LT(
                glm::length(to.pose[k].translation - from.pose[k].translation - glm::dvec3(0.0, 0.5, 0.0)),
                1e-9);
    };
    expect_moved(exact.world_from_vehicle, moved.world_from_vehicle);
    for (std::size_t b = 0; b < exact.boxes.size(); ++b)
        expect_moved(exact.boxes[b].world_from_box, moved.boxes[b].world_from_box);
    EXPECT_EQ(exact.frames[2].scan.range_m, moved.frames[2].scan.range_m);
}

TEST(Synthetic, SizesAreBoundedByTheirProductToo) {
    const test::LogFolder files("relidar_synthetic_sizes");
    const fs::path& folder = files.folder;
    fs::create_directories(folder);
    std::ofstream(folder / "street.toml") << "n_frames = 10000\nrows = 256\ncolumns = 8192\n";
    files.expect_error("street.toml ... 10000 ... 2097152 ... 2.1e+10");
    EXPECT_EQ(files.load({.frames = {0, 1}}).frames.size(), 1u);
    std::string dots = "a";
    for (int i = 0; i < 40000; ++i) dots += ".a";
    for (const std::string& text : {dots + " = 1\n", "[" + dots + "]\nx = 1\n"}) {
        std::ofstream(folder / "street.toml") << text;
        EXPECT_THROW(files.load(), DataError);
    }
}

StreetOptions make_rig_street() {
    StreetOptions options{.n_frames = 4, .range_noise_m = 0.0};
    options.rig = test::write_rig(fs::path(testing::TempDir()) / "relidar_synthetic_rig");
    return options;
}

TEST(SyntheticRig, EachLidarSeesTheStreetFromWhereItIsMounted) {
    const StreetOptions options = make_rig_street();
    const Log log = make_street_log(options);
    ASSERT_EQ(log.lidars.size(), 4u);
    ASSERT_EQ(log.frames.size(), 16u);
    EXPECT_EQ(log.world_from_vehicle.pose.size(), 4u) << "a pose for each sweep";
    for (const Frame& frame : log.frames) {
        const Lidar& lidar = log.lidar_of(frame);
        const PoseTrack track = log.lidar_track(frame.lidar);
        EXPECT_EQ(frame.scan.rays.direction, make_lidar_rays(lidar, frame.time_s).direction) << lidar.name;
        const Scan truth = frame.lidar == test::kTwoReturns
                               ? cast_street_beams(options, frame.scan.rays, track, frame.time_s,
                                                   log.lidar_of(frame).sensor.max_range_m)
                               : cast_street_rays(options, frame.scan.rays, track, frame.time_s);
        std::size_t n = 0;
        for (std::size_t i = 0; i < truth.range_m.size(); ++i) {
            if (!(truth.range_m[i] > 0.0f && frame.scan.range_m[i] > 0.0f)) continue;
            ASSERT_NEAR(frame.scan.range_m[i], truth.range_m[i], 1e-5) << lidar.name << " ray " << i;
            ++n;
        }
        EXPECT_GT(n, truth.range_m.size() / 2) << lidar.name;
    }
    EXPECT_NE(log.frames[test::kRosette].scan.rays.direction,
              log.frames[4 + test::kRosette].scan.rays.direction);
    EXPECT_TRUE(log.frames[0].scan.second_returns.empty());
}

TEST(SyntheticRig, SecondReturnsLieOnSurfacesThatExactRaysOfTheBeamMeet) {
    const StreetOptions options = make_rig_street();
    const Log log = make_street_log(options);
    const Frame& frame = log.frames[test::kTwoReturns];
    ASSERT_EQ(frame.scan.second_returns.size(), 1u);
    const PoseTrack track = log.lidar_track(frame.lidar);
    std::size_t n = 0, met = 0;
    for (std::size_t i = 0; i < frame.scan.range_m.size() && n < 200; ++i) {
        const float second_m = frame.scan.second_returns[0].range_m[i];
        if (second_m == 0.0f) continue;
        ++n;
        EXPECT_GE(std::abs(second_m - frame.scan.range_m[i]), 0.4f)
            << "means of returns whose nearest parts are 0.5 m apart";
        RayTable fan = make_one_ray(frame.scan.rays.direction[i]);  // 20 x 20 directions of the cone
        fan.time_offset_s.clear();
        fan.origin.clear();
        fan.channel.clear();
        fan.direction.clear();
        const glm::vec3 d = frame.scan.rays.direction[i],
                        side = glm::normalize(glm::cross(d, glm::vec3(0, 0, 1)));
        const glm::vec3 up = glm::cross(side, d);
        for (int k = 0; k < 400; ++k) {
            const float u = (float(k % 20) - 9.5f) / 10.0f, v = (float(k / 20) - 9.5f) / 10.0f;
            fan.direction.push_back(glm::normalize(d + 4.5e-3f * (u * side + v * up)));
            fan.origin.emplace_back(0.0f);
            fan.time_offset_s.push_back(frame.scan.rays.time_offset_s[i]);
            fan.channel.push_back(0);
        }
        fan.columns = 400;
        const Scan scan = cast_street_rays(options, fan, track, frame.time_s);
        const auto [low, high] = std::ranges::minmax(scan.range_m);
        const bool has_similar_range =
            std::ranges::any_of(scan.range_m, [&](float r) { return std::abs(r - second_m) < 0.3f; });
        // mean range of a slope
        met +=
            has_similar_range || (low < second_m && second_m < high && high - low > 2.0f && second_m > 10.0f);
    }
    EXPECT_GE(n, 100u);
    EXPECT_GE(met, n * 98 / 100);
}

TEST(SyntheticRig, IsSavedByItsFileAndLidarsAreChosenByName) {
    const test::LogFolder files("relidar_synthetic_rig_log");
    const fs::path& folder = files.folder;
    const StreetOptions options = make_rig_street();
    save_street(options, folder);
    EXPECT_EQ(load_street(folder).rig, options.rig);
    const Log all = files.load();
    const Log two = files.load({.lidars = {"wide", "front"}});
    ASSERT_EQ(two.lidars.size(), 2u);
    EXPECT_EQ(two.lidars[0].name, "front") << "in the order of the log";
    ASSERT_EQ(two.frames.size(), 8u);
    EXPECT_EQ(two.frames[1].scan.range_m, all.frames[3].scan.range_m);
    EXPECT_EQ(two.world_from_vehicle.time_s, all.world_from_vehicle.time_s);
    EXPECT_THAT(two.notes, testing::Contains(Names("top, flower")));
    EXPECT_THAT(test::find_load_error(folder.string(), {.lidars = {"top", "roof"}}),
                Names("\"roof\" ... top, front, flower, wide"));
    std::ofstream(folder / "street.toml") << "rig = \"street.toml\"\n";
    files.expect_error("rig");
}

TEST(Synthetic, BeamsOfTwoReturnsNeedADivergence) {
    EXPECT_THROW(cast_street_beams(small(), make_one_ray({1, 0, 0}), {{0.2}, {Pose{}}}, 0.2, 80.0),
                 UsageError);
}

TEST(Synthetic, BeamsOfOneTableAreCastWithTheirOwnCones) {
    const StreetOptions options = small();
    const PoseTrack track{{0.2}, {make_street_log(options).lidar_track(0).pose_at(0.2)}};
    RayTable narrow = make_rays(WindowScanSensor{.name = "",
                                                 .rows = 12,
                                                 .columns = 30,
                                                 .left_rad = 1.0,
                                                 .right_rad = -1.0,
                                                 .top_rad = 0.05,
                                                 .bottom_rad = -0.1});
    RayTable wide = narrow, mixed = narrow;
    narrow.divergence_rad = 1e-3f;
    wide.divergence_rad = 0.03f;
    for (std::size_t i = 0; i < mixed.size(); ++i) mixed.ray_divergence_rad.push_back(i % 2 ? 0.03f : 1e-3f);
    const auto cast = [&](const RayTable& rays) {
        return cast_street_beams(options, rays, track, 0.2, 80.0);
    };
    const Scan a = cast(narrow), b = cast(wide), both = cast(mixed);
    std::size_t differ = 0;
    for (std::size_t i = 0; i < mixed.size(); ++i) {
        EXPECT_EQ(both.range_m[i], (i % 2 ? b : a).range_m[i]) << i;
        EXPECT_EQ(both.second_returns[0].range_m[i], (i % 2 ? b : a).second_returns[0].range_m[i]) << i;
        differ += a.range_m[i] != b.range_m[i];
    }
    EXPECT_GT(differ, mixed.size() / 2);
}

TEST(Synthetic, BoxesHoldTheReturnsOfTheMovingCars) {
    StreetOptions with = small(), without = small();
    with.range_noise_m = without.range_noise_m = 0.0;
    without.moving_cars = false;
    const Log log = make_street_log(with), empty = make_street_log(without);
    ASSERT_EQ(log.boxes.size(), 2u);
    EXPECT_TRUE(empty.boxes.empty());
    std::size_t on_cars = 0;
    for (std::size_t f = 0; f < log.frames.size(); ++f) {
        const Scan &scan = log.frames[f].scan, &bare = empty.frames[f].scan;
        for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
            const double t = log.frames[f].time_s + double(scan.rays.time_offset_s[i]);
            const glm::dvec3 world = log.world_from_vehicle.pose_at(t) * glm::dvec3(scan.return_point(i));
            const bool changed = scan.range_m[i] > 0.0f && scan.range_m[i] != bare.range_m[i];
            on_cars += changed;
            if (scan.range_m[i] == 0.0f) continue;
            ASSERT_EQ(changed, is_in_moving_box(log.boxes, world, t, 0.0)) << f << " " << i;
        }
    }
    EXPECT_GT(on_cars, 50u);
}

TEST(Synthetic, SavedAndLoadedAgain) {
    const test::LogFolder files("relidar_street");
    const fs::path& folder = files.folder;
    StreetOptions options = small();
    options.seed = 99;
    options.speed_mps = 6;
    options.people = options.gait = true;
    save_street(options, folder);
    EXPECT_EQ(detect_kind(folder), "synthetic");
    EXPECT_THROW(files.load({.sequence = "kd1"}), UsageError) << "a street is one drive";
    EXPECT_THROW(load_log("synthetc:" + folder.string(), {}), UsageError);
    EXPECT_THROW(load_log((folder / "none").string(), {}), DataError);
    EXPECT_THROW(load_log("synthetic:" + (folder / "none").string(), {}), DataError);
    const Log made = make_street_log(options);
    DatasetOptions range{.frames = {1, 3}};
    const Log read = load_log("synthetic:" + folder.string(), range);
    ASSERT_EQ(read.frames.size(), 2u);
    EXPECT_EQ(read.frames[1].index, 2);
    EXPECT_EQ(read.world_offset_m, made.world_offset_m);
    const Scan original = files.load().frames[2].scan;
    EXPECT_EQ(original.range_m, made.frames[2].scan.range_m);
    EXPECT_TRUE(read.rolling_shutter);
    range.rolling_shutter = false;
    EXPECT_FALSE(files.load(range).rolling_shutter)
        << "the setting must reach initialisation and training, not rendering alone";
    range.frames = {5, 9};
    EXPECT_THROW(files.load(range), UsageError);
}

TEST(Synthetic, WrongFilesAreNamed) {
    const test::LogFolder files("relidar_wrong_street");
    const fs::path& folder = files.folder;
    fs::create_directories(folder);
    const auto message = [&](const std::string& text) {
        std::ofstream(folder / "street.toml") << text;
        return test::find_load_error(folder.string());
    };
    EXPECT_THAT(message("row = 16\n"), Names("street.toml line 1: unknown key 'row' ... 'rows'"));
    EXPECT_THAT(message("rows = 1\n"), Names("rows ... 1 ... 2 ... 256"));
    EXPECT_THAT(message("range_noise_m = nan\n"), Names("range_noise_m ... nan"));
    EXPECT_THAT(message("speed_mps = \"fast\"\n"), Names("line 1 ... speed_mps ... type"));
    EXPECT_THAT(message("n_frames = 0\n"), Names("n_frames ... 0"));
    EXPECT_THAT(message("gait = true\n"), Names("gait = true ... people = true"));
    EXPECT_THAT(message("rows = \n"), Names("street.toml line 1 ... malformed"));
    // These numbers cannot be converted to an integer. Fuzzing detected the error.
    for (const char* real : {"16.0", "4.4e38", "-1e308", "nan"})
        EXPECT_THAT(message(std::string("rows = ") + real + "\n"), Names("street.toml line 1 ... rows"));
    StreetOptions options;
    options.columns = 0;
    EXPECT_THROW(make_street_log(options), UsageError);
}

class SyntheticPeople : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(GaitPhaseWindow, SyntheticPeople, testing::Bool());

TEST_P(SyntheticPeople, AreMetInTheirBoxes) {
    StreetOptions options = {
        .n_frames = 5, .rows = 64, .columns = 512, .range_noise_m = 0.0, .people = true, .gait = GetParam()};
    const Log street = make_street_log(options);
    options.people = options.gait = false;
    EXPECT_EQ(make_street_log(options).boxes.size(), 2u);
    std::vector<std::string> categories;
    for (const BoxTrack& box : street.boxes) categories.push_back(box.category);
    EXPECT_THAT(categories,
                testing::ElementsAre("Car", "Car", "Pedestrian", "Pedestrian", "Pedestrian", "Cyclist"));
    for (const std::size_t person : {2u, 5u}) {
        std::size_t inside = 0;
        const Frame& frame = street.frames[2];
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
            if (frame.scan.range_m[ray] > 0.0f) {
                const WorldReturn w = locate_return(street, frame, ray);
                inside += street.boxes[person].contains_point(w.point_m, w.time_s, 0.01);
            }
        EXPECT_GT(inside, 10u) << categories[person];
    }
}

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
        street::ActorPoses poses;
        const std::optional<street::StreetHit> hit = caster.find_first_hit(ray, t_s, 20.0, poses);
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
