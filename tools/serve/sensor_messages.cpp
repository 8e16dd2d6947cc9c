// SPDX-License-Identifier: Apache-2.0
#include "sensor_messages.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/run/run.hpp>

#include "geometry_messages.hpp"
#include "refusal.hpp"

namespace relidar::serve {
namespace {

constexpr std::uint64_t kMostRows = 65536;
constexpr std::size_t kLongestName = 200;
constexpr double kFarthestOrigin_m = 1000.0, kLongestScan_s = 60.0, kFarthestRange_m = 1e5,
                 kDefaultRange_m = 80.0, kWidestBeam_rad = 1.0, kFarthestBeam_m = 10.0,
                 kFastestMirror_hz = 1e6;

void check_count(const std::string& field, std::uint64_t rays) {
    if (rays < 1 || rays > kMostRaysOfScan)
        throw_refusal(field, fmt::format("{} rays per scan", rays), fmt::format("1 to {}", kMostRaysOfScan));
}

void check_rows(const std::string& field, std::uint64_t rows) {
    if (rows > kMostRows)
        throw_refusal(field, fmt::format("{} rows per scan", rows),
                      fmt::format("at most {}, because ring numbers have 16 bits", kMostRows));
}

double read_between(const std::string& field, double value, double low, double high) {
    if (!(value >= low && value <= high))
        throw_refusal(field, fmt::format("{}", value), fmt::format("a number from {} to {}", low, high));
    return value;
}

/// Reads an array from the bytes of a message. The array must have `count` values or be
/// empty.
template <class T>
std::vector<T> read_array(const std::string& bytes, std::size_t count, const std::string& field) {
    if (!bytes.empty() && bytes.size() != count * sizeof(T))
        throw_refusal(field, fmt::format("{} bytes", bytes.size()),
                      fmt::format("{} bytes: a value of {} bytes for each of {} rays", count * sizeof(T),
                                  sizeof(T), count));
    std::vector<T> values(bytes.size() / sizeof(T));
    if (!bytes.empty()) std::memcpy(values.data(), bytes.data(), bytes.size());
    return values;
}

void check_values(const RayTable& rays, const std::string& field) {
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const auto fail = [&](const char* name, float found, const std::string& expected) {
            throw_refusal(fmt::format("{}.{} of ray {}", field, name, i), fmt::format("{}", found), expected);
        };
        const float length = glm::length(rays.direction[i]), time_s = rays.time_offset_s[i];
        if (!(std::abs(double(length) - 1.0) <= kUnitSlack)) fail("direction", length, "a length of 1");
        for (int axis = 0; axis < 3; ++axis)
            if (const float x = rays.origin[i][axis]; !(std::abs(double(x)) <= kFarthestOrigin_m))
                fail("origin_m", x, fmt::format("metres of at most {}", kFarthestOrigin_m));
        if (const double angle = rays.compute_divergence(i); !(angle >= 0.0 && angle <= kWidestBeam_rad))
            fail("divergence_rad", float(angle), fmt::format("radians in [0, {}]", kWidestBeam_rad));
        if (!(std::abs(double(time_s)) <= kLongestScan_s))
            fail("time_s", time_s, fmt::format("seconds of at most {}", kLongestScan_s));
    }
}

RayTable read_rays(const v1::RayTable& message, const std::string& field) {
    static_assert(sizeof(glm::vec3) == 12);
    if (message.direction().size() % sizeof(glm::vec3) != 0)
        throw_refusal(field + ".direction", fmt::format("{} bytes", message.direction().size()),
                      "a multiple of 12");
    const std::size_t n = message.direction().size() / sizeof(glm::vec3);
    check_count(field + ".direction", n);
    const bool has_order = message.rows() != 0 || message.columns() != 0;
    if (has_order && std::uint64_t(message.rows()) * message.columns() != n)
        throw_refusal(
            field, fmt::format("{} rows, {} columns and {} directions", message.rows(), message.columns(), n),
            "one direction for each combination of row and column");
    check_rows(field, message.rows());
    RayTable rays;
    rays.rows = has_order ? int(message.rows()) : 1;
    rays.columns = has_order ? int(message.columns()) : int(n);
    rays.direction = to_scan_array(read_array<glm::vec3>(message.direction(), n, field + ".direction"));
    rays.origin = to_scan_array(read_array<glm::vec3>(message.origin_m(), n, field + ".origin_m"));
    rays.time_offset_s = to_scan_array(read_array<float>(message.time_s(), n, field + ".time_s"));
    rays.channel = to_scan_array(read_array<std::uint16_t>(message.ring(), n, field + ".ring"));
    rays.ray_divergence_rad =
        to_scan_array(read_array<float>(message.divergence_rad(), n, field + ".divergence_rad"));
    rays.origin.resize(n, glm::vec3(0.0f));
    rays.time_offset_s.resize(n, 0.0f);
    for (std::size_t i = rays.channel.size(); i < n; ++i)
        rays.channel.push_back(std::uint16_t(i / std::size_t(rays.columns)));
    check_values(rays, field);
    for (glm::vec3& direction : rays.direction) direction = glm::normalize(direction);
    return rays;
}

/// Checks a beam like a beam in a sensor file, and adds it to the sensor.
void read_beam(const v1::Beam& message, const std::string& field, SpinningSensor& sensor) {
    const Beam beam{read_between(field + ".elevation_rad", message.elevation_rad(), -kPi / 2, kPi / 2),
                    read_between(field + ".azimuth_offset_rad", message.azimuth_offset_rad(), -kPi, kPi),
                    read_between(field + ".origin_offset_m", message.origin_offset_m(), -kFarthestBeam_m,
                                 kFarthestBeam_m)};
    sensor.beams.push_back(beam);
}

SpinningSensor read_spinning(const v1::SpinningSensor& message, const std::string& field) {
    check_count(field, std::uint64_t(message.beams_size()) * message.columns());
    check_rows(field, std::uint64_t(message.beams_size()));
    SpinningSensor sensor;
    for (const v1::Beam& beam : message.beams())
        read_beam(beam, fmt::format("{}.beams[{}]", field, sensor.beams.size()), sensor);
    // Checks only that the first beam is above the last beam, because neighbouring beams
    // of real sensors can be slightly out of order.
    if (const auto& beams = sensor.beams;
        !beams.empty() && beams.back().elevation_rad > beams.front().elevation_rad)
        throw_refusal(field + ".beams",
                      fmt::format("a first beam at {} rad and a last beam at {} rad",
                                  beams.front().elevation_rad, beams.back().elevation_rad),
                      "beams from the highest to the lowest, because row 0 of an image is the highest");
    sensor.columns = int(message.columns());
    sensor.period_s = read_between(field + ".period_s", message.period_s(), 1e-4, kLongestScan_s);
    sensor.clockwise = !message.counter_clockwise();
    // The first column is about half a turn away from azimuth 0, so that azimuth 0 is in
    // the middle of the image.
    sensor.first_azimuth_rad = kPi - kPi / sensor.columns;
    return sensor;
}

ScanningWindow read_window(const v1::ScanningWindow& message, const std::string& field) {
    check_count(field, std::uint64_t(message.rows()) * message.columns());
    check_rows(field, message.rows());
    const double top_rad = read_between(field + ".top_rad", message.top_rad(), -kPi / 2, kPi / 2);
    return {.name = "",
            .rows = int(message.rows()),
            .columns = int(message.columns()),
            .left_rad = read_between(field + ".left_rad", message.left_rad(), -2 * kPi, 2 * kPi),
            .right_rad = read_between(field + ".right_rad", message.right_rad(), -2 * kPi, 2 * kPi),
            .top_rad = top_rad,
            // Row 0 is the highest.
            .bottom_rad = read_between(field + ".bottom_rad", message.bottom_rad(), -kPi / 2, top_rad),
            .period_s = read_between(field + ".period_s", message.period_s(), 1e-4, kLongestScan_s)};
}

Rosette read_rosette(const v1::Rosette& message, const std::string& field) {
    check_count(field, message.rays());
    return {.name = "",
            .deflection_rad = read_between(field + ".deflection_rad", message.deflection_rad(), 0.0, kPi / 2),
            .first_hz =
                read_between(field + ".first_hz", message.first_hz(), -kFastestMirror_hz, kFastestMirror_hz),
            .second_hz = read_between(field + ".second_hz", message.second_hz(), -kFastestMirror_hz,
                                      kFastestMirror_hz),
            .n_rays = int(message.rays()),
            .period_s = read_between(field + ".period_s", message.period_s(), 1e-4, kLongestScan_s)};
}

/// Returns the name of a sensor without its resolution and rate, for example "VLP-16" for
/// "VLP-16:900x20". Returns the full name if the part after the colon has another form.
std::string get_base_name(const std::string& name) {
    const std::size_t colon = name.rfind(':');
    const bool sized =
        colon != std::string::npos && name.find_first_not_of("0123456789x.", colon + 1) == std::string::npos;
    return sized ? name.substr(0, colon) : name;
}

}  // namespace

