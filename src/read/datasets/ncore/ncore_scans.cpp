// SPDX-License-Identifier: Apache-2.0
// A frame stores, in the order of measurement, the direction and the time of each ray,
// its row and column in the model, and up to several returns. Directions are those at the
// time of the ray, without motion compensation.
#include "read/datasets/ncore/ncore_scans.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/median.hpp"
#include "read/scans/robust_line.hpp"

namespace relidar::ncore {
namespace {

constexpr std::size_t kMostReturns = 8;
constexpr double kNearest_m = 1e-3;               // A nearer point has no direction from its beam.
constexpr double kLengthTolerance = 1e-2;         // of a direction, which has length 1
constexpr double kMaxDeviation_steps = 1.0;       // of a column from its place in equal steps
constexpr std::int64_t kMostLate_us = 1'000'000;  // largest time between a ray and its frame

/// Reads a list of n angles in radians.
std::vector<double> read_angles(const JsonField& field, std::size_t n) {
    std::vector<double> angles = field.numbers();
    if (angles.size() != n)
        field.reject(fmt::format("found {} angles", angles.size()), fmt::format("expected {}", n));
    for (const double angle : angles)
        if (!(std::abs(angle) <= 4.0 * kPi)) field.reject(fmt::format("found {}", angle), "expected radians");
    return angles;
}

/// Returns which returns of a frame are valid. Reads a mask of packed bits, in which the
/// highest bit of a byte is the first. Without a mask, all returns are valid.
std::vector<bool> read_valid(const Component& lidar, const std::string& frame, std::size_t n) {
    std::vector<bool> valid(n, true);
    const std::string path = frame + "/ray_bundle_returns_valid_mask_packed";
    if (!lidar.store->has_key(path + "/.zarray")) return valid;
    const auto bytes = read_zarr_array<std::uint8_t>(*lidar.store, path, {(n + 7) / 8});
    for (std::size_t i = 0; i < n; ++i) valid[i] = (bytes[i / 8] >> (7 - i % 8) & 1) != 0;
    return valid;
}

/// Returns the number of columns in a full turn of the head, or nothing if the columns of
/// the model are not in nearly equal steps. A model can cover only a part of the turn.
std::optional<int> count_columns(const SpinningModel& model) {
    const std::size_t n_columns = model.azimuth_rad.size();
    std::vector<double> steps_rad;
    for (std::size_t j = 1; j < n_columns; ++j)
        steps_rad.push_back(
            std::remainder(model.turn_sign() * (model.azimuth_rad[j] - model.azimuth_rad[j - 1]), 2.0 * kPi));
    const double step_rad = steps_rad.empty() ? 0.0 : compute_median(std::move(steps_rad));
    // With smaller steps, the image of a full turn would have more than kMaxRays rays.
    const double least_step_rad = 2.0 * kPi * double(model.beams.size()) / double(kMaxRays);
    if (!(step_rad > least_step_rad)) return std::nullopt;
    const int turn_columns = int(std::lround(2.0 * kPi / step_rad));
    if (n_columns > std::size_t(turn_columns)) return std::nullopt;
    for (std::size_t j = 0; j < n_columns; ++j) {
        const double error_rad =
            std::remainder(model.azimuth_rad[j] - model.even_azimuth_rad(j, turn_columns), 2.0 * kPi);
        if (std::abs(error_rad) > kMaxDeviation_steps * 2.0 * kPi / turn_columns) return std::nullopt;
    }
    return turn_columns;
}

/// Limits the field of view of a sensor to the azimuths of its rays, unless the model has
/// a full turn. A ray points to the azimuth of its column plus the azimuth offset of its
/// row, rounded to columns. So the rows with the extreme offsets widen the view.
void limit_view(SpinningSensor& sensor, const SpinningModel& model) {
    const double step_rad = 2.0 * kPi / sensor.columns;
    const auto offset_rad = [&](const Beam& beam) { return step_rad * offset_columns(beam, sensor.columns); };
    const auto [right, left] = std::ranges::minmax(sensor.beams, {}, offset_rad);
    const double right_rad = offset_rad(right), left_rad = offset_rad(left);
    const double width_rad = double(model.azimuth_rad.size() - 1) * step_rad + left_rad - right_rad;
    // In a full turn, the last ray is a step before the first; half a step for rounding.
    if (width_rad >= 2.0 * kPi - 1.5 * step_rad) return;
    // A clockwise head reaches the azimuths of the rays that are farthest left first.
    const double begin_rad = model.azimuth_rad.front() + (model.is_clockwise ? left_rad : right_rad);
    sensor.azimuth_rad = {{begin_rad, begin_rad + model.turn_sign() * width_rad}};
}

/// Measured minus nominal times of the rays of a column, positive if they were late.
struct ColumnDelay {
    double sum_s = 0.0, n_rays = 0.0;
};

/// Returns the mean delay of each column. A column without a ray gets the delay of the
/// column before, or of the first column with a ray. Returns an empty list if no column
/// has a ray.
std::vector<double> fill_column_delays(const std::vector<ColumnDelay>& columns) {
    auto last_with_ray =
        std::ranges::find_if(columns, [](const ColumnDelay& column) { return column.n_rays > 0.0; });
    if (last_with_ray == columns.end()) return {};
    std::vector<double> delay_s;
    for (auto column = columns.begin(); column != columns.end(); ++column) {
        if (column->n_rays > 0.0) last_with_ray = column;
        delay_s.push_back(last_with_ray->sum_s / last_with_ray->n_rays);
    }
    return delay_s;
}

}  // namespace

std::vector<std::size_t> SpinningModel::rows_by_height() const {
    std::vector<std::size_t> rows(beams.size());
    std::iota(rows.begin(), rows.end(), std::size_t(0));
    std::ranges::stable_sort(rows, std::greater{}, [&](std::size_t row) { return beams[row].elevation_rad; });
    return rows;
}

std::optional<SpinningModel> read_model(const NcoreSequence& sequence, const std::string& lidar_name) {
    for (const Component& component : sequence.list_components("intrinsics")) {
        const ZarrJson attributes = component.attributes("lidars/" + lidar_name);
        if (attributes.json.empty()) continue;
        const JsonField root = attributes.root(), type = root.at("lidar_model_type"),
                        parameters = root.at("lidar_model_parameters");
        if (type.short_text(99) != "row-offset-spinning")
            type.reject("found '" + quote(type.short_text(99)) + "'", "expected 'row-offset-spinning'");
        const auto n_rows = std::size_t(parameters.at("n_rows").integer_in(1, 65535)),
                   n_columns =
                       std::size_t(parameters.at("n_columns").integer_in(1, std::int64_t(kMaxRays / n_rows)));
        const std::vector<double> elevation_rad = read_angles(parameters.at("row_elevations_rad"), n_rows),
                                  offset_rad = read_angles(parameters.at("row_azimuth_offsets_rad"), n_rows);
        if (!std::ranges::is_sorted(elevation_rad, std::greater{}))
            parameters.at("row_elevations_rad")
                .reject("found another order", "expected the highest row first");
        SpinningModel model;
        for (std::size_t row = 0; row < n_rows; ++row)
            model.beams.push_back(
                {.elevation_rad = elevation_rad[row], .azimuth_offset_rad = offset_rad[row]});
        model.azimuth_rad = read_angles(parameters.at("column_azimuths_rad"), n_columns);
        model.period_s = 1.0 / parameters.at("spinning_frequency_hz").number_in(0.01, 1e4);
        model.is_clockwise = parameters.at("spinning_direction").short_text(9) == "cw";
        return model;
    }
    return std::nullopt;
}

std::optional<SpinningSensor> to_sensor(const SpinningModel& model) {
    const std::optional<int> columns = count_columns(model);
    if (!columns) return std::nullopt;
    SpinningSensor sensor;
    sensor.clockwise = model.is_clockwise;
    sensor.period_s = model.period_s;
    sensor.columns = *columns;
    // Column 0 of a sensor is less than a step below azimuth pi, and a whole number of
    // steps from column 0 of the model.
    const double step_rad = 2.0 * kPi / sensor.columns, model_below_pi_rad = kPi - model.azimuth_rad.front();
    const double whole_steps_rad = step_rad * std::floor(model_below_pi_rad / step_rad);
    sensor.first_azimuth_rad = kPi - (model_below_pi_rad - whole_steps_rad);
    for (const std::size_t row : model.rows_by_height()) sensor.beams.push_back(model.beams[row]);
    limit_view(sensor, model);
    return sensor;
}

std::vector<StoredFrame> list_stored_frames(const Component& lidar) {
    const ZarrJson attributes = lidar.attributes("frames");
    const JsonField root = attributes.root(), times = root.at("frames_timestamps_us");
    std::vector<StoredFrame> frames;
    for (std::size_t i = 0; i < times.size(); ++i) {
        const JsonField pair = times.at(i);
        if (pair.size() != 2) pair.reject(fmt::format("found {} numbers", pair.size()), "expected 2");
        frames.push_back({read_time_us(pair.at(0)), read_time_us(pair.at(1))});
        if (frames[i].end_us < frames[i].start_us ||
            (i > 0 && frames[i].middle_us() <= frames[i - 1].middle_us()))
            pair.reject("found no later time", "expected increasing times");
    }
    return frames;
}

namespace {

/// Reads the directions and times of all rays of a frame. Checks that the times are at
/// most kMostLate_us outside of the sweep.
/// @param rays  name of the group in the store
/// @param n  number of rays
/// @param time_us  reference time of the frame in the log, to which times become relative
void read_ray_arrays(RayBundle& bundle, const ZarrStore& store, const std::string& rays, std::size_t n,
                     const StoredFrame& frame, std::int64_t time_us, const std::string& where) {
    const auto directions = read_zarr_array<float>(store, rays + "/direction", {n, 3});
    const auto times_us = read_zarr_array<std::uint64_t>(store, rays + "/timestamp_us", {n});
    for (std::size_t i = 0; i < n; ++i) {
        const glm::dvec3 d(directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]);
        if (!(std::abs(glm::length(d) - 1.0) <= kLengthTolerance))
            fail("{}: the direction of ray {} is ({}, {}, {}), expected a unit vector", where, i, d.x, d.y,
                 d.z);
        bundle.direction.push_back(glm::normalize(d));
        // A time of 2^63 or more becomes negative, which is too early.
        const auto ray_us = std::int64_t(times_us[i]);
        if (ray_us < frame.start_us - kMostLate_us || ray_us > frame.end_us + kMostLate_us)
            fail("{}: the time of ray {} is {}, expected {} to {}", where, i, times_us[i], frame.start_us,
                 frame.end_us);
        bundle.time_offset_s.push_back(float(1e-6 * double(ray_us - time_us)));
    }
}

/// Reads the ranges and intensities of all returns of a frame. The arrays in the store
/// have n_returns rows of one value per ray. Moves the valid returns of each ray to the
/// front, so that a missing first return does not make a dropped ray.
/// @param path  name of the frame's group in the store
void read_return_arrays(RayBundle& bundle, const Component& lidar, const std::string& path,
                        std::size_t n_returns) {
    const std::size_t n = bundle.direction.size();
    const std::string returns = path + "/ray_bundle_returns";
    const std::vector<bool> valid = read_valid(lidar, path, n * n_returns);
    const auto range_m = read_zarr_array<float>(*lidar.store, returns + "/distance_m", {n_returns, n});
    const auto intensity = read_zarr_array<float>(*lidar.store, returns + "/intensity", {n_returns, n});
    bundle.range_m.assign(n_returns, std::vector<float>(n, 0.0f));
    bundle.intensity = bundle.range_m;
    for (std::size_t i = 0; i < n; ++i) {
        std::size_t n_valid = 0;  // returns of this ray
        for (std::size_t r = 0; r < n_returns; ++r) {
            const std::size_t at = r * n + i;
            if (!valid[at] || !std::isfinite(range_m[at]) || !(range_m[at] > 0.0f)) continue;
            bundle.range_m[n_valid][i] = range_m[at];
            bundle.intensity[n_valid][i] =
                std::isfinite(intensity[at]) ? std::clamp(intensity[at], 0.0f, 1.0f) : 0.0f;
            ++n_valid;
        }
    }
}

}  // namespace

