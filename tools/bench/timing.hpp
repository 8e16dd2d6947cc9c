// SPDX-License-Identifier: Apache-2.0
// Statistics of repeated measurements.
#pragma once

#include <algorithm>
#include <chrono>
#include <vector>

namespace relidar {

/// Returns the median of some values.
/// @param values at least one value
inline double median(std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(values.size() / 2), values.end());
    return values[values.size() / 2];
}

/// Returns the wall time of some work.
template <class Work>
double measure_wall_time_ms(Work&& function) {
    const auto start = std::chrono::steady_clock::now();
    function();
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace relidar
