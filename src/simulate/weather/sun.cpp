// SPDX-License-Identifier: Apache-2.0
// Models sunlight in a receiver as shot noise. N photo-electrons during a pulse have a
// standard deviation of sqrt(F N). Also computes how often noise causes a false return.
// Values that data sheets do not list are assumptions. They describe a typical sensor
// with avalanche photodiodes at 905 nm.
#include <relidar/simulate/weather.hpp>

#include <algorithm>
#include <cmath>

#include <relidar/base/math.hpp>

namespace relidar {
namespace {

// Solar irradiance in W/m^2/nm at 905 nm per 100 klux of direct light on a clear day.
// This value is an assumption.
constexpr double kIrradiance = 0.65;
constexpr double kSun_rad = 4.65e-3;  // angular radius of the sun
constexpr double kSun_sr = kPi * kSun_rad * kSun_rad;
// Sunlight that a dusty window scatters by one degree, per steradian. It decreases with 1
// / angle^2. The total scattered light is 5 %.
constexpr double kScatter_sr = 5.0;
constexpr double kDegree_rad = kPi / 180.0;
constexpr double kFilter_nm = 20.0;
// Effective area of a lens with a diameter of 5 cm and a transmission of one half.
constexpr double kReceiver_m2 = 1e-3;
constexpr double kEfficiency = 0.7;         // quantum efficiency, electrons per photon
constexpr double kExcess = 3.0;             // excess noise factor F of an avalanche photodiode
constexpr double kPeak_W = 75.0;            // peak power of a pulse
constexpr double kPhoton_J = 2.195e-19;     // energy of a photon at 905 nm
constexpr double kSpeed_m_s = 299792458.0;  // speed of light

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
    // A diffuse surface scatters 1 / pi of the reflected light per steradian.
    const double of_unit_power = kPeak_W * kReceiver_m2 / kPi * sensor.pulse_s * electrons_per_J;
    return std::sqrt(kExcess * n) / of_unit_power;
}

double false_returns_per_m(const WeatherSensor& sensor, double level) {
    return std::exp(-0.5 * level * level) / (std::sqrt(3.0) * kSpeed_m_s * sensor.pulse_s);
}

}  // namespace relidar
