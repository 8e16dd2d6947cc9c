// SPDX-License-Identifier: Apache-2.0
// Poses of a track moved all at once until the points that they place lie on common
// planes.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "log/registration/plane_cells.hpp"
#include "log/registration/pose_equations.hpp"

namespace relidar {

/// The planes of one grid.
struct PlaneMap {
    PlaneCells cells;
    std::vector<std::optional<Plane>> planes;  ///< [cells]

    /// The plane of the cell that a point lies in, if it has one.
    const Plane* at(const glm::dvec3& point_m) const;
};

/// Prior of the corrections of poses, in units of the weight of one point.
struct CorrectionPrior {
    Vector6 pull = Vector6::Zero();  ///< stiffness towards no correction
    Vector6 link = Vector6::Zero();  ///< stiffness between poses that are 0.1 s apart
};

class PlaneAdjustment {
public:
    /// @param given  what corrections are counted from @param start  where the poses are,
    /// near enough for the first round's cells
    /// @param points of all sweeps, sweep by sweep @param gauge [poses] those whose mean
    /// correction is zero
    PlaneAdjustment(const PoseTrack& given, const PoseTrack& start, std::vector<ThinPoint> points,
                    std::vector<bool> gauge);

    /// Rounds with cells and kernels that shrink from the first to the last, then two
    /// more of the last size.
    /// @return them; fewer where proceed() returned false
    std::vector<RegisterRound> run(const RegisterRound& first, const RegisterRound& last,
                                   const std::function<bool(double done)>& proceed);
    /// Sets a prior for the following rounds.
    void set_prior(const CorrectionPrior& prior) { prior_ = prior; }
    PlaneMap planes(const RegisterRound& round) const;
    const PoseTrack& track() const { return track_; }

    /// Poses of candidates whose own points do not place them (is_placed), or whose
    /// correction stands out by more than largest_m; they, and poses that are no
    /// candidates, move as the nearest others did. @param candidates [poses] those that
    /// have points of their own
    std::vector<std::size_t> replace_lost(const PlaneMap& map, const std::vector<bool>& candidates,
                                          double scale_m, double largest_m);
    /// One step of a pose alone: its own points towards planes that stay, all else where
    /// it is.
    void place_pose(const PlaneMap& map, std::size_t pose, const std::vector<ThinPoint>& own, double scale_m);
    /// Whether enough of a frame's points lie on planes.
    static bool is_placed(double share, std::size_t n_points);
    /// Share of a frame's points that lie on planes.
    double share_on_planes(const PlaneMap& map, std::span<const ThinPoint> own, double scale_m) const;
    /// How far a pose's correction is from that of the nearest pose before, of the
    /// nearest after, among some, and from what lies between them: the least of the
    /// three. 0 at an end.
    double stands_out_m(std::size_t pose, const std::vector<bool>& among) const;
    void set_pose(std::size_t pose, const Pose& value) { track_.pose[pose] = value; }

private:
    PoseTrack given_, track_, start_;  // start_: before the first round
    std::vector<ThinPoint> points_;
    std::vector<bool> gauge_;
    std::optional<CorrectionPrior> prior_;

    RegisterRound step(RegisterRound round, double shift);
    void add_prior(PoseEquations& equations) const;
    void remove_common_motion();
    void interpolate_corrections(const std::vector<bool>& is_known);
    /// The nearest poses before and after one, among some; itself where there is none.
    static std::pair<std::size_t, std::size_t> neighbours_of(std::size_t pose,
                                                             const std::vector<bool>& among);
    double share_of_time(std::size_t before, std::size_t pose, std::size_t after) const;
};

}  // namespace relidar
