// SPDX-License-Identifier: Apache-2.0
// Reads Boreas sequences. Each line of lidar_poses.csv contains the position and the
// angles of the LiDAR in an East-North-Up frame. The angles rotate frames, not vectors.
// So the rotation from the LiDAR to the East-North-Up frame is
//   C = C_1(roll) C_2(pitch) C_3(yaw) = R_x(-roll) R_y(-pitch) R_z(-yaw),
// and not the usual R_z(yaw) R_y(pitch) R_x(roll). The reader checks this convention.
#include "read/readers.hpp"

#include <cmath>
#include <optional>

#include <fmt/format.h>

#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/scans/stamped_log.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

// east, north, up, three velocities, roll, pitch, yaw, three angular rates
constexpr std::size_t kPoseNumbers = 12;
constexpr std::size_t kFirstAngle = 6;
constexpr double kMicrosecond = 1e-6;
constexpr double kMostGap_s = 0.5;  // maximum time between two poses; the dataset has one pose per scan
// Another convention for roll, pitch and yaw must raise the forward-motion score (1: the
// vehicle always drives forward) by more than this.
constexpr double kClearlyForward = 0.05;
// With similar scores, new / previous spread of the vertical motion must be below this.
constexpr double kClearlyLevel = 0.7;
// Steps of at least a metre that the vertical motion needs.
constexpr std::size_t kFewestSteps = 50;
constexpr double kMaxIntensity = 255.0;

/// Reads the forward direction of the vehicle from T_applanix_lidar.txt, the 4x4
/// transform from the LiDAR to the Applanix frame (x right, y forward, z up). Without
/// this file, the direction is unknown.
std::optional<glm::dvec3> read_forward(const fs::path& calibration_file) {
    if (!does_path_exist(calibration_file)) return std::nullopt;
    const auto m = parse_numbers(read_text_file(calibration_file));
    if (!m || m->size() != 16)
        fail("{}: found {}, expected 4 lines of 4 numbers", calibration_file.string(),
             m ? fmt::format("{} numbers", m->size()) : "a word that is not a number");
    const Pose applanix_from_lidar = make_pose(*m, calibration_file.string());
    return inverse(applanix_from_lidar).rotation * glm::dvec3(0, 1, 0);
}

/// How roll, pitch and yaw define the rotation from the LiDAR to the world.
struct EulerAngleConvention {
    const char* name;
    double sign;     ///< sign of the angles
    bool yaw_first;  ///< if true, vectors are rotated by yaw first; if false, by roll first
};
// The first is the documented convention.
constexpr EulerAngleConvention kAngleOrders[] = {
    {.name = "R_x(-roll) R_y(-pitch) R_z(-yaw)", .sign = -1.0, .yaw_first = true},
    {.name = "R_z(yaw) R_y(pitch) R_x(roll)", .sign = 1.0, .yaw_first = false},
    {.name = "R_z(-yaw) R_y(-pitch) R_x(-roll)", .sign = -1.0, .yaw_first = false},
    {.name = "R_x(roll) R_y(pitch) R_z(yaw)", .sign = 1.0, .yaw_first = true}};

/// Returns the rotation R_x(roll) R_y(pitch) R_z(yaw) if `yaw_first`, and otherwise
/// R_z(yaw) R_y(pitch) R_x(roll).
glm::dquat compose_angles(double roll_rad, double pitch_rad, double yaw_rad, bool yaw_first) {
    if (!yaw_first) return make_rotation(yaw_rad, pitch_rad, roll_rad);
    // The inverse has the negated angles in the reverse order.
    return glm::conjugate(make_rotation(-yaw_rad, -pitch_rad, -roll_rad));
}

/// Returns the LiDAR poses in the East-North-Up frame, with one meaning of the angles.
PoseTrack make_lidar_track(const std::vector<read::PoseRow>& pose_rows, const read::StampedLog& stamped,
                           const EulerAngleConvention& angle_convention) {
    const double sign = angle_convention.sign;
    PoseTrack track;
    for (const read::PoseRow& row : pose_rows) {
        const std::vector<double>& v = row.values;
        const glm::dvec3 position_m(v[0], v[1], v[2]);
        const double roll_rad = sign * v[kFirstAngle], pitch_rad = sign * v[kFirstAngle + 1],
                     yaw_rad = sign * v[kFirstAngle + 2];
        const glm::dquat enu_from_lidar =
            compose_angles(roll_rad, pitch_rad, yaw_rad, angle_convention.yaw_first);
        track.append(stamped.seconds_of(row.stamp), {enu_from_lidar, position_m});
    }
    return track;
}

/// Returns how well the vehicle drives forward; 1 is perfect. If the forward direction is
/// unknown, returns how constant the driving direction is in the LiDAR frame.
double score_motion(const read::DrivingDirection& driving, const std::optional<glm::dvec3>& forward) {
    return forward ? glm::dot(driving.mean, *forward) : glm::length(driving.mean);
}

