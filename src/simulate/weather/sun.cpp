// SPDX-License-Identifier: Apache-2.0
// Light of the sun in a receiver, as shot noise: of N photo-electrons in a pulse's time
// sqrt(F N) are noise; and how often noise looks like a return. What a data sheet does
// not say of a sensor is that of a usual one with avalanche photodiodes at 905 nm, an
// assumption.
#include <relidar/simulate/weather.hpp>

#include <algorithm>
#include <cmath>

#include <relidar/base/math.hpp>

namespace relidar {
namespace {

// W/m^2/nm at 905 nm for 100 klux, direct light of a clear day: an assumption
constexpr double kIrradiance = 0.65;
constexpr double kSun_rad = 4.65e-3;  // radius of its disc
constexpr double kSun_sr = kPi * kSun_rad * kSun_rad;
// of light one degree off, by 1 / angle^2: 5 % of it in all, a window with dust on it
constexpr double kScatter_sr = 5.0;
constexpr double kDegree_rad = kPi / 180.0;
constexpr double kFilter_nm = 20.0;
constexpr double kReceiver_m2 = 1e-3;       // a lens 5 cm wide that passes half
constexpr double kEfficiency = 0.7;         // electrons per photon
constexpr double kExcess = 3.0;             // F: an avalanche adds noise
constexpr double kPeak_W = 75.0;            // of a pulse
constexpr double kPhoton_J = 2.195e-19;     // 905 nm
constexpr double kSpeed_m_s = 299792458.0;  // of light

}  // namespace

double sun_noise(const Sun& sun, const WeatherSensor& sensor, double from_sun_rad, double albedo,
                 bool sees_sky) {
    const double irradiance = kIrradiance * sun.klux / 100.0, half_rad = 0.5 * sensor.divergence_rad;
    const double off_deg = std::max(from_sun_rad, kSun_rad) / kDegree_rad;
    double per_sr = kScatter_sr / (off_deg * off_deg) + albedo / kPi;
    if (sees_sky)
        per_sr +=
            std::clamp((kSun_rad + half_rad - from_sun_rad) / sensor.divergence_rad, 0.0, 1.0) / kSun_sr;
    const double view_sr = kPi * half_rad * half_rad, electrons_per_J = kEfficiency / kPhoton_J;
    const double n =
        irradiance * per_sr * kFilter_nm * view_sr * kReceiver_m2 * sensor.pulse_s * electrons_per_J;
    // a dull surface spreads by 1 / pi
    const double of_unit_power = kPeak_W * kReceiver_m2 / kPi * sensor.pulse_s * electrons_per_J;
    return std::sqrt(kExcess * n) / of_unit_power;
}

double false_returns_per_m(const WeatherSensor& sensor, double level) {
    return std::exp(-0.5 * level * level) / (std::sqrt(3.0) * kSpeed_m_s * sensor.pulse_s);
}

}  // namespace relidar
