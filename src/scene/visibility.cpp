// SPDX-License-Identifier: Apache-2.0
#include "scene/visibility.hpp"

#include <numeric>

#include "base/geometry/cell_key.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

// Limits of the size of a grid. A scan without rows gets kEvenRows rows.
constexpr int kMostRows = 96, kEvenRows = 64, kFewestColumns = 64, kMostColumns = 1024;
// Ratio (columns of a range image per turn) / (rays per turn in a scan row). The 2 x 3
// cells around a point then contain four or five returns: two rows of 3 / (4/3) rays.
constexpr double kCellsPerRay = 4.0 / 3.0;
constexpr double kBeamMargin_rad = 0.002;  // margin at the outermost beams, about the width of a beam
constexpr int kMinReturns = 3;       // the 2 x 3 cells around a point must contain at least this many returns
constexpr int kAzimuthSectors = 64;  // number of azimuth sectors of a sweep with one sensor position each
// A frame finds a point empty if all its returns in this direction are farther behind the
// point than this multiple of the range error `margin`.
constexpr double kMinBehindMargins = 1.5;
constexpr double kGroundTile_m = 8.0;  // edge of a ground tile; points above a tile use the same frames
// Maximum distance between a sensor and the tiles for which its frame is used. Farther
// away, even a person has only one or two returns.
constexpr double kMaxTileDistance_m = 40.0;
// Farther frames are used up to this multiple of the distance of the nearest frame, so
// that distant tiles have frames too.
constexpr double kMaxDistanceRatio = 1.25;
constexpr std::size_t kMostViews = 64;  // per tile

double elevation_rad(const glm::vec3& direction) {
    return std::asin(std::clamp(double(direction.z), -1.0, 1.0));
}

/// Returns the elevations of the rows of a scan, descending. Without rows, returns evenly
/// spaced elevations over the field of view.
std::vector<double> row_elevations_rad(const RayTable& rays) {
    std::vector<double> rows;
    if (rays.rows > 1) {
        rows.resize(std::size_t(rays.rows));
        for (std::size_t ray = 0; ray < rays.size(); ++ray)
            rows[ray / std::size_t(rays.columns)] += elevation_rad(rays.direction[ray]) / rays.columns;
    } else {
        double low = 1e9, high = -1e9;
        for (const glm::vec3& d : rays.direction) {
            low = std::min(low, elevation_rad(d));
            high = std::max(high, elevation_rad(d));
        }
        for (int k = 0; k < kEvenRows; ++k) rows.push_back(high + (low - high) * k / (kEvenRows - 1));
    }
    std::sort(rows.begin(), rows.end(), std::greater<>());
    return rows;
}

/// Returns the number of columns of a grid per turn. A column is a little narrower than
/// the azimuth between neighbouring rays (kCellsPerRay), measured in the middle row.
int choose_columns(const RayTable& rays) {
    if (rays.rows <= 1 || rays.columns <= 1) return kMostColumns;
    const std::size_t first_of_middle_row = std::size_t(rays.rows / 2) * std::size_t(rays.columns);
    const auto azimuth = [&](int column) {
        const glm::vec3 d = rays.direction[first_of_middle_row + std::size_t(column)];
        return std::atan2(double(d.y), double(d.x));
    };
    double covered_rad = 0.0;  // azimuth between the first and the last ray of the row
    for (int c = 1; c < rays.columns; ++c)
        covered_rad += std::abs(std::remainder(azimuth(c) - azimuth(c - 1), 2.0 * kPi));
    const double columns = kCellsPerRay * 2.0 * kPi * (rays.columns - 1) / std::max(covered_rad, 1e-9);
    return static_cast<int>(std::clamp(std::round(columns), double(kFewestColumns), double(kMostColumns)));
}

glm::dvec3 tile_centre(const glm::dvec3& point_m) {
    return kGroundTile_m *
           (glm::floor(glm::dvec3(point_m.x, point_m.y, 0.0) / kGroundTile_m) + glm::dvec3(0.5, 0.5, 0.0));
}

