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

std::vector<double> read_angles(const JsonField& field, std::size_t n) {
    std::vector<double> angles = field.numbers();
    if (angles.size() != n)
        field.reject(fmt::format("found {} angles", angles.size()), fmt::format("expected {}", n));
    for (const double angle : angles)
        if (!(std::abs(angle) <= 4.0 * kPi)) field.reject(fmt::format("found {}", angle), "expected radians");
    return angles;
}

/// Returns the bits of the mask of valid returns, or nothing if the frame has no mask.
std::vector<bool> read_valid(const Component& lidar, const std::string& frame, std::size_t n) {
    std::vector<bool> valid(n, true);
    const std::string path = frame + "/ray_bundle_returns_valid_mask_packed";
    if (!lidar.store->has_key(path + "/.zarray")) return valid;
    const auto bytes = read_zarr_array<std::uint8_t>(*lidar.store, path, {(n + 7) / 8});
    for (std::size_t i = 0; i < n; ++i) valid[i] = (bytes[i / 8] >> (7 - i % 8) & 1) != 0;
    return valid;
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
    SpinningSensor sensor;
    sensor.clockwise = model.is_clockwise;
    sensor.period_s = model.period_s;
    const double sign = model.is_clockwise ? -1.0 : 1.0, first = model.azimuth_rad.front();
    const std::size_t n = model.azimuth_rad.size();
    std::vector<double> steps;
    for (std::size_t j = 1; j < n; ++j)
        steps.push_back(std::remainder(sign * (model.azimuth_rad[j] - model.azimuth_rad[j - 1]), 2.0 * kPi));
    const double step = steps.empty() ? 0.0 : compute_median(std::move(steps));
    if (!(step > 2.0 * kPi * double(model.elevation_rad.size()) / double(kMaxRays))) return std::nullopt;
    sensor.columns = int(std::lround(2.0 * kPi / step));
    const double even_step = 2.0 * kPi / sensor.columns;
    if (n > std::size_t(sensor.columns)) return std::nullopt;
    for (std::size_t j = 0; j < n; ++j) {
        const double expected = first + sign * double(j) * even_step;
        if (std::abs(std::remainder(model.azimuth_rad[j] - expected, 2.0 * kPi)) > kMostUneven * even_step)
            return std::nullopt;
    }
    // Column 0 is the first column at or below +180 degrees.
    const double below = kPi - first;
    sensor.first_azimuth_rad = kPi - (below - even_step * std::floor(below / even_step));
    std::vector<std::size_t> rows(beams.size());
    std::iota(rows.begin(), rows.end(), std::size_t(0));
    std::ranges::stable_sort(rows, std::greater{}, [&](std::size_t row) { return beams[row].elevation_rad; });
    model.beam_of_row.resize(rows.size());
    for (const std::size_t row : rows) {
        model.beam_of_row[row] = sensor.beams.size();
        sensor.beams.push_back(beams[row]);
    }
    // The field of view contains the image columns of all rows, which are shifted by the
    // offsets of the rows.
    const auto [low, high] = std::ranges::minmax_element(
        sensor.beams, {}, [&](const Beam& beam) { return offset_columns(beam, sensor.columns); });
    const double least = even_step * offset_columns(*low, sensor.columns),
                 most = even_step * offset_columns(*high, sensor.columns);
    const double wide_rad = double(n - 1) * even_step + most - least;
    if (wide_rad < 2.0 * kPi - 1.5 * even_step) {
        const double begin = first + (model.is_clockwise ? most : least);
        sensor.azimuth_rad = {{begin, begin + sign * wide_rad}};
    }
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

RayBundle read_rays(const Component& lidar, const StoredFrame& frame, std::int64_t time_us) {
    const std::string path = fmt::format("{}/frames/{}", lidar.path, frame.end_us);
    const std::string rays = path + "/ray_bundle", returns = path + "/ray_bundle_returns";
    const ZarrStore& store = *lidar.store;
    const ZarrJson of_rays = read_zarr_attributes(store, rays),
                   of_returns = read_zarr_attributes(store, returns);
    const auto n = std::size_t(of_rays.root().at("n_rays").integer_in(0, std::int64_t(kMaxRays))),
               n_returns = std::size_t(of_returns.root().at("n_returns").integer_in(0, kMostReturns));
    const std::string where = fmt::format("{}: {}", store.name(), path);
    RayBundle bundle;
    const auto directions = read_zarr_array<float>(store, rays + "/direction", {n, 3});
    const auto times_us = read_zarr_array<std::uint64_t>(store, rays + "/timestamp_us", {n});
    for (std::size_t i = 0; i < n; ++i) {
        const glm::dvec3 d(directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]);
        if (!(std::abs(glm::length(d) - 1.0) <= kUnitLength))
            fail("{}: the direction of ray {} is ({}, {}, {}), expected a unit vector", where, i, d.x, d.y,
                 d.z);
        bundle.direction.push_back(glm::normalize(d));
        // The subtraction of unsigned numbers wraps like that of signed numbers.
        const auto late_us = std::int64_t(times_us[i] - std::uint64_t(time_us));
        if (times_us[i] > std::uint64_t(frame.end_us + kMostLate_us) ||
            std::int64_t(times_us[i]) < frame.start_us - kMostLate_us)
            fail("{}: the time of ray {} is {}, expected {} to {}", where, i, times_us[i], frame.start_us,
                 frame.end_us);
        bundle.time_offset_s.push_back(float(1e-6 * double(late_us)));
    }
    if (store.has_key(rays + "/model_element/.zarray"))
        bundle.element = read_zarr_array<std::uint16_t>(store, rays + "/model_element", {n, 2});
    const std::vector<bool> valid = read_valid(lidar, path, n * n_returns);
    auto range_m = read_zarr_array<float>(store, returns + "/distance_m", {n_returns, n});
    auto intensity = read_zarr_array<float>(store, returns + "/intensity", {n_returns, n});
    for (std::size_t k = 0; k < range_m.size(); ++k) {
        const bool is_return = valid[k] && std::isfinite(range_m[k]) && range_m[k] > 0.0f;
        if (!is_return) range_m[k] = 0.0f;
        intensity[k] = is_return && std::isfinite(intensity[k]) ? std::clamp(intensity[k], 0.0f, 1.0f) : 0.0f;
    }
    // Moves the returns of each ray to the front, so that a missing first return does not
    // make a dropped ray.
    bundle.range_m.assign(n_returns, std::vector<float>(n, 0.0f));
    bundle.intensity = bundle.range_m;
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t r = 0, k = 0; r < n_returns; ++r)
            if (const std::size_t at = r * n + i; range_m[at] > 0.0f) {
                bundle.range_m[k][i] = range_m[at];
                bundle.intensity[k++][i] = intensity[at];
            }
    return bundle;
}

