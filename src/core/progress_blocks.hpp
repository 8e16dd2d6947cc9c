// SPDX-License-Identifier: Apache-2.0
// A loop over many independent items that says how far it is.
#pragma once

#include <algorithm>
#include <string_view>

#include <relidar/progress.hpp>

#include "core/parallel.hpp"

namespace relidar {

/// for_each_block, in 20 parts, each of them told before it begins.
template <class Task>
void for_each_block_told(std::size_t n, const Progress& progress, std::string_view what, const Task& task) {
    constexpr std::size_t kParts = 20;
    for (std::size_t part = 0; part < kParts; ++part) {
        const std::size_t begin = n * part / kParts, end = n * (part + 1) / kParts;
        if (progress) progress(what, double(part) / double(kParts));
        for_each_block(end - begin, [&](std::size_t i) { task(begin + i); });
    }
}

/// run_parallel, in parts of 8 of which each is told before it begins.
template <class Task>
void for_each_told(std::size_t n, const Progress& progress, std::string_view what, const Task& task) {
    constexpr std::size_t kPart = 8;
    for (std::size_t begin = 0; begin < n; begin += kPart) {
        if (progress) progress(what, double(begin) / double(n));
        run_parallel(static_cast<int>(std::min(kPart, n - begin)), [&](int i) { task(begin + std::size_t(i)); });
    }
}

}  // namespace relidar
