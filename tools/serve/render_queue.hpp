// SPDX-License-Identifier: Apache-2.0
// Defines a queue of jobs for a render thread. The render thread is the only thread that
// uses the device. If the queue is full, a request fails immediately. The job of a client
// that has disconnected is skipped.
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

/// A job in two parts. The first part submits work to the device. The second part runs
/// after the device has finished this work. In between, the next job of the same kind can
/// start.
struct WorkInTwo {
    /// Submits the work. `is_last` is false if another job of the same kind starts
    /// immediately afterwards, so that both jobs can be submitted together.
    std::function<void(bool is_last)> begin;
    std::function<void()> finish;
    std::size_t kind = 0;  ///< A job may start before earlier jobs of the same kind have finished.
};

class RenderQueue {
public:
    /// Starts the render thread.
    /// @param waiting maximum number of waiting requests, in addition to the running one
    explicit RenderQueue(std::size_t waiting);
    /// Waits until all jobs have ended. All slots must be released before.
    ~RenderQueue();
    RenderQueue(const RenderQueue&) = delete;
    RenderQueue& operator=(const RenderQueue&) = delete;

    /// A slot in the queue. A caller with a slot can always run jobs. The destructor
    /// releases the slot.
    class Place {
    public:
        Place(Place&& other) noexcept : queue_(other.queue_) { other.queue_ = nullptr; }
        Place& operator=(Place&&) = delete;
        ~Place();
        /// Runs a job on the render thread and waits until it ends. Jobs run in the order
        /// of these calls.
        /// @param is_wanted returns false if the client no longer waits. It is called
        /// from time to time by one thread. If it returns false before the job has
        /// started, the job is skipped. If the job has started, this call waits until the
        /// job ends.
        /// @throws all exceptions of the job
        WorkEnd run(const std::function<void()>& work, const std::function<bool()>& is_wanted);
        /// Runs a job in two parts. The first parts of jobs of the same kind run in the
        /// order of the calls, and so do the second parts.
        WorkEnd run(const WorkInTwo& work, const std::function<bool()>& is_wanted);

    private:
        friend RenderQueue;
        explicit Place(RenderQueue* queue) : queue_(queue) {}
        RenderQueue* queue_;
    };
    /// Returns a slot in the queue, or no value if the queue is full.
    std::optional<Place> enter();
    std::size_t places() const { return places_; }
    /// Returns the error message of the driver if the device was lost. Returns no value
    /// while the device works.
    std::optional<std::string> device_loss();
    /// Sets how many waiting jobs of one kind may start before the first of them has
    /// finished. The default is 1.
    void begin_together(std::size_t n);

private:
    struct Job {
        const WorkInTwo& work;  ///< If `finish` is empty, the job has only one part.
        const std::function<bool()>& is_wanted;
        enum class State { waits, runs, done, unwanted } state = State::waits;
        std::exception_ptr failure = {};
        std::condition_variable changed = {};
    };

    const std::size_t places_;
    std::mutex mutex_;
    std::condition_variable more_;
    std::optional<std::string> device_loss_;
    /// Waiting jobs. Each job is stored on the stack of the thread that waits for this
    /// job.
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