SensorChoice read_sensor(const v1::SensorSpec& message, const std::string& field) {
    SensorModel sensor;
    if (message.name().size() > kLongestName)
        throw_refusal(field + ".name", quoted(message.name()), fmt::format("at most {} bytes", kLongestName));
    sensor.name = message.name().empty() ? "a client's sensor" : message.name();
    sensor.limits.max_m = read_between(field + ".max_range_m",
                                       message.has_max_range_m() ? message.max_range_m() : kDefaultRange_m,
                                       1e-3, kFarthestRange_m);
    sensor.limits.min_m =
        read_between(field + ".min_range_m", message.min_range_m(), 0.0, sensor.limits.max_m);
    switch (message.pattern_case()) {
        case v1::SensorSpec::kRays:
            sensor.pattern = read_rays(message.rays(), field + ".rays");
            break;
        case v1::SensorSpec::kSpinning:
            sensor.pattern = read_spinning(message.spinning(), field + ".spinning");
            break;
        case v1::SensorSpec::kWindow:
            sensor.pattern = read_window(message.window(), field + ".window");
            break;
        case v1::SensorSpec::kRosette:
            sensor.pattern = read_rosette(message.rosette(), field + ".rosette");
            break;
        case v1::SensorSpec::PATTERN_NOT_SET:
            throw_refusal(field, "no pattern", "rays, spinning, window or rosette");
    }
    const double divergence_rad =
        read_between(field + ".divergence_rad", message.divergence_rad(), 0.0, kWidestBeam_rad);
    std::visit(
        [&](auto& pattern) {
            if constexpr (requires { pattern.name; }) pattern.name = sensor.name;
            pattern.divergence_rad = static_cast<decltype(pattern.divergence_rad)>(divergence_rad);
        },
        sensor.pattern);
    // Computes the rays to check that they are finite. Otherwise the error would occur
    // only when a scan is rendered.
    if (describe_pattern(sensor.pattern).has_rays_by_time) make_rays(sensor);
    return make_sensor_choice(sensor);
}

