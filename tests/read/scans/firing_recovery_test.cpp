// SPDX-License-Identifier: Apache-2.0
// Drives a spinning LiDAR through the synthetic street, moves all points of a sweep to
// the time of the frame, and recovers their firing times. The truth is exact.
#include "read/scans/firing_recovery.hpp"

#include <cmath>
#include <fstream>

#include <gtest/gtest.h>

#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>

#include "base/median.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using read::CompensatedSweep;
using read::FiringRecovery;
using read::HeadTurn;

constexpr double kPeriod_s = 0.1;
constexpr int kSweeps = 4;

struct Drive {
    HeadTurn turn = {};
    double speed_mps = 10.0, yaw_rate_radps = 0.0;
    double view_rad = kPi;  ///< azimuths beyond this angle from the front have no points
    bool is_half_missing = false;
    /// The dataset extrapolated the motion before each frame.
    bool has_constant_velocity = false;
    double compensated_share = 1.0;  ///< motion that the dataset used, relative to the truth
    bool is_raw = false;             ///< the points were not moved
    double left_m = 0.0;             ///< beams start beside the axis, in turn on its left and right
    int columns = 400, beams = 20;
    /// A mirror turns from the left limit of the view to the right one and back in a
    /// sweep. Points of even columns are seen on the way there.
    bool is_mirror = false;

    double time_turns(double azimuth_rad, std::size_t column) const {
        if (!is_mirror) return turn.time_turns(azimuth_rad);
        return (column % 2 ? 0.25 : -0.25) * (azimuth_rad / view_rad + 1.0);
    }
};

/// Sweeps of a drive before and after the compensation, with true times.
struct Recording {
    PoseTrack world_from_sensor;
    std::vector<CompensatedSweep> sweeps;
    std::vector<LidarPoints> truth;  ///< points at their firing times

    std::vector<CompensatedSweep> truth_sweeps() const {
        std::vector<CompensatedSweep> timed;
        for (std::size_t s = 0; s < sweeps.size(); ++s) timed.push_back({truth[s], sweeps[s].time_s});
        return timed;
    }
};

Pose vehicle_pose(const Drive& drive, double t_s) {
    const double yaw = drive.yaw_rate_radps * t_s, along_m = 5.0 + drive.speed_mps * t_s;
    return {make_rotation(yaw, 0.004 * std::sin(7.0 * t_s), 0.003 * std::cos(9.0 * t_s)),
            {along_m, 0.5 * yaw * drive.speed_mps * t_s, 1.8 + 0.01 * std::sin(5.0 * t_s)}};
}

SpinningSensor make_sensor(const Drive& drive = {}) {
    SpinningSensor sensor;
    sensor.columns = drive.columns;
    sensor.period_s = kPeriod_s;
    sensor.first_azimuth_rad = kPi - kPi / drive.columns;
    for (int k = 0; k < drive.beams; ++k)
        sensor.beams.push_back({.elevation_rad = (3.0 - 28.0 * k / (drive.beams - 1)) * kPi / 180.0,
                                .origin_left_m = k % 2 ? drive.left_m : -drive.left_m});
    return sensor;
}

/// Moves points with times to the sensor frame at the time `to_s`.
void compensate(LidarPoints& points, const PoseTrack& track, double frame_time_s, double to_s) {
    for (std::size_t p = 0; p < points.size(); ++p)
        points.position_m[p] = glm::vec3(inverse(track.pose_at(to_s)) *
                                         (track.pose_at(frame_time_s + double(points.time_offset_s[p])) *
                                          glm::dvec3(points.position_m[p])));
}

