// SPDX-License-Identifier: Apache-2.0
// Reads, writes and generates sensors of the kind "rosette". In such a sensor, two
// rotating prisms deflect one beam.
#include <cmath>

#include <relidar/base/math.hpp>

#include "log/sensor/pattern_kinds.hpp"

namespace relidar {

RayTable make_rays(const Rosette& r, double time_s) {
    pattern_detail::check_count(r.name, r.n_rays);
    pattern_detail::check_finite(
        r.name, r.deflection_rad + r.first_hz + r.second_hz + r.divergence_rad + time_s, r.period_s);
    RayTable rays;
    rays.rows = 1;
    rays.columns = r.n_rays;
    rays.divergence_rad = static_cast<float>(r.divergence_rad);
    for (int i = 0; i < r.n_rays; ++i) {
        const double offset_s = ((i + 0.5) / r.n_rays - 0.5) * r.period_s;
        const double first = 2.0 * kPi * std::fmod(r.first_hz * (time_s + offset_s), 1.0);
        const double second = 2.0 * kPi * std::fmod(r.second_hz * (time_s + offset_s), 1.0);
        const double left = r.deflection_rad * (std::cos(first) + std::cos(second));
        const double up = r.deflection_rad * (std::sin(first) + std::sin(second));
        const double bent = std::hypot(left, up), share = bent > 0.0 ? std::sin(bent) / bent : 1.0;
        pattern_detail::add_ray(rays, {std::cos(bent), left * share, up * share}, offset_s, 0);
    }
    return rays;
}

namespace {

struct RosetteFunctions {
    using Pattern = Rosette;

    static SensorModel parse(const JsonField& field, const std::string& of) {
        pattern_detail::check_members(field, {"rays", "first_hz", "second_hz"}, {"deflection"});
        const auto [name, limits, period_s, divergence_rad] = pattern_detail::read_common(field, of);
        return {name, "", limits,
                Rosette{.name = name,
                        .deflection_rad = pattern_detail::read_angle(field, "deflection", 45.0),
                        .first_hz = field.at("first_hz").number(-1e5, 1e5),
                        .second_hz = field.at("second_hz").number(-1e5, 1e5),
                        .n_rays = static_cast<int>(field.at("rays").integer(1, std::int64_t(kMaxRays))),
                        .period_s = period_s,
                        .divergence_rad = divergence_rad}};
    }
    static nlohmann::ordered_json write(const Rosette& r) {
        return {{"rays", r.n_rays},       {"deflection_rad", r.deflection_rad},
                {"first_hz", r.first_hz}, {"second_hz", r.second_hz},
                {"period_s", r.period_s}, {"divergence_rad", r.divergence_rad}};
    }
    static RayTable make_rays(const Rosette& r, double time_s) { return relidar::make_rays(r, time_s); }
    static PatternSummary describe(const Rosette& r) {
        return {.n_rays = std::size_t(r.n_rays), .period_s = r.period_s, .has_rays_by_time = true};
    }
};

}  // namespace

PatternKind rosette_kind() {
    return pattern_kind<RosetteFunctions>("rosette", "rays, deflection_deg, first_hz, second_hz");
}

}  // namespace relidar