RayBundle read_ray_bundle(const Component& lidar, const StoredFrame& frame, std::int64_t time_us) {
    const std::string path = fmt::format("{}/frames/{}", lidar.path, frame.end_us);
    const std::string rays = path + "/ray_bundle";
    const ZarrStore& store = *lidar.store;
    const ZarrJson ray_attributes = read_zarr_attributes(store, rays),
                   return_attributes = read_zarr_attributes(store, path + "/ray_bundle_returns");
    const auto n = std::size_t(ray_attributes.root().at("n_rays").integer_in(0, std::int64_t(kMaxRays))),
               n_returns = std::size_t(return_attributes.root().at("n_returns").integer_in(0, kMostReturns));
    RayBundle bundle;
    read_ray_arrays(bundle, store, rays, n, frame, time_us, fmt::format("{}: {}", store.name(), path));
    if (store.has_key(rays + "/model_element/.zarray"))
        bundle.element = read_zarr_array<std::uint16_t>(store, rays + "/model_element", {n, 2});
    read_return_arrays(bundle, lidar, path, n_returns);
    return bundle;
}

// NCore's model has no origins of beams, but beams of some LiDARs start 20 cm beside the
// centre. Seen from the centre, the direction of such a beam depends on the range.
namespace {

constexpr double kLeastRho_m = 1.0;         // Nearer points have inaccurate directions
constexpr double kMaxSlopeError_m = 0.005;  // largest standard error of an origin
constexpr read::RobustLineOptions kRowFit{.n_passes = 3, .min_points = 50};
// Origins are used if they make the angle between rays and points clearly smaller.
constexpr double kClearly = 0.8, kLeastMisfit_rad = 1e-4;

/// A return in the sensor frame, and the azimuth of its column.
struct RowPoint {
    glm::dvec3 position_m;
    double column_rad;