SensorChoice find_named_sensor(const std::string& name, const Run& run, int lidar) {
    if (name.empty()) return make_configured_sensor(run.config, run.sequence, lidar);
    if (find_known_name(name, {"native", make_kitti360_grid().name}))
        return choose_sensor(name, run.config, run.sequence, lidar);
    std::vector<std::string> known = list_sensor_names();
    if (!find_known_name(get_base_name(name), known)) {
        known.push_back("native");
        throw_refusal("sensor.name", quoted(name),
                      fmt::format("a name that ListScenes returns, such as {}",
                                  find_nearest_name(name.substr(0, 80), known)));
    }
    const SensorModel sensor = find_sensor(name);
    check_count("sensor.name " + quoted(name), describe_pattern(sensor.pattern).n_rays);
    return make_sensor_choice(sensor, lidar);
}

FiringSpan compute_firing_span(const SensorChoice& sensor) {
    const ScanArray<float>& times = sensor.rays.time_offset_s;
    // Without fixed firing times, assumes a full period around the reference time. This
    // applies to rosette sensors and to sensors that are known only from their scans.
    if (times.empty()) {
        const double period_s = sensor.pattern ? get_period(*sensor.pattern) : 0.0;
        return {-0.5 * period_s, 0.5 * period_s};
    }
    const auto [first, last] = std::minmax_element(times.begin(), times.end());
    return {double(*first), double(*last)};
}

std::size_t count_rays(const SensorChoice& sensor) {
    if (sensor.rays.size() > 0 || !sensor.pattern) return sensor.rays.size();
    return describe_pattern(*sensor.pattern).n_rays;
}

}  // namespace relidar::serve
