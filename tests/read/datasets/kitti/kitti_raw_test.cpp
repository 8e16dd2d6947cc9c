// SPDX-License-Identifier: Apache-2.0
// Also reads drive 2011_09_26_drive_0005_sync if RELIDAR_KITTI_DRIVE names its folder.
#include <relidar/read/dataset.hpp>

#include <cstdlib>
#include <cstring>
#include <fstream>

#include <fmt/format.h>

#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

using test::KittiDrive;

TEST(KittiRaw, RecoversTheSensorFromItsScans) {
    const KittiDrive drive("sensor");
    const Log log = drive.load();
    EXPECT_EQ(log.lidars[0].sensor.columns, KittiDrive::kFirings);
    EXPECT_NEAR(log.lidars[0].sensor.period_s, 0.1, 1e-9);
    ASSERT_EQ(log.lidars[0].sensor.beams.size(), 64u);
    for (std::size_t k = 0; k < 64; ++k) {
        const Beam &fitted_beam = log.lidars[0].sensor.beams[k], &truth = drive.beams[k];
        EXPECT_NEAR(fitted_beam.elevation_rad, truth.elevation_rad, 1e-4) << k;
        EXPECT_NEAR(fitted_beam.origin_up_m / std::cos(fitted_beam.elevation_rad),
                    truth.origin_up_m / std::cos(truth.elevation_rad), 1e-3)
            << k;
        EXPECT_NEAR(fitted_beam.azimuth_offset_rad, truth.azimuth_offset_rad, 2e-4) << k;
        EXPECT_NEAR(fitted_beam.origin_left_m, truth.origin_left_m, 1e-3) << k;
    }
}

TEST(KittiRaw, EveryPointAndEveryDropHasItsRay) {
    const KittiDrive drive("rays");
    const Log log = drive.load();
    const Scan& scan = log.frames[0].scan;
    ASSERT_EQ(scan.rays.rows, 64);
    ASSERT_EQ(scan.rays.columns, KittiDrive::kFirings);
    EXPECT_EQ(scan.count_returns(), drive.n_points);
    std::vector<glm::dvec3> model;
    for (std::size_t i = 0; i < scan.rays.size(); ++i) {
        if (scan.range_m[i] > 0.0f) continue;
        model.emplace_back(scan.rays.direction[i]);
        EXPECT_EQ(scan.intensity[i], 0.0f);
    }
    ASSERT_EQ(model.size(), drive.dropped.size());
    for (const glm::dvec3& truth : drive.dropped) {
        double nearest = 1.0;
        for (const glm::dvec3& d : model) nearest = std::min(nearest, glm::length(d - truth));
        ASSERT_LT(nearest, 3e-4);  // a step is 9e-3
    }
    // The time of a ray must follow from the encoder position. The column of a ray must
    // follow from its azimuth.
    for (std::size_t i = 0; i < scan.rays.size(); ++i) {
        const double azimuth = std::atan2(scan.rays.direction[i].y, scan.rays.direction[i].x);
        const double head = azimuth - log.lidars[0].sensor.beams[scan.rays.channel[i]].azimuth_offset_rad;
        const double late = std::remainder(scan.rays.time_offset_s[i] + head / (2 * kPi) * 0.1, 0.1);
        ASSERT_LT(std::abs(late), 2e-4);  // the left offset turns a ray by 26 mm divided by its range
        const double column_azimuth =
            kPi - (double(i % KittiDrive::kFirings) + 0.5) * 2 * kPi / KittiDrive::kFirings;
        ASSERT_LT(std::abs(std::remainder(azimuth - column_azimuth, 2 * kPi)), 0.03);
    }
}

TEST(KittiRaw, WithoutEncoderTicksStepsAreEven) {
    const KittiDrive even("even", test::Heads::even), jittered("jittered", test::Heads::jittered);
    Log log = even.load();
    EXPECT_EQ(log.lidars[0].sensor.columns, KittiDrive::kFirings);
    EXPECT_EQ(log.frames[0].scan.count_returns(), even.n_points);
    log = jittered.load();
    EXPECT_NEAR(log.lidars[0].sensor.columns, KittiDrive::kFirings, 15);
    EXPECT_GT(double(log.frames[0].scan.count_returns()), 0.99 * double(jittered.n_points));
}