Recording record(const Drive& drive) {
    Recording recording;
    for (int i = -1; i <= kSweeps; ++i)
        recording.world_from_sensor.append(i * kPeriod_s, vehicle_pose(drive, i * kPeriod_s));
    const RayTable nominal = make_rays(make_sensor(drive));
    for (int i = 0; i < kSweeps; ++i) {
        const double time_s = i * kPeriod_s;
        RayTable rays = nominal;
        for (std::size_t r = 0; r < rays.size(); ++r)
            rays.time_offset_s[r] =
                float(drive.time_turns(std::atan2(double(rays.direction[r].y), double(rays.direction[r].x)),
                                       r % std::size_t(rays.columns)) *
                      kPeriod_s);
        PoseTrack compensation = recording.world_from_sensor;
        if (drive.has_constant_velocity) {
            compensation.time_s.resize(std::size_t(i) + 2);
            compensation.pose.resize(std::size_t(i) + 2);
        }
        for (Pose& pose : compensation.pose) pose.translation *= drive.compensated_share;
        const Scan scan = cast_street_rays({.moving_cars = false}, rays, recording.world_from_sensor, time_s);
        LidarPoints fired;
        for (std::size_t r = 0; r < rays.size(); ++r) {
            const glm::vec3& d = rays.direction[r];
            if (!(scan.range_m[r] > 0.0f) || (drive.is_half_missing && d.y < 0.0f) ||
                std::abs(std::atan2(double(d.y), double(d.x))) > drive.view_rad)
                continue;
            fired.position_m.push_back(scan.return_point(r));
            fired.intensity.push_back(0.5f);
            fired.ring.push_back(rays.channel[r]);
            fired.time_offset_s.push_back(rays.time_offset_s[r]);
        }
        LidarPoints moved = fired;
        if (!drive.is_raw) compensate(moved, compensation, time_s, time_s);
        moved.time_offset_s.clear();
        recording.sweeps.push_back({std::move(moved), time_s});
        recording.truth.push_back(std::move(fired));
    }
    return recording;
}

std::optional<FiringRecovery> recover(const Recording& recording, bool has_poses) {
    read::CompensatedSensor sensor{.period_s = kPeriod_s};
    if (has_poses) sensor.world_from_sensor = recording.world_from_sensor;
    return read::find_firings(recording.sweeps, sensor);
}

/// Compares times and points with the truth.
/// @param max_point_m  maximum median distance of points
void expect_recovered(const Drive& drive, bool has_poses, double max_point_m) {
    const Recording recording = record(drive);
    const std::optional<FiringRecovery> recovery = recover(recording, has_poses);
    ASSERT_TRUE(recovery.has_value());
    EXPECT_EQ(recovery->turn.clockwise, drive.turn.clockwise);
    std::vector<double> time_errors_s, point_errors_m;
    for (std::size_t s = 0; s < recording.sweeps.size(); ++s) {
        LidarPoints points = recording.sweeps[s].points;
        read::restore_firings(points, *recovery, recording.sweeps[s].time_s);
        for (std::size_t p = 0; p < points.size(); ++p) {
            time_errors_s.push_back(
                std::abs(double(points.time_offset_s[p] - recording.truth[s].time_offset_s[p])));
            point_errors_m.push_back(
                double(glm::distance(points.position_m[p], recording.truth[s].position_m[p])));
        }
    }
    const auto n_wrong = std::ranges::count_if(time_errors_s, [](double e) { return e > 0.01; });
    EXPECT_LT(compute_median(time_errors_s), 1e-3);
    EXPECT_LT(double(n_wrong), 0.01 * double(time_errors_s.size()));
    EXPECT_LT(compute_median(point_errors_m), max_point_m);
}

TEST(FiringRecovery, FindsBothDirectionsAndAllSeams) {
    expect_recovered({.speed_mps = 10.0}, true, 2e-3);
    expect_recovered({.turn = {false, 0.5 * kPi, -0.5}, .speed_mps = 20.0}, true, 2e-3);
    expect_recovered({.turn = {true, -2.0, -1.0}, .speed_mps = 5.0}, true, 2e-3);
    expect_recovered({.speed_mps = 8.0, .yaw_rate_radps = 0.3}, true, 2e-3);
}

/// The azimuths of a beam beside the axis depend on the range. They are multiples of the
/// tick only after its offset is known.
TEST(FiringRecovery, FindsTheYawOfBeamsBesideTheAxis) {
    expect_recovered({.yaw_rate_radps = 0.3, .left_m = 0.05, .columns = 2000, .beams = 12}, false, 0.004);
}

TEST(FiringRecovery, NeedsNoPoses) {
    expect_recovered({.speed_mps = 30.0}, false, 0.02);
    expect_recovered({.turn = {false, 0.3, 0.0}, .speed_mps = 10.0}, false, 0.02);
    expect_recovered({.speed_mps = 8.0, .yaw_rate_radps = 0.3}, false, 0.02);
}

/// Without poses, a slow yaw looks like another number of columns.
TEST(FiringRecovery, PrefersUsualNumbersOfColumns) {
    for (const int columns : {512, 900, 1800, 3600}) {
        const std::optional<FiringRecovery> recovery =
            recover(record({.yaw_rate_radps = 0.1, .columns = columns, .beams = 6}), false);
        ASSERT_TRUE(recovery.has_value());
        EXPECT_EQ(recovery->ticks.n, columns);
    }
}

