// SPDX-License-Identifier: Apache-2.0
#include "sensor_messages.hpp"

#include <algorithm>
#include <cmath>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "geometry_messages.hpp"
#include "refusal.hpp"

namespace relidar::serve {
namespace {

constexpr std::uint64_t kMostRows = 65536;
constexpr std::size_t kLongestName = 200;
constexpr double kFarthestOrigin_m = 1000.0, kLongestScan_s = 60.0, kFarthestRange_m = 1e5,
                 kDefaultRange_m = 80.0, kWidestBeam_rad = 1.0, kFarthestBeam_m = 10.0,
                 kFastestMirror_hz = 1e6;

void check_ray_count(const std::string& field, std::uint64_t n_rays) {
    if (n_rays < 1 || n_rays > kMostRaysOfScan)
        reject_field(field, fmt::format("{} rays per scan", n_rays),
                     fmt::format("1 to {} rays", kMostRaysOfScan));
}

void check_row_count(const std::string& field, std::uint64_t n_rows) {
    if (n_rows > kMostRows)
        reject_field(field, fmt::format("{} rows per scan", n_rows),
                     fmt::format("at most {} rows, because ring numbers have 16 bits", kMostRows));
}

/// Returns a number of a message, or rejects it if it is outside its limits or NaN.
struct NumberReader {
    std::string field;  ///< path of the message in the request, for errors

