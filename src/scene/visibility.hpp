// SPDX-License-Identifier: Apache-2.0
// Decides what each frame observes at a point: a return, or empty space if the returns
// above and below lie well behind the point. Points where frames observe empty space
// belong to moving objects (docs/method.md section 6).
#pragma once

#include <unordered_map>

#include <relidar/log/log.hpp>

namespace relidar {

enum class PointVisibility : char { unknown, occupied, empty };

/// Grid of the directions of a LiDAR. Each row has the elevation of a beam.
class BeamGrid {
public:
    BeamGrid() = default;
    explicit BeamGrid(const Scan& scan);  ///< any scan of the LiDAR

    /// Cell that contains the direction of a point.
    struct BeamGridCell {
        int row = 0, column = 0;  ///< nearest row and column
        int row_below = 0;        ///< the point lies between this row and the row above it
        bool is_beyond = false;   ///< above or below all rows; no beam can hit such a point
    };
    int rows() const { return static_cast<int>(row_rad_.size()); }
    int columns() const { return columns_; }  ///< columns per turn
    /// Returns the cell in the direction of a point, or nothing at the sensor position.
    /// @param point_m [3] sensor frame
    std::optional<BeamGridCell> find_grid_cell(const glm::dvec3& point_m) const;
    std::size_t cell_index(int row, int column) const {
        return std::size_t(row) * std::size_t(columns_) + std::size_t(column);
    }
    /// Returns the nearest range in each cell, [rows * columns] metres, or 0.
    std::vector<float> nearest_ranges_m(const Scan& scan) const;

private:
    std::vector<double> row_rad_;  ///< [rows] elevations, descending
    int columns_ = 1;
};

/// Compares a point with the range images of at most 64 frames, evenly spaced in time.
/// Their sensors are within 40 m, or within 1.25 times the smallest distance.
class VisibilityChecker {
public:
    /// Selects the frames that can observe each tile of the ground. `log` is not
    /// copied and must not change.
    /// @param positions indices of the frames to use, in `log.frames`
    VisibilityChecker(const Log& log, const std::vector<int>& positions);

    /// Creates the images for these points (world). Only they may be looked up.
    template <class Points>
    void make_images(const Points& points_m) {
        for (const auto& point_m : points_m) request_images(glm::dvec3(point_m));
        make_requested();
    }

    struct VisibilityVotes {
        int n_occupied = 0, n_empty = 0;
        /// Returns true if at least two frames observe empty space, and at least
        /// `min_vote_ratio` times the number of frames with a return at the point.
        bool is_empty_space(double min_vote_ratio) const {
            return n_empty >= 2 && double(n_empty) >= min_vote_ratio * double(n_occupied);
        }
    };
    /// Counts the frames that have a return, or observe empty space, at a point (world).
    VisibilityVotes count_votes(const glm::vec3& point_m) const;

    /// Returns the views of a point (world), ascending indices into `positions`.
    const std::vector<std::uint32_t>& find_views_near(const glm::dvec3& point_m) const;
    /// Returns what one frame observes at a point (world), with an error of decimetres.
    PointVisibility classify_point(std::uint32_t view_index, const glm::dvec3& point_m) const;
    /// Returns true if a frame has a return in the direction of a point (world) whose
    /// range differs by at most `tolerance_m`.
    bool has_return_at(std::uint32_t view_index, const glm::dvec3& point_m, double tolerance_m) const;
    double view_time_s(std::uint32_t view_index) const { return views_[view_index].time_s; }

private:
    struct VisibilityImage {
        double time_s;
        int lidar;
        /// [azimuth sectors of the sweep] when the LiDAR head faces the middle of the
        /// sector. Empty until make_image() is called.
        std::vector<Pose> sensor_from_world;
        std::vector<float> range_m;  ///< [rows * columns] see nearest_ranges_m()

        const Pose& facing_pose(const glm::dvec3& point_m) const;
    };
    /// Range of a point, and the ranges of the returns in the six cells around it.
    struct NeighbourRanges {
        double range_m = 0.0;
        float returned_m[6];
        int n = 0;
    };
    /// Square tile of the ground, with the frames that can observe points above it.
    struct GroundTile {
        std::vector<std::uint32_t> views;
        bool is_requested = false;
    };
    const Log& log_;
    std::vector<BeamGrid> grids_;  ///< [lidars]
    std::vector<int> positions_;   ///< [views] index of each view's frame in the log
    std::vector<VisibilityImage> views_;
    std::unordered_map<std::uint64_t, GroundTile> tiles_;
    /// indices of the views whose images must still be created; can contain duplicates
    std::vector<std::uint32_t> requested_views_;

    void request_images(const glm::dvec3& point_m);
    void make_requested();
    void make_image(VisibilityImage& view, const Frame& frame) const;
    void select_frames();
    NeighbourRanges ranges_around(const VisibilityImage& view, const glm::dvec3& point_m) const;
};

}  // namespace relidar
