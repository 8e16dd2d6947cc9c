// SPDX-License-Identifier: Apache-2.0
#include "read/files/scan_npz.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/ranges.h>

#include <relidar/base/arrays.hpp>
#include <relidar/read/clouds.hpp>

#include "base/fail.hpp"
#include "read/files/dropped_ray.hpp"

namespace relidar::read {
namespace {

/// The named arrays of a scan file. Each array has one entry per ray of the range image.
class NpzArrays {
public:
    NpzArrays(const std::string& location, std::vector<NamedArray> arrays)
        : where_(location), arrays_(std::move(arrays)) {
        const std::vector<std::size_t>& shape = required_array("range").shape;
        if (shape.empty() || shape.size() > 2 || required_array("range").element_count() > kMaxRays)
            fail(
                "{}: the array range has the shape [{}], expected [rows, columns] or [rays] with at most {} "
                "rays",
                where_, fmt::join(shape, ", "), kMaxRays);
        // Rays without an image form one row.
        rows = shape.size() == 2 ? shape[0] : 1;
        columns = shape.back();
    }
    std::size_t rows = 0, columns = 0;

    const NamedArray* find_optional(const std::string& array_name) const {
        return find_array(arrays_, array_name);
    }
    const NamedArray& required_array(const std::string& array_name) const {
        if (const NamedArray* array = find_optional(array_name)) return *array;
        fail("{}: the array '{}' is missing, expected it in every scan file", where_, array_name);
    }
    /// Returns the values of an array with one number per ray.
    /// @param default_value  value of all rays if the file does not contain the array
    std::vector<double> ray_values_or(const std::string& array_name, double default_value) const {
        return find_optional(array_name) ? ray_values(array_name, 1)
                                         : std::vector<double>(rows * columns, default_value);
    }
    /// Returns the values of an array with `n_values_per_ray` numbers per ray.
    /// @throws DataError if the file does not contain the array
    std::vector<double> ray_values(const std::string& array_name, std::size_t n_values_per_ray) const {
        if (required_array(array_name).element_count() != rows * columns * n_values_per_ray)
            fail("{}: the array {} has the shape [{}], expected {} x {} x {} values", where_, array_name,
                 fmt::join(required_array(array_name).shape, ", "), rows, columns, n_values_per_ray);
        return required_array(array_name).to_doubles();
    }
    std::vector<glm::vec3> ray_vectors(const std::string& array_name) const {
        const std::vector<double> v = ray_values(array_name, 3);
        std::vector<glm::vec3> vectors;
        for (std::size_t i = 0; i < v.size(); i += 3) vectors.emplace_back(v[i], v[i + 1], v[i + 2]);
        return vectors;
    }
    std::string ray_location(const std::string& array_name, std::size_t ray) const {
        return fmt::format("{}: {} of ray {}", where_, array_name, ray);
    }
    const std::string& error_place() const { return where_; }

private:
    std::string where_;
    std::vector<NamedArray> arrays_;
};

/// Reads the ranges and intensities of one return per ray. Rays without this return get
/// 0. Dropped rays of a rendered scan may also have a range, so drop_prob decides.
AdditionalReturns read_returns(const NpzArrays& arrays, const std::string& range_name,
                               const std::string& intensity_name, const PointFileUnits& units) {
    constexpr double kFarthest_m = 1e6;
    const std::vector<double> ranges_m = arrays.ray_values(range_name, 1);
    const std::vector<double> drop_probs = arrays.ray_values_or("drop_prob", 0.0);
    const std::vector<double> intensities = arrays.ray_values_or(intensity_name, 0.0);
    AdditionalReturns echo;
    for (std::size_t i = 0; i < ranges_m.size(); ++i) {
        const bool has_return = is_return_range(ranges_m[i]) && drop_probs[i] < 0.5;
        if (has_return && ranges_m[i] > kFarthest_m)
            fail("{} has the value {}, expected a range in metres, or 0 for a ray without return",
                 arrays.ray_location(range_name, i), ranges_m[i]);
        if (has_return && intensities[i] < 0.0)
            fail("{} has the value {}, expected an intensity of at least 0",
                 arrays.ray_location(intensity_name, i), intensities[i]);
        echo.range_m.push_back(has_return ? float(ranges_m[i]) : 0.0f);
        echo.intensity.push_back(
            has_return ? scale_intensity(intensities[i], units, arrays.ray_location(intensity_name, i))
                       : 0.0f);
    }
    return echo;
}

/// Returns the classes of the returns: the values of the channel `class`. Returns an
/// empty array if the file does not contain the channel.
std::vector<SurfaceClass> read_ray_classes(const NpzArrays& arrays, const std::vector<float>& range_m) {
    std::vector<SurfaceClass> classes;
    if (!arrays.find_optional("class")) return classes;
    const std::vector<double> numbers = arrays.ray_values("class", 1);
    for (std::size_t i = 0; i < numbers.size(); ++i) {
        const double number = range_m[i] > 0.0f ? numbers[i] : 0.0;
        if (!(number >= 0.0 && number < double(kSurfaceClasses)) || number != std::floor(number))
            fail("{} has the value {}, expected a whole number below {}", arrays.ray_location("class", i),
                 number, kSurfaceClasses);
        classes.push_back(SurfaceClass(int(number)));
    }
    return classes;
}

/// Returns the rays of the LiDAR's sensor model, for a range image without ray
/// directions. Throws if the image and the model differ in size.
RayTable match_sensor_rays(const NpzArrays& arrays, const ImageContext& image_context) {
    RayTable rays = make_lidar_rays(image_context.lidar, image_context.time_s);
    if (rays.size() == 0)
        fail("{}: the array of ray directions and the sensor in sequence.json are missing",
             arrays.error_place());
    if (std::size_t(rays.rows) != arrays.rows || std::size_t(rays.columns) != arrays.columns)
        fail("{}: the array range has {} x {} values, expected {} x {} (beams x columns) or ray directions",
             arrays.error_place(), arrays.rows, arrays.columns, rays.rows, rays.columns);
    return rays;
}

/// Reverses the order of the image rows, so that row 0 becomes the highest beam. An image
/// is an array with as many rows as the image of ranges.
void reverse_rows(std::vector<NamedArray>& arrays) {
    const NamedArray* range = find_array(arrays, "range");
    if (!range || range->shape.size() != 2) return;
    const std::size_t n_rows = range->shape[0];
    for (NamedArray& array : arrays) {
        const bool is_image = array.shape.size() >= 2 && array.shape[0] == n_rows;
        const std::size_t row_bytes = is_image && n_rows > 0 ? array.bytes.size() / n_rows : 0;
        if (row_bytes == 0) continue;
        std::vector<std::byte> reversed;
        for (std::size_t row = n_rows; row-- > 0;) {
            const auto begin = array.bytes.begin() + std::ptrdiff_t(row * row_bytes);
            reversed.insert(reversed.end(), begin, begin + std::ptrdiff_t(row_bytes));
        }
        array.bytes = std::move(reversed);
    }
}

/// Reads the times, rings and divergences of the rays, if the file contains them.
void set_ray_fields(const NpzArrays& arrays, const ImageContext& image_context, RayTable& rays) {
    const PointFileUnits& units = image_context.units;
    const std::size_t n = rays.size();
    if (arrays.find_optional("time") && !units.ignore_times) {
        const std::vector<double> time = arrays.ray_values("time", 1);
        for (std::size_t i = 0; i < n; ++i)
            rays.time_offset_s[i] =
                frame_offset_s(time[i], units, image_context.time_s, arrays.ray_location("time", i));
    }
    if (arrays.find_optional("ring")) {
        const std::vector<double> ring = arrays.ray_values("ring", 1);
        for (std::size_t i = 0; i < n; ++i)
            rays.channel[i] = convert_ring(ring[i], arrays.ray_location("ring", i));
    }
    if (arrays.find_optional("divergence_rad")) {
        const std::vector<double> common_rad = arrays.required_array("divergence_rad").to_doubles();
        if (common_rad.size() != 1)
            fail("{}: the array divergence_rad has {} numbers, expected one", arrays.error_place(),
                 common_rad.size());
        rays.divergence_rad = float(common_rad[0]);
        rays.ray_divergence_rad.clear();
    }
    if (arrays.find_optional("divergence")) {
        const std::vector<double> angles = arrays.ray_values("divergence", 1);
        rays.ray_divergence_rad.assign(angles.begin(), angles.end());
    }
}

/// Returns the rays with the exact directions in the file, instead of a fitted sensor's.
RayTable make_stored_rays(const NpzArrays& arrays) {
    RayTable rays;
    rays.rows = int(arrays.rows);
    rays.columns = int(arrays.columns);
    rays.direction = to_scan_array(arrays.ray_vectors("directions"));
    if (arrays.find_optional("origin")) rays.origin = to_scan_array(arrays.ray_vectors("origin"));
    else rays.origin.assign(rays.direction.size(), glm::vec3(0.0f));
    rays.time_offset_s.assign(rays.size(), 0.0f);  // set_ray_fields() reads times
    for (std::size_t i = 0; i < rays.size(); ++i) rays.channel.push_back(std::uint16_t(i / arrays.columns));
    return rays;
}

}  // namespace

void check_deskewing(bool is_deskewed, bool is_declared, const std::string& where) {
    if (is_deskewed && !is_declared)
        fail(
            "{}: the points are motion-compensated or in the world frame, but sequence.json does not say so; "
            "set \"motion_compensated\": true in sequence.json, or render the scans again without --deskew "
            "and without --frame world",
            where);
}

float scale_intensity(double file_value, const PointFileUnits& units, const std::string& where) {
    if (!std::isfinite(file_value))
        fail("{}: the intensity is {}, expected a finite number", where, file_value);
    if (units.intensity_max) return float(std::clamp(file_value / *units.intensity_max, 0.0, 1.0));
    if (file_value < 0.0 || file_value > 1.0)
        fail("{}: the intensity is {}, expected 0 to 1, or \"intensity_max\" in sequence.json", where,
             file_value);
    return float(file_value);
}

float frame_offset_s(double file_value, const PointFileUnits& units, double frame_time_s,
                     const std::string& where) {
    const double offset_s =
        (file_value - units.time_zero) * units.time_unit_s - (units.absolute_times ? frame_time_s : 0.0);
    if (!(std::abs(offset_s) <= kMaxTimeOffset_s))
        fail(
            "{}: the time {} is {} s away from the time of the frame, expected at most {} s; check the unit "
            "and the start of the times of points (conventions.time_unit and conventions.time_zero)",
            where, file_value, offset_s, kMaxTimeOffset_s);
    return float(offset_s);
}

std::uint16_t convert_ring(double file_value, const std::string& where) {
    if (!(file_value >= 0.0 && file_value < kNoBeam) || file_value != std::floor(file_value))
        fail("{}: the ring is {}, expected a whole number below {}", where, file_value, kNoBeam);
    return std::uint16_t(file_value);
}

Scan scan_from_arrays(const std::string& where, std::vector<NamedArray> stored_arrays,
                      const ImageContext& context) {
    // Without directions, the rays are those of the sensor, whose row 0 is the highest.
    const bool has_rays = find_array(stored_arrays, "directions") != nullptr;
    if (!has_rays && context.lowest_first) reverse_rows(stored_arrays);
    const NpzArrays arrays(where, std::move(stored_arrays));
    const NamedArray* flag = arrays.find_optional("deskewed");
    const bool is_deskewed = flag && flag->element_count() == 1 && flag->to_floats()[0] != 0.0f;
    check_deskewing(is_deskewed, context.motion_compensated, arrays.error_place());

    Scan scan;
    scan.rays = has_rays ? make_stored_rays(arrays) : match_sensor_rays(arrays, context);
    set_ray_fields(arrays, context, scan.rays);
    // A rendered file contains a median and a mean range. The median is used, because the
    // mean can be between two surfaces.
    const std::string range_name = arrays.find_optional("median_range") ? "median_range" : "range";
    const AdditionalReturns first = read_returns(arrays, range_name, "intensity", context.units);
    scan.range_m = to_scan_array(first.range_m);
    scan.intensity = to_scan_array(first.intensity);
    scan.classes = to_scan_array(read_ray_classes(arrays, first.range_m));
    for (std::size_t number = 2; number <= kMostReturns; ++number) {
        const std::string name = fmt::format("range_{}", number);
        if (!arrays.find_optional(name)) break;
        scan.second_returns.push_back(
            read_returns(arrays, name, fmt::format("intensity_{}", number), context.units));
    }
    return scan;
}

Scan read_scan_image(const std::filesystem::path& file, const ImageContext& image_context) {
    return file.extension() == ".exr" ? read_scan_exr(file, image_context)
                                      : scan_from_arrays(file.string(), read_npz(file), image_context);
}

void write_scan_npz(const std::filesystem::path& file, const Scan& scan, bool motion_compensated) {
    const RayTable& rays = scan.rays;
    const std::vector<std::size_t> shape = {std::size_t(rays.rows), std::size_t(rays.columns)};
    std::vector<NamedArray> arrays;
    const auto add = [&](const std::string& name, const auto& values) {
        arrays.push_back(make_array(name, shape, values.data(), values.size()));
    };
    const auto add_vectors = [&](const char* name, const ScanArray<glm::vec3>& vector) {
        arrays.push_back(make_array(name, {shape[0], shape[1], 3},
                                    vector.empty() ? nullptr : &vector.front().x, vector.size() * 3));
    };
    add("range", scan.range_m);
    add("intensity", scan.intensity);
    add_vectors("directions", rays.direction);
    add_vectors("origin", rays.origin);
    if (motion_compensated) add("time", std::vector<float>(rays.size(), 0.0f));
    else add("time", rays.time_offset_s);
    add("ring", rays.channel);
    if (!rays.ray_divergence_rad.empty()) add("divergence", rays.ray_divergence_rad);
    std::vector<std::int32_t> classes;
    for (const SurfaceClass surface : scan.classes) classes.push_back(std::int32_t(surface));
    if (!classes.empty()) add("class", classes);
    // Returns are numbered from 1, so the first additional return has the number 2.
    for (std::size_t k = 0; k < scan.second_returns.size(); ++k) {
        add(fmt::format("range_{}", k + 2), scan.second_returns[k].range_m);
        add(fmt::format("intensity_{}", k + 2), scan.second_returns[k].intensity);
    }
    // The shape {} means a single number.
    arrays.push_back(make_array("divergence_rad", {}, &rays.divergence_rad, 1));
    const std::int32_t deskewed = motion_compensated ? 1 : 0;
    arrays.push_back(make_array("deskewed", {}, &deskewed, 1));
    write_npz(file, arrays);
}

}  // namespace relidar::read
