// SPDX-License-Identifier: Apache-2.0
#include <relidar/weather.hpp>

#include <algorithm>
#include <cmath>

namespace relidar {

double SprayStretch::extinction_at(double range_m) const { return alpha * std::exp(-decay * (range_m - from_m)); }

double SprayStretch::depth_to(double range_m) const {
    const double way_m = std::clamp(range_m, from_m, to_m) - from_m;
    return std::abs(decay * way_m) < 1e-9 ? alpha * way_m : -alpha * std::expm1(-decay * way_m) / decay;
}

}  // namespace relidar