    double operator()(const char* member, double value, double min_value, double max_value) const {
        if (!(value >= min_value && value <= max_value))
            reject_field(field + "." + member, fmt::format("{}", value),
                         fmt::format("a number from {} to {}", min_value, max_value));
        return value;
    }
};

/// Reads an array from the bytes of a message. It must be empty or have a value per ray.
template <class T>
std::vector<T> read_array(const std::string& bytes, std::size_t n_rays, const std::string& field) {
    if (!bytes.empty() && bytes.size() != n_rays * sizeof(T))
        reject_field(field, fmt::format("{} bytes", bytes.size()),
                     fmt::format("{} bytes, which are {} bytes for each of {} rays", n_rays * sizeof(T),
                                 sizeof(T), n_rays));
    std::vector<T> values(bytes.size() / sizeof(T));
    if (!bytes.empty()) std::memcpy(values.data(), bytes.data(), bytes.size());
    return values;
}

/// Checks every ray of a client. Negated comparisons (`!(x <= limit)`) also reject NaN.
void check_rays(const RayTable& rays, const std::string& field) {
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const auto reject = [&](const char* name, float found, const std::string& expected) {
            reject_field(fmt::format("{}.{} of ray {}", field, name, i), fmt::format("{}", found), expected);
        };
        const float length = glm::length(rays.direction[i]), time_s = rays.time_offset_s[i];
        if (!(std::abs(double(length) - 1.0) <= kUnitSlack)) reject("direction", length, "a length of 1");
        for (int axis = 0; axis < 3; ++axis)
            if (!(std::abs(double(rays.origin[i][axis])) <= kFarthestOrigin_m))
                reject("origin_m", rays.origin[i][axis],
                       fmt::format("a distance of at most {} metres", kFarthestOrigin_m));
        const double angle_rad = rays.divergence_of_rad(i);
        if (!(angle_rad >= 0.0 && angle_rad <= kWidestBeam_rad))
            reject("divergence_rad", float(angle_rad),
                   fmt::format("an angle from 0 to {} radians", kWidestBeam_rad));
        if (!(std::abs(double(time_s)) <= kLongestScan_s))
            reject("time_s", time_s, fmt::format("a time of at most {} seconds", kLongestScan_s));
    }
}

/// Reads a sensor that is a list of rays, row by row. Only the directions are required.
/// By default, all rays are in one row and start at the sensor's origin at time 0. The
/// ring of a ray, the number of its beam, is its row by default.
RayTable read_ray_table(const v1::RayTable& message, const std::string& field) {
    static_assert(sizeof(glm::vec3) == 12);
    if (message.direction().size() % sizeof(glm::vec3) != 0)
        reject_field(field + ".direction", fmt::format("{} bytes", message.direction().size()),
                     "a multiple of 12 bytes (three floats for each ray)");
    const std::size_t n_rays = message.direction().size() / sizeof(glm::vec3);
    check_ray_count(field + ".direction", n_rays);
    const bool has_image_size = message.rows() != 0 || message.columns() != 0;
    if (has_image_size && std::uint64_t(message.rows()) * message.columns() != n_rays)
        reject_field(
            field,
            fmt::format("{} rows, {} columns and {} directions", message.rows(), message.columns(), n_rays),
            "rows * columns directions");
    check_row_count(field, message.rows());
    RayTable rays;
    rays.rows = has_image_size ? int(message.rows()) : 1;
    rays.columns = has_image_size ? int(message.columns()) : int(n_rays);
    rays.direction = to_scan_array(read_array<glm::vec3>(message.direction(), n_rays, field + ".direction"));
    rays.origin = to_scan_array(read_array<glm::vec3>(message.origin_m(), n_rays, field + ".origin_m"));
    rays.time_offset_s = to_scan_array(read_array<float>(message.time_s(), n_rays, field + ".time_s"));
    rays.channel = to_scan_array(read_array<std::uint16_t>(message.ring(), n_rays, field + ".ring"));
    rays.ray_divergence_rad =
        to_scan_array(read_array<float>(message.divergence_rad(), n_rays, field + ".divergence_rad"));
    rays.origin.resize(n_rays, glm::vec3(0.0f));
    rays.time_offset_s.resize(n_rays, 0.0f);
    for (std::size_t i = rays.channel.size(); i < n_rays; ++i)
        rays.channel.push_back(std::uint16_t(i / std::size_t(rays.columns)));
    check_rays(rays, field);
    for (glm::vec3& direction : rays.direction) direction = glm::normalize(direction);
    return rays;
}

/// Reads a spinning sensor with an elevation and an azimuth offset per beam, in radians.
SpinningSensor read_spinning(const v1::SpinningSensor& message, const std::string& field) {
    check_ray_count(field, std::uint64_t(message.beams_size()) * message.columns());
    check_row_count(field, std::uint64_t(message.beams_size()));
    SpinningSensor sensor;
    for (const v1::Beam& beam : message.beams()) {
        const NumberReader read{fmt::format("{}.beams[{}]", field, sensor.beams.size())};
        sensor.beams.push_back(
            {read("elevation_rad", beam.elevation_rad(), -kPi / 2, kPi / 2),
             read("azimuth_offset_rad", beam.azimuth_offset_rad(), -kPi, kPi),
             read("origin_offset_m", beam.origin_offset_m(), -kFarthestBeam_m, kFarthestBeam_m)});
    }
    // Compares only the first and the last beam, because neighbouring beams of real
    // sensors can be slightly out of order.
    if (const auto& beams = sensor.beams;
        !beams.empty() && beams.back().elevation_rad > beams.front().elevation_rad)
        reject_field(field + ".beams",
                     fmt::format("a first beam at {} rad and a last beam at {} rad",
                                 beams.front().elevation_rad, beams.back().elevation_rad),
                     "the highest beam first");
    sensor.columns = int(message.columns());
    sensor.period_s = NumberReader{field}("period_s", message.period_s(), 1e-4, kLongestScan_s);
    sensor.clockwise = !message.counter_clockwise();
    // The image begins behind the sensor (azimuth pi), so azimuth 0 is in its middle.
    // The centre of the first column is half a column (pi / columns) from there.
    sensor.first_azimuth_rad = kPi - kPi / sensor.columns;
    return sensor;
}

/// Reads a sensor that scans a rectangular window column by column. Row 0 is the highest.
WindowScanSensor read_window(const v1::ScanningWindow& message, const std::string& field) {
    check_ray_count(field, std::uint64_t(message.rows()) * message.columns());
    check_row_count(field, message.rows());
    const NumberReader read{field};
    const double top_rad = read("top_rad", message.top_rad(), -kPi / 2, kPi / 2);
    return {.name = "",
            .rows = int(message.rows()),
            .columns = int(message.columns()),
            .left_rad = read("left_rad", message.left_rad(), -2 * kPi, 2 * kPi),
            .right_rad = read("right_rad", message.right_rad(), -2 * kPi, 2 * kPi),
            .top_rad = top_rad,
            .bottom_rad = read("bottom_rad", message.bottom_rad(), -kPi / 2, top_rad),
            .period_s = read("period_s", message.period_s(), 1e-4, kLongestScan_s)};
}

/// Reads a sensor that draws a rosette, because two rotating prisms deflect its beam.
RosetteSensor read_rosette(const v1::Rosette& message, const std::string& field) {
    check_ray_count(field, message.rays());
    const NumberReader read{field};
    return {.name = "",
            .deflection_rad = read("deflection_rad", message.deflection_rad(), 0.0, kPi / 2),
            .first_hz = read("first_hz", message.first_hz(), -kFastestMirror_hz, kFastestMirror_hz),
            .second_hz = read("second_hz", message.second_hz(), -kFastestMirror_hz, kFastestMirror_hz),
            .n_rays = int(message.rays()),
            .period_s = read("period_s", message.period_s(), 1e-4, kLongestScan_s)};
}

}  // namespace