    double rho_m() const { return std::hypot(position_m.x, position_m.y); }
    double azimuth_from_column_rad() const {
        return std::remainder(std::atan2(position_m.y, position_m.x) - column_rad, 2.0 * kPi);
    }
};

/// Returns the angle between the ray of a beam at the azimuth of a column and the point
/// that it hit.
double misfit_rad(const Beam& beam, const RowPoint& point) {
    const BeamRay ray = aim_beam(beam, point.column_rad);
    const glm::dvec3 to_point = glm::normalize(point.position_m - ray.origin_m);
    return 2.0 * std::asin(std::min(1.0, 0.5 * glm::distance(to_point, ray.direction)));
}

/// Returns the median angle between the points of all rows and the rays of their beams.
double median_misfit(const std::vector<Beam>& beams, const std::vector<std::vector<RowPoint>>& rows) {
    std::vector<double> angles;
    for (std::size_t row = 0; row < rows.size(); ++row)
        for (const RowPoint& point : rows[row]) angles.push_back(misfit_rad(beams[row], point));
    return angles.empty() ? 0.0 : compute_median(std::move(angles));
}

/// Returns the first return of each ray of some frames, grouped by the row of the model.
/// Leaves out near points, and rays without a row and column of the model.
std::vector<std::vector<RowPoint>> collect_row_points(const std::vector<RayBundle>& bundles,
                                                      const SpinningModel& model) {
    std::vector<std::vector<RowPoint>> rows(model.beams.size());
    for (const RayBundle& bundle : bundles) {
        if (bundle.range_m.empty() || !bundle.has_elements()) continue;
        for (std::size_t i = 0; i < bundle.direction.size(); ++i) {
            const std::size_t row = bundle.row_of(i), column = bundle.column_of(i);
            if (row >= rows.size() || column >= model.azimuth_rad.size()) continue;
            const RowPoint point{.position_m = double(bundle.range_m[0][i]) * bundle.direction[i],
                                 .column_rad = model.azimuth_rad[column]};
            if (point.rho_m() >= kLeastRho_m) rows[row].push_back(point);
        }
    }
    return rows;
}

/// Fits the direction and the origin of a beam to its points. With the horizontal
/// distance rho and the height z of a point, these are lines over 1 / rho:
///   z / rho = tan(elevation) + (origin_up / cos(elevation)) / rho,
///   azimuth - azimuth of the column = azimuth_offset + origin_left / rho.
/// Keeps the values of a line that is not determined well.
void fit_beam(Beam& beam, const std::vector<RowPoint>& points) {
    std::vector<glm::dvec2> heights, azimuths;
    for (const RowPoint& point : points) {
        heights.emplace_back(1.0 / point.rho_m(), point.position_m.z / point.rho_m());
        azimuths.emplace_back(1.0 / point.rho_m(), point.azimuth_from_column_rad());
    }
    const read::RobustLine height_line = fit_robust_line(heights, kRowFit),
                           azimuth_line = fit_robust_line(azimuths, kRowFit);
    if (height_line.slope_error < kMaxSlopeError_m) {
        beam.elevation_rad = std::atan(height_line.at_zero);
        beam.origin_up_m = height_line.slope * std::cos(beam.elevation_rad);
    }
    if (azimuth_line.slope_error < kMaxSlopeError_m) {
        beam.azimuth_offset_rad = azimuth_line.at_zero;
        beam.origin_left_m = azimuth_line.slope;
    }
}

}  // namespace

