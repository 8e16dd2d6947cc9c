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
constexpr double kUnitLength = 1e-2;              // tolerance of the length of a direction
constexpr double kMostUneven = 1.0;               // largest deviation of a column from equal steps, in steps
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
    const double sign = model.is_clockwise ? -1.0 : 1.0, first_rad = model.azimuth_rad.front();
    const std::size_t n_columns = model.azimuth_rad.size();
    std::vector<double> steps_rad;
    for (std::size_t j = 1; j < n_columns; ++j)
        steps_rad.push_back(
            std::remainder(sign * (model.azimuth_rad[j] - model.azimuth_rad[j - 1]), 2.0 * kPi));
    const double step_rad = steps_rad.empty() ? 0.0 : compute_median(std::move(steps_rad));
    // With smaller steps, the image of a full turn would have more than kMaxRays rays.
    const double least_step_rad = 2.0 * kPi * double(model.elevation_rad.size()) / double(kMaxRays);
    if (!(step_rad > least_step_rad)) return std::nullopt;
    const int turn_columns = int(std::lround(2.0 * kPi / step_rad));
    if (n_columns > std::size_t(turn_columns)) return std::nullopt;
    const double even_step_rad = 2.0 * kPi / turn_columns;
    for (std::size_t j = 0; j < n_columns; ++j) {
        const double expected_rad = first_rad + sign * double(j) * even_step_rad;
        const double error_rad = std::remainder(model.azimuth_rad[j] - expected_rad, 2.0 * kPi);
        if (std::abs(error_rad) > kMostUneven * even_step_rad) return std::nullopt;
    }
    return turn_columns;
}

/// Limits the field of view of a sensor to the azimuths of the model, unless the model
/// has a full turn. The rays of row r in a column point to the azimuth of the column plus
/// the azimuth offset of row r. The field of view contains the rays of all rows.
void limit_view(SpinningSensor& sensor, const SpinningModel& model) {
    const double sign = model.is_clockwise ? -1.0 : 1.0, step_rad = 2.0 * kPi / sensor.columns;
    const auto [low, high] = std::ranges::minmax_element(
        sensor.beams, {}, [&](const Beam& beam) { return offset_columns(beam, sensor.columns); });
    const double least_offset_rad = step_rad * offset_columns(*low, sensor.columns),
                 most_offset_rad = step_rad * offset_columns(*high, sensor.columns);
    const double width_rad =
        double(model.azimuth_rad.size() - 1) * step_rad + most_offset_rad - least_offset_rad;
    // From the first to the last column, a full turn is one step less than 2 pi.
    const bool is_full_turn = width_rad >= 2.0 * kPi - 1.5 * step_rad;
    if (is_full_turn) return;
    const double begin_rad =
        model.azimuth_rad.front() + (model.is_clockwise ? most_offset_rad : least_offset_rad);
    sensor.azimuth_rad = {{begin_rad, begin_rad + sign * width_rad}};
}

/// Returns the delay of each column in seconds: the mean of its rays' measured minus
/// nominal times, positive if they were late.
/// A column without a ray gets the delay of the column before, or of the first column
/// with a ray. Returns an empty list if no column has a ray.
/// @param delay_sum_s, n_rays  [columns] sum over the rays of a column, and their number
std::vector<double> fill_column_delays(const std::vector<double>& delay_sum_s,
                                       const std::vector<double>& n_rays) {
    const auto first = std::ranges::find_if(n_rays, [](double n) { return n > 0.0; });
    if (first == n_rays.end()) return {};
    std::vector<double> delay_s;
    auto last_with_ray = std::size_t(first - n_rays.begin());
    for (std::size_t column = 0; column < n_rays.size(); ++column) {
        if (n_rays[column] > 0.0) last_with_ray = column;
        delay_s.push_back(delay_sum_s[last_with_ray] / n_rays[last_with_ray]);
    }
    return delay_s;
}

}  // namespace

std::optional<SpinningModel> read_model(const NcoreSequence& sequence, const std::string& lidar_name) {
    for (const Component& component : sequence.list_components("intrinsics")) {
        const ZarrJson attributes = component.attributes("lidars/" + lidar_name);
        if (attributes.json.empty()) continue;
        const JsonField root = attributes.root(), type = root.at("lidar_model_type"),
                        head = root.at("lidar_model_parameters");
        if (type.short_text(99) != "row-offset-spinning")
            type.reject("found '" + quote(type.short_text(99)) + "'", "expected 'row-offset-spinning'");
        SpinningModel model;
        const auto rows = std::size_t(head.at("n_rows").integer_in(1, 65535)),
                   columns = std::size_t(head.at("n_columns").integer_in(1, std::int64_t(kMaxRays / rows)));
        model.elevation_rad = read_angles(head.at("row_elevations_rad"), rows);
        model.offset_rad = read_angles(head.at("row_azimuth_offsets_rad"), rows);
        model.azimuth_rad = read_angles(head.at("column_azimuths_rad"), columns);
        if (!std::ranges::is_sorted(model.elevation_rad, std::greater{}))
            head.at("row_elevations_rad").reject("found another order", "expected the highest row first");
        model.period_s = 1.0 / head.at("spinning_frequency_hz").number_in(0.01, 1e4);
        model.is_clockwise = head.at("spinning_direction").short_text(9) == "cw";
        return model;
    }
    return std::nullopt;
}