TEST(KittiRaw, LaserWithoutReturnsInOneScan) {
    const KittiDrive drive("ring");
    const std::string original = test::read_text(drive.scan(1));
    std::size_t end = 16;  // first ring: until the azimuth wraps
    const auto y = [&](std::size_t at) {
        float v;
        std::memcpy(&v, original.data() + at + 4, 4);
        return v;
    };
    while (!(y(end - 16) < 0.0f && y(end) >= 0.0f)) end += 16;
    test::write_text(drive.scan(1), original.substr(end));
    const Scan scan = drive.load().frames[1].scan;
    EXPECT_EQ(scan.count_returns(), (original.size() - end) / 16);
    for (int c = 0; c < KittiDrive::kFirings; ++c) EXPECT_EQ(scan.range_m[std::size_t(c)], 0.0f);
}

/// Distance of a frame to the next one in Mercator coordinates: s R dlon with s = cos 60.
const double kStep_m = 0.5 * 6378137.0 * 1e-5 * kPi / 180;

TEST(KittiRaw, PosesTimesAndBoxes) {
    const KittiDrive drive("poses");
    const Log log = drive.load();
    ASSERT_EQ(log.frames.size(), 3u);
    EXPECT_NEAR(log.frames[2].time_s, 0.2, 1e-9);  // across midnight and New Year
    EXPECT_EQ(log.start_unix_ns, 1325375999850000000) << "2011-12-31 23:59:59.85";
    EXPECT_THAT(log.conventions, testing::HasSubstr("zone"));
    // The view of camera 2: f = 721.54, centre 609.56 of 1242 columns.
    ASSERT_TRUE(log.labelled_azimuth);
    EXPECT_NEAR(log.labelled_azimuth->left_rad, std::atan(609.56 / 721.54), 2e-3);
    EXPECT_NEAR(log.labelled_azimuth->right_rad, -std::atan((1241 - 609.56) / 721.54), 2e-3);
    const PoseTrack& track = log.world_from_vehicle;
    EXPECT_NEAR(track.pose[1].translation.x, 0.0, 1e-9);
    EXPECT_LT(glm::distance(track.pose[2].translation, track.pose[1].translation + glm::dvec3(kStep_m, 0, 0)),
              1e-6);
    // The sensor is at -T = (0.8, -0.3, 0.8) in the frame of the car. The car is rotated
    // a quarter turn to the left.
    EXPECT_LT(glm::distance(log.world_offset_m, glm::dvec3(kStep_m + 0.3, 0.8, 0.8)), 1e-6);
    ASSERT_EQ(log.boxes.size(), 1u);
    const BoxTrack& box = log.boxes[0];
    EXPECT_EQ(box.category, "Van");
    EXPECT_EQ(box.size_m, glm::dvec3(4.4, 1.8, 2.0));
    ASSERT_EQ(box.world_from_box.pose.size(), 2u);
    EXPECT_DOUBLE_EQ(box.world_from_box.time_s[0], log.frames[1].time_s);
    // (10, 2, -1.5 + h/2) in the sensor frame of frame 1
    const glm::dvec3 centre = box.world_from_box.pose[0].translation;
    EXPECT_NEAR(glm::length(centre - glm::dvec3(-2, 10, -0.5)), 0.0, 1e-6);
    const glm::dvec3 ahead = box.world_from_box.pose[0].rotation * glm::dvec3(1, 0, 0);
    EXPECT_NEAR(std::atan2(ahead.y, ahead.x), kPi / 2 + 0.5, 1e-9);
}

TEST(KittiRaw, KnowsItsPlaceOnTheEarth) {
    if (!has_proj()) GTEST_SKIP() << "built without PROJ";
    const Log log = KittiDrive("place").load({.frames = {1, -1}});
    ASSERT_TRUE(log.georeference);
    // The IMU is at T in the frame of the sensor.
    const glm::dvec3 imu_m =
        log.world_from_vehicle.pose[1] * glm::dvec3(-0.8, 0.3, -0.8) + log.world_offset_m;
    const GeoConverter earth(*log.georeference);
    EXPECT_NE(earth.wkt(), "") << "the world has the coordinates of the projection";
    const GeodeticPosition found = earth.to_geodetic(imu_m);
    EXPECT_NEAR(found.latitude_deg, 60.0, 1e-10);
    EXPECT_NEAR(found.longitude_deg, 8.0 + 2e-5, 1e-10);
    EXPECT_NEAR(found.height_m, 100.5, 1e-6);
}

