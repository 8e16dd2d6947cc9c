// SPDX-License-Identifier: Apache-2.0
// Poses of a track moved all at once until the points that they place lie on common planes.
#pragma once

#include <optional>
#include <vector>

#include "registration/plane_cells.hpp"

namespace relidar {

/// The planes of one grid.
struct PlaneMap {
    PlaneCells cells;
    std::vector<std::optional<Plane>> planes;   ///< [cells]

    /// The plane of the cell that a point lies in, if it has one.
    const Plane* at(const glm::dvec3& point_m) const;
};

class PlaneAdjustment {
public:
    /// @param points of all frames, frame by frame @param gauge [poses] those whose mean correction stays zero
    PlaneAdjustment(const PoseTrack& start, std::vector<ThinPoint> points, std::vector<bool> gauge);

    /// Rounds with cells and kernels that shrink from the first to the last, then two more of the last size.
    /// @return them; fewer where stop() said so
    std::vector<RegisterRound> run(const RegisterRound& first, const RegisterRound& last, const std::function<bool()>& stop);
    PlaneMap planes(const RegisterRound& round) const;
    const PoseTrack& track() const { return track_; }

    /// Poses of candidates whose own points do not place them (is_placed); they, and poses that are no candidates, take the corrections of
    /// the nearest others, interpolated. @param candidates [poses] those that have points of their own
    std::vector<std::size_t> replace_lost(const PlaneMap& map, const std::vector<bool>& candidates, double scale_m, double largest_m);
    /// One step of a pose alone: its own points towards planes that stay, all else where it is.
    void place_pose(const PlaneMap& map, std::size_t pose, const std::vector<ThinPoint>& own, double scale_m);
    /// Whether enough of a frame's points lie on planes, and the correction of its pose is not larger than it may be.
    bool is_placed(const PlaneMap& map, std::size_t pose, std::span<const ThinPoint> own, double scale_m, double largest_m) const;
    void set_pose(std::size_t pose, const Pose& value) { track_.pose[pose] = value; }

private:
    PoseTrack start_, track_;
    std::vector<ThinPoint> points_;
    std::vector<bool> gauge_;

    RegisterRound step(RegisterRound round, double shift);
    void remove_common_motion();
    void interpolate_corrections(const std::vector<bool>& is_known);
};

}  // namespace relidar
