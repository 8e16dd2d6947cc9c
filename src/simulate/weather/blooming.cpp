// SPDX-License-Identifier: Apache-2.0
// Simulates blooming: a retro-reflector is so bright that the receivers of other beams
// detect its light. Their returns have the range of the reflector and the reflectivity
//   X bloom * integral of (1 deg / angle)^3 over the reflector, deg^2
// X is a random factor of each beam. ln X is normal with mean 0 and standard deviation 3.
// The constants were measured on a log (see docs/method.md).
#include <bit>

#include "base/parallel.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

// Makes the random factor of each beam independent of other random numbers.
constexpr std::uint64_t kBeamSeed = 0x626C6F6F6D696E67ull;
constexpr float kMinReflectorIntensity = 0.95f;
constexpr double kLogSpread = 3.0;  // standard deviation of ln X, where X is the random factor of a beam
// Smaller angles are set to this value: at them, the beam would hit the reflector itself.
constexpr double kMinHaloAngle_deg = 0.5;
constexpr double kSameRange_m = 0.5;
constexpr double kPerRad = 180.0 / kPi;

/// One square degree.
struct DirectionCell {
    int n_rays = 0, n_hits = 0;  // n_hits: rays that hit a reflector
    glm::dvec3 direction{0.0};   // sum over these rays
    double range_m = 0.0;        // sum over these rays
};
struct RetroReflector {
    glm::dvec3 direction;
    double range_m, deg2;  // deg2: solid angle in square degrees
};

bool is_retro_reflector(const RenderedScan& scan, std::size_t ray) {
    return is_ray_returned(scan.image.drop_prob[ray], scan.median_range_m[ray]) &&
           scan.image.intensity[ray] >= kMinReflectorIntensity;
}

/// Finds the reflectors of a scan in cells of one square degree. The solid angle of a
/// reflector is the share of rays in its cell that hit it.
std::vector<RetroReflector> find_reflectors(const RenderedScan& scan) {
    std::map<std::pair<int, int>, DirectionCell> cells;
    for (std::size_t i = 0; i < scan.image.direction.size(); ++i) {
        const glm::dvec3 direction(scan.image.direction[i]);
        // Azimuths are scaled by the cosine of the elevation: all cells are square.
        const double row = std::floor(std::asin(std::clamp(direction.z, -1.0, 1.0)) * kPerRad);
        const double column =
            std::atan2(direction.y, direction.x) * kPerRad * std::cos((row + 0.5) / kPerRad);
        DirectionCell& cell = cells[{int(row), int(std::floor(column))}];
        ++cell.n_rays;
        if (!is_retro_reflector(scan, i)) continue;
        ++cell.n_hits;
        cell.direction += direction;
        cell.range_m += double(scan.median_range_m[i]);
    }
    std::vector<RetroReflector> reflectors;
    for (const auto& [row_and_column, cell] : cells)
        if (cell.n_hits > 0)
            reflectors.push_back({.direction = glm::normalize(cell.direction),
                                  .range_m = cell.range_m / cell.n_hits,
                                  .deg2 = double(cell.n_hits) / cell.n_rays});
    return reflectors;
}

/// Returns the stray light of retro-reflectors that a ray in this direction receives:
///   reflectivity = solid angle of the reflector (deg2) / (angle to the reflector)^3
/// The caller must multiply it by `bloom` and by the random factor of the beam.
LidarEcho stray_echo(const std::vector<RetroReflector>& reflectors, const glm::dvec3& ray_direction) {
    // The brightest reflector determines the range.
    std::vector<double> reflectivity;  // [reflectors]
    double max_power = 0.0;
    LidarEcho echo{reflectors.front().range_m, 0.0, ReturnCause::blooming};
    for (const RetroReflector& reflector : reflectors) {
        const double cosine = std::clamp(glm::dot(reflector.direction, ray_direction), -1.0, 1.0),
                     off_deg = std::max(std::acos(cosine) * kPerRad, kMinHaloAngle_deg);
        reflectivity.push_back(reflector.deg2 / (off_deg * off_deg * off_deg));
        const double power = reflectivity.back() / (reflector.range_m * reflector.range_m);
        if (power <= max_power) continue;
        max_power = power;
        echo.range_m = reflector.range_m;
    }
    // Only reflectors at nearly the same range add to its return.
    for (std::size_t i = 0; i < reflectors.size(); ++i)
        if (std::abs(reflectors[i].range_m - echo.range_m) < kSameRange_m)
            echo.reflectivity += reflectivity[i];
    return echo;
}

/// Computes the stray-light return of each ray of a scan. Surfaces with an intensity of
/// at least kMinReflectorIntensity are reflectors.
/// @return [rays] empty returns for rays without stray light; no list without reflectors
std::vector<LidarEcho> stray_echoes(const WeatherInput& input) {
    const RenderedScan& scan = input.scan;
    const std::vector<RetroReflector> reflectors = find_reflectors(scan);
    if (reflectors.empty()) return {};
    const std::uint64_t scan_seed =
        hash_pair(hash_pair(input.seed, std::bit_cast<std::uint64_t>(scan.time_s)), kBeamSeed);
    std::vector<LidarEcho> stray(scan.image.direction.size());
    parallel_blocks(stray.size(), [&](std::size_t ray) {
        if (is_retro_reflector(scan, ray)) return;
        stray[ray] = stray_echo(reflectors, glm::dvec3(scan.image.direction[ray]));
        Random random(hash_pair(scan_seed, scan.ring[ray]));  // equal for all rays of a beam
        stray[ray].reflectivity *= input.weather.bloom * std::exp(kLogSpread * random.sample_normal());
    });
    return stray;
}

class BloomingEffect : public RayWeatherEffect {
public:
    BloomingEffect(const WeatherInput& input, std::vector<LidarEcho> stray)
        : sensor_(input.sensor), alpha_(extinction_per_m(input.weather)), stray_(std::move(stray)) {}

    void append_returns(EchoCandidates& candidates, const RayWeatherState& ray, Random&) const override {
        const LidarEcho& echo = stray_[ray.index];
        if (ray.free_m > 0.0)
            append_detectable(candidates, echo, sensor_, std::exp(-2.0 * alpha_ * echo.range_m));
    }

private:
    const WeatherSensorProperties sensor_;
    const double alpha_;
    const std::vector<LidarEcho> stray_;  // [rays] echo of the stray light
};

constexpr WeatherParameter kBloomNumbers[] = {
    {[](Weather& weather) -> double& { return weather.bloom; }, 0.0, 1.0, 1.2e-4}};

}  // namespace

const WeatherEffectEntry kBloomingEffect{
    .name = "bloom",
    .form = "bloom[=REFLECTIVITY]",
    .meaning = "stray light of reflectors",
    .expected = "a reflectivity of 0 to 1",
    .examples = "bloom",
    .numbers = kBloomNumbers,
    .n_required = 0,
    .prepare = [](const WeatherInput& input) -> std::unique_ptr<RayWeatherEffect> {
        std::vector<LidarEcho> stray = stray_echoes(input);
        if (stray.empty()) return nullptr;
        return std::make_unique<BloomingEffect>(input, std::move(stray));
    }};

}  // namespace relidar