/// A view (frame) that can observe a tile, and its distance.
struct ViewInRange {
    std::uint32_t view;
    double distance_m;
};

/// Returns the views whose sensors are near a tile, or about as near as the nearest one.
/// Of more than kMostViews (sorted by time), returns kMostViews that are evenly spaced.
std::vector<std::uint32_t> choose_views(const std::vector<ViewInRange>& in_range) {
    const double nearest_m = std::ranges::min(in_range, {}, &ViewInRange::distance_m).distance_m,
                 max_distance_m = std::max(kMaxTileDistance_m, kMaxDistanceRatio * nearest_m);
    std::vector<std::uint32_t> near, chosen;
    for (const ViewInRange& candidate : in_range)
        if (candidate.distance_m <= max_distance_m) near.push_back(candidate.view);
    if (near.size() <= kMostViews) return near;
    for (std::size_t k = 0; k < kMostViews; ++k) chosen.push_back(near[k * near.size() / kMostViews]);
    return chosen;
}

}  // namespace

/// Derives the rows and the columns of the grid from the rays of a scan.
BeamGrid::BeamGrid(const Scan& scan) {
    if (scan.rays.direction.empty()) return;
    columns_ = choose_columns(scan.rays);
    // Joins beams to at most kMostRows rows, because some scans have hundreds of beams.
    const std::vector<double> elevations = row_elevations_rad(scan.rays);  // descending
    const double min_height_rad = (elevations.front() - elevations.back()) / kMostRows;
    for (auto first = elevations.begin(); first != elevations.end();) {
        // The next row begins with the first beam that is clearly lower. It must be lower
        // even if the minimum height is 0, because otherwise this row would be empty.
        const auto end = std::find_if(first, elevations.end(), [&](double elevation) {
            return elevation < *first && *first - elevation >= min_height_rad;
        });
        row_rad_.push_back(std::accumulate(first, end, 0.0) / double(end - first));
        first = end;
    }
}

std::optional<BeamGrid::BeamGridCell> BeamGrid::find_grid_cell(const glm::dvec3& point_m) const {
    const double range_m = glm::length(point_m);
    if (!(range_m > 0.0) || row_rad_.empty()) return std::nullopt;
    const double elevation = std::asin(std::clamp(point_m.z / range_m, -1.0, 1.0));
    BeamGridCell cell;
    cell.is_beyond =
        elevation > row_rad_.front() + kBeamMargin_rad || elevation < row_rad_.back() - kBeamMargin_rad;
    // The rows descend, so this is the first row below the point.
    cell.row_below = static_cast<int>(
        std::upper_bound(row_rad_.begin(), row_rad_.end(), elevation, std::greater<>()) - row_rad_.begin());
    const int row_above = cell.row_below - 1;
    const auto angle_to_row = [&](int row) {  // rows outside the grid are never the nearest
        return row < 0 || row >= rows() ? 1e9 : std::abs(row_rad_[std::size_t(row)] - elevation);
    };
    cell.row = angle_to_row(cell.row_below) < angle_to_row(row_above) ? cell.row_below : row_above;
    // Column 0 is at azimuth pi. The azimuth decreases with the column.
    const double turn = (1.0 - std::atan2(point_m.y, point_m.x) / kPi) / 2.0;  // 0 to 1
    cell.column = static_cast<int>(std::lround(turn * columns_) % columns_);
    return cell;
}

std::vector<float> BeamGrid::nearest_ranges_m(const Scan& scan) const {
    std::vector<float> nearest(std::size_t(rows()) * std::size_t(columns_));
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const glm::vec3 point = scan.return_point(ray);
        const std::optional<BeamGridCell> cell = find_grid_cell(glm::dvec3(point));
        if (!cell) continue;
        float& nearest_m = nearest[cell_index(cell->row, cell->column)];
        // From the sensor's origin, because rays can start elsewhere.
        const float range_m = glm::length(point);
        nearest_m = nearest_m > 0.0f ? std::min(nearest_m, range_m) : range_m;
    }
    return nearest;
}

