// SPDX-License-Identifier: Apache-2.0
// Decides what each frame observes at a point. `seen` means that a return is at the
// point. `seen_through` means that the returns above and below are well behind the point.
// Points that frames see through belong to moving objects without labels (docs/method.md
// section 6).
#pragma once

#include <cstdint>
#include <optional>
#include <unordered_map>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

enum class Sight : char { nothing, seen, seen_through };

/// Grid of the directions of a LiDAR. The rows follow the beams, which can be unevenly
/// spaced. On the ground, a point between two beams is farther away than the return of
/// the lower beam. Evenly spaced rows without a beam would not show this.
class BeamGrid {
public:
    BeamGrid() = default;  ///< Makes an empty grid.
    /// Makes the grid from the rays of a scan. Any scan of the LiDAR can be used.
    explicit BeamGrid(const Scan& scan);

    /// Cell of the grid that contains the direction of a point.
    struct Place {
        int row = 0, column = 0;  ///< nearest row and column
        int row_below = 0;        ///< the point lies between this row and the row above
        /// true if the point lies above or below all rows, so that no beam can hit it
        bool is_beyond = false;
    };
    int rows() const { return static_cast<int>(row_rad_.size()); }
    int columns() const { return columns_; }  ///< columns per turn
    /// Returns the cell of a point. Returns nothing if the point is the position of the
    /// sensor.
    /// @param point_m [3] sensor frame
    std::optional<Place> place(const glm::dvec3& point_m) const;
    /// Returns the range of the nearest return in each cell.
    /// @param scan scan in the sensor's frame
    /// @return [rows * columns] metres, 0 if a cell has no return
    std::vector<float> nearest_m(const Scan& scan) const;

private:
    std::vector<double> row_rad_;  ///< [rows] elevations, descending
    int columns_ = 1;
};

/// Range images of selected frames. Looks a point up in at most 64 frames, so that the
/// cost per point is limited. Uses frames whose sensor was within 40 m, or almost as near
/// as the nearest sensor. These frames are evenly spaced in time. announce() creates the
/// images near the given points. Therefore a process that handles a part of a log creates
/// only the images of that part.
class Visibility {
public:
    /// Selects the frames for each ground tile of a log, but creates no images. Keeps a
    /// reference to `sequence`, which must not change.
    Visibility(const Sequence& sequence, const std::vector<int>& positions);

    /// Creates the range images for these points. Only these points may be looked up
    /// afterwards.
    /// @param points_m [points] vectors of 3, world
    template <class Points>
    void announce(const Points& points_m) {
        for (const auto& point_m : points_m) want(glm::dvec3(point_m));
        make_requested_images();
    }

    struct Votes {
        int seen = 0;
        int seen_through = 0;
        /// Returns true if enough frames see through the point. At least two frames must
        /// do so, and at least `share` times as many frames as see a return there.
        bool is_seen_through(double share) const {
            return seen_through >= 2 && double(seen_through) >= share * double(seen);
        }
    };
    /// Counts the frames that see a return at a point, and the frames that see through
    /// the point.
    /// @param point_m [3] world
    Votes votes(const glm::vec3& point_m) const;

    /// Returns the frames in which a point is looked up, ascending.
    /// @param point_m [3] world
    /// @return indices into the positions given to the constructor
    const std::vector<std::uint32_t>& find_views_near(const glm::dvec3& point_m) const;
    /// Returns what one frame observes at a point: a return, an empty space, or nothing.
    /// Allows an error of decimetres.
    /// @param point_m [3] world
    Sight look(std::uint32_t view, const glm::dvec3& point_m) const;
    /// Returns true if a frame has a return in the direction of a point and at the same
    /// range, up to `tolerance_m`.
    /// @param point_m [3] world
    bool has_return_at(std::uint32_t view, const glm::dvec3& point_m, double tolerance_m) const;
    double time_s(std::uint32_t view) const { return views_[view].time_s; }

private:
    struct View {
        double time_s;
        int lidar;
        /// One pose for each azimuth sector of the sweep, at the time when the LiDAR's
        /// head faces the middle of the sector. Empty until the image is made.
        std::vector<Pose> sensor_from_world;
        /// [rows * columns] range of the nearest return, or 0 if a cell has no return
        std::vector<float> range_m;
    };
    /// Range of a point in a view, and the ranges of the returns around it. The returns
    /// are in 2 x 3 cells of the two nearest rows.
    struct Surroundings {
        double range_m = 0.0;
        float returned_m[6];
        int n = 0;
    };
    /// Frames in which the points of a ground tile are looked up.
    struct Tile {
        std::vector<std::uint32_t> views;
        bool wanted = false;
    };
    const Sequence& sequence_;
    std::vector<BeamGrid> grids_;  ///< [lidars]
    std::vector<int> positions_;   ///< [views] index of each view's frame in the log
    std::vector<View> views_;
    std::unordered_map<std::uint64_t, Tile> tiles_;
    std::vector<std::uint32_t> wanted_;  ///< views whose images are pending; can contain duplicates

    void want(const glm::dvec3& point_m);
    void make_requested_images();
    void make(View& view, const Frame& frame) const;
    void sort_by_tile();
    Surroundings around(const View& view, const glm::dvec3& point_m) const;
};

}  // namespace relidar
