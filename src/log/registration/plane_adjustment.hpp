// SPDX-License-Identifier: Apache-2.0
// Optimises all poses of a track together, so that the points of all scans lie on common
// planes (bundle adjustment).
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

    /// Returns the plane of the cell that contains a point, or null if there is none.
    const Plane* at(const glm::dvec3& point_m) const;
};

/// Prior for pose corrections. Its weights are relative to the weight of one point.
struct CorrectionPrior {
    Vector6 pull = Vector6::Zero();  ///< weight of the term that pulls each correction to zero
    /// weight of the term that makes the corrections of consecutive poses similar, for
    /// poses 0.1 s apart
    Vector6 link = Vector6::Zero();
};

class PlaneAdjustment {
public:
    /// Prepares the optimisation of a track.
    /// @param initial_track poses that the corrections refer to
    /// @param start initial poses, accurate enough for the cells of the first round
    /// @param points points of all sweeps, sweep by sweep
    /// @param gauge [poses] true for poses whose mean correction is kept at zero
    PlaneAdjustment(const PoseTrack& initial_track, const PoseTrack& start, std::vector<ThinPoint> points,
                    std::vector<bool> gauge);

    /// Runs rounds in which the cell size and the scale of the robust kernel decrease
    /// from `first` to `last`, and two more rounds with `last`.
    /// @return statistics of the rounds; fewer rounds if proceed() returned false
    std::vector<RegisterRound> run(const RegisterRound& first, const RegisterRound& last,
                                   const std::function<bool(double done)>& proceed);
    /// Sets the prior for the pose corrections of the next rounds.
    void set_prior(const CorrectionPrior& prior) { prior_ = prior; }
    PlaneMap planes(const RegisterRound& round) const;
    const PoseTrack& track() const { return track_; }

    /// Finds poses that the registration could not determine. Too few points of such a
    /// pose lie on planes, or its correction differs from the neighbouring corrections by
    /// more than `largest_m`. The corrections of these poses are replaced by
    /// interpolation between the nearest other poses. Poses that are not candidates are
    /// interpolated too.
    /// @param candidates [poses] poses that have points
    /// @return indices of the replaced candidates
    std::vector<std::size_t> replace_lost_poses(const PlaneMap& map, const std::vector<bool>& candidates,
                                                double scale_m, double largest_m);
    /// Moves one pose by a Gauss-Newton step that moves its points towards fixed planes.
    /// All other poses stay unchanged.
    void align_pose_to_planes(const PlaneMap& map, std::size_t pose, const std::vector<ThinPoint>& points,
                              double scale_m);
    /// Returns true if enough points of a scan lie on planes to determine its pose.
    /// @param share share of the points that lie on planes
    static bool is_placed(double share, std::size_t n_points);
    /// Returns the share of a scan's points that lie on planes of a map.
    double compute_fraction_on_planes(const PlaneMap& map, std::span<const ThinPoint> points,
                                      double scale_m) const;
    /// Returns the distance in metres between the corrections of a pose and of its
    /// neighbours: the minimum over the earlier neighbour, the later one, and their
    /// interpolation. Returns 0 at an end of the track.
    /// @param selected [poses] poses that count as neighbours
    double compute_deviation_m(std::size_t pose, const std::vector<bool>& selected) const;
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
    /// Returns the nearest earlier and the nearest later pose that `selected` marks. If
    /// one side has none, returns `pose` for this side.
    static std::pair<std::size_t, std::size_t> find_neighbour_poses(std::size_t pose,
                                                                    const std::vector<bool>& selected);
    double compute_time_fraction(std::size_t before, std::size_t pose, std::size_t after) const;
};

}  // namespace relidar
