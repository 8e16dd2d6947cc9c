// SPDX-License-Identifier: Apache-2.0
// Defines the bounded queue of requests, and the render thread that serves them in
// batches. The render thread is the only thread that uses the device. If the queue is
// full, a request fails immediately. A cancelled request is skipped.
#pragma once

#include <chrono>
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

/// A request to the render thread. A derived class also holds the response.
class Request {
public:
    virtual ~Request() = default;
    /// Submits the work to the device.
    /// @param is_last false if another request of the same batch follows immediately, so
    /// that both can be submitted together
    virtual void submit(bool is_last) = 0;
    /// Waits for the device and stores the response. Runs only for requests with a scene.
    virtual void finish() {}
    /// Returns true if nobody waits for the response any more: the client has
    /// disconnected, or the deadline has passed. Called from time to time by one thread.
    virtual bool is_cancelled() const { return false; }

    /// Requests for the same scene are in flight together: a request is submitted before
    /// earlier ones have finished. Without a scene, the request runs alone.
    std::optional<std::size_t> scene = {};
    /// Time between run() and submit(), and time from submit() to the response.
    double queued_ms() const { return ms_between(queued_at_, submitted_at_); }
    double rendered_ms() const { return ms_between(submitted_at_, finished_at_); }

private:
    friend class RenderQueue;
    using Clock = std::chrono::steady_clock;

    enum class State { pending, in_flight, done, cancelled } state_ = State::pending;
    std::exception_ptr failure_ = {};
    std::condition_variable changed_ = {};
    Clock::time_point queued_at_ = {}, submitted_at_ = {}, finished_at_ = {};

    static double ms_between(Clock::time_point begin, Clock::time_point end) {
        return std::chrono::duration<double, std::milli>(end - begin).count();
    }
};

class RenderQueue {
public:
    /// Starts the render thread.
    /// @param n_pending maximum number of pending requests, in addition to the current
    /// one
    explicit RenderQueue(std::size_t n_pending);
    /// Waits until all requests have ended. All slots must be released before.
    ~RenderQueue();
    RenderQueue(const RenderQueue&) = delete;
    RenderQueue& operator=(const RenderQueue&) = delete;

    enum class Outcome { done, cancelled };
    /// A slot in the queue. A caller with a slot can always run requests. The destructor
    /// releases the slot.
    class Slot {
    public:
        Slot(Slot&& other) noexcept : queue_(other.queue_) { other.queue_ = nullptr; }
        Slot& operator=(Slot&&) = delete;
        ~Slot();
        /// Runs a request on the render thread and waits until it ends. Requests are
        /// submitted in the order of these calls. A request that is cancelled before it
        /// was submitted is skipped. Otherwise this call waits until the request ends.
        /// @throws all exceptions of the request
        Outcome run(Request& request);
        /// Runs a function on the render thread.
        void run(const std::function<void()>& function);

    private:
        friend RenderQueue;
        explicit Slot(RenderQueue* queue) : queue_(queue) {}
        RenderQueue* queue_;
    };
    /// Returns a slot in the queue, or no value if the queue is full.
    std::optional<Slot> reserve();
    std::size_t slots() const { return slots_; }
    /// Returns the error message of the driver if the device was lost. Returns no value
    /// while the device works.
    std::optional<std::string> device_loss();
    /// Sets the maximum number of requests in a batch, see Request::submit(). The default
    /// is 1.
    void set_batch_size(std::size_t n);

private:
    using Batch = std::vector<Request*>;

    const std::size_t slots_;
    std::mutex mutex_;
    std::condition_variable more_;
    std::optional<std::string> device_loss_;
    /// Pending requests. The thread that waits for a request owns it.
    std::deque<Request*> pending_;
    std::size_t n_reserved_ = 0, batch_size_ = 1;
    bool closed_ = false;
    std::thread thread_;

    void serve();
    Request* next(const std::optional<std::size_t>& scene = {});
    Batch submit(Request* request, std::unique_lock<std::mutex>& lock);
    void finish(const Batch& batch, std::unique_lock<std::mutex>& lock);
    void run_part(Request& request, std::optional<bool> submits_last, std::unique_lock<std::mutex>& lock);
    void wait(Request& request, std::unique_lock<std::mutex>& lock);
};

}  // namespace relidar::serve
