// SPDX-License-Identifier: Apache-2.0
#include "base/parallel.hpp"

#include <atomic>
#include <exception>
#include <mutex>

#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

namespace relidar {

std::size_t max_threads() {
    const std::size_t limit = tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
    return std::clamp<std::size_t>(std::size_t(tbb::this_task_arena::max_concurrency()), 1, limit);
}

void parallel_for(int n_tasks, const std::function<void(int)>& task) {
    if (n_tasks <= 0) return;
    std::mutex mutex;
    std::exception_ptr failure;
    int first_failed_task = n_tasks;
    std::atomic<int> next_task{0};
    // Uses a shared counter, so that tasks start in ascending order. The loops of oneTBB
    // do not guarantee this, because they split the range in the middle.
    const auto run_tasks = [&] {
        for (int i = next_task++; i < n_tasks; i = next_task++) {
            try {
                task(i);
            } catch (...) {
                const std::scoped_lock lock(mutex);
                if (i < first_failed_task) {
                    failure = std::current_exception();
                    first_failed_task = i;
                }
                // No further task starts.
                next_task = n_tasks;
            }
        }
    };
    const std::size_t n_threads = std::min(std::size_t(n_tasks), max_threads());
    if (n_threads == 1) {
        run_tasks();
    } else {
        // While a thread waits for this loop, it runs no tasks of other loops. If the
        // caller's task group is cancelled, this loop still runs to its end.
        tbb::task_group_context context(tbb::task_group_context::isolated);
        tbb::this_task_arena::isolate([&] {
            tbb::parallel_for(
                std::size_t(0), n_threads, [&](std::size_t) { run_tasks(); }, tbb::simple_partitioner(),
                context);
        });
    }
    if (failure) std::rethrow_exception(failure);
}

}  // namespace relidar
