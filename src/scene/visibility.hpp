// SPDX-License-Identifier: Apache-2.0
// Decides what each frame observes at a point. A frame "sees" a point if a return lies at
// the point. A frame "sees through" a point if the returns above and below lie well
// behind the point. A point that frames see through belongs to a moving object without a
// label (docs/method.md section 6).
#pragma once

#include <cstdint>
#include <optional>
#include <unordered_map>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

enum class Sight : char { nothing, seen, seen_through };

/// Grid of the directions of a LiDAR. The rows follow the beams, because beams can be
/// unevenly spaced. Evenly spaced rows could contain no beam. Points between two beams
/// would then be compared with the wrong returns.
class BeamGrid {
public:
    BeamGrid() = default;  ///< Makes an empty grid.
    /// Makes the grid from the rays of a scan. Any scan of the LiDAR can be used.
    explicit BeamGrid(const Scan& scan);

    /// Cell of the grid that contains the direction of a point.
    struct Place {
        int row = 0, column = 0;  ///< nearest row and column
        int row_below = 0;        ///< the point lies between this row and the row above it
        /// true if the point lies above or below all rows; no beam can hit such a point
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
    std::vector<float> compute_nearest_m(const Scan& scan) const;

private:
    std::vector<double> row_rad_;  ///< [rows] elevations, descending
    int columns_ = 1;
};

/// Range images of selected frames. Looks up a point in at most 64 frames, to limit the
/// time per point. Uses frames whose sensor was within 40 m, or almost as near as the
/// nearest sensor. These frames are evenly spaced in time. request_images() creates the
/// images that the given points need. Therefore a process that handles a part of a log
/// creates only the images of this part.
class Visibility {
public:
    /// Selects the frames that observe each tile of the ground. Creates no range images
    /// yet. Keeps a reference to `sequence`, so `sequence` must not change.
    Visibility(const Sequence& sequence, const std::vector<int>& positions);

    /// Creates the range images that these points need. After this call, only these
    /// points may be looked up.
    /// @param points_m [points] vectors of 3, world
    template <class Points>
    void request_images(const Points& points_m) {
        for (const auto& point_m : points_m) request_point_images(glm::dvec3(point_m));
        make_requested_images();
    }

    struct Votes {
        int seen = 0;
        int seen_through = 0;
        /// Returns true if enough frames observe empty space at the point. At least two
        /// frames must do so. Their number must also be at least `share` times the number
        /// of frames that have a return at the point.
        bool is_seen_through(double share) const {
            return seen_through >= 2 && double(seen_through) >= share * double(seen);
        }
    };
    /// Counts the frames that have a return at a point, and the frames that observe empty
    /// space there.
    /// @param point_m [3] world
    Votes count_votes(const glm::vec3& point_m) const;

    /// Returns the frames near a point, ascending. The point is looked up in these
    /// frames.
    /// @param point_m [3] world
    /// @return indices into the positions given to the constructor
    const std::vector<std::uint32_t>& find_views_near(const glm::dvec3& point_m) const;
    /// Returns what one frame observes at a point: a return, empty space, or nothing.
    /// Allows an error of several decimetres.
    /// @param point_m [3] world
    Sight look(std::uint32_t view, const glm::dvec3& point_m) const;
    /// Returns true if a frame has a return at a point. The return must be in the
    /// direction of the point. Its range may differ from the range of the point by at
    /// most `tolerance_m`.
    /// @param point_m [3] world
    bool has_return_at(std::uint32_t view, const glm::dvec3& point_m, double tolerance_m) const;
    double time_s(std::uint32_t view) const { return views_[view].time_s; }

private:
    struct View {
        double time_s;
        int lidar;
        /// One pose for each azimuth sector of the sweep, at the time when the LiDAR head
        /// faces the middle of the sector. Empty until the image is created.
        std::vector<Pose> sensor_from_world;
        /// [rows * columns] range of the nearest return, or 0 if a cell has no return
        std::vector<float> range_m;
    };
    /// Range of a point, and the ranges of the returns around it in the range image of a
    /// frame. These returns lie in 6 cells: 3 neighbours in each of the two nearest rows.
    struct Surroundings {
        double range_m = 0.0;
        float returned_m[6];
        int n = 0;
    };
    /// Square tile of the ground, with the frames that can observe points above it.
    struct Tile {
        std::vector<std::uint32_t> views;
        bool wanted = false;
    };
    const Sequence& sequence_;
    std::vector<BeamGrid> grids_;  ///< [lidars]
    std::vector<int> positions_;   ///< [views] index of each view's frame in the log
    std::vector<View> views_;
    std::unordered_map<std::uint64_t, Tile> tiles_;
    /// indices of the views whose images must still be created; can contain duplicates
    std::vector<std::uint32_t> wanted_;

    void request_point_images(const glm::dvec3& point_m);
    void make_requested_images();
    void make(View& view, const Frame& frame) const;
    void sort_views_by_tile();
    Surroundings find_surroundings(const View& view, const glm::dvec3& point_m) const;
};

}  // namespace relidar