/// No turn of a head explains such points. Most fits are worse than none.
TEST(FiringRecovery, KeepsScansOfAnOscillatingMirror) {
    for (const double view_rad : {kPi / 3.0, 0.99 * kPi}) {
        const Recording recording = record({.view_rad = view_rad, .is_mirror = true});
        EXPECT_FALSE(recover(recording, true).has_value());
        EXPECT_FALSE(recover(recording, false).has_value());
    }
}

TEST(FiringRecovery, AcceptsEmptySweepsAndOtherRings) {
    const Recording recording = record({.speed_mps = 10.0});
    std::optional<FiringRecovery> recovery = recover(recording, false);
    ASSERT_TRUE(recovery.has_value());
    EXPECT_GT(recovery->ticks.n, 0);
    LidarPoints empty, other = recording.sweeps[0].points;
    read::restore_firings(empty, *recovery, 0.0);
    EXPECT_EQ(empty.size(), 0u);
    std::ranges::fill(other.ring, std::uint16_t(500));
    other.ring[0] = 0;
    read::restore_firings(other, *recovery, 0.0);
    EXPECT_EQ(other.time_offset_s.size(), other.size());
}

TEST(FiringRecovery, AcceptsAnInexactCompensation) {
    expect_recovered({.yaw_rate_radps = 0.2, .has_constant_velocity = true}, true, 0.02);
    expect_recovered({.compensated_share = 1.3}, true, 0.02);
}

TEST(FiringRecovery, AcceptsHalfASweep) {
    expect_recovered({.is_half_missing = true}, true, 2e-3);
    // The start is in the gap behind the sensor, so it is not known, but the times are.
    expect_recovered({.view_rad = kPi / 1.5}, true, 2e-3);
    expect_recovered({.turn = {true, kPi, 0.0}, .view_rad = kPi / 1.5}, false, 0.02);
}

/// Both beams of a firing look far beside the head, so their azimuths give wrong times,
/// and the wrong end of the sweep near its start.
TEST(FiringRecovery, TimesAreThoseOfTheHead) {
    const std::vector<Beam> beams = {{.azimuth_offset_rad = 0.15}, {.azimuth_offset_rad = -0.15}};
    const EncoderTickGrid ticks{.n_ticks = 2000, .zero_rad = 0.001};
    FiringRecovery recovery;
    recovery.sensor.period_s = kPeriod_s;
    LidarPoints points;
    std::vector<double> expected_s;
    for (const double head_rad : {3.1, 1.5, 0.0, -2.0, -3.1})
        for (const std::uint16_t ring : {0, 1}) {
            const double azimuth_rad = head_rad + beams[ring].azimuth_offset_rad;
            points.position_m.emplace_back(9.0 * std::cos(azimuth_rad), 9.0 * std::sin(azimuth_rad), 0.0);
            points.ring.push_back(ring);
            expected_s.push_back(-head_rad / (2.0 * kPi) * kPeriod_s);
        }
    read::set_head_times(points, beams, ticks, recovery);
    for (std::size_t i = 0; i < points.size(); ++i)
        EXPECT_NEAR(double(points.time_offset_s[i]), expected_s[i], kPeriod_s / ticks.n_ticks);
}

TEST(FiringRecovery, KeepsLogsWithoutClearOptimum) {
    for (const Drive& drive :
         {Drive{.speed_mps = 0.0}, Drive{.is_raw = true}, Drive{.yaw_rate_radps = 0.3, .is_raw = true}}) {
        const Recording recording = record(drive);
        EXPECT_FALSE(recover(recording, true).has_value());
        EXPECT_FALSE(recover(recording, false).has_value());
    }
}

TEST(FiringRecovery, FindsTheTimeToWhichPointsWithTimesWereMoved) {
    for (const double moved_to_s : {0.0, 0.05}) {
        Recording recording = record({.speed_mps = 8.0, .yaw_rate_radps = 0.2, .is_raw = true});
        EXPECT_FALSE(
            read::find_moved_time(recording.truth_sweeps(), recording.world_from_sensor).has_value());
        std::vector<CompensatedSweep> moved = recording.truth_sweeps();
        const PoseTrack& track = recording.world_from_sensor;
        for (auto& [points, time_s] : moved) compensate(points, track, time_s, time_s + moved_to_s);
        const std::optional<double> found_s = read::find_moved_time(moved, track);
        ASSERT_TRUE(found_s.has_value());
        EXPECT_NEAR(*found_s, moved_to_s, 1e-3);
        for (std::size_t s = 0; s < moved.size(); ++s) {
            read::undo_deskew_to(moved[s].points, track, moved[s].time_s, *found_s);
            for (std::size_t p = 0; p < moved[s].points.size(); ++p)
                EXPECT_LT(glm::distance(moved[s].points.position_m[p], recording.truth[s].position_m[p]),
                          1e-2f);
        }
    }
}