/// Selects the frames for each tile of the ground. make_images() makes their images.
VisibilityChecker::VisibilityChecker(const Log& log, const std::vector<int>& positions)
    : log_(log), grids_(log.lidars.size()), positions_(positions) {
    for (const int position : positions) {
        const Frame& frame = log.frames[std::size_t(position)];
        BeamGrid& grid = grids_[std::size_t(frame.lidar)];  // of its first frame with rays
        if (grid.rows() == 0) grid = BeamGrid(frame.scan);
        views_.push_back(
            {.time_s = frame.time_s, .lidar = frame.lidar, .sensor_from_world = {}, .range_m = {}});
    }
    select_frames();
}

/// Notes all views of the tile below a point whose images do not exist yet.
void VisibilityChecker::request_images(const glm::dvec3& point_m) {
    const auto entry = tiles_.find(grid_key(tile_centre(point_m), kGroundTile_m));
    if (entry == tiles_.end() || entry->second.is_requested) return;
    GroundTile& tile = entry->second;
    tile.is_requested = true;
    for (const std::uint32_t view : tile.views)
        if (views_[view].sensor_from_world.empty()) requested_views_.push_back(view);
}

/// Creates the images that request_images() has noted, each once.
void VisibilityChecker::make_requested() {
    std::sort(requested_views_.begin(), requested_views_.end());
    requested_views_.erase(std::unique(requested_views_.begin(), requested_views_.end()),
                           requested_views_.end());
    parallel_for(static_cast<int>(requested_views_.size()), [&](int index) {
        const std::uint32_t view = requested_views_[std::size_t(index)];
        make_image(views_[view], log_.frames[std::size_t(positions_[view])]);
    });
    requested_views_.clear();
}

/// Stores the nearest range in each cell of a frame, and the sensor pose when the LiDAR
/// head faces the middle of each azimuth sector, because the vehicle moves meanwhile.
void VisibilityChecker::make_image(VisibilityImage& view, const Frame& frame) const {
    const Pose& mounted = log_.lidar_of(frame).vehicle_from_sensor;
    const int n_sectors = log_.rolling_shutter ? kAzimuthSectors : 1;
    for (int sector = 0; sector < n_sectors; ++sector) {
        const double azimuth = 2.0 * kPi * ((sector + 0.5) / n_sectors - 0.5);
        const glm::dvec3 middle_of_sector(std::cos(azimuth), std::sin(azimuth), 0.0);
        const double time_s = facing_time_s(log_, middle_of_sector, timing_of(frame));
        view.sensor_from_world.push_back(inverse(log_.world_from_vehicle.mounted_pose_at(time_s, mounted)));
    }
    view.range_m = grids_[std::size_t(frame.lidar)].nearest_ranges_m(frame.scan);
}

/// Selects the views (frames) of each tile, a square of the ground: those whose sensors
/// are nearest, among the sensors whose maximum range reaches the tile.
void VisibilityChecker::select_frames() {
    std::unordered_map<std::uint64_t, std::vector<ViewInRange>> in_range_of_tile;
    for (std::uint32_t v = 0; v < views_.size(); ++v) {
        const Lidar& lidar = log_.lidars[std::size_t(views_[v].lidar)];
        const double farthest_m = lidar.sensor.max_range_m + kGroundTile_m;
        glm::dvec3 sensor =
            log_.world_from_vehicle.mounted_pose_at(views_[v].time_s, lidar.vehicle_from_sensor).translation;
        sensor.z = 0.0;  // tiles are at z = 0, and distances horizontal
        for (double dx = -farthest_m; dx <= farthest_m; dx += kGroundTile_m)
            for (double dy = -farthest_m; dy <= farthest_m; dy += kGroundTile_m) {
                const glm::dvec3 tile = tile_centre(sensor + glm::dvec3(dx, dy, 0.0));
                const double distance_m = glm::distance(tile, sensor);
                if (distance_m < farthest_m)
                    in_range_of_tile[grid_key(tile, kGroundTile_m)].push_back({v, distance_m});
            }
    }
    for (const auto& [tile, in_range] : in_range_of_tile) tiles_[tile].views = choose_views(in_range);
}