TEST(KittiRaw, PosesFileInTumOrder) {
    const KittiDrive drive("tum");
    const auto write = [&](const char* order) {  // drives to the north
        std::string text;
        for (int k = -10; k < 30; ++k) text += fmt::format("{} 5 {} 0 {}\n", 0.1 * k, 0.8 * k, order);
        test::write_text(drive.file("poses.txt"), text);
    };
    const DatasetOptions options{.poses_file = drive.file("poses.txt")};
    for (const char* order : {"0 0 0.70710678 0.70710678", "0.70710678 0 0 0.70710678"}) {
        write(order);
        const Log log = drive.load(options);
        const Pose pose = log.world_from_vehicle.pose[2];
        EXPECT_NEAR(glm::distance(pose.rotation * glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0)), 0.0, 1e-6);
        EXPECT_NEAR(glm::distance(pose.translation + log.world_offset_m, glm::dvec3(5, 1.6, 0)), 0.0, 0.1);
        const auto used = std::ranges::find(log.conventions_used, "quaternions", &UsedConvention::name);
        ASSERT_NE(used, log.conventions_used.end());
        EXPECT_EQ(used->value, order[0] == '0' && order[2] == '0' ? "x y z w" : "w x y z");
    }
}

TEST(KittiRaw, PosesFileFrameRangeAndMissingScans) {
    const KittiDrive drive("range");
    fs::remove(drive.scan(1));
    fs::remove(drive.file("tracklet_labels.xml"));
    const auto poses = drive.file("poses.txt");
    test::write_text(poses, "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n0 -1 0 5 1 0 0 6 0 0 1 7\n");
    drive.expect_error("missing (1)", {.poses_file = poses, .allow_missing_scans = false});
    const Log log = drive.load({.poses_file = poses});
    ASSERT_EQ(log.frames.size(), 2u);
    EXPECT_EQ(log.frames[1].index, 2);
    EXPECT_NEAR(log.frames[1].time_s, 0.2, 1e-9);
    EXPECT_TRUE(log.boxes.empty());
    EXPECT_EQ(log.world_offset_m, glm::dvec3(5, 6, 7));
    EXPECT_FALSE(log.georeference) << "the poses are those of the user";
    const glm::dvec3 x = log.world_from_vehicle.pose[1].rotation * glm::dvec3(1, 0, 0);
    EXPECT_NEAR(x.y, 1.0, 1e-12);
    EXPECT_EQ(drive.load({.frames = {2, -1}, .poses_file = poses}).frames.size(), 1u);
}

void erase_lines(const fs::path& path, const std::vector<std::size_t>& numbers) {
    const std::string original = test::read_text(path);
    std::string text, line;
    std::istringstream lines(original);
    for (std::size_t n = 0; std::getline(lines, line); ++n)
        text += (std::find(numbers.begin(), numbers.end(), n) == numbers.end() ? line : "") + "\n";
    test::write_text(path, text);
}

// As in drive 0009, scans are missing and their lines in the timestamp files are empty,
// but their OXTS files exist.
TEST(KittiRaw, LoadsADriveWithoutSomeOfItsScans) {
    const KittiDrive drive("drive0009");
    fs::remove(drive.scan(1));
    for (const char* name : {"timestamps.txt", "timestamps_start.txt", "timestamps_end.txt"})
        erase_lines(drive.file(std::string("velodyne_points/") + name), {1});
    const Log log = drive.load();
    ASSERT_EQ(log.frames.size(), 2u);
    EXPECT_EQ(log.frames[1].index, 2);
    EXPECT_NEAR(log.frames[1].time_s - log.frames[0].time_s, 0.2, 1e-9);
    EXPECT_NEAR(log.lidars[0].sensor.period_s, 0.1, 1e-9);
    EXPECT_THAT(log.notes, testing::Contains(test::Names("1 ... 0 ... 2 ... (1)")));
    // frames are missing, so the number of a frame differs from its index; the pose must
    // be read from the OXTS file with the frame's number
    EXPECT_NEAR(log.world_from_vehicle.pose[1].translation.x - log.world_from_vehicle.pose[0].translation.x,
                2 * kStep_m, 1e-6);
    ASSERT_EQ(log.boxes.size(), 1u);
    ASSERT_EQ(log.boxes[0].world_from_box.pose.size(), 1u);  // labelled in frames 1 and 2
    EXPECT_DOUBLE_EQ(log.boxes[0].world_from_box.time_s[0], log.frames[1].time_s);
}

TEST(KittiRaw, TimesAreCountedFromTheFirstLineThatHasOne) {
    const KittiDrive drive("headless");
    fs::remove(drive.scan(0));
    for (const char* name : {"timestamps.txt", "timestamps_start.txt", "timestamps_end.txt"})
        erase_lines(drive.file(std::string("velodyne_points/") + name), {0});
    const Log log = drive.load();
    EXPECT_NEAR(log.frames[0].time_s, 0.0, 1e-9);
    EXPECT_NEAR(log.frames[1].time_s, 0.1, 1e-9);
    EXPECT_EQ(log.start_unix_ns, 1325375999950000000);
}

