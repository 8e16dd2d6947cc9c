// SPDX-License-Identifier: Apache-2.0
// Defines a queue of render requests, and the render thread that processes them in
// batches. Only the render thread uses the device. If the queue is full, a new request
// fails immediately. A cancelled request is skipped.
#pragma once

#include <atomic>
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

class QueuedRequest {
public:
    virtual ~QueuedRequest() = default;
    /// Submits the work of this request to the device.
    /// @param is_last false if another request of the same batch follows, so that both
    /// can be submitted together
    virtual void submit(bool is_last) = 0;
    /// Waits for the device and stores the response. Only requests with a scene need it.
    virtual void finish() {}
    /// Returns true if nobody waits for the response any more. Polled from one thread.
    virtual bool is_cancelled() const { return false; }

    /// Requests for the same scene may overlap. Requests without a value never overlap.
    std::optional<std::size_t> scene = {};
    double queued_ms() const { return elapsed_ms(queued_at_, submitted_at_); }
    double render_ms() const { return elapsed_ms(submitted_at_, finished_at_); }

private:
    friend class RenderQueue;
    using Clock = std::chrono::steady_clock;

    enum class RequestState { pending, in_flight, done, cancelled } state_ = RequestState::pending;
    std::exception_ptr failure_ = {};
    std::condition_variable changed_ = {};
    Clock::time_point queued_at_ = {}, submitted_at_ = {}, finished_at_ = {};

    static double elapsed_ms(Clock::time_point begin, Clock::time_point end) {
        return std::chrono::duration<double, std::milli>(end - begin).count();
    }
};

class RenderQueue {
public:
    explicit RenderQueue(std::size_t n_pending);
    /// All QueueSlot objects must be destroyed before.
    ~RenderQueue();

    enum class RequestOutcome { done, cancelled };
    /// The right to run requests, which a call holds until it ends. The number of slots
    /// limits the number of calls. The destructor releases the slot.
    class QueueSlot {
    public:
        QueueSlot(QueueSlot&& other) noexcept : queue_(other.queue_) { other.queue_ = nullptr; }
        QueueSlot& operator=(QueueSlot&&) = delete;
        ~QueueSlot();
        /// Requests are submitted in the order of these calls. A request that is
        /// cancelled before its submission is skipped. A submitted request always runs to
        /// its end.
        /// @throws all exceptions of the request
        RequestOutcome run_request(QueuedRequest& request);
        void run_function(const std::function<void()>& function);

    private:
        friend RenderQueue;
        explicit QueueSlot(RenderQueue* queue) : queue_(queue) {}
        RenderQueue* queue_;
    };
    std::optional<QueueSlot> reserve_slot();
    std::size_t total_slots() const { return slots_; }
    /// From now on, is_draining() returns true, so that callers reject new calls.
    void drain(std::chrono::milliseconds max_wait);
    bool is_draining() const { return draining_; }
    /// No value as long as the device works.
    std::optional<std::string> loss_message();
    void set_batch_size(std::size_t max_requests);

private:
    using RequestBatch = std::vector<QueuedRequest*>;

    const std::size_t slots_;
    std::mutex mutex_;
    std::condition_variable more_;
    std::optional<std::string> device_loss_;
    std::deque<QueuedRequest*> pending_;
    std::size_t n_reserved_ = 0, batch_size_ = 1;
    bool closed_ = false;
    std::atomic<bool> draining_ = false;
    std::thread thread_;

    void run_render_loop();
    QueuedRequest* take_request(const std::optional<std::size_t>& scene = {});
    RequestBatch submit_batch(QueuedRequest* first, std::unique_lock<std::mutex>& lock);
    void finish_batch(const RequestBatch& batch, std::unique_lock<std::mutex>& lock);
    /// Steps of a request: submit() with or without another request of its batch behind
    /// it, and finish().
    enum class RequestStep { submit_with_next, submit_last, finish };
    void process_request(QueuedRequest& request, RequestStep step, std::unique_lock<std::mutex>& lock);
    void wait_for_end(QueuedRequest& request, std::unique_lock<std::mutex>& lock);
};

using QueueSlot = RenderQueue::QueueSlot;

}  // namespace relidar::serve