/// Writes the compensated sweeps as a plain folder without point times.
fs::path write_folder(const Recording& recording, const std::string& name, bool is_marked = true) {
    const fs::path folder = fs::path(testing::TempDir()) / name;
    fs::remove_all(folder);
    fs::create_directories(folder / "scans");
    std::ofstream poses(folder / "poses.txt");
    poses.precision(12);
    for (std::size_t s = 0; s < recording.sweeps.size(); ++s) {
        std::ofstream file(folder / "scans" / ("0" + std::to_string(s) + ".bin"), std::ios::binary);
        const LidarPoints& points = recording.sweeps[s].points;
        for (std::size_t p = 0; p < points.size(); ++p) {
            const std::array<float, 5> values = {points.position_m[p].x, points.position_m[p].y,
                                                 points.position_m[p].z, points.intensity[p],
                                                 float(points.ring[p])};
            file.write(reinterpret_cast<const char*>(values.data()), sizeof values);
        }
        const glm::dmat4 m = to_matrix(recording.world_from_sensor.pose_at(recording.sweeps[s].time_s));
        for (int row = 0; row < 3; ++row)
            for (int column = 0; column < 4; ++column) poses << m[column][row] << ' ';
        poses << '\n';
    }
    std::ofstream(folder / "sequence.json")
        << R"({"format": "relidar log", "version": 1, "rate_hz": 10, "motion_compensated": )"
        << (is_marked ? "true" : "false") << R"(, "columns": ["x", "y", "z", "intensity", "ring"]})";
    return folder;
}

TEST(FiringRecovery, GivesAFolderItsRollingShutter) {
    const Recording recording = record({.turn = {false, kPi, -0.5}, .speed_mps = 15.0});
    const fs::path folder = write_folder(recording, "relidar_compensated");
    for (const char* poses : {"", kNoPoses}) {
        const Log log = load_log(folder.string(), {.poses_file = poses});
        EXPECT_TRUE(log.rolling_shutter);
        EXPECT_FALSE(log.lidars[0].sensor.clockwise);
        const SpinningSensor truth = make_sensor();
        EXPECT_EQ(log.lidars[0].sensor.columns, truth.columns);
        EXPECT_EQ(log.lidars[0].sensor.beams.size(), truth.beams.size());
        for (std::size_t k = 0; k < truth.beams.size(); ++k)
            EXPECT_NEAR(log.lidars[0].sensor.beams[k].elevation_rad, truth.beams[k].elevation_rad, 2e-4);
        const auto& times = log.frames[2].scan.rays.time_offset_s;
        EXPECT_NEAR(double(std::ranges::min(times)), -0.05, 2e-3);
        EXPECT_NEAR(double(std::ranges::max(times)), 0.05, 2e-3);
    }
    EXPECT_FALSE(load_log(folder.string(), {.rolling_shutter = false}).rolling_shutter);
}

TEST(FiringRecovery, HintsAtAMissingFlag) {
    const auto has_hint = [](const Recording& recording) {
        const Log log = load_log(write_folder(recording, "relidar_unmarked", false).string(), {});
        return std::ranges::any_of(log.notes, [](const Note& note) {
            return note.text.find("\"motion_compensated\": true") != std::string::npos;
        });
    };
    EXPECT_TRUE(has_hint(record({.speed_mps = 15.0})));
    EXPECT_FALSE(has_hint(record({.speed_mps = 15.0, .is_raw = true})));
}

TEST(FiringRecovery, KeepsAFolderOfAStandingVehicle) {
    const fs::path folder = write_folder(record({.speed_mps = 0.0}), "relidar_standing");
    const Log log = load_log(folder.string(), {}),
              as_is = load_log(folder.string(), {.rolling_shutter = false});
    EXPECT_FALSE(log.rolling_shutter);
    for (std::size_t f = 0; f < log.frames.size(); ++f) {
        EXPECT_EQ(log.frames[f].scan.range_m, as_is.frames[f].scan.range_m);
        EXPECT_EQ(log.frames[f].scan.rays.direction, as_is.frames[f].scan.rays.direction);
        EXPECT_EQ(log.frames[f].scan.rays.time_offset_s, as_is.frames[f].scan.rays.time_offset_s);
    }
}

}  // namespace
}  // namespace relidar
