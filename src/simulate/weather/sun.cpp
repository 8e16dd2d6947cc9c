// SPDX-License-Identifier: Apache-2.0
// Models the noise of sunlight in the receiver, which causes false returns. The receiver
// counts N photo-electrons during a pulse with a standard deviation of sqrt(F N). False
// returns form a Poisson process along the ray. Their rate depends on the angle between
// the ray and the sun. Values that data sheets do not list are assumptions for a typical
// sensor with avalanche photodiodes at 905 nm.

#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

constexpr double kSunIrradiance = 0.65;     // assumption: W/m^2/nm at 905 nm on a day with 100 klux
constexpr double kSunRadius_rad = 4.65e-3;  // angular radius of the sun
constexpr double kSunSolidAngle_sr = kPi * kSunRadius_rad * kSunRadius_rad;
// A dusty window scatters sunlight: radiance / irradiance in 1/sr at one degree from the
// sun. Decreases with 1 / angle^2.
constexpr double kAureole_sr = 5.0;
constexpr double kRadPerDegree = kPi / 180.0;
constexpr double kFilterWidth_nm = 20.0;
constexpr double kReceiverArea_m2 = 1e-3;   // lens with a diameter of 5 cm that transmits one half
constexpr double kQuantumEfficiency = 0.7;  // quantum efficiency, electrons per photon
constexpr double kExcessNoiseFactor = 3.0;  // excess noise factor F of an avalanche photodiode
constexpr double kPeak_W = 75.0;            // peak power of a pulse
constexpr double kPhoton_J = 2.195e-19;     // energy of a photon at 905 nm
constexpr double kClearDay_klux = 100.0;    // illuminance on a clear day
constexpr float kHidesSun = 0.5f;           // surfaces that absorb this share of light hide the sun

/// Returns the angle between each ray of a scan and the direction to the sun, in radians.
/// Returns an empty list if the scene hides the sun from the sensor.
std::vector<float> sun_angles_rad(const WeatherInput& input) {
    const RenderedScan& scan = input.scan;
    const double azimuth_rad = input.weather.sun.azimuth_deg * kPi / 180.0,
                 elevation_rad = input.weather.sun.elevation_deg * kPi / 180.0;
    // direction to the sun in the world frame of the dataset
    const glm::dvec3 to_sun(std::cos(elevation_rad) * std::cos(azimuth_rad),
                            std::cos(elevation_rad) * std::sin(azimuth_rad), std::sin(elevation_rad));
    WorldRays line_of_sight;
    line_of_sight.origin.push_back(glm::vec3(scan.world_from_sensor.translation - input.world_offset_m));
    line_of_sight.direction.push_back(glm::vec3(to_sun));
    if (input.trace(line_of_sight).weight[0] >= kHidesSun) return {};
    std::vector<float> angles;
    FiringPoseInterpolator firing(scan);
    for (std::size_t i = 0; i < scan.image.direction.size(); ++i) {
        const glm::dvec3 direction = firing.pose_of(i).rotation * glm::dvec3(scan.image.direction[i]);
        angles.push_back(static_cast<float>(std::acos(std::clamp(glm::dot(direction, to_sun), -1.0, 1.0))));
    }
    return angles;
}

class SunlightEffect : public RayWeatherEffect {
public:
    SunlightEffect(const WeatherInput& input, std::vector<float> angles_rad)
        : sensor_(input.sensor), sun_(input.weather.sun), angles_rad_(std::move(angles_rad)) {}

