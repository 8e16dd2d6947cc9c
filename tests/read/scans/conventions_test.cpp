// SPDX-License-Identifier: Apache-2.0
// Each convention: a log that is read rightly only if the user sets it.
#include "read/datasets/folder/point_log.hpp"

namespace relidar {
namespace {

using test::PointLog;

/// Poses of a vehicle that stands, which no motion can explain.
const Pose kStanding{make_rotation(0.5, 0.0, 0.0), {3.0, -4.0, 0.5}};

/// Writes a pose every 0.1 s: `numbers` after the time.
void write_standing(const PointLog& files, const std::string& numbers, double clock_s = 0.0) {
    std::string text;
    for (int k = -2; k < 8; ++k) text += fmt::format("{} {}\n", clock_s + 0.1 * k, numbers);
    test::write_text(files.folder / "poses.txt", text);
}

DatasetOptions with(const Conventions& set) { return {.conventions = set}; }

void expect_pose(const Log& log, const Pose& expected) {
    const Pose pose = log.world_from_vehicle.pose[1];
    EXPECT_LT(glm::distance(pose.translation + log.world_offset_m, expected.translation), 1e-9);
    EXPECT_NEAR(std::abs(glm::dot(pose.rotation, expected.rotation)), 1.0, 1e-9);
}

const UsedConvention& find_row(const Log& log, const std::string& name) {
    static const UsedConvention kNone{};
    const auto row = std::ranges::find(log.conventions_used, name, &UsedConvention::name);
    return row == log.conventions_used.end() ? kNone : *row;
}

std::string numbers_of(const glm::dvec3& t, std::initializer_list<double> rotation) {
    return fmt::format("{} {} {} {:.17g}", t.x, t.y, t.z, fmt::join(rotation, " "));
}

TEST(Conventions, OrderOfQuaternions) {
    const PointLog files("set_quaternions", "bin", test::bin, test::kRings);
    const auto& [q, t] = kStanding;
    write_standing(files, numbers_of(t, {q.x, q.y, q.z, q.w}));
    EXPECT_LT(std::abs(glm::dot(files.load().world_from_vehicle.pose[1].rotation, q)), 0.9);
    const Log log = files.load(with({.quaternions = Conventions::Quaternions::xyzw}));
    expect_pose(log, kStanding);
    EXPECT_EQ(find_row(log, "quaternions"),
              (UsedConvention{"quaternions", "x y z w", "setting", "conventions.quaternions"}));
}

TEST(Conventions, DirectionOfPoses) {
    const PointLog files("set_direction", "bin", test::bin, test::kRings);
    const auto [q, t] = inverse(kStanding);
    write_standing(files, numbers_of(t, {q.w, q.x, q.y, q.z}));
    expect_pose(files.load(), inverse(kStanding));
    expect_pose(files.load(with({.poses = Conventions::Poses::sensor_from_world})), kStanding);
}

TEST(Conventions, DirectionOfNamedPoses) {
    const PointLog files("set_named", "bin", test::bin, test::kRings);
    const auto [q, t] = inverse(kStanding);
    write_standing(files, numbers_of(t, {q.w, q.x, q.y, q.z}));
    const std::string text = test::read_text(files.folder / "poses.txt");
    test::write_text(files.folder / "poses.txt", "# time_s x y z qw qx qy qz\n" + text);
    expect_pose(files.load(), inverse(kStanding));
    expect_pose(files.load(with({.poses = Conventions::Poses::sensor_from_world})), kStanding);
    EXPECT_THROW(files.load(with({.quaternions = Conventions::Quaternions::xyzw})), UsageError);
}

TEST(Conventions, UnitOfAngles) {
    const PointLog files("set_angles", "bin", test::bin, test::kRings);
    write_standing(files, numbers_of(kStanding.translation, {0.0, 0.0, 0.5 * 180.0 / kPi}));
    expect_pose(files.load(with({.angles = Conventions::Angles::degrees})), kStanding);
}

TEST(Conventions, ClockOfPoses) {
    const PointLog files("set_clock", "bin", test::bin, test::kRings);
    const auto& [q, t] = kStanding;
    write_standing(files, numbers_of(t, {q.w, q.x, q.y, q.z}), -37.0);
    EXPECT_THROW(files.load(), DataError);
    expect_pose(files.load(with({.clock_offset_s = "37"})), kStanding);
    EXPECT_THROW(files.load(with({.clock_offset_s = "x"})), UsageError);
}

/// Points of a .npy file whose times have another unit and zero.
PointLog change_times(const std::string& name, double factor, double added_s) {
    const auto changed = [=](test::FilePoints points) {
        for (test::FilePoint& point : points) point.time_s = factor * (point.time_s + added_s);
        return test::npy(points);
    };
    return {name, "npy", changed,
            R"(, "columns": ["x", "y", "z", "intensity", "ring", "time"], "intensity_max": 1)"};
}

TEST(Conventions, TimesOfPoints) {
    const PointLog files = change_times("set_times", 1000.0, 0.0);
    const Log log =
        files.load(with({.time_unit = Conventions::TimeUnit::ms, .time_zero = Conventions::TimeZero::clock}));
    const test::Difference worst = test::measure_difference(log, files.street);
    EXPECT_LT(worst.point_m, 1e-4);
    EXPECT_LT(worst.time_s, 1e-6);
    EXPECT_EQ(find_row(log, "unit of point times").value, "ms");
    EXPECT_EQ(find_row(log, "zero of point times").from, kFromSetting);
}

TEST(Conventions, TheUnitAloneLeavesTheZeroToTheGuess) {
    const PointLog files = change_times("set_unit", 1e6, 1000.0);
    std::string frames;  // of a clock that started 1000 s ago
    for (int i = 0; i < 4; ++i)
        frames += fmt::format(R"({}{{"number": {}, "time_s": {:.1f}, "scan": "scans/{:02}.npy"}})",
                              i == 0 ? "" : ", ", i, 1000.0 + 0.1 * i, i);
    test::write_text(files.folder / "sequence.json",
                     R"({"format": "relidar log", "version": 1, "intensity_max": 1, "columns": ["x", "y", "z",
                         "intensity", "ring", "time"], "frames": [)" +
                         frames + "]}");
    for (const auto unit : {Conventions::TimeUnit::automatic, Conventions::TimeUnit::us}) {
        const Log log = files.load(with({.time_unit = unit}));
        EXPECT_LT(test::measure_difference(log, files.street).time_s, 1e-5);
        EXPECT_EQ(find_row(log, "zero of point times").from, "guess: times of some scans");
    }
}

TEST(Conventions, ScaleOfIntensities) {
    const auto percent = [](test::FilePoints points) {
        for (test::FilePoint& point : points) point.intensity *= 100.0f;
        return test::bin(points);
    };
    const PointLog files("set_intensity", "bin", percent, test::kRings);
    const Log log = files.load(with({.intensity_max = 100.0}));
    EXPECT_LT(test::measure_difference(log, files.street).intensity, 0.51 / 255.0);
    EXPECT_EQ(find_row(log, "intensity"),
              (UsedConvention{"intensity", "0 to 100", "setting", "conventions.intensity_max"}));
}

TEST(Conventions, OrderOfRings) {
    const auto reversed = [](test::FilePoints points) {
        for (test::FilePoint& point : points) point.ring = std::uint16_t(15 - point.ring);
        return test::bin(points);
    };
    PointLog files("set_rings", "bin", reversed, test::kRings);
    files.put_head(test::kRings + fmt::format(R"(, "lidars": [{{"sensor": {{{}, "columns": 360}}}}])",
                                              test::make_beams(files.street.lidars[0].sensor)));
    const Log log = files.load(with({.rings = Conventions::Rings::lowest_first}));
    EXPECT_LT(test::measure_difference(log, files.street).point_m, 1e-4);
    EXPECT_EQ(find_row(log, "ring 0").value, "lowest beam");
}

TEST(Conventions, MotionCompensation) {
    const PointLog files("set_deskew", "npy", test::npy,
                         R"(, "columns": ["x", "y", "z", "intensity", "ring", "time"], "intensity_max": 1,
                              "point_times": "absolute", "motion_compensated": true)");
    // The file says that raw points were compensated.
    EXPECT_GT(test::measure_difference(files.load(), files.street).point_m, 0.1);
    const Log log = files.load(with({.deskew = Conventions::Deskew::raw}));
    EXPECT_LT(test::measure_difference(log, files.street).point_m, 1e-4);
    EXPECT_TRUE(log.rolling_shutter);
}

TEST(Conventions, Boxes) {
    const PointLog files("set_boxes", "bin", test::bin, test::kRings);
    test::write_text(files.folder / "boxes.json",
                     R"({"boxes": [{"track": "a", "category": "Car", "frame": 1, "size": [4, 2, 1.5],
                         "position": [10, 5, 0.5], "yaw_deg": 30}]})");
    const auto load = [&](const Conventions& set) {
        const Log log = files.load(with(set));
        Pose pose = log.boxes[0].world_from_box.pose[0];
        pose.translation += log.world_offset_m;
        return std::pair(log.boxes[0].size_m, pose);
    };
    const auto [size_m, pose] = load({});
    const auto near = [&](const Pose& p, const glm::dvec3& t, double yaw_deg) {
        EXPECT_LT(glm::distance(p.translation, t), 1e-9);
        EXPECT_NEAR(std::abs(glm::dot(p.rotation, make_rotation(yaw_deg * kPi / 180.0, 0, 0))), 1.0, 1e-9);
    };
    near(pose, {10, 5, 0.5}, 30);
    near(load({.box_origin = Conventions::BoxOrigin::bottom}).second, {10, 5, 1.25}, 30);
    near(load({.box_axes = Conventions::BoxAxes::turned}).second, {10, 5, 0.5}, 120);
    near(load({.box_axes = Conventions::BoxAxes::mirrored_world}).second, {10, -5, 0.5}, -30);
    EXPECT_EQ(load({.box_axes = Conventions::BoxAxes::swapped}).first, glm::dvec3(2, 4, 1.5));
    // In the frame of the vehicle at the time of the label.
    const Pose vehicle = files.street.world_from_vehicle.pose[1];
    Pose local = inverse(vehicle) * pose;
    local.translation.y = -local.translation.y;
    const Pose mirrored = load({.box_axes = Conventions::BoxAxes::mirrored_vehicle}).second;
    EXPECT_LT(glm::distance((inverse(vehicle) * mirrored).translation, local.translation), 1e-9);
}

TEST(Conventions, ImagesOfRaysDefineTheirOwn) {
    const PointLog files("set_images", "bin", test::bin, test::kRings);
    const std::filesystem::path folder = test::make_fresh_folder_path("set_images_npz");
    save_folder(files.street, folder);
    for (const Conventions& set : {Conventions{.rings = Conventions::Rings::lowest_first},
                                   Conventions{.time_unit = Conventions::TimeUnit::us},
                                   Conventions{.time_zero = Conventions::TimeZero::clock}})
        EXPECT_THAT(test::find_load_error(folder.string(), with(set)), test::Names("no effect"));
}

TEST(Conventions, ASettingWithoutEffectIsAnError) {
    const PointLog files("set_nothing", "bin", test::bin, test::kRings);
    EXPECT_THAT(
        test::find_load_error(files.folder.string(), with({.quaternions = Conventions::Quaternions::xyzw})),
        test::Names("conventions.quaternions ... no effect ... auto"));
}

}  // namespace
}  // namespace relidar
