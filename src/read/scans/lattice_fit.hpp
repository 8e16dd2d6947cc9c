// SPDX-License-Identifier: Apache-2.0
// Fits the cones of beams and the motion of the sensor to motion-compensated points, for
// an assumed turn of the head.
#pragma once

#include <array>
#include <cmath>
#include <vector>

#include <Eigen/Core>

#include "read/scans/firing_recovery.hpp"

namespace relidar::read {

/// index of the rotation about z in a twist
inline constexpr std::size_t kYaw = 5;
/// parameters of a twist that elevations show: all before the yaw
inline constexpr std::size_t kMotionParameters = kYaw;

inline constexpr double kFullTurn_rad = 2.0 * kPi;

/// Motion of the sensor in a full turn: twists before and after the time of the frame.
using SweepMotion = std::array<Twist, 2>;

/// Points of a sweep in the frame of the log.
struct SweepPoints {
    std::vector<glm::dvec3> position_m;
    std::vector<double> azimuth_rad;
    std::vector<std::size_t> ring;
};

/// A point in the sensor frame at its firing time.
struct FiredPoint {
    glm::dvec3 position_m;
    double time_turns = 0.0;  ///< firing time after the time of the frame
};

inline double azimuth_rad_of(const glm::dvec3& p) { return std::atan2(p.y, p.x); }

/// Returns the azimuth of a point that was moved a little. The series replaces std::atan2
/// because the fits need most of their time for azimuths. Its error is below 1e-8 rad.
/// The result can be outside of +-pi.
inline double moved_azimuth_rad(const glm::dvec3& moved_m, const glm::dvec3& point_m, double azimuth_rad) {
    constexpr double kMaxTangent = 0.15;
    const double cross = point_m.x * moved_m.y - point_m.y * moved_m.x,
                 dot = point_m.x * moved_m.x + point_m.y * moved_m.y;
    if (!(std::abs(cross) < kMaxTangent * dot)) return azimuth_rad + std::atan2(cross, dot);
    const double t = cross / dot, tt = t * t;
    return azimuth_rad + t * (1.0 - tt * (1.0 / 3.0 - tt * (1.0 / 5.0 - tt / 7.0)));
}

/// Returns the distance from the axis of the head.
inline double axis_distance_m(const glm::dvec3& p) { return std::sqrt(p.x * p.x + p.y * p.y); }

/// Returns the difference of the slopes of a point and its cone: 0 if it is on the cone.
inline double cone_error(const glm::dvec3& p, const RingCone& cone) {
    return (p.z - cone.z0_m) / axis_distance_m(p) - cone.slope;
}

/// Returns the poses of the sensor around a frame, in the sensor frame at its time. The
/// times of the track are in turns after this time.
PoseTrack make_track(const PoseTrack& world_from_sensor, double time_s, double period_s);
/// Returns the twists that a track has in the turn before and after time 0.
SweepMotion twists_of(const PoseTrack& track);

/// Moves a point from the sensor frame at time 0 to the sensor frame at another time.
glm::dvec3 undo_motion(const glm::dvec3& point_m, const PoseTrack& track, double time_turns);
/// Fast version with a rotation of third order. The error is below 1e-5 rad for rotations
/// below 0.12 rad, which are 2.4 rad/s at 10 Hz.
glm::dvec3 undo_motion(const glm::dvec3& point_m, const SweepMotion& motion, double time_turns);

/// Computes the firing of a point. The azimuth at the firing time differs from that of
/// the moved point, so the function iterates.
/// @param azimuth_rad  azimuth of the point
template <class Motion>
FiredPoint find_firing(const glm::dvec3& point_m, double azimuth_rad, const Motion& motion,
                       const HeadTurn& turn) {
    FiredPoint fired{point_m, turn.time_turns(azimuth_rad)};
    for (int pass = 0; pass < 2; ++pass) {
        fired.position_m = undo_motion(point_m, motion, fired.time_turns);
        fired.time_turns = turn.time_turns(moved_azimuth_rad(fired.position_m, point_m, azimuth_rad));
    }
    fired.position_m = undo_motion(point_m, motion, fired.time_turns);
    return fired;
}

/// Selects at most `n_points` first returns of the first `n_rings` rings, evenly.
SweepPoints pick_points(const LidarPoints& points, std::size_t n_points, std::size_t n_rings);

/// Cones and motions that fit the points of some sweeps, for an assumed turn.
struct LatticeFit {
    HeadTurn turn;
    std::vector<RingCone> rings;
    std::vector<SweepMotion> motions;  ///< [sweeps]
    double spread_rad = INFINITY;
};

/// The values of a fit that may change.
enum class FreeValues { cones, motions, all };

class LatticeFitter {
public:
    LatticeFitter(std::vector<SweepPoints> sweeps, std::size_t n_rings)
        : sweeps_(std::move(sweeps)), n_rings_(n_rings) {}

    /// Returns a fit without cones and motion for improve().
    LatticeFit start_fit(const HeadTurn& turn) const {
        return {.turn = turn, .rings = {}, .motions = std::vector<SweepMotion>(sweeps_.size())};
    }
    /// Improves a fit. Starts with the median slopes if the fit has no cones.
    /// @param n_steps  Gauss-Newton steps: 2 after a small change, otherwise 4 to 8
    void improve(LatticeFit& fit, int n_steps, FreeValues free_values) const;
    /// Returns the mean robust error of all points, from 0 to 1.
    double cost(const LatticeFit& fit, double scale_rad) const;

private:
    using Firings = std::vector<std::vector<FiredPoint>>;  // [sweeps][points]

    std::vector<SweepPoints> sweeps_;
    std::size_t n_rings_;

    /// Moves all points to their firing times, with the turn and the motions of the fit.
    Firings compute_firings(const LatticeFit& fit) const;
    /// Sets the first cones, which start at the origin (z0 = 0). The slope is the median
    /// of z / (distance from the z axis) over the points of a ring. Without points, it is
    /// NaN, and never used.
    void set_median_slopes(LatticeFit& fit, const Firings& firings) const;
    /// Calls visit(sweep, point, elevation error), in radians at a slope of 0.
    template <class Visit>
    void visit_errors(const LatticeFit& fit, const Firings& firings, const Visit& visit) const;
    double spread_of(const LatticeFit& fit, const Firings& firings) const;
    /// Returns the index of the first value of a twist in the unknowns of the equations.
    /// They are z0 and slope of each ring, then (v, w.x, w.y) of the twists of each
    /// sweep.
    /// @param half  0: before the time of the frame, 1: after it
    std::size_t motion_index(std::size_t sweep, std::size_t half) const {
        return 2 * n_rings_ + (2 * sweep + half) * kMotionParameters;
    }

    /// Returns the Gauss-Newton step of all unknowns.
    Eigen::VectorXd solve_step(const LatticeFit& fit, const Firings& firings, FreeValues free_values) const;
    /// Adds a weak penalty on the difference of both twists of a sweep, so that a twist
    /// without points equals the other one.
    void join_halves(const LatticeFit& fit, Eigen::MatrixXd& normal, Eigen::VectorXd& gradient) const;
    /// Adds a step of all unknowns to the cones and twists of a fit.
    /// @param change  z0 and slope of each ring, then the twists; see motion_index()
    void apply_change(LatticeFit& fit, const Eigen::VectorXd& change) const;
};

}  // namespace relidar::read