TEST(KittiRaw, CalibrationBesideAboveOrInItsArchive) {
    for (const char* calibration_path :
         {"calib_imu_to_velo.txt", "calib/calib_imu_to_velo.txt",
          "../2011_12_31_calib/2011_12_31/calib_imu_to_velo.txt", "../../calib_imu_to_velo.txt"}) {
        const KittiDrive drive("calibration_places");
        const glm::dvec3 usual = drive.load().world_offset_m;
        const std::string text = test::read_text(drive.calibration());
        fs::remove(drive.calibration());
        test::write_text(drive.file(calibration_path), text);
        EXPECT_EQ(drive.load().world_offset_m, usual) << calibration_path;
    }
}

/// The camera looks along the x axis of the LiDAR and is 6 cm to the left of camera 0.
TEST(KittiRaw, CamerasAreThoseOfItsCalibration) {
    const KittiDrive drive("cameras");
    EXPECT_TRUE(drive.load().cameras.empty());
    const auto write = [&](const std::string& p2) {
        test::write_text(drive.file("../calib_velo_to_cam.txt"),
                         "calib_time: 15-Mar-2012 11:37:16\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n");
        test::write_text(
            drive.file("../calib_cam_to_cam.txt"),
            "calib_time: 09-Jan-2012 13:57:47\nS_rect_02: 1.242e+03 375\nR_rect_00: 1 0 0 0 1 0 0 0 1\n" +
                p2);
    };
    write("P_rect_02: 700 0 600 42 0 710 170 0 0 0 1 0\n");
    const Log log = drive.load();
    ASSERT_EQ(log.cameras.size(), 1u);
    const Camera& camera = log.cameras[0];
    EXPECT_EQ(camera.name, "image_2");
    EXPECT_EQ(camera.columns, 1242);
    EXPECT_EQ(camera.rows, 375);
    EXPECT_LT(glm::distance(camera.rig_from_camera.translation, glm::dvec3(0.27, 0.06, -0.08)), 1e-12);
    const glm::dvec3 in_camera_m = inverse(camera.rig_from_camera) * glm::dvec3(10.27, 1.06, 0.92);
    EXPECT_LT(glm::distance(*camera.project(in_camera_m), glm::dvec2(530.0, 99.0)), 1e-9);
    write("P_rect_02: 0 0 600 42 0 710 170 0 0 0 1 0\n");
    drive.expect_error("calib_cam_to_cam.txt ... camera 2 ... 0 ... 710");
}

TEST(KittiRaw, WithoutPosesAndTracklets) {
    const KittiDrive drive("no_poses");
    const Log original = drive.load();
    fs::remove_all(drive.file("oxts"));
    fs::remove(drive.calibration());
    const DatasetOptions options{.poses_file = kNoPoses};
    Log log = drive.load(options);
    EXPECT_THAT(log.notes, testing::Contains(test::Names("poses ... read")));
    for (std::size_t i = 0; i < 3; ++i) {
        EXPECT_EQ(log.world_from_vehicle.pose[i].translation, glm::dvec3(0.0));
        EXPECT_EQ(log.world_from_vehicle.pose[i].rotation, glm::dquat(1, 0, 0, 0));
        EXPECT_EQ(log.world_from_vehicle.time_s[i], original.world_from_vehicle.time_s[i]);
        EXPECT_EQ(log.frames[i].scan.range_m, original.frames[i].scan.range_m);
    }
    EXPECT_EQ(log.boxes[0].world_from_box.pose[0].translation, glm::dvec3(10, 2, -0.5));  // as labelled
    set_trajectory(log, original.world_from_vehicle);
    for (std::size_t k = 0; k < 2; ++k)
        EXPECT_NEAR(glm::distance(log.boxes[0].world_from_box.pose[k].translation,
                                  original.boxes[0].world_from_box.pose[k].translation),
                    0.0, 1e-9);
    fs::remove(drive.file("tracklet_labels.xml"));
    log = drive.load(options);
    EXPECT_THAT(log.notes, testing::Contains(test::Names("tracklet_labels.xml ... missing")));
    EXPECT_TRUE(log.boxes.empty());
    EXPECT_FALSE(log.labelled_azimuth);
}

class KittiRawReal : public testing::Test {
protected:
    void SetUp() override {
        if (!folder) GTEST_SKIP() << "RELIDAR_KITTI_DRIVE names no KITTI raw drive";
    }
    const char* folder = std::getenv("RELIDAR_KITTI_DRIVE");
};

