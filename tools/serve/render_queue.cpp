// SPDX-License-Identifier: Apache-2.0
#include "render_queue.hpp"

#include <algorithm>
#include <utility>

#include <relidar/base/error.hpp>

namespace relidar::serve {
namespace {

/// Interval at which a waiting call checks whether its client has cancelled it. The
/// render thread checks this again before it submits the request.
constexpr std::chrono::milliseconds kPoll{10};

class FunctionRequest final : public Request {
public:
    explicit FunctionRequest(const std::function<void()>& function) : function_(function) {}
    void submit(bool) override { function_(); }

private:
    const std::function<void()>& function_;
};

}  // namespace

RenderQueue::RenderQueue(std::size_t n_pending) : slots_(n_pending + 1), thread_([this] { serve(); }) {}

RenderQueue::~RenderQueue() {
    {
        const std::lock_guard lock(mutex_);
        closed_ = true;
    }
    more_.notify_one();
    thread_.join();
}

std::optional<RenderQueue::Slot> RenderQueue::reserve() {
    const std::lock_guard lock(mutex_);
    if (n_reserved_ == slots_) return {};
    ++n_reserved_;
    return Slot(this);
}

std::optional<std::string> RenderQueue::get_device_loss_message() {
    const std::lock_guard lock(mutex_);
    return device_loss_;
}

void RenderQueue::set_batch_size(std::size_t count) {
    const std::lock_guard lock(mutex_);
    batch_size_ = count;
}

RenderQueue::Slot::~Slot() {
    if (!queue_) return;
    const std::lock_guard lock(queue_->mutex_);
    --queue_->n_reserved_;
}

RenderQueue::Outcome RenderQueue::Slot::run(Request& request) {
    request.queued_at_ = Request::Clock::now();
    std::unique_lock lock(queue_->mutex_);
    queue_->pending_.push_back(&request);
    queue_->more_.notify_one();
    queue_->wait(request, lock);
    if (request.failure_) std::rethrow_exception(request.failure_);
    return request.state_ == Request::State::done ? Outcome::done : Outcome::cancelled;
}

void RenderQueue::Slot::run(const std::function<void()>& function) {
    FunctionRequest request(function);
    run(request);
}

void RenderQueue::wait(Request& request, std::unique_lock<std::mutex>& lock) {
    using State = Request::State;
    while (request.state_ == State::pending &&
           !request.changed_.wait_for(lock, kPoll, [&] { return request.state_ != State::pending; })) {
        if (!request.is_cancelled()) continue;
        request.state_ = State::cancelled;
        pending_.erase(std::find(pending_.begin(), pending_.end(), &request));
    }
    request.changed_.wait(
        lock, [&] { return request.state_ == State::done || request.state_ == State::cancelled; });
}

/// Removes the next request that is not cancelled from the queue and returns it. Returns
/// null if there is none.
/// @param scene if set, also returns null if the next request is for another scene
Request* RenderQueue::next(const std::optional<std::size_t>& scene) {
    while (!pending_.empty()) {
        Request* request = pending_.front();
        if (scene && request->scene != scene) return nullptr;
        pending_.pop_front();
        request->state_ = request->is_cancelled() ? Request::State::cancelled : Request::State::in_flight;
        request->changed_.notify_one();
        if (request->state_ == Request::State::in_flight) return request;
    }
    return nullptr;
}

/// Runs submit() or finish() of a request. A request is done after finish(), or when one
/// of them throws an exception.
/// @param submits_last argument of submit(); without a value, runs finish() instead
void RenderQueue::run_request_part(Request& request, std::optional<bool> submits_last,
                                   std::unique_lock<std::mutex>& lock) {
    lock.unlock();
    std::exception_ptr failure;
    std::optional<std::string> loss;
    if (submits_last) request.submitted_at_ = Request::Clock::now();
    try {
        if (submits_last) request.submit(*submits_last);
        else request.finish();
    } catch (const DeviceLost& error) {
        failure = std::current_exception();
        loss = error.what();
    } catch (...) {
        failure = std::current_exception();
    }
    request.finished_at_ = Request::Clock::now();
    lock.lock();
    if (loss && !device_loss_) device_loss_ = loss;
    if (submits_last && request.scene && !failure) return;
    request.failure_ = failure;
    request.state_ = Request::State::done;
    request.changed_.notify_one();
}

/// Submits a batch: a request, and the requests after it for the same scene.
/// @return the submitted requests that are not finished yet
RenderQueue::Batch RenderQueue::submit(Request* request, std::unique_lock<std::mutex>& lock) {
    Batch batch;
    for (std::size_t n = 1; request; ++n) {
        Request* following = request->scene && n < batch_size_ ? next(request->scene) : nullptr;
        run_request_part(*request, !following, lock);
        if (request->state_ == Request::State::in_flight) batch.push_back(request);
        request = following;
    }
    return batch;
}

void RenderQueue::finish(const Batch& batch, std::unique_lock<std::mutex>& lock) {
    for (Request* request : batch) run_request_part(*request, {}, lock);
}

void RenderQueue::serve() {
    std::unique_lock lock(mutex_);
    Batch in_flight;
    while (true) {
        Request* request = next();
        if (!request && in_flight.empty()) {
            more_.wait(lock, [&] { return closed_ || !pending_.empty(); });
            if (pending_.empty()) return;
            continue;
        }
        const bool overlaps =
            request && !in_flight.empty() && request->scene && request->scene == in_flight.front()->scene;
        if (!overlaps) finish(std::exchange(in_flight, {}), lock);
        if (!request) continue;
        const Batch submitted = submit(request, lock);
        finish(std::exchange(in_flight, submitted), lock);
    }
}

}  // namespace relidar::serve
