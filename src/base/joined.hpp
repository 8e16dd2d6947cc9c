// SPDX-License-Identifier: Apache-2.0
// Concatenates lists.
#pragma once

#include <cstddef>
#include <vector>

namespace relidar {

/// Frees each list after it has been copied, to save memory.
template <class T>
std::vector<T> concatenate(std::vector<std::vector<T>> vectors) {
    std::size_t n = 0;
    for (const std::vector<T>& part : vectors) n += part.size();
    std::vector<T> all;
    all.reserve(n);
    for (std::vector<T>& part : vectors) {
        all.insert(all.end(), part.begin(), part.end());
        part = {};
    }
    return all;
}

}  // namespace relidar
