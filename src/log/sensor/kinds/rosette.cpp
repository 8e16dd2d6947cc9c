// SPDX-License-Identifier: Apache-2.0
// Reads, writes and generates sensors of the kind "rosette". In such a sensor, two
// rotating prisms deflect one beam.
#include <cmath>

#include <relidar/base/math.hpp>

#include "log/sensor/pattern_kinds.hpp"

namespace relidar {

using namespace sensor;

/// Returns the rays of one scan, in the order of firing. The pattern depends on the time,
/// because the prisms do not return to the same angles after a period.
/// @param time_s  time of the middle of the scan
RayTable make_rays(const RosetteSensor& rosette, double time_s) {
    check_ray_count(rosette.name, rosette.n_rays);
    check_pattern(
        rosette.name, rosette.period_s,
        {rosette.deflection_rad, rosette.first_hz, rosette.second_hz, rosette.divergence_rad, time_s});
    RayTable rays;
    rays.rows = 1;
    rays.columns = rosette.n_rays;
    rays.divergence_rad = float(rosette.divergence_rad);
    for (int i = 0; i < rosette.n_rays; ++i) {
        const double offset_s = ((i + 0.5) / rosette.n_rays - 0.5) * rosette.period_s;
        const double first_rad = 2.0 * kPi * std::fmod(rosette.first_hz * (time_s + offset_s), 1.0);
        const double second_rad = 2.0 * kPi * std::fmod(rosette.second_hz * (time_s + offset_s), 1.0);
        // Each prism deflects the beam by the same angle, in the direction of its
        // rotation angle. The sum of both is a vector: its length is the angle between
        // the ray and the x axis.
        const double left_rad = rosette.deflection_rad * (std::cos(first_rad) + std::cos(second_rad));
        const double up_rad = rosette.deflection_rad * (std::sin(first_rad) + std::sin(second_rad));
        const double bent_rad = std::hypot(left_rad, up_rad);
        // The part of the ray perpendicular to the axis has the length sin(bent_rad).
        const double scale = bent_rad > 0.0 ? std::sin(bent_rad) / bent_rad : 1.0;
        add_ray(rays, {std::cos(bent_rad), left_rad * scale, up_rad * scale}, offset_s, 0);
    }
    return rays;
}

/// Reads a rosette sensor from its JSON object. A deflection is the angle of one prism.
SensorModel sensor::parse_rosette(const JsonField& field, const std::string& default_name) {
    check_members(field, {"rays", "first_hz", "second_hz"}, {"deflection"});
    const auto [name, limits, period_s, divergence_rad] = read_common(field, default_name);
    return {.name = name,
            .limits = limits,
            .pattern = RosetteSensor{.name = name,
                                     .deflection_rad = read_angle_rad(field, "deflection", 45.0),
                                     .first_hz = field.at("first_hz").number_in(-1e5, 1e5),
                                     .second_hz = field.at("second_hz").number_in(-1e5, 1e5),
                                     .n_rays = int(field.at("rays").integer_in(1, std::int64_t(kMaxRays))),
                                     .period_s = period_s,
                                     .divergence_rad = divergence_rad}};
}

nlohmann::ordered_json sensor::write(const RosetteSensor& rosette) {
    return {{"rays", rosette.n_rays},       {"deflection_rad", rosette.deflection_rad},
            {"first_hz", rosette.first_hz}, {"second_hz", rosette.second_hz},
            {"period_s", rosette.period_s}, {"divergence_rad", rosette.divergence_rad}};
}

ScanPatternSummary sensor::describe(const RosetteSensor& rosette) {
    return {.n_rays = std::size_t(rosette.n_rays), .period_s = rosette.period_s, .has_rays_by_time = true};
}

}  // namespace relidar
