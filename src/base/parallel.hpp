// SPDX-License-Identifier: Apache-2.0
// Parallel loops over independent items on all cores. The worker threads are kept between
// loops.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <thread>
#include <utility>
#include <vector>

namespace relidar {

/// Returns the number of cores that this process may use, at least 1.
inline std::size_t n_cores() {
    static const std::size_t n = std::max(1u, std::thread::hardware_concurrency());
    return n;
}

/// Runs task(i) for every i in [0, n), on the calling thread and on idle worker threads.
/// A task may start another parallel loop. After an exception, no further task starts.
/// When all running tasks have ended, the exception of the smallest i is rethrown, so
/// that the message does not depend on timing.
void run_parallel(int n, const std::function<void(int)>& task);

/// Returns the number of consecutive items that a thread processes at a time. There are
/// several blocks per core, and each is large enough that the overhead is negligible.
inline std::size_t block_size(std::size_t n) {
    constexpr std::size_t kLeast = 128, kMost = 4096, kBlocksOfCore = 8;
    return std::clamp(n / (kBlocksOfCore * n_cores()), kLeast, kMost);
}

/// Runs task(begin, end) on all cores, for consecutive parts of `size` items of [0, n).
/// The last part may be shorter.
template <class Task>
void for_each_part(std::size_t n, std::size_t size, const Task& task) {
    run_parallel(static_cast<int>((n + size - 1) / size),
                 [&](int i) { task(std::size_t(i) * size, std::min(n, (std::size_t(i) + 1) * size)); });
}

/// Runs task(i) for every i < n on all cores, in blocks.
template <class Task>
void for_each_block(std::size_t n, const Task& task) {
    for_each_part(n, block_size(n), [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) task(i);
    });
}

/// Computes a sum over [0, n) that does not depend on the number of cores. It sums parts
/// of `size` items in parallel and adds the partial sums in order.
/// @param part function (begin, end) -> Sum; Sum has operator+=
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

/// Sorts on all cores: sorts sections and then merges them in pairs. The order does not
/// depend on the number of cores if `less` distinguishes all different elements.
template <class T, class Less>
void sort_parallel(std::vector<T>& values, const Less& less) {
    constexpr std::size_t kLeast = 1 << 15;  // Minimum number of elements in a section.
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
