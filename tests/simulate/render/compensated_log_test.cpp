// SPDX-License-Identifier: Apache-2.0
// Tests scans of a run whose log is motion-compensated. A sensor drives towards a wall.
// The expected position of the wall follows from the path and the time of each point.
// Uses the sensor of the log and a different sensor.

#include <gmock/gmock.h>

#include <relidar/log/sensor_files.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/scan_files.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

using testing::HasSubstr;

constexpr double kWall_m = 10.0, kSpeed_mps = 30.0, kFirst_s = 5.0, kPeriod_s = 0.1;
constexpr double kTolerance_m = 2e-3;  // errors of a surfel's plane and of floats
constexpr int kScans = 3;

/// A wall across x, and a sensor that drives along x and passes the origin at kFirst_s.
Run make_run_towards_wall() {
    Run run;
    run.scene.surfels = test::make_plate({kWall_m, 0.0f, 0.0f}, glm::vec2(8.0f));
    run.scene.models = {{"background", 0, 1}};
    run.scene.instances = {{0, ""}};
    Log& log = run.log;
    log.lidars[0].sensor = {"own", {{0.2}, {0.0}, {-0.2}}, 96};
    log.lidars[0].sensor.first_azimuth_rad = kPi;
    log.rolling_shutter = false;
    for (int i = -1; i <= kScans; ++i) {
        const double time_s = kFirst_s + kPeriod_s * i;
        if (i >= 0 && i < kScans) log.frames.push_back({i, time_s, {}});
        log.world_from_vehicle.time_s.push_back(time_s);
        log.world_from_vehicle.pose.push_back(
            {{1, 0, 0, 0}, {kSpeed_mps * (time_s - kFirst_s) - 8.0, 0.0, 0.0}});
    }
    return run;
}

double compute_sensor_x(double time_s) { return kSpeed_mps * (time_s - kFirst_s) - 8.0; }

struct TimedPoint {
    glm::dvec3 position_m;
    double time_s;  ///< time of the log
};

class CompensatedLog : public test::DeviceTest {
protected:
    relidar::Run run = make_run_towards_wall();
    std::filesystem::path folder = std::filesystem::temp_directory_path() / "relidar-compensated-log";

    void TearDown() override {
        std::filesystem::remove_all(folder);
        DeviceTest::TearDown();
    }

    void write(const SimulatedSensor& sensor, bool deskew) {
        std::filesystem::remove_all(folder);
        std::filesystem::create_directories(folder);
        ScanOutputOptions format = default_options(run, sensor);
        format.formats = {"npz", "exr", "ply", "pcd", "mcap", "rosbag"};
        format.deskew = deskew;
        ScanRenderer renderer(device(), run);
        ScanFolderWriter scans(folder, format);
        for (const Frame& frame : run.log.frames)
            scans.write_scan(frame.index, renderer.render(sensor, frame.time_s));
        scans.finish();
    }
    std::string text(const char* name) const { return read_contents(folder / name); }

    std::vector<TimedPoint> points() const {
        const auto arrays = read_npz(folder / "frame_000000.npz");
        const auto values = [&](const char* name) { return find_array(arrays, name)->to_floats(); };
        const std::vector<float> range_m = values("median_range"), drop = values("drop_prob"),
                                 time_s = values("time"), origin_m = values("origin"),
                                 direction = values("directions");
        std::vector<TimedPoint> result;
        for (std::size_t i = 0; i < range_m.size(); ++i) {
            if (drop[i] >= 0.5f) continue;
            const auto vector = [&](const std::vector<float>& v) {
                return glm::dvec3(v[3 * i], v[3 * i + 1], v[3 * i + 2]);
            };
            result.push_back(
                {vector(origin_m) + double(range_m[i]) * vector(direction), kFirst_s + double(time_s[i])});
        }
        return result;
    }
    std::vector<glm::dvec3> points_of(const char* name, const std::string& end_of_header,
                                      std::size_t count) const {
        const std::string bytes = text(name);
        const std::size_t begin = bytes.find(end_of_header) + end_of_header.size(),
                          stride = (bytes.size() - begin) / count;
        std::vector<glm::dvec3> result;
        for (std::size_t i = 0; i < count; ++i)
            result.emplace_back(read_at<glm::vec3>(bytes, begin + i * stride));
        return result;
    }
    void expect_statements(bool deskewed) const {
        const char* frame = deskewed ? "sensor at time_s" : "sensor at each ray's firing time";
        EXPECT_THAT(text("frame_000000.ply"), HasSubstr(frame));
        EXPECT_THAT(text("frame_000000.pcd"), HasSubstr(frame));
        EXPECT_THAT(read_exr(folder / "frame_000000.exr").notes.at("points_in"), HasSubstr(frame));
        EXPECT_EQ(find_array(read_npz(folder / "frame_000000.npz"), "deskewed")->to_floats()[0],
                  deskewed ? 1.0f : 0.0f);
        EXPECT_THAT(text("scans.json"), HasSubstr(deskewed ? "\"deskewed\": true" : "\"deskewed\": false"));
        for (const char* recording : {"scans.mcap", "rosbag.mcap"})
            EXPECT_THAT(text(recording),
                        HasSubstr(deskewed ? "sensor at the stamp" : "sensor at each ray's firing time"))
                << recording;
    }
    void expect_recordings(bool rolls) const {
        for (const char* recording : {"scans.mcap", "rosbag.mcap"}) {
            const Log log = load_log((folder / recording).string(), {});
            EXPECT_EQ(log.rolling_shutter, rolls) << recording;
            const PoseTrack track = shift_track(log.lidar_track(0), log.world_offset_m);
            std::size_t n = 0;
            for (const Frame& frame : log.frames)
                for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
                    if (frame.scan.range_m[i] == 0.0f) continue;
                    const double fired_s =
                        frame.time_s + (rolls ? double(frame.scan.rays.time_offset_s[i]) : 0.0);
                    ASSERT_NEAR((track.pose_at(fired_s) * glm::dvec3(frame.scan.return_point(i))).x, kWall_m,
                                2.0 * kTolerance_m)
                        << recording;
                    ++n;
                }
            EXPECT_GT(n, 50u) << recording;
        }
    }
};