    /// Adds false returns caused by sunlight: peaks of Gaussian noise above the detection
    /// threshold. A peak has power^2 = threshold^2 + 2 sigma^2 E, with an exponential
    /// random number E.
    void append_returns(EchoCandidates& echoes, const RayWeatherState& ray, Random& random) const override {
        if (!(ray.free_m > 0.0)) return;
        const bool meets_surface = ray.strongest.source == ReturnCause::surface;
        const double albedo = meets_surface ? std::min(ray.strongest.reflectivity, 1.0) : 0.0;
        const double sigma = sun_noise(sun_, sensor_, double(angles_rad_[ray.index]), albedo,
                                       !meets_surface && ray.free_m >= sensor_.max_range_m);
        const double per_m = false_returns_per_m(sensor_, sensor_.floor_power() / sigma);
        // Exponential distances between the returns make a Poisson process.
        const auto waiting = [&random] { return -std::log(1.0 - random.sample_uniform()); };
        if (!(per_m > 0.0)) return;
        for (double range_m = min_air_range_m(sensor_) + waiting() / per_m; range_m < sensor_.max_range_m;
             range_m += waiting() / per_m) {
            const double power =
                std::sqrt(sensor_.floor_power() * sensor_.floor_power() + 2.0 * sigma * sigma * waiting());
            echoes.push_back({{range_m, power * range_m * range_m, ReturnCause::noise}, power});
        }
    }

private:
    const WeatherSensorProperties sensor_;
    const Sun sun_;
    const std::vector<float> angles_rad_;  // [rays] angle between the ray and the sun
};

constexpr WeatherParameter kSunNumbers[] = {
    {[](Weather& weather) -> double& { return weather.sun.azimuth_deg; }, -360.0, 360.0},
    {[](Weather& weather) -> double& { return weather.sun.elevation_deg; }, 0.0, 90.0},
    {[](Weather& weather) -> double& { return weather.sun.klux; }, std::numeric_limits<double>::min(), 150.0,
     kClearDay_klux}};

}  // namespace

double sun_noise(const Sun& sun, const WeatherSensorProperties& sensor, double angle_rad, double albedo_or_0,
                 bool sees_sky) {
    const double irradiance = kSunIrradiance * sun.klux / kClearDay_klux;  // E in W/m^2/nm
    const double half_beam_rad = 0.5 * sensor.divergence_rad;
    const double sun_angle_deg = std::max(angle_rad, kSunRadius_rad) / kRadPerDegree;
    // Radiance that the receiver sees, divided by E, in 1/sr: light that the dusty window
    // scatters, light of the surface, and the part of the beam that the solar disc fills.
    double per_sr = kAureole_sr / (sun_angle_deg * sun_angle_deg) + albedo_or_0 / kPi;
    if (sees_sky) {
        const double disc_share = (kSunRadius_rad + half_beam_rad - angle_rad) / sensor.divergence_rad;
        per_sr += std::clamp(disc_share, 0.0, 1.0) / kSunSolidAngle_sr;
    }
    const double view_sr = kPi * half_beam_rad * half_beam_rad;
    const double sunlight_W = irradiance * per_sr * kFilterWidth_nm * view_sr * kReceiverArea_m2;
    // A diffuse surface with reflectivity 1 at 1 m reflects 1 / pi of the pulse per
    // steradian. By definition, its relative power is 1.
    const double unit_power_W = kPeak_W * kReceiverArea_m2 / kPi;
    constexpr double kElectronsPerJ = kQuantumEfficiency / kPhoton_J;
    const auto count_electrons = [&](double watt) { return watt * sensor.pulse_s * kElectronsPerJ; };
    // N electrons have a standard deviation of sqrt(F N).
    return std::sqrt(kExcessNoiseFactor * count_electrons(sunlight_W)) / count_electrons(unit_power_W);
}

double false_returns_per_m(const WeatherSensorProperties& sensor, double sigmas) {
    return std::exp(-0.5 * sigmas * sigmas) / (std::sqrt(3.0) * kLight_m_s * sensor.pulse_s);
}

const WeatherEffectEntry kSunlightEffect{
    .name = "sun",
    .form = "sun=AZIMUTH:ELEVATION[:KLUX]",
    .meaning = "degrees in the dataset's world",
    .expected =
        "sun=AZIMUTH:ELEVATION or sun=AZIMUTH:ELEVATION:KLUX with an azimuth from -360 to 360 degrees, an "
        "elevation from 0 to 90 degrees and an illuminance above 0 and up to 150 klux",
    .examples = "sun=0:5",
    .numbers = kSunNumbers,
    .n_required = 2,
    .prepare = [](const WeatherInput& input) -> std::unique_ptr<RayWeatherEffect> {
        std::vector<float> angles_rad = sun_angles_rad(input);
        if (angles_rad.empty()) return nullptr;
        return std::make_unique<SunlightEffect>(input, std::move(angles_rad));
    }};

}  // namespace relidar