FittedBeams fit_beam_origins(const std::vector<RayBundle>& bundles, const SpinningModel& model) {
    const std::vector<std::vector<RowPoint>> rows = collect_row_points(bundles, model);
    FittedBeams fitted{.beams = model.beams};
    for (std::size_t row = 0; row < rows.size(); ++row) {
        fit_beam(fitted.beams[row], rows[row]);  // changes the beam
        fitted.n_returns += rows[row].size();
    }
    fitted.model_misfit_rad = median_misfit(model.beams, rows);
    fitted.misfit_rad = median_misfit(fitted.beams, rows);
    fitted.is_better =
        fitted.model_misfit_rad > kLeastMisfit_rad && fitted.misfit_rad < kClearly * fitted.model_misfit_rad;
    if (!fitted.is_better) fitted.beams = model.beams;
    return fitted;
}

/// Returns the column of a model whose azimuth is nearest to an azimuth of the head, or
/// nothing if the model does not cover this azimuth.
static std::optional<std::size_t> find_column(const SpinningModel& model, double head_rad, int turn_columns) {
    const double turned_rad = model.turn_sign() * (head_rad - model.azimuth_rad.front());  // since column 0
    const auto steps = std::lround(turned_rad / (2.0 * kPi) * turn_columns);
    const auto column = std::size_t((steps % turn_columns + turn_columns) % turn_columns);
    return column < model.azimuth_rad.size() ? std::optional(column) : std::nullopt;
}

