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

/// Returns the number of threads that can run a parallel loop of the calling thread, at
/// least 1.
std::size_t get_max_concurrency();

/// Runs task(i) for every i in [0, count), on the calling thread and on idle threads of
/// oneTBB. Tasks start in ascending order of i. A task may start another parallel loop.
/// While it waits for the inner loop, its thread runs no tasks of other loops.
///
/// If a task throws, no further task starts. After all started tasks have ended, the
/// exception with the smallest i is rethrown, so that the error message does not depend
/// on timing.
void parallel_for(int count, const std::function<void(int)>& task);

/// Returns the number of items in a block, the unit of work of a thread. Blocks are large
/// enough that the cost of starting them is small. Each thread gets several blocks.
inline std::size_t compute_block_size(std::size_t count) {
    constexpr std::size_t kSmallest = 128, kLargest = 4096, kBlocksPerThread = 8;
    return std::clamp(count / (kBlocksPerThread * get_max_concurrency()), kSmallest, kLargest);
}

/// Divides [0, count) into ranges of `size` items, and runs task(begin, end) for each
/// range in parallel. The last range may be shorter.
template <class Task>
void for_each_range_parallel(std::size_t count, std::size_t size, const Task& task) {
    parallel_for(static_cast<int>((count + size - 1) / size), [&](int index) {
        task(std::size_t(index) * size, std::min(count, (std::size_t(index) + 1) * size));
    });
}

/// Runs task(i) for every i in [0, count) in parallel. Each thread processes blocks of
/// consecutive items.
template <class Task>
void for_each_block(std::size_t count, const Task& task) {
    for_each_range_parallel(count, compute_block_size(count), [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) task(i);
    });
}

/// Computes a sum over [0, count) in parallel. Each range of `size` items has a partial
/// sum. Partial sums are added in the order of the ranges, so that the result does not
/// depend on the number of threads.
/// @param part function (begin, end) -> Sum. Sums are added with operator+=
template <class Part>
auto parallel_reduce(std::size_t count, std::size_t size, const Part& part) {
    using Sum = decltype(part(std::size_t{}, std::size_t{}));
    std::vector<Sum> sums((count + size - 1) / size);
    for_each_range_parallel(
        count, size, [&](std::size_t begin, std::size_t end) { sums[begin / size] = part(begin, end); });
    if (sums.empty()) return Sum{};
    for (std::size_t i = 1; i < sums.size(); ++i) sums[0] += sums[i];
    return std::move(sums[0]);
}

}  // namespace relidar
