// SPDX-License-Identifier: Apache-2.0
// What each frame says about a point: seen (a return lies there), seen through (the
// returns above and below it lie well behind it), or nothing. Points that frames see
// through belong to something that moved without a label (docs/method.md section 6).
#pragma once

#include <cstdint>
#include <optional>
#include <unordered_map>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

enum class Sight : char { nothing, seen, seen_through };

/// Directions of a LiDAR in rows and columns. Rows are as its beams are, close or far
/// apart: on the ground a place between two beams is farther than what the lower one
/// meets, and a row without a beam would leave that unsaid.
class BeamGrid {
public:
    BeamGrid() = default;                 ///< no rows: holds no direction
    explicit BeamGrid(const Scan& scan);  ///< of any of its scans

    /// Where a point is seen.
    struct Place {
        int row = 0, column = 0;  ///< the nearest
        int row_below = 0;        ///< it lies between this row and the one above
        bool is_beyond = false;   ///< above or below all rows: no beam was meant for it
    };
    int rows() const { return static_cast<int>(row_rad_.size()); }
    int columns() const { return columns_; }  ///< of a turn
    /// @param point_m [3] sensor frame @return nothing at the sensor itself
    std::optional<Place> place(const glm::dvec3& point_m) const;
    /// Nearest returns. @param scan  in the sensor's frame @return [rows * columns] m, 0
    /// where there is none
    std::vector<float> nearest_m(const Scan& scan) const;

private:
    std::vector<double> row_rad_;  ///< [rows] elevations, falling
    int columns_ = 1;
};

/// Range images of some frames. A point asks at most 64 of them, so that the cost of many
/// points grows with their number alone: frames whose sensor was within 40 m, or little
/// farther than the nearest was, evenly spread in time. Images are made when points near
/// them are announced, so that a process that asks for a part of a log makes those of
/// that part.
class Visibility {
public:
    /// Of a log that stays as it is.
    Visibility(const Sequence& sequence, const std::vector<int>& positions);

    /// Makes the images that some points ask; nothing may be asked of other points.
    /// @param points_m [points] vectors of 3, world
    template <class Points>
    void announce(const Points& points_m) {
        for (const auto& point_m : points_m) want(glm::dvec3(point_m));
        make_wanted();
    }

    struct Votes {
        int seen = 0;
        int seen_through = 0;
        /// Seen through by at least two frames, and by this share of those that see it.
        bool is_seen_through(double share) const {
            return seen_through >= 2 && double(seen_through) >= share * double(seen);
        }
    };
    /// @param point_m [3] world
    Votes votes(const glm::vec3& point_m) const;

    /// Views that a point asks, ascending. @param point_m [3] world @return indices into
    /// the positions given
    const std::vector<std::uint32_t>& views_near(const glm::dvec3& point_m) const;
    /// What one view says of a point, with a margin of decimetres. @param point_m [3]
    /// world
    Sight look(std::uint32_t view, const glm::dvec3& point_m) const;
    /// Whether a view has a return in the direction of a point that is as far away, to
    /// tolerance_m. @param point_m [3] world
    bool has_return_at(std::uint32_t view, const glm::dvec3& point_m, double tolerance_m) const;
    double time_s(std::uint32_t view) const { return views_[view].time_s; }

private:
    struct View {
        double time_s;
        int lidar;
        /// one a sector of the sweep, when the head faces the middle of it; none: not
        /// made yet
        std::vector<Pose> sensor_from_world;
        std::vector<float> range_m;  ///< [rows*columns] nearest return, 0 where there is none
    };
    /// A point as a view sees it: its range, and the returns of the 2 x 3 cells around
    /// it, of the rows between which it lies.
    struct Surroundings {
        double range_m = 0.0;
        float returned_m[6];
        int n = 0;
    };
    /// Views that a tile of the ground asks.
    struct Tile {
        std::vector<std::uint32_t> views;
        bool wanted = false;
    };
    const Sequence& sequence_;
    std::vector<BeamGrid> grids_;  ///< [lidars]
    std::vector<int> positions_;   ///< [views] in the log
    std::vector<View> views_;
    std::unordered_map<std::uint64_t, Tile> tiles_;
    std::vector<std::uint32_t> wanted_;  ///< views to be made; some twice

    void want(const glm::dvec3& point_m);
    void make_wanted();
    void make(View& view, const Frame& frame) const;
    void sort_by_tile();
    Surroundings around(const View& view, const glm::dvec3& point_m) const;
};

}  // namespace relidar
