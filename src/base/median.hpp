// SPDX-License-Identifier: Apache-2.0
// Median of a list of values.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace relidar {

/// For an even number of values, the larger of the two middle values.
template <class Value>
Value compute_median(std::vector<Value> values) {
    const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
    std::ranges::nth_element(values, middle);
    return *middle;
}

}  // namespace relidar
