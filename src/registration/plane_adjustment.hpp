// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment: moves all poses, so that the points of all scans share planes.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "registration/plane_cells.hpp"
#include "registration/pose_equations.hpp"

namespace relidar {

/// Planes in the cells of one grid.
struct PlaneMap {
    PointCellGrid cells;
    std::vector<std::optional<LocalPlane>> planes;  ///< [cells]

    /// Returns the plane of the cell that contains a point, or null if there is none.
    const LocalPlane* find_plane_at(const glm::dvec3& point_m) const;
};

/// Weights of terms that keep the corrections of poses small and smooth. See
/// point_weight().
struct PoseCorrectionPrior {
    Vector6 pull;  ///< weight of the term that pulls each correction to zero
    /// weight of the term that pulls the motion between two consecutive poses to that of
    /// the reference track; it is multiplied by (0.1 s / time between the poses)
    Vector6 link;
    bool has_given_poses;  ///< see min_information()

    /// @param pull_m, pull_rad, link_m, link_rad  standard deviations
    PoseCorrectionPrior(double pull_m, double pull_rad, double link_m, double link_rad, bool is_given = true)
        : has_given_poses(is_given) {
        pull << Eigen::Vector3d::Constant(point_weight(pull_m)),
            Eigen::Vector3d::Constant(point_weight(pull_rad));
        link << Eigen::Vector3d::Constant(point_weight(link_m)),
            Eigen::Vector3d::Constant(point_weight(link_rad));
    }
};

/// Optimises all poses of a track so that points of different sweeps lie on common
/// planes. The planes are fitted again in each round. Motions that the points do not show
/// stay as in a reference track.
class PoseAdjustment {
public:
    /// @param initial_track  poses before any correction
    /// @param start  start values of the poses, accurate enough for the first cell size
    /// @param points  points of all sweeps, sweep by sweep
    /// @param reference  track whose motions are kept where points do not show the motion
    /// @param gauge  [poses] true for the poses whose mean correction is kept at zero, so
    /// that the track does not move as a unit
    PoseAdjustment(const PoseTrack& initial_track, const PoseTrack& start, const PoseTrack& reference,
                   const PoseCorrectionPrior& prior, std::vector<SubsampledPoint> points,
                   std::vector<bool> gauge);

    /// Optimises all poses in several rounds. The cell size and the scale of the robust
    /// kernel decrease from `first_round_settings` to `last_round_settings`.
    /// @return statistics of each round; fewer if `should_continue` returned false
    std::vector<FitRound> adjust_poses(const FitRound& first_round_settings,
                                       const FitRound& last_round_settings,
                                       const std::function<bool(double finished_fraction)>& should_continue);
    /// Like adjust_poses(), but continues until the poses converge. Small changes of the
    /// points change the result only a little. A round takes about four times as long.
    void converge_poses(const FitRound& first, const FitRound& last);
    /// Returns the mean weight of the points on the planes that converge_poses() uses. It
    /// is about 1 if all points lie exactly on planes.
    double mean_weight(const FitRound& round) const;
    PlaneMap fit_planes(const FitRound& round_settings) const;
    const PoseTrack& track() const { return track_; }

    /// Replaces poses without points and poses whose registration failed by
    /// interpolation. Too few points of a failed pose lie on planes, or its correction
    /// differs from both neighbours by more than `max_deviation_m`.
    /// @param shares_on_planes  [poses] share_on_planes() of each scan
    /// @return indices of the failed poses
    std::vector<std::size_t> interpolate_lost(const SubsampledScans& scans,
                                              const std::vector<double>& shares_on_planes,
                                              const std::vector<bool>& pose_has_points,
                                              double max_deviation_m);
    /// Returns the equations that move one pose towards fixed planes.
    SinglePoseEquations equations_of_pose(const PlaneMap& map, std::size_t pose_index,
                                          const std::vector<SubsampledPoint>& points, double scale_m) const;
    /// Moves one pose by a Gauss-Newton step towards fixed planes.
    /// @param start  pose that is kept where points do not show the motion
    void align_pose(const PlaneMap& map, std::size_t pose_index, const Pose& start,
                    const std::vector<SubsampledPoint>& points, double scale_m);
    /// Returns true if enough points of a scan lie on planes to determine its pose.
    static bool has_enough_planes(double fraction_on_planes, std::size_t n_points);
    /// Returns the share of a scan's points that lie on planes of a map.
    double share_on_planes(const PlaneMap& map, const std::vector<SubsampledPoint>& points,
                           double scale_m) const;
    /// Returns the smallest difference between the correction of a pose and those of the
    /// earlier neighbour, the later one, and the interpolation between both, in metres,
    /// or 0 if one neighbour is missing.
    /// @param is_neighbour  [poses] true for the poses that are used as neighbours
    double deviation_m(std::size_t pose_index, const std::vector<bool>& is_neighbour) const;
    void set_pose(std::size_t pose_index, const Pose& new_pose) { track_.pose[pose_index] = new_pose; }

private:
    PoseTrack initial_track_, track_, start_;  // start_: poses before the first round
    PoseTrack reference_;
    std::vector<SubsampledPoint> points_;
    std::vector<bool> gauge_;  // [poses] see the constructor
    PoseCorrectionPrior prior_;

    FitRound run_round(FitRound round, PoseEquations equations);
    PoseEquations sum_grid(const FitRound& round, double grid_shift_cells) const;
    PoseEquations sum_grids(const FitRound& round) const;
    PoseEquations sum_equations(const std::vector<WorldPointWithOrigin>& world_points, const PlaneMap& map,
                                double scale_m) const;
    void add_prior(PoseEquations& equations) const;
    void centre_poses();
    void fill_corrections(const std::vector<bool>& is_correction_known);
    double time_fraction(std::size_t before, std::size_t pose, std::size_t after_index) const;
};

}  // namespace relidar