ModelImage::ModelImage(SpinningModel spinning_model, const SpinningSensor& sensor)
    : model(std::move(spinning_model)), beams(make_generators(model.beams)), rays(make_rays(sensor)) {
    const std::vector<std::size_t> row_of_beam = model.rows_by_height();
    const int turn_columns = sensor.columns;
    ray_of_element.assign(model.beams.size() * model.azimuth_rad.size(), -1);
    for (std::size_t ray = 0; ray < rays.size(); ++ray) {
        const std::size_t row = row_of_beam[rays.channel[ray]];
        const glm::dvec3 direction(rays.direction[ray]);
        const double head_rad = std::atan2(direction.y, direction.x) - model.beams[row].azimuth_offset_rad;
        const std::optional<std::size_t> column = find_column(model, head_rad, turn_columns);
        if (!column) continue;
        ray_of_element[row * model.azimuth_rad.size() + *column] = int(ray);
        // The columns of the sensor are in equal steps, those of the model only nearly.
        // The small rotation from one to the other corrects the ray.
        const double uneven_rad = model.azimuth_rad[*column] - model.even_azimuth_rad(*column, turn_columns);
        const glm::dquat correction = make_rotation(std::remainder(uneven_rad, 2.0 * kPi), 0.0, 0.0);
        rays.direction[ray] = glm::vec3(correction * direction);
        rays.origin[ray] = glm::vec3(correction * glm::dvec3(rays.origin[ray]));
    }
}

NcoreScans::NcoreScans(const Log& log, std::vector<Component> lidars, std::vector<ScanLocation> scans,
                       std::vector<std::optional<SpinningModel>> models)
    : lidars_(std::move(lidars)), scans_(std::move(scans)), images_(lidars_.size()) {
    for (std::size_t l = 0; l < lidars_.size(); ++l)
        if (models[l]) images_[l].emplace(std::move(*models[l]), log.lidars[l].sensor);
}

std::string NcoreScans::frame_name(std::size_t frame) const {
    const Component& lidar = lidars_[scans_[frame].lidar];
    return fmt::format("{}: {}/frames/{}", lidar.store->name(), lidar.path, scans_[frame].frame.end_us);
}

RayBundle NcoreScans::read_bundle(std::size_t frame) const {
    const ScanLocation& scan = scans_[frame];
    return read_ray_bundle(lidars_[scan.lidar], scan.frame, scan.time_us);
}

/// Returns all returns of a frame as points in the sensor frame.
LidarPoints NcoreScans::read_points(std::size_t frame) const {
    const RayBundle bundle = read_bundle(frame);
    LidarPoints points;
    for (std::size_t i = 0; i < bundle.direction.size(); ++i)
        for (std::size_t r = 0; r < bundle.range_m.size() && bundle.range_m[r][i] > 0.0f; ++r) {
            points.position_m.emplace_back(double(bundle.range_m[r][i]) * bundle.direction[i]);
            points.intensity.push_back(bundle.intensity[r][i]);
            points.time_offset_s.push_back(bundle.time_offset_s[i]);
            if (bundle.has_elements()) points.ring.push_back(std::uint16_t(bundle.row_of(i)));
            if (bundle.range_m.size() > 1) points.return_number.push_back(std::uint8_t(r + 1));
        }
    return points;
}

