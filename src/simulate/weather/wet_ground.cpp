// SPDX-License-Identifier: Apache-2.0
// Models water on the ground as a smooth film on a diffuse surface. Follows Lekner and
// Dorf, "Why some things are darker when wet", Applied Optics 1988.
#include <relidar/simulate/weather.hpp>

#include <algorithm>
#include <cmath>

namespace relidar {
namespace {

constexpr double kWater = 1.33;      // refractive index of water in the near infrared
constexpr double kTexture_mm = 1.0;  // depth of the texture of asphalt

/// Returns the fraction of diffuse light that a film of water reflects. This is the
/// integral of 2 c F(c) dc, computed with the midpoint rule.
double mean_mirrored() {
    constexpr int kParts = 1000;
    double sum = 0.0;
    for (int i = 0; i < kParts; ++i) {
        const double cosine = (i + 0.5) / kParts;
        sum += 2.0 * cosine * mirrored_by_water(cosine) / kParts;
    }
    return sum;
}

}  // namespace

double mirrored_by_water(double cosine) {
    // cosine of the angle in water, from Snell's law
    const double in_water = std::sqrt(1.0 - (1.0 - cosine * cosine) / (kWater * kWater));
    const double across = (cosine - kWater * in_water) / (cosine + kWater * in_water),
                 along = (in_water - kWater * cosine) / (in_water + kWater * cosine);
    return 0.5 * (across * across + along * along);
}

double wet_over_dry(double cosine, double albedo) {
    // Fraction of the scattered light that total internal reflection keeps in the film.
    static const double kept = 1.0 - (1.0 - mean_mirrored()) / (kWater * kWater);
    const double passes = 1.0 - mirrored_by_water(cosine);
    return passes * passes / (kWater * kWater * (1.0 - std::clamp(albedo, 0.0, 1.0) * kept));
}

double film_share(double wet_mm) { return std::clamp(wet_mm / kTexture_mm, 0.0, 1.0); }

}  // namespace relidar
