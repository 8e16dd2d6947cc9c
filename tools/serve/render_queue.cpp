// SPDX-License-Identifier: Apache-2.0
#include "render_queue.hpp"

#include <utility>

#include <relidar/base/error.hpp>

namespace relidar::serve {
namespace {

constexpr std::chrono::milliseconds kPollInterval{10};

class FunctionRequest final : public QueuedRequest {
public:
    explicit FunctionRequest(const std::function<void()>& function) : function_(function) {}
    void submit(bool) override { function_(); }

private:
    const std::function<void()>& function_;
};

}  // namespace

/// Starts the render thread. The call that is rendered needs a slot too.
RenderQueue::RenderQueue(std::size_t n_pending)
    : slots_(n_pending + 1), thread_([this] { run_render_loop(); }) {}

RenderQueue::~RenderQueue() {
    {
        const std::lock_guard lock(mutex_);
        closed_ = true;
    }
    more_.notify_one();
    thread_.join();
}

std::optional<RenderQueue::QueueSlot> RenderQueue::reserve_slot() {
    const std::lock_guard lock(mutex_);
    if (n_reserved_ == slots_) return {};
    ++n_reserved_;
    return QueueSlot(this);
}

/// Rejects new calls, and waits until all slots are released, but at most `max_wait`.
void RenderQueue::drain(std::chrono::milliseconds max_wait) {
    draining_ = true;
    const auto end = std::chrono::steady_clock::now() + max_wait;
    std::unique_lock lock(mutex_);
    while (n_reserved_ > 0 && std::chrono::steady_clock::now() < end) {
        // Other threads need the lock to release their slots.
        lock.unlock();
        std::this_thread::sleep_for(kPollInterval);
        lock.lock();
    }
}

std::optional<std::string> RenderQueue::loss_message() {
    const std::lock_guard lock(mutex_);
    return device_loss_;
}

void RenderQueue::set_batch_size(std::size_t max_requests) {
    const std::lock_guard lock(mutex_);
    batch_size_ = max_requests;
}

RenderQueue::QueueSlot::~QueueSlot() {
    if (!queue_) return;
    const std::lock_guard lock(queue_->mutex_);
    --queue_->n_reserved_;
}

/// Appends the request to the queue and waits until the render thread has processed it.
RenderQueue::RequestOutcome RenderQueue::QueueSlot::run_request(QueuedRequest& request) {
    request.queued_at_ = QueuedRequest::Clock::now();
    std::unique_lock lock(queue_->mutex_);
    queue_->pending_.push_back(&request);
    queue_->more_.notify_one();
    queue_->wait_for_end(request, lock);
    if (request.failure_) std::rethrow_exception(request.failure_);
    return request.state_ == QueuedRequest::RequestState::done ? RequestOutcome::done
                                                               : RequestOutcome::cancelled;
}

void RenderQueue::QueueSlot::run_function(const std::function<void()>& function) {
    FunctionRequest request(function);
    run_request(request);
}

/// Waits until the request is done or cancelled. Polls for cancellation only while the
/// request is pending, because work on the device cannot be cancelled.
void RenderQueue::wait_for_end(QueuedRequest& request, std::unique_lock<std::mutex>& lock) {
    using State = QueuedRequest::RequestState;
    while (request.state_ == State::pending) {
        request.changed_.wait_for(lock, kPollInterval);
        if (request.state_ != State::pending || !request.is_cancelled()) continue;
        request.state_ = State::cancelled;
        std::erase(pending_, &request);
    }
    request.changed_.wait(lock, [&] { return request.state_ != State::in_flight; });
}

/// Removes the next request that is not cancelled from the queue and returns it. Returns
/// null if there is none.
/// @param scene if set, also returns null if the next request is for another scene
QueuedRequest* RenderQueue::take_request(const std::optional<std::size_t>& scene) {
    using State = QueuedRequest::RequestState;
    while (!pending_.empty()) {
        QueuedRequest* request = pending_.front();
        if (scene && request->scene != scene) return nullptr;
        pending_.pop_front();
        const bool is_cancelled = request->is_cancelled();
        request->state_ = is_cancelled ? State::cancelled : State::in_flight;
        request->changed_.notify_one();
        if (!is_cancelled) return request;
    }
    return nullptr;
}

/// Executes one step of a request without holding the lock, so that other threads can add
/// requests. If a step fails, the request is done.
void RenderQueue::process_request(QueuedRequest& request, RequestStep step,
                                  std::unique_lock<std::mutex>& lock) {
    lock.unlock();
    std::exception_ptr failure;
    std::optional<std::string> loss;
    const bool is_submission = step != RequestStep::finish;
    if (is_submission) request.submitted_at_ = QueuedRequest::Clock::now();
    try {
        if (is_submission) request.submit(step == RequestStep::submit_last);
        else request.finish();
    } catch (const DeviceLost& error) {
        failure = std::current_exception();
        loss = error.what();
    } catch (...) {
        failure = std::current_exception();
    }
    request.finished_at_ = QueuedRequest::Clock::now();
    lock.lock();
    if (loss && !device_loss_) device_loss_ = loss;
    // Only requests with a scene have results to read from the device.
    const bool needs_finish = is_submission && request.scene && !failure;
    if (needs_finish) return;
    request.failure_ = failure;
    request.state_ = QueuedRequest::RequestState::done;
    request.changed_.notify_one();
}

/// Submits a request together with requests for the same scene that follow in the queue,
/// up to the batch size. A request must know whether it is the last of its batch, so the
/// next one is taken before it is submitted.
/// @return requests whose results must still be read from the device
RenderQueue::RequestBatch RenderQueue::submit_batch(QueuedRequest* first,
                                                    std::unique_lock<std::mutex>& lock) {
    RequestBatch batch;
    QueuedRequest* request = first;
    for (std::size_t n_taken = 1; request; ++n_taken) {
        const bool may_continue = request->scene && n_taken < batch_size_;
        QueuedRequest* next = may_continue ? take_request(request->scene) : nullptr;
        process_request(*request, next ? RequestStep::submit_with_next : RequestStep::submit_last, lock);
        if (request->state_ == QueuedRequest::RequestState::in_flight) batch.push_back(request);
        request = next;
    }
    return batch;
}

void RenderQueue::finish_batch(const RequestBatch& batch, std::unique_lock<std::mutex>& lock) {
    for (QueuedRequest* request : batch) process_request(*request, RequestStep::finish, lock);
}

/// Processes requests until the queue is closed and empty. Submits the next batch before
/// it reads the previous batch, so that the device does not wait for the host.
void RenderQueue::run_render_loop() {
    std::unique_lock lock(mutex_);
    RequestBatch in_flight;
    while (true) {
        QueuedRequest* request = take_request();
        if (!request && in_flight.empty()) {
            more_.wait(lock, [&] { return closed_ || !pending_.empty(); });
            if (pending_.empty()) return;
            continue;
        }
        // Batches overlap only if both use the same scene. Another scene could unload the
        // first scene before its results are read.
        const bool may_overlap =
            request && !in_flight.empty() && request->scene && request->scene == in_flight.front()->scene;
        if (!may_overlap) finish_batch(std::exchange(in_flight, {}), lock);
        if (!request) continue;
        const RequestBatch submitted = submit_batch(request, lock);
        finish_batch(std::exchange(in_flight, submitted), lock);
    }
}

}  // namespace relidar::serve