/// Reads a client's description of a sensor and checks every value, because clients may
/// send invalid values. Lengths are in metres.
SimulatedSensor read_sensor(const v1::SensorSpec& message, const std::string& field) {
    SensorModel sensor;
    if (message.name().size() > kLongestName)
        reject_field(field + ".name", quote_client_text(message.name()),
                     fmt::format("at most {} bytes", kLongestName));
    sensor.name = message.name().empty() ? "a client's sensor" : message.name();
    const NumberReader read{field};
    sensor.limits.max_m =
        read("max_range_m", message.has_max_range_m() ? message.max_range_m() : kDefaultRange_m, 1e-3,
             kFarthestRange_m);
    sensor.limits.min_m = read("min_range_m", message.min_range_m(), 0.0, sensor.limits.max_m);
    switch (message.pattern_case()) {
        case v1::SensorSpec::kRays: sensor.pattern = read_ray_table(message.rays(), field + ".rays"); break;
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
            reject_field(field, "no pattern", "the pattern rays, spinning, window or rosette");
    }
    const double divergence_rad = read("divergence_rad", message.divergence_rad(), 0.0, kWidestBeam_rad);
    // Copies the common values to the pattern. A ray table has no name.
    std::visit(
        [&](auto& pattern) {
            if constexpr (requires { pattern.name; }) pattern.name = sensor.name;
            pattern.divergence_rad = static_cast<decltype(pattern.divergence_rad)>(divergence_rad);
        },
        sensor.pattern);
    // Rays that change from scan to scan are computed later, for each scan. Computes them
    // once here, only to reject invalid rays before rendering.
    if (summarise_pattern(sensor.pattern).has_rays_by_time) make_rays(sensor);
    return simulate_sensor(sensor);
}

SimulatedSensor find_known_sensor(const std::string& name, const Run& run, int lidar) {
    if (name.empty()) return make_sensor(run.config, run.log, lidar);
    if (find_name(name, {"native", kitti360_grid().name}))
        return choose_sensor(name, run.config, run.log, lidar);
    // A name may end with columns and scans per second, for example "VLP-16:900x20". For
    // this check, any digits will do, because find_sensor() checks them.
    const std::size_t colon = name.rfind(':');
    const bool has_resolution =
        colon != std::string::npos && name.find_first_not_of("0123456789x.", colon + 1) == std::string::npos;
    const std::string model_name = has_resolution ? name.substr(0, colon) : name;
    std::vector<std::string> known_names = list_sensors();
    if (!find_name(model_name, known_names)) {
        known_names.push_back("native");
        constexpr std::size_t kMaxCompared = 80;  // The comparison is slow for long texts.
        reject_field("sensor.name", quote_client_text(name),
                     fmt::format("a name that ListScenes returns, such as {}",
                                 nearest_name(name.substr(0, kMaxCompared), known_names)));
    }
    const SensorModel sensor = find_sensor(name);
    check_ray_count("sensor.name " + quote_client_text(name), summarise_pattern(sensor.pattern).n_rays);
    return simulate_sensor(sensor, lidar);
}

/// Returns when the first and last ray are fired, seconds relative to the scan's time.
FiringTimeSpan firing_span(const SimulatedSensor& sensor) {
    const ScanArray<float>& times = sensor.rays.time_offset_s;
    // The sensor has no fixed firing times, for example a rosette scanner. Assumes a full
    // scan period, centred at the time of the scan.
    if (times.empty()) {
        const double period_s = sensor.pattern ? scan_period_s(*sensor.pattern) : 0.0;
        return {-0.5 * period_s, 0.5 * period_s};
    }
    const auto [first, last] = std::minmax_element(times.begin(), times.end());
    return {double(*first), double(*last)};
}

std::size_t count_rays(const SimulatedSensor& sensor) {
    if (sensor.rays.size() > 0 || !sensor.pattern) return sensor.rays.size();
    return summarise_pattern(*sensor.pattern).n_rays;
}

std::pair<std::string, SensorPtr> SensorCache::add_upload(SimulatedSensor sensor) {
    const std::string handle = fmt::format("sensor-{}", ++n_uploads_);
    return {handle, add_sensor(handle, std::move(sensor))};
}

SensorPtr SensorCache::add_sensor(const std::string& key, SimulatedSensor sensor) {
    const auto shared_sensor = std::make_shared<const SimulatedSensor>(std::move(sensor));
    const std::lock_guard lock(mutex_);
    while (!entries_.empty() &&
           (entries_.size() >= kMostSensors || cached_rays() + shared_sensor->rays.size() > kMostRays))
        entries_.erase(
            std::ranges::min_element(entries_, {}, [](const auto& entry) { return entry.second.used; }));
    entries_[key] = {shared_sensor, ++clock_};
    return shared_sensor;
}

SensorPtr SensorCache::find_cached(const std::string& key) {
    const std::lock_guard lock(mutex_);
    const auto entry = entries_.find(key);
    if (entry == entries_.end()) return nullptr;
    entry->second.used = ++clock_;
    return entry->second.sensor;
}

std::size_t SensorCache::cached_rays() const {
    std::size_t rays = 0;
    for (const auto& [handle, entry] : entries_) rays += entry.sensor->rays.size();
    return rays;
}

}  // namespace relidar::serve
