// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <concepts>

namespace relidar {

/// Returns the probability 1 / (1 + exp(-logit)).
template <std::floating_point T>
T sigmoid(T logit) {
    return T(1) / (T(1) + std::exp(-logit));
}

}  // namespace relidar
