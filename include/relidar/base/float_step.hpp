// SPDX-License-Identifier: Apache-2.0
// Distance between neighbouring single-precision numbers.
#pragma once

#include <cmath>
#include <limits>

namespace relidar {

/// Returns the distance between a coordinate in single precision and the next number of
/// larger magnitude.
inline double float_step_m(double coordinate_m) {
    const float value = std::abs(static_cast<float>(coordinate_m));
    return double(std::nextafter(value, std::numeric_limits<float>::infinity())) - double(value);
}

}  // namespace relidar
