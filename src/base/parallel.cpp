// SPDX-License-Identifier: Apache-2.0
#include "base/parallel.hpp"

#include <atomic>
#include <condition_variable>
#include <exception>
#include <list>
#include <mutex>

#include <unistd.h>

namespace relidar {
namespace {

/// Worker threads, one less than the number of cores. The threads start with the first
/// parallel loop and are never joined, because other static objects may still use them
/// during shutdown. They are kept because starting threads takes longer than many loops.
class IdleThreads {
public:
    IdleThreads() {
        for (std::size_t k = 1; k < n_cores(); ++k) std::thread([this] { serve(); }).detach();
    }

    /// Runs work() on this thread and concurrently on up to n worker threads. Returns
    /// when all calls have returned.
    void run(std::size_t n, const std::function<void()>& work) {
        Job job{&work, n};
        {
            const std::scoped_lock lock(mutex_);
            jobs_.push_back(&job);
        }
        wake();
        work();
        std::unique_lock lock(mutex_);
        jobs_.remove(&job);  // Workers that have not started the job yet no longer find it.
        ended_.wait(lock, [&] { return job.n_running == 0; });
    }

private:
    struct Job {
        const std::function<void()>* work;
        std::size_t n_needed, n_running = 0;
    };
    std::mutex mutex_;
    std::condition_variable wake_, ended_;
    std::list<Job*> jobs_;  // Jobs that need more threads.

    /// Wakes two threads, each of which wakes two others if they are needed. The caller
    /// thus starts immediately, and finishes a short loop alone.
    void wake() {
        wake_.notify_one();
        wake_.notify_one();
    }

    void serve() {
        std::unique_lock lock(mutex_);
        for (;;) {
            wake_.wait(lock, [&] { return !jobs_.empty(); });
            Job& job = *jobs_.front();
            if (--job.n_needed == 0) jobs_.pop_front();
            ++job.n_running;
            const bool needs_more_threads = !jobs_.empty();
            lock.unlock();
            if (needs_more_threads) wake();
            (*job.work)();
            lock.lock();
            if (--job.n_running == 0) ended_.notify_all();
        }
    }
};

/// Returns the worker threads of this process. A forked process has none of its parent's
/// threads.
IdleThreads& idle_threads() {
    static std::mutex mutex;
    static IdleThreads* threads = nullptr;
    static pid_t of = 0;
    const std::scoped_lock lock(mutex);
    if (of != ::getpid()) threads = new IdleThreads, of = ::getpid();
    return *threads;
}

}  // namespace

void run_parallel(int n, const std::function<void(int)>& task) {
    if (n <= 0) return;
    std::mutex mutex;
    std::exception_ptr failure;
    int failed = n;
    std::atomic<int> next{0};
    const auto work = [&] {
        for (int i = next++; i < n; i = next++) {
            try {
                task(i);
            } catch (...) {
                const std::scoped_lock lock(mutex);
                if (i < failed) failure = std::current_exception(), failed = i;
                next = n;  // All tasks with a smaller i have already started.
            }
        }
    };
    if (const std::size_t helpers = std::min(std::size_t(n), n_cores()) - 1; helpers > 0)
        idle_threads().run(helpers, work);
    else work();
    if (failure) std::rethrow_exception(failure);
}

}  // namespace relidar
