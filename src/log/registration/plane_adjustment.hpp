// SPDX-License-Identifier: Apache-2.0
// Joint optimisation of all poses of a track, so that the points of all scans lie on
// common planes.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "log/registration/plane_cells.hpp"

namespace relidar {

/// The planes of one grid.
struct PlaneMap {
    PlaneCells cells;
    std::vector<std::optional<Plane>> planes;  ///< [cells]

    /// Returns the plane of the cell that contains a point, or null.
    const Plane* at(const glm::dvec3& point_m) const;
};

class PlaneAdjustment {
public:
    /// Prepares an adjustment.
    /// @param given  reference of the corrections
    /// @param start  initial poses, accurate enough for the cell size of the first round
    /// @param points  points of all sweeps, sweep by sweep
    /// @param gauge  [poses] poses whose mean correction is kept at zero
    PlaneAdjustment(const PoseTrack& given, const PoseTrack& start, std::vector<ThinPoint> points,
                    std::vector<bool> gauge);

    /// Runs rounds with cells and kernels that shrink from the first to the last size,
    /// then two more rounds of the last size.
    /// @return the rounds; fewer if proceed() returned false
    std::vector<RegisterRound> run(const RegisterRound& first, const RegisterRound& last,
                                   const std::function<bool(double done)>& proceed);
    PlaneMap planes(const RegisterRound& round) const;
    const PoseTrack& track() const { return track_; }

    /// Finds candidates whose points do not determine their pose (see is_placed()), or
    /// whose correction differs from its neighbours by more than largest_m. Their poses,
    /// and poses that are not candidates, get interpolated corrections.
    /// @param candidates  [poses] poses that have points
    /// @return the poses that were replaced
    std::vector<std::size_t> replace_lost(const PlaneMap& map, const std::vector<bool>& candidates,
                                          double scale_m, double largest_m);
    /// Moves one pose by one Gauss-Newton step. Uses the pose's points and fixed planes.
    /// All other poses stay.
    void place_pose(const PlaneMap& map, std::size_t pose, const std::vector<ThinPoint>& own, double scale_m);
    /// Returns true if enough points of a frame lie on planes.
    static bool is_placed(double share, std::size_t n_points);
    /// Returns the share of a frame's points that lie on planes.
    double share_on_planes(const PlaneMap& map, std::span<const ThinPoint> own, double scale_m) const;
    /// Returns how much a pose's correction differs from its neighbours in `among`: the
    /// minimum of the distances to the previous correction, to the next correction, and
    /// to their interpolation. Returns 0 at either end.
    double stands_out_m(std::size_t pose, const std::vector<bool>& among) const;
    void set_pose(std::size_t pose, const Pose& value) { track_.pose[pose] = value; }

private:
    PoseTrack given_, track_, start_;  // `start_`: the poses before the first round
    std::vector<ThinPoint> points_;
    std::vector<bool> gauge_;

    RegisterRound step(RegisterRound round, double shift);
    void remove_common_motion();
    void interpolate_corrections(const std::vector<bool>& is_known);
    /// Returns the nearest poses in `among` before and after a pose, or the pose itself
    /// if none exists.
    static std::pair<std::size_t, std::size_t> neighbours_of(std::size_t pose,
                                                             const std::vector<bool>& among);
    double share_of_time(std::size_t before, std::size_t pose, std::size_t after) const;
};

}  // namespace relidar
