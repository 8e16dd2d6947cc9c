// SPDX-License-Identifier: Apache-2.0
// A render thread that owns a device, and its queue. If the queue is full, requests fail
// immediately. Jobs of disconnected clients are skipped.
#pragma once

#include <condition_variable>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace relidar::serve {

/// Result of a job.
enum class WorkEnd { done, unwanted };

/// A job in two parts: it submits work to the device, and continues when the work is
/// done. While the device is busy, the next job of the same kind can start.
struct WorkInTwo {
    /// is_last: true if no other job of this kind starts immediately afterwards to be
    /// submitted together.
    std::function<void(bool is_last)> begin;
    std::function<void()> finish;
    std::size_t kind = 0;  ///< Jobs of the same kind may start before earlier ones have finished.
};

class RenderQueue {
public:
    /// Starts the render thread.
    /// @param waiting maximum number of waiting requests, not counting the current one
    explicit RenderQueue(std::size_t waiting);
    /// All Place objects must be destroyed first.
    ~RenderQueue();
    RenderQueue(const RenderQueue&) = delete;
    RenderQueue& operator=(const RenderQueue&) = delete;

    /// A place in the queue. Its owner can always run jobs. The destructor releases the
    /// place.
    class Place {
    public:
        Place(Place&& other) noexcept : queue_(other.queue_) { other.queue_ = nullptr; }
        Place& operator=(Place&&) = delete;
        ~Place();
        /// Runs a job on the render thread, in the order of calls, and waits for it.
        /// @param is_wanted polled from time to time, never concurrently. If it returns
        /// false before the job has started, the job is skipped. If the job has started,
        /// this call waits until it is finished.
        /// @throws all exceptions of the job
        WorkEnd run(const std::function<void()>& work, const std::function<bool()>& is_wanted);
        /// Runs a job in two parts. Both parts run in the order of all jobs of the same
        /// kind.
        WorkEnd run(const WorkInTwo& work, const std::function<bool()>& is_wanted);

    private:
        friend RenderQueue;
        explicit Place(RenderQueue* queue) : queue_(queue) {}
        RenderQueue* queue_;
    };
    /// Returns a place, or no value if the queue is full.
    std::optional<Place> enter();
    std::size_t places() const { return places_; }
    /// Returns the error message after which the device became unusable, or no value
    /// while it works.
    std::optional<std::string> device_loss();
    /// Sets the number of waiting jobs of one kind that are started together before any
    /// of them is finished. Initially 1.
    void begin_together(std::size_t n);

private:
    struct Job {
        const WorkInTwo& work;  ///< Without `finish`, the job has only one part.
        const std::function<bool()>& is_wanted;
        enum class State { waits, runs, done, unwanted } state = State::waits;
        std::exception_ptr failure = {};
        std::condition_variable changed = {};
    };

    const std::size_t places_;
    std::mutex mutex_;
    std::condition_variable more_;
    std::optional<std::string> device_loss_;
    /// Waiting jobs. Each is stored on the stack of the thread that waits for it.
    std::deque<Job*> line_;
    std::size_t taken_ = 0, together_ = 1;
    bool closed_ = false;
    std::thread thread_;

    void serve();
    Job* next(const Job* before = nullptr);
    std::vector<Job*> begin(Job* job, std::unique_lock<std::mutex>& lock);
    void finish(const std::vector<Job*>& jobs, std::unique_lock<std::mutex>& lock);
    void do_part(Job& job, const std::function<void()>& part, bool is_last,
                 std::unique_lock<std::mutex>& lock);
    void wait(Job& job, std::unique_lock<std::mutex>& lock);
};

}  // namespace relidar::serve