const std::vector<std::uint32_t>& VisibilityChecker::find_views_near(const glm::dvec3& point_m) const {
    static const std::vector<std::uint32_t> none;
    const auto tile = tiles_.find(grid_key(tile_centre(point_m), kGroundTile_m));
    return tile == tiles_.end() ? none : tile->second.views;
}

/// Returns the sensor pose when the LiDAR head faced a point: that of its azimuth sector.
const Pose& VisibilityChecker::VisibilityImage::facing_pose(const glm::dvec3& point_m) const {
    const auto n_sectors = static_cast<int>(sensor_from_world.size());
    // The sector depends on the sensor pose and the other way round. The pose in the
    // middle of the sweep is accurate enough to find the sector.
    const glm::dvec3 rough_m = sensor_from_world[std::size_t(n_sectors / 2)] * point_m;
    const double turn = 0.5 + std::atan2(rough_m.y, rough_m.x) / (2.0 * kPi);  // 0 to 1
    return sensor_from_world[std::size_t(std::clamp(static_cast<int>(turn * n_sectors), 0, n_sectors - 1))];
}

/// Returns the range of a point and the returns in the 2 x 3 cells around its direction:
/// the rows above and below it, and three columns. No returns if no beam can hit it.
VisibilityChecker::NeighbourRanges VisibilityChecker::ranges_around(const VisibilityImage& view,
                                                                    const glm::dvec3& point_m) const {
    const glm::dvec3 in_sensor_m = view.facing_pose(point_m) * point_m;
    const BeamGrid& grid = grids_[std::size_t(view.lidar)];
    const std::optional<BeamGrid::BeamGridCell> cell = grid.find_grid_cell(in_sensor_m);
    NeighbourRanges result;
    if (!cell || cell->is_beyond) return result;
    result.range_m = glm::length(in_sensor_m);
    const int first_row = std::max(cell->row_below - 1, 0),
              last_row = std::min(cell->row_below, grid.rows() - 1);
    for (int row = first_row; row <= last_row; ++row)
        for (int offset = -1; offset <= 1; ++offset) {
            const int column = (cell->column + offset + grid.columns()) % grid.columns();
            const float range_m = view.range_m[grid.cell_index(row, column)];
            if (range_m > 0.0f) result.returned_m[result.n++] = range_m;
        }
    return result;
}

PointVisibility VisibilityChecker::classify_point(std::uint32_t view_index, const glm::dvec3& point_m) const {
    const NeighbourRanges here = ranges_around(views_[view_index], point_m);
    if (here.n < kMinReturns) return PointVisibility::unknown;
    const auto [nearest, farthest] = std::minmax_element(here.returned_m, here.returned_m + here.n);
    // The margin, metres, allows errors of poses, of oblique surfaces and of wide beams.
    const double range_m = here.range_m, margin_m = 0.3 + 0.02 * range_m;
    // All returns around the point are clearly behind it, so the space is empty.
    if (*nearest > range_m + kMinBehindMargins * margin_m) return PointVisibility::empty;
    const bool is_among_returns = range_m > *nearest - margin_m && range_m < *farthest + margin_m;
    return is_among_returns ? PointVisibility::occupied : PointVisibility::unknown;  // or hidden
}

bool VisibilityChecker::has_return_at(std::uint32_t view, const glm::dvec3& point_m, double within_m) const {
    const NeighbourRanges here = ranges_around(views_[view], point_m);
    return std::any_of(here.returned_m, here.returned_m + here.n,
                       [&](float returned) { return std::abs(returned - here.range_m) < within_m; });
}

VisibilityChecker::VisibilityVotes VisibilityChecker::count_votes(const glm::vec3& point_m) const {
    VisibilityVotes votes;
    for (const std::uint32_t view : find_views_near(glm::dvec3(point_m))) {
        const PointVisibility sight = classify_point(view, glm::dvec3(point_m));
        votes.n_occupied += sight == PointVisibility::occupied;
        votes.n_empty += sight == PointVisibility::empty;
    }
    return votes;
}

}  // namespace relidar