std::optional<SpinningSensor> to_sensor(SpinningModel& model, const std::vector<Beam>& beams) {
    const std::optional<int> columns = count_columns(model);
    if (!columns) return std::nullopt;
    SpinningSensor sensor;
    sensor.clockwise = model.is_clockwise;
    sensor.period_s = model.period_s;
    sensor.columns = *columns;
    // Column 0 is the first column at or below +180 degrees: less than a step below.
    const double step_rad = 2.0 * kPi / sensor.columns, below_rad = kPi - model.azimuth_rad.front();
    sensor.first_azimuth_rad = kPi - (below_rad - step_rad * std::floor(below_rad / step_rad));

    // The sensor has its beams from the highest to the lowest.
    std::vector<std::size_t> rows(beams.size());
    std::iota(rows.begin(), rows.end(), std::size_t(0));
    std::ranges::stable_sort(rows, std::greater{}, [&](std::size_t row) { return beams[row].elevation_rad; });
    model.beam_of_row.resize(rows.size());
    for (const std::size_t row : rows) {
        model.beam_of_row[row] = sensor.beams.size();
        sensor.beams.push_back(beams[row]);
    }
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

/// Reads the directions and times of all rays of a frame. Times become seconds after
/// `time_us`, the reference time of the frame in the log.
/// @param rays  name of the group in the store
/// @param n  number of rays
void read_ray_arrays(RayBundle& bundle, const ZarrStore& store, const std::string& rays, std::size_t n,
                     const StoredFrame& frame, std::int64_t time_us, const std::string& where) {
    const auto directions = read_zarr_array<float>(store, rays + "/direction", {n, 3});
    const auto times_us = read_zarr_array<std::uint64_t>(store, rays + "/timestamp_us", {n});
    for (std::size_t i = 0; i < n; ++i) {
        const glm::dvec3 d(directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]);
        if (!(std::abs(glm::length(d) - 1.0) <= kUnitLength))
            fail("{}: the direction of ray {} is ({}, {}, {}), expected a unit vector", where, i, d.x, d.y,
                 d.z);
        bundle.direction.push_back(glm::normalize(d));
        // Unsigned numbers wrap, so the value of a ray before `time_us` becomes negative.
        const auto offset_us = std::int64_t(times_us[i] - std::uint64_t(time_us));
        if (times_us[i] > std::uint64_t(frame.end_us + kMostLate_us) ||
            std::int64_t(times_us[i]) < frame.start_us - kMostLate_us)
            fail("{}: the time of ray {} is {}, expected {} to {}", where, i, times_us[i], frame.start_us,
                 frame.end_us);
        bundle.time_offset_s.push_back(float(1e-6 * double(offset_us)));
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

RayBundle read_rays(const Component& lidar, const StoredFrame& frame, std::int64_t time_us) {
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
// centre. Seen from the centre, the direction of such a beam depends on the range. With
// the horizontal distance rho of a point and its height z, both
//   z / rho = tan(elevation) + (origin_up / cos(elevation)) / rho   and
//   azimuth - azimuth of the column = azimuth_offset + origin_left / rho
// are lines over 1 / rho, which are fitted to the points of each row.
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
    double azimuth_rad() const {
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

/// Returns the first returns of some frames, grouped by the row of the model. Leaves out
/// near points, and rays without an element of the model.
std::vector<std::vector<RowPoint>> collect_row_points(const std::vector<RayBundle>& bundles,
                                                      const SpinningModel& model) {
    std::vector<std::vector<RowPoint>> rows(model.elevation_rad.size());
    for (const RayBundle& bundle : bundles) {
        if (bundle.range_m.empty()) continue;
        for (std::size_t i = 0; i < bundle.element.size() / 2; ++i) {
            const std::size_t row = bundle.element[2 * i], column = bundle.element[2 * i + 1];
            if (row >= rows.size() || column >= model.azimuth_rad.size()) continue;
            const RowPoint point{double(bundle.range_m[0][i]) * bundle.direction[i],
                                 model.azimuth_rad[column]};
            if (point.rho_m() >= kLeastRho_m) rows[row].push_back(point);
        }
    }
    return rows;
}

/// Fits the direction and the origin of a beam to its points: the lines over 1 / rho
///   z / rho = tan(elevation) + (origin_up / cos(elevation)) / rho,
///   azimuth = azimuth_offset + origin_left / rho.
/// Keeps the values of a line that is not determined well.
void fit_beam(Beam& beam, const std::vector<RowPoint>& points) {
    std::vector<glm::dvec2> heights, azimuths;
    for (const RowPoint& point : points) {
        heights.emplace_back(1.0 / point.rho_m(), point.position_m.z / point.rho_m());
        azimuths.emplace_back(1.0 / point.rho_m(), point.azimuth_rad());
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
    std::vector<Beam> model_beams;
    for (std::size_t row = 0; row < model.elevation_rad.size(); ++row)
        model_beams.push_back(
            {.elevation_rad = model.elevation_rad[row], .azimuth_offset_rad = model.offset_rad[row]});
    const std::vector<std::vector<RowPoint>> rows = collect_row_points(bundles, model);
    FittedBeams fitted{.beams = model_beams};
    for (std::size_t row = 0; row < rows.size(); ++row) {
        fit_beam(fitted.beams[row], rows[row]);  // changes the beam
        fitted.n_returns += rows[row].size();
    }
    fitted.model_misfit_rad = median_misfit(model_beams, rows);
    fitted.misfit_rad = median_misfit(fitted.beams, rows);
    fitted.is_better =
        fitted.model_misfit_rad > kLeastMisfit_rad && fitted.misfit_rad < kClearly * fitted.model_misfit_rad;
    if (!fitted.is_better) fitted.beams = model_beams;
    return fitted;
}

NcoreScans::NcoreScans(const Log& log, std::vector<Component> lidars, std::vector<ScanLocation> scans,
                       std::vector<std::optional<SpinningModel>> models)
    : lidars_(std::move(lidars)),
      scans_(std::move(scans)),
      models_(std::move(models)),
      beams_(lidars_.size()),
      images_(lidars_.size()),
      ray_of_element_(lidars_.size()) {
    for (std::size_t l = 0; l < lidars_.size(); ++l)
        if (models_[l]) make_image(l, log.lidars[l].sensor);
}

// An element is a pixel (row, column) of the model. The image has the same rows, sorted
// by elevation (beams), but the columns of a full turn, of which the model has a part.
void NcoreScans::make_image(std::size_t lidar, const SpinningSensor& sensor) {
    const SpinningModel& model = *models_[lidar];
    const std::size_t model_columns = model.azimuth_rad.size();  // maybe not a full turn
    const int turn_columns = sensor.columns;
    const double sign = model.is_clockwise ? -1.0 : 1.0, first_rad = model.azimuth_rad.front();
    std::vector<std::size_t> row_of_beam(sensor.beams.size());
    for (std::size_t row = 0; row < row_of_beam.size(); ++row) row_of_beam[model.beam_of_row[row]] = row;

    beams_[lidar] = make_generators(sensor.beams);
    RayTable& image = images_[lidar] = make_rays(sensor);
    std::vector<int>& ray_of_element = ray_of_element_[lidar];
    ray_of_element.assign(model.elevation_rad.size() * model_columns, -1);
    for (std::size_t ray = 0; ray < image.size(); ++ray) {
        // The column of the model follows from the azimuth without the beam's offset.
        const std::size_t beam = image.channel[ray];
        const glm::dvec3 direction(image.direction[ray]);
        const double turned_rad =  // of the head, since column 0 of the model
            sign * (std::atan2(direction.y, direction.x) - sensor.beams[beam].azimuth_offset_rad - first_rad);
        const auto turned_columns = std::lround(turned_rad / (2.0 * kPi) * turn_columns);
        const auto column = std::size_t((turned_columns % turn_columns + turn_columns) % turn_columns);
        if (column >= model_columns) continue;  // the model does not cover this azimuth
        ray_of_element[row_of_beam[beam] * model_columns + column] = int(ray);
        // The columns of the sensor are in equal steps, those of the model only nearly.
        // The small rotation from one to the other corrects the ray.
        const double even_rad = first_rad + sign * 2.0 * kPi * double(column) / turn_columns;
        const glm::dquat correction =
            make_rotation(std::remainder(model.azimuth_rad[column] - even_rad, 2.0 * kPi), 0.0, 0.0);
        image.direction[ray] = glm::vec3(correction * direction);
        image.origin[ray] = glm::vec3(correction * glm::dvec3(image.origin[ray]));
    }
}

std::string NcoreScans::frame_name(std::size_t frame) const {
    const Component& lidar = lidars_[scans_[frame].lidar];
    return fmt::format("{}: {}/frames/{}", lidar.store->name(), lidar.path, scans_[frame].frame.end_us);
}

RayBundle NcoreScans::read_bundle(std::size_t frame) const {
    const ScanLocation& scan = scans_[frame];
    return ncore::read_rays(lidars_[scan.lidar], scan.frame, scan.time_us);
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
            if (!bundle.element.empty()) points.ring.push_back(bundle.element[2 * i]);
            if (bundle.range_m.size() > 1) points.return_number.push_back(std::uint8_t(r + 1));
        }
    return points;
}

Scan NcoreScans::read_rays(std::size_t frame) const {
    const RayBundle bundle = read_bundle(frame);
    const std::size_t lidar = scans_[frame].lidar;
    Scan scan;
    scan.rays = images_[lidar];
    scan.range_m.assign(scan.rays.size(), 0.0f);
    scan.intensity.assign(scan.rays.size(), 0.0f);
    if (bundle.element.size() != 2 * bundle.direction.size())
        fail("{}: the array model_element is missing, but other frames have it", frame_name(frame));
    place_rays(scan, bundle, lidar, frame_name(frame));
    return scan;
}

/// Copies the stored rays to their places in the image: row and column in the model give
/// the ray (ray_of_element_). A ray that is not stored was dropped. Its time is the
/// nominal one plus the delay of its column. Of two stored rays in the same place, the
/// ray with a return stays.
void NcoreScans::place_rays(Scan& scan, const RayBundle& bundle, std::size_t lidar,
                            const std::string& where) const {
    const std::size_t n_rows = models_[lidar]->elevation_rad.size(),
                      n_columns = models_[lidar]->azimuth_rad.size();
    std::vector<bool> is_stored(scan.rays.size(), false);
    std::vector<double> delay_sum_s(n_columns, 0.0), n_rays(n_columns, 0.0);  // [columns]
    for (std::size_t i = 0; i < bundle.direction.size(); ++i) {
        const std::size_t row = bundle.element[2 * i], column = bundle.element[2 * i + 1];
        if (row >= n_rows || column >= n_columns)
            fail("{}: ray {} has row {} and column {}, expected numbers below {} and {}", where, i, row,
                 column, n_rows, n_columns);
        const int image_ray = ray_of_element_[lidar][row * n_columns + column];
        if (image_ray < 0) continue;
        const auto ray = std::size_t(image_ray);
        if (is_stored[ray] && scan.range_m[ray] > 0.0f) continue;
        const double nominal_s = images_[lidar].time_offset_s[ray];
        delay_sum_s[column] += double(bundle.time_offset_s[i]) - nominal_s;
        n_rays[column] += 1.0;
        is_stored[ray] = true;
        scan.rays.direction[ray] = glm::vec3(bundle.direction[i]);
        scan.rays.time_offset_s[ray] = bundle.time_offset_s[i];
        place_returns(scan, ray, bundle, i, beams_[lidar][models_[lidar]->beam_of_row[row]]);
    }

    const std::vector<double> delay_s = fill_column_delays(delay_sum_s, n_rays);
    for (std::size_t column = 0; column < delay_s.size(); ++column)
        for (std::size_t row = 0; row < n_rows; ++row) {
            const int ray = ray_of_element_[lidar][row * n_columns + column];
            if (ray >= 0 && !is_stored[std::size_t(ray)])
                scan.rays.time_offset_s[std::size_t(ray)] += float(delay_s[column]);
        }
}

/// Copies the returns of a stored ray to a ray of the image, which starts at the origin
/// of its beam and ends at the first return. The other returns get the distances of their
/// points from this origin.
void NcoreScans::place_returns(Scan& scan, std::size_t ray, const RayBundle& bundle, std::size_t stored_ray,
                               const BeamRays& beam) {
    for (std::size_t r = 0; r < bundle.range_m.size(); ++r) {
        const float stored_range_m = bundle.range_m[r][stored_ray];
        if (!(stored_range_m > 0.0f)) break;
        const glm::dvec3 point = double(stored_range_m) * bundle.direction[stored_ray];
        if (r == 0) {
            // The beam has another origin for each azimuth. It must face the point.
            const glm::dvec3 origin = beam.compute_ray(beam.azimuth_facing(point)).origin_m;
            const double range_m = glm::distance(point, origin);
            if (!(range_m > kNearest_m)) break;
            scan.rays.origin[ray] = glm::vec3(origin);
            scan.rays.direction[ray] = glm::vec3((point - origin) / range_m);
            scan.range_m[ray] = float(range_m);
            scan.intensity[ray] = bundle.intensity[0][stored_ray];
            continue;
        }
        const std::size_t n = scan.rays.size();
        if (scan.second_returns.size() < r)
            scan.second_returns.push_back({std::vector<float>(n, 0.0f), std::vector<float>(n, 0.0f)});
        AdditionalReturns& further = scan.second_returns[r - 1];
        further.range_m[ray] = float(glm::distance(point, glm::dvec3(scan.rays.origin[ray])));
        further.intensity[ray] = bundle.intensity[r][stored_ray];
    }
}

}  // namespace relidar::ncore