namespace {

/// Copies the returns of a stored ray to a ray of the image. Stored ranges begin at the
/// sensor origin, but a ray of the image begins at the origin of its beam. So it gets the
/// direction to the first return, and the distances of all returns from this origin.
void place_returns(Scan& scan, std::size_t ray, const RayBundle& bundle, std::size_t stored_ray,
                   const BeamRays& beam) {
    const auto point_of = [&](std::size_t r) {
        return double(bundle.range_m[r][stored_ray]) * bundle.direction[stored_ray];
    };
    if (bundle.range_m.empty() || !(bundle.range_m[0][stored_ray] > 0.0f)) return;
    // The origin rotates with the head, which faced the point.
    const glm::dvec3 point = point_of(0);
    const double head_rad = beam.azimuth_facing(point);
    const glm::dvec3 origin = beam.compute_ray(head_rad).origin_m;
    const double range_m = glm::distance(point, origin);
    if (!(range_m > kNearest_m)) return;
    scan.rays.origin[ray] = glm::vec3(origin);
    scan.rays.direction[ray] = glm::vec3((point - origin) / range_m);
    scan.range_m[ray] = float(range_m);
    scan.intensity[ray] = bundle.intensity[0][stored_ray];
    for (std::size_t r = 1; r < bundle.range_m.size() && bundle.range_m[r][stored_ray] > 0.0f; ++r) {
        const std::size_t n = scan.rays.size();
        if (scan.second_returns.size() < r)
            scan.second_returns.push_back({std::vector<float>(n, 0.0f), std::vector<float>(n, 0.0f)});
        AdditionalReturns& further = scan.second_returns[r - 1];
        further.range_m[ray] = float(glm::distance(point_of(r), glm::dvec3(scan.rays.origin[ray])));
        further.intensity[ray] = bundle.intensity[r][stored_ray];
    }
}

/// Copies the stored rays to the pixels of the image. Of two stored rays of a pixel, the
/// one with a return stays. A ray that is not stored was dropped. It gets its nominal
/// time plus the mean delay of the stored rays of its column.
void place_rays(Scan& scan, const RayBundle& bundle, const ModelImage& image, const std::string& where) {
    const std::size_t n_rows = image.model.beams.size(), n_columns = image.model.azimuth_rad.size();
    std::vector<bool> is_stored(scan.rays.size(), false);
    std::vector<ColumnDelay> delays(n_columns);
    for (std::size_t i = 0; i < bundle.direction.size(); ++i) {
        const std::size_t row = bundle.row_of(i), column = bundle.column_of(i);
        if (row >= n_rows || column >= n_columns)
            fail("{}: ray {} has row {} and column {}, expected numbers below {} and {}", where, i, row,
                 column, n_rows, n_columns);
        if (image.ray_of(row, column) < 0) continue;  // no pixel of the image
        const auto ray = std::size_t(image.ray_of(row, column));
        if (scan.range_m[ray] > 0.0f) continue;  // a ray before has a return in this pixel
        delays[column].sum_s += double(bundle.time_offset_s[i]) - double(image.rays.time_offset_s[ray]);
        delays[column].n_rays += 1.0;
        is_stored[ray] = true;
        scan.rays.direction[ray] = glm::vec3(bundle.direction[i]);
        scan.rays.time_offset_s[ray] = bundle.time_offset_s[i];
        place_returns(scan, ray, bundle, i, image.beams[row]);
    }

    const std::vector<double> delay_s = fill_column_delays(delays);
    for (std::size_t column = 0; column < delay_s.size(); ++column)
        for (std::size_t row = 0; row < n_rows; ++row) {
            const int ray = image.ray_of(row, column);
            if (ray >= 0 && !is_stored[std::size_t(ray)])
                scan.rays.time_offset_s[std::size_t(ray)] += float(delay_s[column]);
        }
}

}  // namespace

/// Returns a frame of a LiDAR with a model as an image, one ray per row and column.
Scan NcoreScans::read_rays(std::size_t frame) const {
    const RayBundle bundle = read_bundle(frame);
    const ModelImage& image = *images_[scans_[frame].lidar];
    if (!bundle.has_elements() && !bundle.direction.empty())
        fail("{}: the array model_element is missing, but other frames have it", frame_name(frame));
    Scan scan;
    scan.rays = image.rays;
    scan.range_m.assign(scan.rays.size(), 0.0f);
    scan.intensity.assign(scan.rays.size(), 0.0f);
    place_rays(scan, bundle, image, frame_name(frame));
    return scan;
}

}  // namespace relidar::ncore
