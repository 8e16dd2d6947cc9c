// SPDX-License-Identifier: Apache-2.0
// One thread that owns a device, and the line in front of it: who does not get in is told
// so at once, who has left is not served.
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

/// How a piece of work ended.
enum class WorkEnd { done, unwanted };

/// Work that has a device do something, and goes on when that is done. While the device
/// is busy with one, the next of its kind is begun.
struct WorkInTwo {
    /// is_last: no other of its kind is begun right after it, to go to the device with it
    std::function<void(bool is_last)> begin;
    std::function<void()> finish;
    std::size_t kind = 0;  ///< of work that may be begun while other work of its kind is not finished
};

class RenderQueue {
public:
    /// @param waiting  how many may wait, beside the one that is served
    explicit RenderQueue(std::size_t waiting);
    /// Nobody may hold a place any more.
    ~RenderQueue();
    RenderQueue(const RenderQueue&) = delete;
    RenderQueue& operator=(const RenderQueue&) = delete;

    /// A place in the line; who holds it can always have work done. Given back on
    /// destruction.
    class Place {
    public:
        Place(Place&& other) noexcept : queue_(other.queue_) { other.queue_ = nullptr; }
        Place& operator=(Place&&) = delete;
        ~Place();
        /// Has work done on the render thread, in the order of calls, and waits for it.
        /// @param is_wanted  asked now and then, never at the same time as itself: work
        /// that has not begun is left out where it says no; where it has, this waits for
        /// its end
        /// @throws what the work throws
        WorkEnd run(const std::function<void()>& work, const std::function<bool()>& is_wanted);
        /// The same of work in two parts, which are done in order, and in the order of
        /// all others of its kind.
        WorkEnd run(const WorkInTwo& work, const std::function<bool()>& is_wanted);

    private:
        friend RenderQueue;
        explicit Place(RenderQueue* queue) : queue_(queue) {}
        RenderQueue* queue_;
    };
    /// Nothing where all places are taken.
    std::optional<Place> enter();
    std::size_t places() const { return places_; }
    /// What the error said after which the device cannot work any more; nothing while it
    /// works.
    std::optional<std::string> device_loss();
    /// From now on so many pieces of work of one kind are begun before any of them is
    /// finished, where so many wait; at first 1.
    void begin_together(std::size_t n);

private:
    struct Job {
        const WorkInTwo& work;  ///< no `finish`: it has one part
        const std::function<bool()>& is_wanted;
        enum class State { waits, runs, done, unwanted } state = State::waits;
        std::exception_ptr failure = {};
        std::condition_variable changed = {};
    };

    const std::size_t places_;
    std::mutex mutex_;
    std::condition_variable more_;
    std::optional<std::string> device_loss_;
    std::deque<Job*> line_;  ///< those that wait; each lives on the stack of who waits for it
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
