// SPDX-License-Identifier: Apache-2.0
// Defines a queue of render requests, and the render thread that processes them in
// batches. Only the render thread uses the device. If the queue is full, a new request
// fails immediately. A cancelled request is skipped.
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

/// A request to the render thread. Derived classes add the data of the request and its
/// response.
class Request {
public:
    virtual ~Request() = default;
    /// Submits the work of this request to the device.
    /// @param is_last false if another request of the same batch follows, so that both
    /// can be submitted together
    virtual void submit(bool is_last) = 0;
    /// Waits for the device and stores the response. It is called only for requests that
    /// have a scene.
    virtual void finish() {}
    /// Returns true if the client no longer waits for the response, because it has
    /// disconnected or its deadline has passed. One thread calls this function from time
    /// to time.
    virtual bool is_cancelled() const { return false; }

    /// Index of the scene to render. A request for the same scene may be submitted before
    /// the previous request has finished. Without a value, the request runs alone.
    std::optional<std::size_t> scene = {};
    /// queued_ms() is the time between run() and submit(). rendered_ms() is the time from
    /// submit() until the response is ready.
    double queued_ms() const { return measure_ms_between(queued_at_, submitted_at_); }
    double rendered_ms() const { return measure_ms_between(submitted_at_, finished_at_); }

private:
    friend class RenderQueue;
    using Clock = std::chrono::steady_clock;

    enum class State { pending, in_flight, done, cancelled } state_ = State::pending;
    std::exception_ptr failure_ = {};
    std::condition_variable changed_ = {};
    Clock::time_point queued_at_ = {}, submitted_at_ = {}, finished_at_ = {};

    static double measure_ms_between(Clock::time_point begin, Clock::time_point end) {
        return std::chrono::duration<double, std::milli>(end - begin).count();
    }
};

class RenderQueue {
public:
    /// Starts the render thread.
    /// @param n_pending maximum number of waiting requests, not counting the current
    /// request
    explicit RenderQueue(std::size_t n_pending);
    /// Waits until all requests have ended. The caller must release all slots first.
    ~RenderQueue();
    RenderQueue(const RenderQueue&) = delete;
    RenderQueue& operator=(const RenderQueue&) = delete;

    enum class Outcome { done, cancelled };
    /// A reserved slot in the queue, whose number of slots is limited. Only a caller that
    /// holds a slot can run requests. The destructor releases the slot.
    class Slot {
    public:
        Slot(Slot&& other) noexcept : queue_(other.queue_) { other.queue_ = nullptr; }
        Slot& operator=(Slot&&) = delete;
        ~Slot();
        /// Runs a request on the render thread and waits until it ends. Requests are
        /// submitted in the order of these calls. A request that is cancelled before its
        /// submission is skipped. A submitted request always runs to its end.
        /// @throws all exceptions of the request
        Outcome run(Request& request);
        /// Runs a function on the render thread.
        void run(const std::function<void()>& function);

    private:
        friend RenderQueue;
        explicit Slot(RenderQueue* queue) : queue_(queue) {}
        RenderQueue* queue_;
    };
    /// Reserves a slot in the queue. Returns no value if the queue is full.
    std::optional<Slot> reserve();
    std::size_t slots() const { return slots_; }
    /// Returns the driver's error message if the device was lost. Returns no value as
    /// long as the device works.
    std::optional<std::string> get_device_loss_message();
    /// Sets the maximum number of requests in a batch. The default is 1, which means that
    /// each request is submitted alone.
    void set_batch_size(std::size_t count);

private:
    using Batch = std::vector<Request*>;

    const std::size_t slots_;
    std::mutex mutex_;
    std::condition_variable more_;
    std::optional<std::string> device_loss_;
    /// Requests that are not submitted yet. The thread that waits for the response owns
    /// the request.
    std::deque<Request*> pending_;
    std::size_t n_reserved_ = 0, batch_size_ = 1;
    bool closed_ = false;
    std::thread thread_;

    void serve();
    Request* next(const std::optional<std::size_t>& scene = {});
    Batch submit(Request* request, std::unique_lock<std::mutex>& lock);
    void finish(const Batch& batch, std::unique_lock<std::mutex>& lock);
    void run_request_part(Request& request, std::optional<bool> submits_last,
                          std::unique_lock<std::mutex>& lock);
    void wait(Request& request, std::unique_lock<std::mutex>& lock);
};

}  // namespace relidar::serve
