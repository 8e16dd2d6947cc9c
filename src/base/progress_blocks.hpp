// SPDX-License-Identifier: Apache-2.0
// Parallel loops over independent items that report their progress to the caller.
#pragma once

#include <algorithm>
#include <atomic>
#include <string_view>
#include <thread>

#include <relidar/base/progress.hpp>

#include "base/parallel.hpp"

namespace relidar {

/// Runs task(i) for every i in [0, n_tasks) in parallel. Only the calling thread reports
/// progress: the finished fraction before each of its tasks, and 1 at the end. The loop
/// stops if `progress` throws.
template <class Task>
void progress_for(std::size_t n_tasks, const Progress& progress, std::string_view text, const Task& task) {
    if (progress) progress(text, 0.0);
    const std::thread::id caller = std::this_thread::get_id();
    std::atomic<std::size_t> done{0};
    std::atomic<bool> is_ended{false};
    parallel_for(static_cast<int>(n_tasks), [&](int index) {
        if (is_ended) return;
        if (progress && std::this_thread::get_id() == caller) try {
                progress(text, double(done) / double(n_tasks));
            } catch (...) {
                is_ended = true;
                throw;
            }
        task(std::size_t(index));
        ++done;
    });
    if (progress) progress(text, 1.0);
}

template <class Task>
void progress_blocks(std::size_t n_items, const Progress& progress, std::string_view text, const Task& task) {
    const std::size_t size = choose_block_size(n_items);
    progress_for((n_items + size - 1) / size, progress, text, [&](std::size_t block) {
        for (std::size_t i = block * size; i < std::min(n_items, (block + 1) * size); ++i) task(i);
    });
}

}  // namespace relidar
