// SPDX-License-Identifier: Apache-2.0
// Simulates the returns of fog, raindrops and snowflakes along a ray, and selects the
// returns that a sensor reports. Fog is a soft target (Rasshofer, Spies and Spies 2011),
// as in Hahner et al. (ICCV 2021). Particles are drawn for each beam, as in LISA (Kilic
// et al. 2021) and Hahner et al. (CVPR 2022). The density of fog varies along a ray; the
// amount of variation is an assumption.
#include <relidar/simulate/weather.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <relidar/base/math.hpp>

#include "base/random.hpp"

namespace relidar {
namespace {

constexpr double kStep_m = 0.05;  // range step of the tables
// Below this range, the receiver does not see the part of the air that the beam
// illuminates (Hahner et al. 2021).
constexpr double kOverlap_m = 1.0;
constexpr double kLight_m_s = 299792458.0;
// Backscatter coefficient of fog multiplied by its visibility, per steradian (Rasshofer
// et al. 2011).
constexpr double kBackscatter = 0.046;
// Standard deviation of the logarithm of the fog density. This value is an assumption.
constexpr double kFogSpread = 1.0;
// Ignores fog whose density is above this number of standard deviations, because it is
// very rare.
constexpr double kRareFog = 5.0;

double pulse_m(const WeatherSensor& sensor) { return kLight_m_s * sensor.pulse_s; }

}  // namespace

/// A possible return of a ray that is bright enough for the sensor.
struct Air::Candidate {
    Echo echo;
    double power;
};

namespace {

/// Returns the second return of a sensor that reports two returns. This is the last
/// return, or the second strongest if the strongest is also the last.
template <class Candidates>
Echo second_of(const Candidates& candidates, const Echo& strongest, double separation_m) {
    Echo last, next;
    double power = 0.0;
    for (const auto& candidate : candidates) {
        const double range_m = candidate.echo.range_m;
        if (std::abs(range_m - strongest.range_m) < separation_m) continue;
        if (range_m > std::max(strongest.range_m, last.range_m)) last = candidate.echo;
        if (candidate.power > power) next = candidate.echo, power = candidate.power;
    }
    return last.source == PointSource::nothing ? next : last;
}

}  // namespace

double WeatherSensor::threshold(double range_m) const {
    return std::max(weakest(), weakest_reflectivity / (range_m * range_m));
}

Air::Air(const Weather& weather, const WeatherSensor& sensor)
    : weather_(weather), sensor_(sensor), falling_(falling_in(weather)), alpha_(extinction(weather)) {
    check_weather(weather);
    const double thickest = std::exp(kFogSpread * (kRareFog - 0.5 * kFogSpread)),
                 rises_to_m = nearest_m() + pulse_m(sensor);
    bool fog_shows = std::isfinite(weather.fog_visibility_m);
    double expected = 0.0, before = 0.0;
    for (double r = nearest_m(); r <= sensor.max_range_m + kStep_m; r += kStep_m) {
        if (fog_shows) fog_power_.push_back(fog_power(r));
        fog_shows = fog_shows && (r < rises_to_m || fog_power_.back() * thickest > sensor.weakest());
        if (falling_.per_m3_mm == 0.0) continue;
        const double area = 0.25 * kPi * beam_m(r) * beam_m(r),
                     density = area * falling_.per_m3_mm / falling_.slope_per_mm *
                               std::exp(-falling_.slope_per_mm * smallest_mm(r));
        if (!particles_.empty()) expected += 0.5 * (before + density) * kStep_m;
        before = density;
        particles_.push_back(expected);
    }
}

double Air::nearest_m() const { return std::max(kOverlap_m, sensor_.min_range_m); }

/// Returns the diameter of the smallest particle that the sensor detects at a range, in
/// millimetres of liquid water. Returns infinity if even a particle that fills the beam
/// reflects too little light.
double Air::smallest_mm(double range_m) const {
    const double share = sensor_.threshold(range_m) * range_m * range_m * std::exp(2.0 * alpha_ * range_m) /
                         falling_.reflectivity;
    if (share > 1.0) return std::numeric_limits<double>::infinity();
    return 1e3 * beam_m(range_m) * std::sqrt(share) / falling_.widening;
}

/// Returns the mean power of fog at a range. Integrates over the pulse with the midpoint
/// rule.
double Air::fog_power(double range_m) const {
    constexpr int kParts = 32;
    const double width_m = pulse_m(sensor_), part_m = width_m / kParts;
    double sum = 0.0;
    for (int i = 0; i < kParts; ++i) {
        const double x = -0.5 * width_m + (i + 0.5) * part_m, r = range_m + x,
                     pulse = std::cos(kPi * x / width_m);
        if (r >= kOverlap_m) sum += pulse * pulse * std::exp(-2.0 * alpha_ * r) / (r * r) * part_m;
    }
    return kPi * kBackscatter / weather_.fog_visibility_m * sum;
}

/// Returns the reflectivity of a surface. An intensity below one step of the sensor does
/// not determine the reflectivity. In this case, draws a random value between the weakest
/// detectable reflectivity and one step.
double Air::surface_reflectivity(const Echo& surface, Random& random) const {
    const double step = 2.0 * sensor_.darkest;
    if (surface.reflectivity >= step) return surface.reflectivity;
    return std::lerp(sensor_.threshold(surface.range_m) * surface.range_m * surface.range_m, step,
                     random.uniform());
}

void Air::add_surfaces(std::vector<Candidate>& candidates, const RayEchoes& surfaces, Random& random) const {
    for (Echo echo : {surfaces.strongest, surfaces.second, surfaces.mirrored, surfaces.stray}) {
        if (echo.source == PointSource::nothing) continue;
        const bool is_surface = echo.source == PointSource::surface;
        if (!is_surface && echo.range_m > sensor_.max_range_m) continue;
        const double transmission =
            std::exp(-2.0 * alpha_ * echo.range_m) * std::exchange(echo.through_water, 1.0);
        const double darkest = echo.source == PointSource::mirror ? sensor_.darkest : 0.0;
        const double reflectivity =
            is_surface ? surface_reflectivity(echo, random) : std::max(echo.reflectivity, darkest);
        const double power = reflectivity * transmission / (echo.range_m * echo.range_m);
        echo.reflectivity *= transmission;
        if (power >= (is_surface ? sensor_.threshold(echo.range_m) : sensor_.weakest()))
            candidates.push_back({echo, power});
    }
}

void Air::add_fog(std::vector<Candidate>& candidates, double free_m, Random& random) const {
    const double stretch_m = 0.5 * pulse_m(sensor_), first_m = nearest_m();
    for (double begin_m = first_m; begin_m < free_m; begin_m += stretch_m) {
        const double range_m = begin_m + stretch_m * random.uniform(), place = (range_m - first_m) / kStep_m;
        const auto k = std::size_t(place);
        if (range_m >= free_m || k + 1 >= fog_power_.size()) return;
        const double mean = std::lerp(fog_power_[k], fog_power_[k + 1], place - double(k));
        const double power = mean * std::exp(kFogSpread * (random.normal() - 0.5 * kFogSpread));
        if (power >= sensor_.threshold(range_m))
            candidates.push_back({{range_m, power * range_m * range_m, PointSource::fog}, power});
    }
}

void Air::add_particles(std::vector<Candidate>& candidates, double free_m, Random& random) const {
    const auto waiting = [&random] { return -std::log(1.0 - random.uniform()); };
    for (double n = waiting(); n < particles_.back(); n += waiting()) {
        const auto next = std::ranges::upper_bound(particles_, n);
        const double part = (n - *(next - 1)) / (*next - *(next - 1));
        const double range_m = nearest_m() + (double(next - particles_.begin()) - 1.0 + part) * kStep_m;
        if (range_m >= std::min(free_m, sensor_.max_range_m)) return;
        const double wide_mm = falling_.widening * (smallest_mm(range_m) + waiting() / falling_.slope_per_mm);
        const double share = std::min(1e-3 * wide_mm / beam_m(range_m), 1.0),
                     reflectivity = falling_.reflectivity * share * share * std::exp(-2.0 * alpha_ * range_m);
        candidates.push_back({{range_m, reflectivity, falling_.source}, reflectivity / (range_m * range_m)});
    }
}

/// Adds false returns caused by noise. Their powers follow the local maxima of Gaussian
/// noise above the weakest detectable power: power^2 = weakest^2 + 2 sigma^2 E, where E
/// is exponentially distributed.
void Air::add_noise(std::vector<Candidate>& candidates, const RayEchoes& surfaces, double free_m,
                    Random& random) const {
    const bool meets_surface = surfaces.strongest.source == PointSource::surface;
    const double albedo = meets_surface ? std::min(surfaces.strongest.reflectivity, 1.0) : 0.0;
    const double sigma = sun_noise(weather_.sun, sensor_, surfaces.from_sun_rad, albedo,
                                   !meets_surface && free_m >= sensor_.max_range_m);
    const double per_m = false_returns_per_m(sensor_, sensor_.weakest() / sigma);
    const auto waiting = [&random] { return -std::log(1.0 - random.uniform()); };
    if (!(per_m > 0.0)) return;
    for (double range_m = nearest_m() + waiting() / per_m; range_m < sensor_.max_range_m;
         range_m += waiting() / per_m) {
        const double power =
            std::sqrt(sensor_.weakest() * sensor_.weakest() + 2.0 * sigma * sigma * waiting());
        if (power >= sensor_.threshold(range_m))
            candidates.push_back({{range_m, power * range_m * range_m, PointSource::noise}, power});
    }
}

RayEchoes Air::look(const RayEchoes& surfaces, double free_m, std::uint64_t seed) const {
    Random random(seed);
    std::vector<Candidate> candidates;
    add_surfaces(candidates, surfaces, random);
    if (!fog_power_.empty()) add_fog(candidates, free_m, random);
    if (!particles_.empty()) add_particles(candidates, free_m, random);
    if (weather_.sun.klux > 0.0 && std::isfinite(surfaces.from_sun_rad) && free_m > 0.0)
        add_noise(candidates, surfaces, free_m, random);
    if (candidates.empty()) return {};
    const Echo strongest = std::ranges::max_element(candidates, {}, &Candidate::power)->echo;
    return {strongest, second_of(candidates, strongest, sensor_.separation_m)};
}

}  // namespace relidar