TEST_F(CompensatedLog, AnotherSensorHasItsOwnRollingShutter) {
    const SimulatedSensor sensor = choose_sensor("VLP-16:96x10", run.config, run.log);
    write(sensor, false);
    expect_statements(false);
    expect_recordings(true);
    const std::vector<TimedPoint> raw = points();
    ASSERT_GT(raw.size(), 100u);
    double first_s = 1e9, last_s = -1e9;
    for (const auto& [position_m, time_s] : raw) {
        EXPECT_NEAR(position_m.x + compute_sensor_x(time_s), kWall_m, kTolerance_m);
        first_s = std::min(first_s, time_s);
        last_s = std::max(last_s, time_s);
    }
    EXPECT_GT(last_s - first_s, 0.02) << "the head turns";
    for (const auto& [name, header] :
         {std::pair("frame_000000.ply", "end_header\n"), std::pair("frame_000000.pcd", "DATA binary\n")}) {
        const std::vector<glm::dvec3> in_file = points_of(name, header, raw.size());
        for (std::size_t i = 0; i < raw.size(); ++i)
            EXPECT_LT(glm::distance(in_file[i], raw[i].position_m), 1e-4) << name;
    }

    write(sensor, true);
    expect_statements(true);
    expect_recordings(true);  // the reader restores the uncompensated points
    for (const char* recording : {"scans.mcap", "rosbag.mcap"}) {
        DatasetOptions without_poses;
        without_poses.poses_file = kNoPoses;
        EXPECT_FALSE(load_log((folder / recording).string(), without_poses).rolling_shutter) << recording;
    }
    const std::vector<TimedPoint> deskewed = points();
    ASSERT_EQ(deskewed.size(), raw.size());
    for (std::size_t i = 0; i < raw.size(); ++i) {
        EXPECT_NEAR(deskewed[i].position_m.x + compute_sensor_x(kFirst_s), kWall_m, kTolerance_m);
        EXPECT_NEAR(deskewed[i].position_m.x - raw[i].position_m.x, kSpeed_mps * (raw[i].time_s - kFirst_s),
                    1e-4);
    }
}

TEST_F(CompensatedLog, ItsOwnSensorIsCompensatedAndSaysSo) {
    write(choose_sensor("native", run.config, run.log), false);
    expect_statements(true);
    expect_recordings(false);
    const std::vector<TimedPoint> points_m = points();
    ASSERT_GT(points_m.size(), 20u);
    for (const auto& [position_m, time_s] : points_m) {
        EXPECT_EQ(time_s, kFirst_s) << "all rays are fired at the scan's time";
        EXPECT_NEAR(position_m.x + compute_sensor_x(time_s), kWall_m, kTolerance_m);
    }
}

TEST_F(CompensatedLog, TheSettingGivesItsOwnSensorARollingShutter) {
    run.config.sensor.rolling_shutter = RollingShutter::yes;
    write(choose_sensor("native", run.config, run.log), false);
    expect_statements(false);
    expect_recordings(true);
    for (const auto& [position_m, time_s] : points())
        EXPECT_NEAR(position_m.x + compute_sensor_x(time_s), kWall_m, kTolerance_m);

    run.config.sensor.rolling_shutter = RollingShutter::no;
    write(choose_sensor("VLP-16:96x10", run.config, run.log), false);
    expect_statements(true);
    for (const auto& [position_m, time_s] : points()) EXPECT_EQ(time_s, kFirst_s);
}

TEST_F(CompensatedLog, PointsOfTheServiceToo) {
    ScanRenderer renderer(device(), run);
    for (const char* name : {"native", "VLP-16:96x10"}) {
        const bool rolls = name != std::string("native");
        renderer.submit_points(choose_sensor(name, run.config, run.log),
                               {kFirst_s, run.log.world_from_vehicle}, kFirst_s + 0.05);
        const LidarPoints points = renderer.wait_for_points().points;
        ASSERT_GT(points.size(), 20u);
        double later = 0.0;
        for (std::size_t i = 0; i < points.size(); ++i) {
            const glm::dvec3 at_m = points.world_from_points * glm::dvec3(points.position_m[i]);
            EXPECT_NEAR(at_m.x, kWall_m, kTolerance_m);
            const double offset_s = points.time_offset_s[i], time_s = kFirst_s + offset_s;
            const glm::dvec3 vector_m = at_m - glm::dvec3(compute_sensor_x(time_s), 0.0, 0.0);
            // direction in which the sensor fired at that time
            const double beam =
                rolls ? (15.0 - 2.0 * points.ring[i]) * kPi / 180.0 : 0.2 - 0.2 * points.ring[i];
            // The lasers of a VLP-16 cross 41.9 mm before the axis (manual 63-9243).
            const double up_m = rolls ? -0.0419 * std::tan(beam) : 0.0;
            const double elevation = std::atan2(vector_m.z - up_m, std::hypot(vector_m.x, vector_m.y));
            EXPECT_NEAR(elevation, beam, 2e-4) << name << ", " << offset_s;
            later = std::max(later, std::abs(offset_s));
        }
        EXPECT_EQ(later > 0.01, rolls) << name;
    }
}

}  // namespace
}  // namespace relidar