TEST_F(KittiRawReal, Drive) {
    const Log log = load_log(folder, {.frames = {0, 12}});
    EXPECT_NEAR(log.lidars[0].sensor.columns, 2152, 10);
    EXPECT_NEAR(log.lidars[0].sensor.beams[0].elevation_rad * 180 / kPi, 1.94, 0.02);
    EXPECT_NEAR(log.lidars[0].sensor.beams[63].elevation_rad * 180 / kPi, -25.0, 0.05);
    const RayTable nominal = make_rays(log.lidars[0].sensor);
    for (const Frame& frame : log.frames) {
        const Scan& scan = frame.scan;
        ASSERT_EQ(scan.rays.size(), nominal.size());
        double elevation_error = 0.0;
        for (std::size_t i = 0; i < scan.rays.size(); ++i)
            if (scan.range_m[i] > 5.0f)
                elevation_error = std::max<double>(
                    elevation_error, std::abs(scan.rays.direction[i].z - nominal.direction[i].z));
        EXPECT_LT(elevation_error, 5e-4) << "frame " << frame.index;
        EXPECT_NEAR(double(scan.count_returns()) / double(scan.rays.size()), 0.875, 0.075);
    }
}

std::vector<glm::vec3> read_file_points(const fs::path& file, float max_range_m,
                                        std::vector<float>& intensity) {
    std::vector<glm::vec4> records(fs::file_size(file) / sizeof(glm::vec4));
    const auto n_bytes = std::streamsize(records.size() * sizeof(glm::vec4));
    std::ifstream(file, std::ios::binary).read(reinterpret_cast<char*>(records.data()), n_bytes);
    std::vector<glm::vec3> points;
    for (const glm::vec4& r : records)
        if (glm::length(glm::vec3(r)) < max_range_m) {
            points.emplace_back(r);
            intensity.push_back(r.w);
        }
    return points;
}

std::size_t count_missing(const std::vector<glm::vec3>& points, std::vector<glm::vec3> others) {
    constexpr float kSame_m = 1e-3f;
    std::ranges::sort(others, {}, &glm::vec3::x);
    return std::size_t(std::ranges::count_if(points, [&](const glm::vec3& point) {
        for (auto o = std::ranges::lower_bound(others, point.x - kSame_m, {}, &glm::vec3::x);
             o != others.end() && o->x <= point.x + kSame_m; ++o)
            if (glm::distance(*o, point) <= kSame_m) return false;
        return true;
    }));
}

TEST_F(KittiRawReal, ScansKeepTheirPointsOnTheNativeGrid) {
    const Log log = load_log(folder, {.frames = {0, 12}});
    std::size_t all = 0, lost_native = 0, lost_grid = 0;
    for (const Frame& frame : log.frames) {
        const fs::path file =
            fs::path(folder) / "velodyne_points/data" / (fmt::format("{:010}.bin", frame.index));
        std::vector<float> intensity;
        const std::vector<glm::vec3> points = read_file_points(file, 79.9f, intensity);
        std::vector<glm::vec3> scan_points;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
            if (frame.scan.range_m[i] > 0.0f) scan_points.push_back(frame.scan.return_point(i));
        const ProjectedRangeImage grid = project_points(kitti360_grid(), points, intensity);
        all += points.size();
        lost_native += count_missing(points, std::move(scan_points));
        lost_grid +=
            points.size() - std::size_t(std::ranges::count_if(grid.source, [](int s) { return s >= 0; }));
    }
    EXPECT_LE(double(lost_native), 1e-3 * double(all));
    EXPECT_GT(lost_grid, lost_native);
}

/// The setting render.follow_sweeps needs this property: if the nominal rays of each
/// firing are rotated together, they equal the rays of the scan, including dropped rays.
TEST_F(KittiRawReal, ScansHaveOneAzimuthAFiring) {
    const Log log = load_log(folder, {.frames = {40, 44}});
    for (const Frame& frame : log.frames) {
        const SpinningSensor& sensor = log.lidar_of(frame).sensor;
        const RayTable nominal = make_rays(sensor),
                       turned = rotate_firings(nominal, sensor, frame.azimuth_shift_rad);
        std::vector<float> followed;
        for (std::size_t i = 0; i < nominal.size(); ++i)
            followed.push_back(glm::length(turned.direction[i] - frame.scan.rays.direction[i]));
        const auto share = [](std::vector<float>& values, double at) {
            std::ranges::sort(values);
            return double(values[std::size_t(at * double(values.size() - 1))]);
        };
        const double column_rad = 2.0 * kPi / sensor.columns;
        EXPECT_LT(share(followed, 0.5), 0.05 * column_rad);
        EXPECT_LT(share(followed, 0.99), 0.2 * column_rad);
    }
}

}  // namespace
}  // namespace relidar
