// SPDX-License-Identifier: Apache-2.0
// Converts structs that kernels fill to arrays of floats, so that tests can compare them
// element by element.
#pragma once

#include <cstring>
#include <vector>

namespace relidar::test {

template <class T>
std::vector<float> to_floats(const std::vector<T>& rows) {
    static_assert(sizeof(T) % sizeof(float) == 0);
    std::vector<float> floats(rows.size() * sizeof(T) / sizeof(float));
    if (!rows.empty()) std::memcpy(floats.data(), rows.data(), floats.size() * sizeof(float));
    return floats;
}

}  // namespace relidar::test