// NCore's model has no origins of beams, but beams of some LiDARs start 20 cm beside the
// centre. Seen from the centre, the direction of such a beam depends on the range. With
// the horizontal distance rho of a point and its height z, both
//   z / rho = tan(elevation) + (origin_up / cos(elevation)) / rho   and
//   azimuth - azimuth of the column = azimuth_offset + origin_left / rho
// are lines over 1 / rho, which are fitted to the points of each row.
namespace {

constexpr double kLeastRho_m = 1.0;         // nearer points have inaccurate directions
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

double median_misfit(const std::vector<Beam>& beams, const std::vector<std::vector<RowPoint>>& rows) {
    std::vector<double> angles;
    for (std::size_t row = 0; row < rows.size(); ++row)
        for (const RowPoint& point : rows[row]) angles.push_back(misfit_rad(beams[row], point));
    return angles.empty() ? 0.0 : compute_median(std::move(angles));
}

}  // namespace

FittedBeams fit_beam_origins(const std::vector<RayBundle>& bundles, const SpinningModel& model) {
    FittedBeams fitted;
    std::vector<Beam> of_model;
    for (std::size_t row = 0; row < model.elevation_rad.size(); ++row)
        of_model.push_back(
            {.elevation_rad = model.elevation_rad[row], .azimuth_offset_rad = model.offset_rad[row]});
    std::vector<std::vector<RowPoint>> rows(of_model.size());
    for (const RayBundle& bundle : bundles)
        for (std::size_t i = 0; i < bundle.element.size() / 2 && !bundle.range_m.empty(); ++i) {
            const std::size_t row = bundle.element[2 * i], column = bundle.element[2 * i + 1];
            if (row >= rows.size() || column >= model.azimuth_rad.size()) continue;
            const RowPoint point{double(bundle.range_m[0][i]) * bundle.direction[i],
                                 model.azimuth_rad[column]};
            if (point.rho_m() < kLeastRho_m) continue;
            rows[row].push_back(point);
            ++fitted.n_returns;
        }
    fitted.beams = of_model;
    for (std::size_t row = 0; row < rows.size(); ++row) {
        std::vector<glm::dvec2> heights, azimuths;
        for (const RowPoint& point : rows[row]) {
            heights.emplace_back(1.0 / point.rho_m(), point.position_m.z / point.rho_m());
            azimuths.emplace_back(1.0 / point.rho_m(), point.azimuth_rad());
        }
        Beam& beam = fitted.beams[row];
        if (const auto line = fit_robust_line(heights, kRowFit); line.slope_error < kMaxSlopeError_m) {
            beam.elevation_rad = std::atan(line.at_zero);
            beam.origin_up_m = line.slope * std::cos(beam.elevation_rad);
        }
        if (const auto line = fit_robust_line(azimuths, kRowFit); line.slope_error < kMaxSlopeError_m) {
            beam.azimuth_offset_rad = line.at_zero;
            beam.origin_left_m = line.slope;
        }
    }
    fitted.model_misfit_rad = median_misfit(of_model, rows);
    fitted.misfit_rad = median_misfit(fitted.beams, rows);
    fitted.is_better =
        fitted.model_misfit_rad > kLeastMisfit_rad && fitted.misfit_rad < kClearly * fitted.model_misfit_rad;
    if (!fitted.is_better) fitted.beams = of_model;
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
    for (std::size_t l = 0; l < lidars_.size(); ++l) {
        if (!models_[l]) continue;
        const SpinningModel& model = *models_[l];
        const std::size_t n_columns = model.azimuth_rad.size();
        const SpinningSensor& sensor = log.lidars[l].sensor;
        const int n = sensor.columns;
        std::vector<std::size_t> row_of_beam(sensor.beams.size());
        for (std::size_t row = 0; row < row_of_beam.size(); ++row) row_of_beam[model.beam_of_row[row]] = row;
        beams_[l] = make_generators(sensor.beams);
        const double sign = model.is_clockwise ? -1.0 : 1.0;
        images_[l] = make_rays(sensor);
        ray_of_element_[l].assign(model.elevation_rad.size() * n_columns, -1);
        for (std::size_t ray = 0; ray < images_[l].size(); ++ray) {
            const std::size_t beam = images_[l].channel[ray], row = row_of_beam[beam];
            const glm::dvec3 d(images_[l].direction[ray]);
            const double turned = sign * (std::atan2(d.y, d.x) - sensor.beams[beam].azimuth_offset_rad -
                                          model.azimuth_rad.front());
            const auto column = std::size_t((std::lround(turned / (2.0 * kPi) * n) % n + n) % n);
            if (column >= n_columns) continue;
            ray_of_element_[l][row * n_columns + column] = int(ray);
            // The columns of the sensor are in equal steps, those of the model nearly.
            const double even_rad = model.azimuth_rad.front() + sign * 2.0 * kPi * double(column) / n;
            const glm::dquat turn =
                make_rotation(std::remainder(model.azimuth_rad[column] - even_rad, 2.0 * kPi), 0.0, 0.0);
            images_[l].direction[ray] = glm::vec3(turn * d);
            images_[l].origin[ray] = glm::vec3(turn * glm::dvec3(images_[l].origin[ray]));
        }
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

/// Copies the stored rays to their places in the image. A ray that is not stored gets the
/// time of its column. Of two rays in the same place, the ray with a return stays.
void NcoreScans::place_rays(Scan& scan, const RayBundle& bundle, std::size_t lidar,
                            const std::string& where) const {
    const std::size_t n_rows = models_[lidar]->elevation_rad.size(), n = models_[lidar]->azimuth_rad.size();
    const std::vector<int>& ray_of = ray_of_element_[lidar];
    std::vector<bool> is_stored(scan.rays.size(), false);
    std::vector<double> delay_s(n, 0.0), count(n, 0.0);  // [columns] measured minus nominal time
    for (std::size_t i = 0; i < bundle.direction.size(); ++i) {
        const std::size_t row = bundle.element[2 * i], column = bundle.element[2 * i + 1];
        if (row >= n_rows || column >= n)
            fail("{}: ray {} has row {} and column {}, expected numbers below {} and {}", where, i, row,
                 column, n_rows, n);
        const int ray = ray_of[row * n + column];
        if (ray < 0) continue;
        const auto at = std::size_t(ray);
        if (is_stored[at] && scan.range_m[at] > 0.0f) continue;
        delay_s[column] += double(bundle.time_offset_s[i]) - double(images_[lidar].time_offset_s[at]);
        count[column] += 1.0;
        is_stored[at] = true;
        scan.rays.direction[at] = glm::vec3(bundle.direction[i]);
        scan.rays.time_offset_s[at] = bundle.time_offset_s[i];
        const BeamRays& beam = beams_[lidar][models_[lidar]->beam_of_row[row]];
        for (std::size_t r = 0; r < bundle.range_m.size() && bundle.range_m[r][i] > 0.0f; ++r) {
            const glm::dvec3 point = double(bundle.range_m[r][i]) * bundle.direction[i];
            if (r == 0) {
                // The ray starts at the origin of its beam and ends at the point.
                const glm::dvec3 origin = beam.compute_ray(beam.azimuth_facing(point)).origin_m;
                const double range_m = glm::distance(point, origin);
                if (!(range_m > kNearest_m)) break;
                scan.rays.origin[at] = glm::vec3(origin);
                scan.rays.direction[at] = glm::vec3((point - origin) / range_m);
                scan.range_m[at] = float(range_m);
                scan.intensity[at] = bundle.intensity[0][i];
                continue;
            }
            if (scan.second_returns.size() < r)
                scan.second_returns.push_back(
                    {std::vector<float>(scan.rays.size(), 0.0f), std::vector<float>(scan.rays.size(), 0.0f)});
            scan.second_returns[r - 1].range_m[at] =
                float(glm::distance(point, glm::dvec3(scan.rays.origin[at])));
            scan.second_returns[r - 1].intensity[at] = bundle.intensity[r][i];
        }
    }
    // A column without a ray has the delay of the column before, or of the first column
    // with a ray.
    double delay = 0.0;
    for (std::size_t j = n; j-- > 0;)
        if (count[j] > 0.0) delay = delay_s[j] / count[j];
    for (std::size_t j = 0; j < n; ++j) {
        if (count[j] > 0.0) delay = delay_s[j] / count[j];
        for (std::size_t row = 0; row < n_rows; ++row)
            if (const int ray = ray_of[row * n + j]; ray >= 0 && !is_stored[std::size_t(ray)])
                scan.rays.time_offset_s[std::size_t(ray)] += float(delay);
    }
}

}  // namespace relidar::ncore
