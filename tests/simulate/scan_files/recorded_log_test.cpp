// SPDX-License-Identifier: Apache-2.0
// Tests that recordings written by relidar can be read as logs with the same points,
// rings, times, poses and actors. The sensor has second returns and is mounted on a
// vehicle that drives a curve.

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../plates.hpp"
#include "base/geometry/ray_box.hpp"
#include "read/bag/bag_file.hpp"

namespace relidar {
namespace {

constexpr int kFrames = 4, kRows = 8, kColumns = 180;
// kFirst_s: timestamp of the first scan
constexpr double kPeriod_s = 0.1, kFirst_s = 1.0 + kPeriod_s * (0.5 / kColumns - 0.5);
const Pose kMounting{glm::angleAxis(0.3, glm::dvec3(0, 0, 1)), {1.2, -0.1, 1.9}};

PoseTrack make_track() {
    PoseTrack track;
    for (int i = 0; i <= 60; ++i) {
        const double t = 0.9 + 0.01 * i, yaw = 0.5 * t;
        track.time_s.push_back(t);
        track.pose.push_back({glm::angleAxis(yaw, glm::dvec3(0, 0, 1)),
                              {20.0 * std::sin(yaw), -20.0 * std::cos(yaw), 0.2 * t}});
    }
    return track;
}

/// Every twelfth ray is dropped, and every fifth ray has a second return.
RenderedScan room(double time_s) {
    RenderedScan scan;
    scan.image.rows = kRows;
    scan.image.columns = kColumns;
    for (int r = 0; r < kRows; ++r)
        for (int c = 0; c < kColumns; ++c) {
            const double azimuth = kPi - 2.0 * kPi * (c + 0.5) / kColumns, elevation = 0.2 - 0.05 * r;
            const auto i = std::size_t(r * kColumns + c);
            scan.image.direction.emplace_back(std::cos(elevation) * std::cos(azimuth),
                                              std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
            scan.image.range_m.push_back(float(12.0 + 3.0 * std::sin(5.0 * azimuth) + 0.5 * r));
            scan.image.intensity.push_back(float(i % 200) / 199.0f);  // not in steps of a byte
            scan.image.drop_prob.push_back(i % 12 == 0 ? 1.0f : 0.0f);
            scan.time_offset_s.push_back(float(kPeriod_s * ((c + 0.5) / kColumns - 0.5)));
            scan.ring.push_back(std::uint16_t(r));
        }
    const std::size_t n = scan.image.range_m.size();
    scan.second_returns.assign(1, {std::vector<float>(n, 0.0f), std::vector<float>(n, 0.0f)});
    for (std::size_t i = 0; i < n; i += 5)
        if (i % 12 != 0) {
            scan.second_returns[0].range_m[i] = scan.image.range_m[i] + 2.0f;
            scan.second_returns[0].intensity[i] = 0.21f;
        }
    scan.time_s = time_s;
    scan.track = make_track();
    for (Pose& pose : scan.track.pose) pose = pose * kMounting;
    scan.world_from_sensor = scan.track.pose_at(time_s);
    return test::complete(std::move(scan));
}

struct SeenPoint {
    double time_s;  ///< time in the recorded log
    int ring;
    bool second;
    glm::dvec3 world_m;
    float intensity;

    auto key() const { return std::tuple(std::llround(1e6 * time_s), ring, second); }
};

std::vector<SeenPoint> compute_truth() {
    std::vector<SeenPoint> points;
    for (int k = 0; k < kFrames; ++k) {
        const RenderedScan scan = room(1.0 + kPeriod_s * k);
        for (std::size_t i = 0; i < scan.image.range_m.size(); ++i) {
            if (scan.image.drop_prob[i] > 0.5f) continue;
            const double t_s = scan.time_s + double(scan.time_offset_s[i]);
            const auto at = [&](float range_m) {
                return scan.track.pose_at(t_s) * (double(range_m) * glm::dvec3(scan.image.direction[i]));
            };
            points.push_back({t_s, scan.ring[i], false, at(scan.image.range_m[i]), scan.image.intensity[i]});
            if (scan.second_returns[0].range_m[i] > 0.0f)
                points.push_back({t_s, scan.ring[i], true, at(scan.second_returns[0].range_m[i]), 0.21f});
        }
    }
    std::ranges::sort(points, {}, &SeenPoint::key);
    return points;
}

/// @param zero_s time in the recording at which the time of the log is zero
std::vector<SeenPoint> read_again(const Log& log, double zero_s) {
    std::vector<SeenPoint> points;
    const PoseTrack track = shift_track(log.lidar_track(0), log.world_offset_m);
    for (const Frame& frame : log.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            const double t_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
            const glm::dvec3 direction(frame.scan.rays.direction[i]);
            const auto add = [&](float range_m, float intensity, bool second) {
                points.push_back({t_s + zero_s, frame.scan.rays.channel[i], second,
                                  track.pose_at(t_s) *
                                      (glm::dvec3(frame.scan.rays.origin[i]) + double(range_m) * direction),
                                  intensity});
            };
            add(frame.scan.range_m[i], frame.scan.intensity[i], false);
            if (!frame.scan.second_returns.empty() && frame.scan.second_returns[0].range_m[i] > 0.0f)
                add(frame.scan.second_returns[0].range_m[i], frame.scan.second_returns[0].intensity[i], true);
        }
    std::ranges::sort(points, {}, &SeenPoint::key);
    return points;
}

/// A car that drives a curve and exists from the second scan on, and a static object.
std::vector<BoxTrack> actors() {
    BoxTrack car{"car 7", "Car", {4.2, 1.8, 1.5}, {}}, bin{"bin", "Bin", {0.7, 0.6, 1.1}, {}};
    for (int i = 0; i <= 40; ++i) {
        const double t = 1.09 + 0.01 * i, yaw = 0.4 * t;
        car.world_from_box.time_s.push_back(t);
        car.world_from_box.pose.push_back({glm::angleAxis(yaw, glm::dvec3(0, 0, 1)),
                                           {30.0 * std::sin(yaw), 4.0 - 30.0 * std::cos(yaw), 0.8}});
    }
    bin.world_from_box = {{0.5, 2.0},
                          std::vector<Pose>(2, {glm::angleAxis(2.0, glm::dvec3(0, 0, 1)), {5.0, -8.0, 0.6}})};
    return {car, bin};
}

/// Once per period, the head turns from behind over the left to the right.
double faced_at(const BoxTrack& box, double time_s) {
    double faced_s = time_s;
    for (int round = 0; round < 20; ++round) {
        const glm::dvec3 box_in_sensor_m = inverse(make_track().pose_at(faced_s) * kMounting) *
                                           box.world_from_box.pose_at(faced_s).translation;
        faced_s = time_s - std::atan2(box_in_sensor_m.y, box_in_sensor_m.x) / (2.0 * kPi) * kPeriod_s;
    }
    return faced_s;
}

/// @param moved_m offset of the read positions from the written positions
void expect_actors(const Log& log, const glm::dvec3& moved_m) {
    SCOPED_TRACE(testing::PrintToString(log.notes));
    ASSERT_EQ(log.boxes.size(), 2u);
    for (const BoxTrack& expected : actors()) {
        const BoxTrack* loaded = find_box(log, expected.id);
        ASSERT_NE(loaded, nullptr) << expected.id;
        EXPECT_EQ(loaded->category, expected.category);
        EXPECT_LT(glm::distance(loaded->size_m, expected.size_m), 1e-9);
        EXPECT_EQ(loaded->is_moving(), expected.is_moving());
        EXPECT_EQ(loaded->world_from_box.time_s.size(), expected.id == "bin" ? kFrames : kFrames - 1);
        for (std::size_t k = 0; k < loaded->world_from_box.time_s.size(); ++k) {
            const double at_s = loaded->world_from_box.time_s[k] + kFirst_s;
            BoxTrack there = expected;
            for (Pose& pose : there.world_from_box.pose) pose.translation += moved_m;
            const double scan_s = 1.0 + kPeriod_s * std::round((at_s - 1.0) / kPeriod_s);
            EXPECT_NEAR(at_s, faced_at(there, scan_s), kPeriod_s / kColumns)
                << expected.id << ": within a column";
            const Pose pose = expected.world_from_box.pose_at(at_s);
            EXPECT_LT(glm::distance(loaded->world_from_box.pose[k].translation + log.world_offset_m,
                                    pose.translation + moved_m),
                      1e-6);
            EXPECT_NEAR(std::abs(glm::dot(loaded->world_from_box.pose[k].rotation, pose.rotation)), 1.0,
                        1e-12);
        }
    }
}

class RecordedLog : public TemporaryFolder {};

void expect_same(const Log& log, bool has_second) {
    SCOPED_TRACE(testing::PrintToString(log.notes));
    ASSERT_EQ(log.frames.size(), std::size_t(kFrames)) << testing::PrintToString(log.notes);
    EXPECT_EQ(log.lidars[0].sensor.beams.size(), std::size_t(kRows));
    EXPECT_EQ(log.lidars[0].sensor.columns, kColumns);
    std::vector<SeenPoint> expected = compute_truth();
    if (!has_second) std::erase_if(expected, &SeenPoint::second);
    const std::vector<SeenPoint> loaded = read_again(log, kFirst_s);
    ASSERT_EQ(loaded.size(), expected.size());
    for (std::size_t i = 0; i < expected.size(); ++i) {
        ASSERT_EQ(loaded[i].ring, expected[i].ring) << i;
        ASSERT_EQ(loaded[i].second, expected[i].second) << i;
        ASSERT_NEAR(loaded[i].time_s, expected[i].time_s, 2e-6) << i;
        ASSERT_NEAR(loaded[i].intensity, expected[i].intensity, 1e-6) << i;
        // Poses of frames would be too coarse: at 10 m/s and 0.5 rad/s, a chord of 0.1 s
        // deviates by 6 mm and extrapolation by 5 cm. A pose every 10 ms deviates by 0.1
        // mm.
        ASSERT_LT(glm::distance(loaded[i].world_m, expected[i].world_m), 3e-4) << i;
    }
}

TEST_F(RecordedLog, OfEitherKindIsTheSameLog) {
    ScanOutputOptions format;
    format.formats = {"mcap", "rosbag"};
    format.vehicle_from_lidar = kMounting;
    format.actors = actors();
    format.world_offset_m = {1.0, 2.0, 3.0};
    ScanFolderWriter scans(folder, format);
    for (int k = 0; k < kFrames; ++k) scans.write_scan(k, room(1.0 + kPeriod_s * k));
    scans.finish();
    for (const char* name : {"scans.mcap", "rosbag.mcap"}) {
        const Log log = load_log((folder / name).string(), {});
        expect_same(log, true);
        expect_actors(log, format.world_offset_m);
    }
}

// The recording has the position of the vehicle on the earth, from which the place of the
// world is found again.
TEST_F(RecordedLog, KnowsItsPlaceOnTheEarth) {
    if (!has_proj()) GTEST_SKIP() << "built without PROJ";
    constexpr int kScans = 10;
    ScanOutputOptions format;
    format.formats = {"mcap", "rosbag"};
    format.vehicle_from_lidar = kMounting;
    const GeodeticPosition origin{49.015, 8.434, 116.0};
    format.georeference = {origin, {3.0, -4.0, 5.0}, local_tangent_crs(origin), make_rotation(0.6, 0.0, 0.0)};
    const GeoConverter truth(*format.georeference);
    ScanFolderWriter scans(folder, format);
    for (int k = 0; k < kScans; ++k) scans.write_scan(k, room(1.0 + kPeriod_s * k));
    scans.finish();
    for (const char* name : {"scans.mcap", "rosbag.mcap"}) {
        const Log log = load_log((folder / name).string(), {});
        ASSERT_TRUE(log.georeference) << name << testing::PrintToString(log.notes);
        const GeoConverter found(*log.georeference);
        for (const glm::dvec3& p : {glm::dvec3(0.0), glm::dvec3(50.0, -80.0, 2.0)})
            EXPECT_LT(glm::distance(truth.to_dataset(found.to_geodetic(p)), p), 1e-3) << name;
    }
}

/// Drives at 5 m/s to the right of and behind a static sensor, where a sweep ends.
BoxTrack make_car_behind() {
    BoxTrack car{"car", "Car", {4.2, 1.8, 1.5}, {}};
    for (int i = 0; i <= 10; ++i) {
        car.world_from_box.time_s.push_back(0.5 + 0.1 * i);
        car.world_from_box.pose.push_back({{1, 0, 0, 0}, {-6.0 + 5.0 * (0.1 * i - 0.5), -5.0, 0.2}});
    }
    return car;
}

RenderedScan make_scan_of_car(double time_s) {
    RenderedScan scan = room(time_s);
    scan.second_returns.clear();
    scan.track = {{0.0, 10.0}, {Pose{}, Pose{}}};
    scan.world_from_sensor = {};
    const BoxTrack car = make_car_behind();
    for (std::size_t i = 0; i < scan.image.range_m.size(); ++i) {
        const glm::dvec3 car_m =
            car.world_from_box.pose_at(time_s + double(scan.time_offset_s[i])).translation;
        const auto inside =
            cross_box(-car_m, glm::dvec3(scan.image.direction[i]), -0.5 * car.size_m, 0.5 * car.size_m);
        const bool is_hit = inside && inside->enter > 0.0;
        scan.image.range_m[i] = is_hit ? float(inside->enter) : 20.0f;
        scan.instance[i] = is_hit;
        scan.image.drop_prob[i] = 0.0f;
    }
    scan.median_range_m = scan.mean_range_m = scan.image.range_m;
    return scan;
}

TEST_F(RecordedLog, BoxesHoldThePointsOfMovingActors) {
    ScanOutputOptions format;
    format.formats = {"mcap", "rosbag"};
    format.actors = {make_car_behind()};
    ScanFolderWriter scans(folder, format);
    for (int k = 0; k < kFrames; ++k) scans.write_scan(k, make_scan_of_car(1.0 + kPeriod_s * k));
    scans.finish();
    for (const char* name : {"scans.mcap", "rosbag.mcap"}) {
        const Log log = load_log((folder / name).string(), {});
        ASSERT_EQ(log.boxes.size(), 1u) << testing::PrintToString(log.notes);
        const PoseTrack& boxes = log.boxes[0].world_from_box;
        ASSERT_EQ(boxes.pose.size(), std::size_t(kFrames));
        std::size_t n = 0;
        for (int k = 0; k < kFrames; ++k) {
            const RenderedScan scan = make_scan_of_car(1.0 + kPeriod_s * k);
            for (std::size_t i = 0; i < scan.image.range_m.size(); ++i) {
                if (scan.instance[i] != 1) continue;
                const glm::dvec3 point_m =
                    double(scan.image.range_m[i]) * glm::dvec3(scan.image.direction[i]);
                const glm::dvec3 box_m = boxes.pose[std::size_t(k)].translation + log.world_offset_m;
                const double later_s =
                    scan.time_s + double(scan.time_offset_s[i]) - (boxes.time_s[std::size_t(k)] + kFirst_s);
                const auto outside_m = [&](const glm::dvec3& middle_m) {
                    const glm::dvec3 beyond = glm::abs(point_m - middle_m) - 0.5 * make_car_behind().size_m;
                    return std::max({beyond.x, beyond.y, beyond.z});
                };
                EXPECT_LT(outside_m(box_m), 0.05)
                    << name << ": hit within some milliseconds of the box's time";
                EXPECT_LT(outside_m(box_m + glm::dvec3(5.0 * later_s, 0.0, 0.0)), 1e-4) << name;
                ++n;
            }
        }
        EXPECT_GT(n, 50u);
    }
    std::string messages;
    bag::TopicTable topics;
    bag::open_mcap_file(folder / "scans.mcap", /*skip_damaged_chunks=*/false)
        ->read_messages(topics, {[](const auto&) { return true; },
                                 [&](const bag::BagMessage& message) { messages += message.bytes; },
                                 [](const auto&) {}, [](double) {}});
    EXPECT_NE(messages.find("5 0 0"), std::string::npos) << "its velocity";
}

}  // namespace
}  // namespace relidar
