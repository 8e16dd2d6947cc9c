// SPDX-License-Identifier: Apache-2.0
// Runs loops over independent items on the threads of oneTBB. The result of a loop does
// not depend on the number of threads. Callers can limit this number with
// tbb::global_control or the CPU affinity of the process.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <utility>
#include <vector>

namespace relidar {

std::size_t max_threads();

/// Runs task(i) for every i in [0, n_tasks), on the calling thread and on idle threads of
/// oneTBB. Tasks start in ascending order of i. A task may start another parallel loop.
/// While the task waits for this inner loop, its thread runs no tasks of other loops.
///
/// If a task throws, no further task starts. After all started tasks have ended, the
/// exception with the smallest i is rethrown, so that the error message does not depend
/// on timing.
void parallel_for(int n_tasks, const std::function<void(int)>& task);

/// Blocks are large enough that starting them costs little. Each thread gets several.
inline std::size_t choose_block_size(std::size_t n_items) {
    constexpr std::size_t kMinBlockItems = 128, kMaxBlockItems = 4096, kBlocksPerThread = 8;
    return std::clamp(n_items / (kBlocksPerThread * max_threads()), kMinBlockItems, kMaxBlockItems);
}

template <class Task>
void parallel_ranges(std::size_t n_items, std::size_t range_size, const Task& task) {
    parallel_for(static_cast<int>((n_items + range_size - 1) / range_size), [&](int index) {
        task(std::size_t(index) * range_size, std::min(n_items, (std::size_t(index) + 1) * range_size));
    });
}

template <class Task>
void parallel_blocks(std::size_t n_items, const Task& task) {
    parallel_ranges(n_items, choose_block_size(n_items), [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) task(i);
    });
}

/// Computes a sum over [0, n_items) in parallel. Partial sums of `range_size` items are
/// added in the order of the ranges, so that the result does not depend on the number of
/// threads.
/// @param compute_range_sum function (begin, end) -> Sum
template <class Part>
auto parallel_sum(std::size_t n_items, std::size_t range_size, const Part& compute_range_sum) {
    using Sum = decltype(compute_range_sum(std::size_t{}, std::size_t{}));
    std::vector<Sum> sums((n_items + range_size - 1) / range_size);
    parallel_ranges(n_items, range_size, [&](std::size_t begin, std::size_t end) {
        sums[begin / range_size] = compute_range_sum(begin, end);
    });
    if (sums.empty()) return Sum{};
    for (std::size_t i = 1; i < sums.size(); ++i) sums[0] += sums[i];
    return std::move(sums[0]);
}

}  // namespace relidar