/// The poses with one meaning of the angles, and how the vehicle then drives.
struct AngleReading {
    const EulerAngleConvention* order;
    PoseTrack track;
    read::DrivingDirection driving = {};
    double forward_score = 0.0;  ///< see score_motion()
};

/// Returns true if the vehicle clearly drives more exactly forward than with the best
/// reading so far, or equally well forward and clearly less up and down.
bool is_clearly_better(const AngleReading& reading, const AngleReading& best) {
    const double gain = reading.forward_score - best.forward_score;
    const bool is_more_level = reading.driving.n_steps >= kFewestSteps &&
                               reading.driving.rise_spread < kClearlyLevel * best.driving.rise_spread;
    return gain > kClearlyForward || (gain >= -kClearlyForward && is_more_level);
}

/// Reads the LiDAR poses. Uses another meaning of the angles than the documented one only
/// if the vehicle then drives clearly better in the direction `forward` (LiDAR frame).
PoseTrack read_boreas_poses(const fs::path& file, const read::StampedLog& stamped,
                            const std::optional<glm::dvec3>& forward, Notes& notes) {
    const std::vector<read::PoseRow> rows = read::read_stamped_rows(file, kPoseNumbers);
    std::optional<AngleReading> best;
    for (const EulerAngleConvention& order : kAngleOrders) {  // the documented one first
        AngleReading reading{.order = &order, .track = make_lidar_track(rows, stamped, order)};
        reading.driving = read::driving_direction(reading.track);
        reading.forward_score = score_motion(reading.driving, forward);
        if (!best || is_clearly_better(reading, *best)) best = std::move(reading);
    }
    if (best->order != &kAngleOrders[0])
        notes.push_back(
            fmt::format("the angles of poses are read as {}, which differs from the documentation of Boreas, "
                        "because only then the vehicle drives forward along the road",
                        best->order->name));
    if (best->driving.n_steps > 0) read::note_driving(notes, best->forward_score);
    return std::move(best->track);
}

}  // namespace

/// Loads a Boreas sequence: LiDAR poses and scans. Boreas' LiDAR frame has another
/// forward direction than relidar's, so poses and points are rotated about z.
Log load_boreas(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "a Boreas sequence (lidar/, applanix/, calib/)");
    const fs::path folder = fs::canonical(log_folder);
    Log log;
    const std::string name = folder.filename().string();
    log.name = name.starts_with("boreas") ? name : "Boreas " + name;
    log.source = log_folder.string();
    log.notes = {"this log has no labels"};
    read::StampedLog stamped{.unit_s = kMicrosecond,
                             .scans = read::list_stamped_files(folder / "lidar"),
                             .world_from_vehicle = {},
                             .poses_file = folder / "applanix/lidar_poses.csv",
                             .most_gap_s = kMostGap_s};
    read::check_pose_source(stamped.poses_file, options);
    std::optional<glm::dvec3> forward = read_forward(folder / "calib/T_applanix_lidar.txt");
    if (does_path_exist(stamped.poses_file)) {
        stamped.world_from_vehicle = read_boreas_poses(stamped.poses_file, stamped, forward, log.notes);
        const glm::dvec3 driven = read::driving_direction(stamped.world_from_vehicle).mean;
        if (!forward && driven != glm::dvec3(0.0)) forward = driven;
    }
    if (!forward)
        log.notes.push_back(
            "the forward direction of the vehicle is unknown; the x axis of the LiDAR is used");
    // Rotates the sensor frame of all poses so that its x axis points forward.
    const double forward_rad = forward ? std::atan2(forward->y, forward->x) : 0.0;
    const Pose lidar_from_turned{make_rotation(forward_rad, 0.0, 0.0), {}};
    for (Pose& pose : stamped.world_from_vehicle.pose) pose = pose * lidar_from_turned;
    log.conventions = fmt::format(
        "LiDAR frame: x forward, y left, z up, in metres (rotated about z by {:.2f} degrees relative to "
        "Boreas). Times are seconds after the first scan. The time of a frame is the middle of its sweep. "
        "Points are not motion-compensated. World frame: x east, y north, z up.",
        -forward_rad * 180.0 / kPi);
    log.lidars[0].sensor.name = "VLS-128 fitted to " + log.name;
    log.lidars[0].sensor.max_range_m = options.max_range_m;
    const std::vector<fs::path> files = read::add_frames(log, stamped, options);
    read::FileFormat format;
    format.units.columns = {"x", "y", "z", "intensity", "ring", "time"};
    format.units.intensity_max = kMaxIntensity;
    format.turned_rad = -forward_rad;
    read::read_frame_scans(log, files, format, options);
    return log;
}

}  // namespace relidar
