// SPDX-License-Identifier: Apache-2.0
// Optimises all poses of a track together, so that the points of the scans lie on common
// planes.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "log/registration/plane_cells.hpp"
#include "log/registration/pose_equations.hpp"

namespace relidar {

/// Planes in the cells of one grid.
struct PlaneMap {
    PlaneCells cells;
    std::vector<std::optional<Plane>> planes;  ///< [cells]

    /// Returns the plane of the cell that contains a point, or null if the cell has none.
    const Plane* at(const glm::dvec3& point_m) const;
};

/// Prior of the corrections of poses, in units of the weight of one point.
struct CorrectionPrior {
    Vector6 pull = Vector6::Zero();  ///< stiffness towards no correction
    Vector6 link = Vector6::Zero();  ///< stiffness between poses that are 0.1 s apart
};

class PlaneAdjustment {
public:
    /// @param given poses to which corrections refer
    /// @param start initial poses, accurate enough for the cells of the first round
    /// @param points points of all sweeps, sweep by sweep
    /// @param gauge [poses] true for the poses whose mean correction is zero
    PlaneAdjustment(const PoseTrack& given, const PoseTrack& start, std::vector<ThinPoint> points,
                    std::vector<bool> gauge);

    /// Runs rounds with cells and kernels that shrink from `first` to `last`, then two
    /// more rounds of the last size.
    /// @return the rounds; fewer if proceed() returned false
    std::vector<RegisterRound> run(const RegisterRound& first, const RegisterRound& last,
                                   const std::function<bool(double done)>& proceed);
    /// Sets a prior for the following rounds.
    void set_prior(const CorrectionPrior& prior) { prior_ = prior; }
    PlaneMap planes(const RegisterRound& round) const;
    const PoseTrack& track() const { return track_; }

    /// Finds candidates whose points do not determine their pose (is_placed), or whose
    /// correction differs from the neighbours by more than `largest_m`. Replaces the
    /// corrections of these poses, and of poses that are no candidates, by interpolation
    /// between the nearest other poses.
    /// @param candidates [poses] poses that have points
    /// @return indices of the replaced candidates
    std::vector<std::size_t> replace_lost(const PlaneMap& map, const std::vector<bool>& candidates,
                                          double scale_m, double largest_m);
    /// Makes one step of a single pose: moves its points towards fixed planes and keeps
    /// all other poses.
    void place_pose(const PlaneMap& map, std::size_t pose, const std::vector<ThinPoint>& own, double scale_m);
    /// Returns true if enough of a frame's points lie on planes.
    static bool is_placed(double share, std::size_t n_points);
    /// Returns the share of a frame's points that lie on planes.
    double share_on_planes(const PlaneMap& map, std::span<const ThinPoint> own, double scale_m) const;
    /// Returns how much a pose's correction differs from its neighbours, in metres. The
    /// function compares it with the nearest earlier pose, the nearest later pose and the
    /// interpolation between them, and returns the smallest difference. Returns 0 at an
    /// end of the track.
    /// @param among [poses] poses that count as neighbours
    double stands_out_m(std::size_t pose, const std::vector<bool>& among) const;
    void set_pose(std::size_t pose, const Pose& value) { track_.pose[pose] = value; }

private:
    PoseTrack given_, track_, start_;  // start_: poses before the first round
    std::vector<ThinPoint> points_;
    std::vector<bool> gauge_;
    std::optional<CorrectionPrior> prior_;

    RegisterRound step(RegisterRound round, double shift);
    void add_prior(PoseEquations& equations) const;
    void remove_common_motion();
    void interpolate_corrections(const std::vector<bool>& is_known);
    /// Returns the nearest earlier and later pose among the marked ones, or the pose
    /// itself if there is none.
    static std::pair<std::size_t, std::size_t> neighbours_of(std::size_t pose,
                                                             const std::vector<bool>& among);
    double share_of_time(std::size_t before, std::size_t pose, std::size_t after) const;
};

}  // namespace relidar
