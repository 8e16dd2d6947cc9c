// SPDX-License-Identifier: Apache-2.0
// Loops over independent items on all cores, by threads that stay.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <thread>
#include <utility>
#include <vector>

namespace relidar {

/// Cores that this process may use, 1 or more.
inline std::size_t n_cores() {
    static const std::size_t n = std::max(1u, std::thread::hardware_concurrency());
    return n;
}

/// Runs task(i) for every i in [0, n), on the calling thread and those that are idle. A
/// task may run another such loop. After a failure no other task is begun; what is
/// thrown, once all have ended, is the failure of the smallest i, so that a message does
/// not depend on timing.
void run_parallel(int n, const std::function<void(int)>& task);

/// Neighbouring items that a thread takes at a time: several blocks a core, and enough
/// that taking one costs nothing.
inline std::size_t block_size(std::size_t n) {
    constexpr std::size_t kLeast = 128, kMost = 4096, kBlocksOfCore = 8;
    return std::clamp(n / (kBlocksOfCore * n_cores()), kLeast, kMost);
}

/// task(begin, end) for the parts of `size` items that [0, n) has, on all cores; the last
/// part may be shorter.
template <class Task>
void for_each_part(std::size_t n, std::size_t size, const Task& task) {
    run_parallel(static_cast<int>((n + size - 1) / size),
                 [&](int i) { task(std::size_t(i) * size, std::min(n, (std::size_t(i) + 1) * size)); });
}

/// task(i) for every i < n, on all cores in blocks.
template <class Task>
void for_each_block(std::size_t n, const Task& task) {
    for_each_part(n, block_size(n), [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) task(i);
    });
}

/// A sum over [0, n) that is the same on any number of cores: of parts of `size` items,
/// added up in their order.
/// @param part  (begin, end) -> Sum, of which operator+= adds two
template <class Part>
auto sum_parallel(std::size_t n, std::size_t size, const Part& part) {
    using Sum = decltype(part(std::size_t{}, std::size_t{}));
    std::vector<Sum> sums((n + size - 1) / size);
    for_each_part(n, size,
                  [&](std::size_t begin, std::size_t end) { sums[begin / size] = part(begin, end); });
    if (sums.empty()) return Sum{};
    for (std::size_t i = 1; i < sums.size(); ++i) sums[0] += sums[i];
    return std::move(sums[0]);
}

/// Sorts on all cores: stretches, which are then merged by twos. The order does not
/// depend on the number of cores where `less` tells elements apart that are not the same.
template <class T, class Less>
void sort_parallel(std::vector<T>& values, const Less& less) {
    constexpr std::size_t kLeast = 1 << 15;  // of a stretch
    std::size_t n = 1;
    while (n < n_cores() && values.size() / (2 * n) >= kLeast) n *= 2;
    const auto at = [&](std::size_t k) {
        return values.begin() + static_cast<std::ptrdiff_t>(values.size() * k / n);
    };
    run_parallel(static_cast<int>(n),
                 [&](int k) { std::sort(at(std::size_t(k)), at(std::size_t(k) + 1), less); });
    for (std::size_t width = 1; width < n; width *= 2)
        run_parallel(static_cast<int>(n / (2 * width)), [&](int pair) {
            const std::size_t first = 2 * width * std::size_t(pair);
            std::inplace_merge(at(first), at(first + width), at(first + 2 * width), less);
        });
}

}  // namespace relidar
