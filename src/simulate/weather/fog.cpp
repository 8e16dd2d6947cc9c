// SPDX-License-Identifier: Apache-2.0
// Simulates returns from fog. Fog is a soft target (Rasshofer, Spies and Spies 2011), as
// in Hahner et al. (ICCV 2021):
//   power(R) = pi beta integral p(x) exp(-2 alpha r) / r^2 dx
//     r = R + x,  p(x) = cos^2(pi x / (c tau)),  |x| <= c tau / 2,  r >= 1 m
// beta is random for each interval of length c tau / 2. Its distribution is log-normal
// with mean 0.046 / visibility. The amount of variation is an assumption. The definition
// of the visibility V gives exp(-alpha V) = 0.05.

#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

constexpr double kFogStep_m = 0.05;  // Range step in metres of the table of backscattered power.
// Per metre and steradian, times the visibility in metres (Rasshofer et al. 2011).
constexpr double kFogBackscatter = 0.046;
constexpr double kFogSpread = 1.0;  // assumption: standard deviation of the logarithm of the density
// Fog that is denser by this many standard deviations is too rare to extend the table.
constexpr double kRareFog = 5.0;

double fog_extinction(const Weather& weather) { return std::log(20.0) / weather.fog_visibility_m; }

class FogEffect : public RayWeatherEffect {
public:
    /// Tabulates the mean power by range, up to where rare dense fog is too weak.
    explicit FogEffect(const WeatherInput& input)
        : sensor_(input.sensor),
          alpha_(extinction_per_m(input.weather)),
          visibility_m_(input.weather.fog_visibility_m) {
        const double thickest = std::exp(kFogSpread * (kRareFog - 0.5 * kFogSpread)),
                     rises_to_m = min_air_range_m(sensor_) + pulse_length_m(sensor_);
        bool shows = true;
        for (double r = min_air_range_m(sensor_); shows && r <= sensor_.max_range_m + kFogStep_m;
             r += kFogStep_m) {
            power_.push_back(mean_fog_power(r));
            shows = r < rises_to_m || power_.back() * thickest > sensor_.min_power_at(r);
        }
    }

    /// Draws one density and one range in each interval of half a pulse length, because
    /// the receiver gets the light of such an interval at the same time.
    void append_returns(EchoCandidates& echoes, const RayWeatherState& ray, Random& random) const override {
        if (power_.empty()) return;
        const double stretch_m = 0.5 * pulse_length_m(sensor_), first_m = min_air_range_m(sensor_);
        for (double begin_m = first_m; begin_m < ray.free_m; begin_m += stretch_m) {
            const double range_m = begin_m + stretch_m * random.sample_uniform(),
                         table_position = (range_m - first_m) / kFogStep_m;
            const auto k = std::size_t(table_position);
            if (range_m >= ray.free_m || k + 1 >= power_.size()) return;
            const double mean = std::lerp(power_[k], power_[k + 1], table_position - double(k));
            const double power = mean * std::exp(kFogSpread * (random.sample_normal() - 0.5 * kFogSpread));
            if (power >= sensor_.min_power_at(range_m))
                echoes.push_back({{range_m, power * range_m * range_m, ReturnCause::fog}, power});
        }
    }

private:
    const WeatherSensorProperties sensor_;
    const double alpha_, visibility_m_;
    // [k] mean power that fog reflects at the minimum range plus k range steps
    std::vector<double> power_;

    /// Returns the mean power that fog reflects from a range. Integrates over the pulse
    /// with the midpoint rule.
    double mean_fog_power(double range_m) const {
        constexpr int kPulseSteps = 32;
        const double width_m = pulse_length_m(sensor_), part_m = width_m / kPulseSteps;
        double sum = 0.0;
        for (int i = 0; i < kPulseSteps; ++i) {
            const double x = -0.5 * width_m + (i + 0.5) * part_m, r = range_m + x,
                         pulse = std::cos(kPi * x / width_m);
            if (r >= kLaserOverlap_m) sum += pulse * pulse * std::exp(-2.0 * alpha_ * r) / (r * r) * part_m;
        }
        return kPi * kFogBackscatter / visibility_m_ * sum;
    }
};

constexpr WeatherParameter kFogNumbers[] = {
    {[](Weather& weather) -> double& { return weather.fog_visibility_m; }, 1.0, 1e6}};

}  // namespace

const WeatherEffectEntry kFogEffect{
    .name = "fog",
    .form = "fog=VISIBILITY_m",
    .expected = "a visibility of 1 to 1e6 metres",
    .examples = "fog=200 fog=50",
    .numbers = kFogNumbers,
    .extinction = fog_extinction,
    .prepare = [](const WeatherInput& input) -> std::unique_ptr<RayWeatherEffect> {
        return std::make_unique<FogEffect>(input);
    }};

}  // namespace relidar
