// SPDX-License-Identifier: Apache-2.0
// A loop over independent items on a few threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <thread>
#include <vector>

namespace relidar {

/// Runs task(i) for every i in [0, n). What a task throws is thrown again once all threads have ended; of several
/// failures the one of the smallest i, so that a message does not depend on timing.
template <class Task>
void run_parallel(int n, const Task& task) {
    const int n_threads = std::clamp(static_cast<int>(std::thread::hardware_concurrency()), 1, std::max(n, 1));
    std::vector<std::exception_ptr> failure(static_cast<std::size_t>(std::max(n, 0)));
    std::atomic<int> next{0};
    const auto work = [&] {
        for (int i = next++; i < n; i = next++) {
            try {
                task(i);
            } catch (...) {
                failure[static_cast<std::size_t>(i)] = std::current_exception();
            }
        }
    };
    std::vector<std::thread> threads;
    for (int t = 1; t < n_threads; ++t) threads.emplace_back(work);
    work();
    for (std::thread& thread : threads) thread.join();
    for (const std::exception_ptr& f : failure) {
        if (f) std::rethrow_exception(f);
    }
}

/// task(i) for every i < n, on all cores in blocks.
template <class Task>
void for_each_block(std::size_t n, const Task& task) {
    constexpr std::size_t kBlock = 4096;
    run_parallel(static_cast<int>((n + kBlock - 1) / kBlock), [&](int block) {
        const std::size_t end = std::min(n, (std::size_t(block) + 1) * kBlock);
        for (std::size_t i = std::size_t(block) * kBlock; i < end; ++i) task(i);
    });
}

/// Sorts on all cores: stretches, which are then merged by twos. `less` must tell any two elements apart, so that there is one order.
template <class T, class Less>
void sort_parallel(std::vector<T>& values, const Less& less) {
    constexpr std::size_t kLeast = 1 << 15;   // of a stretch
    const std::size_t n_threads = std::max(1u, std::thread::hardware_concurrency());
    std::size_t n = 1;
    while (n < n_threads && values.size() / (2 * n) >= kLeast) n *= 2;
    const auto at = [&](std::size_t k) { return values.begin() + static_cast<std::ptrdiff_t>(values.size() * k / n); };
    run_parallel(static_cast<int>(n), [&](int k) { std::sort(at(std::size_t(k)), at(std::size_t(k) + 1), less); });
    for (std::size_t width = 1; width < n; width *= 2)
        run_parallel(static_cast<int>(n / (2 * width)), [&](int pair) {
            const std::size_t first = 2 * width * std::size_t(pair);
            std::inplace_merge(at(first), at(first + width), at(first + 2 * width), less);
        });
}

}  // namespace relidar
