// SPDX-License-Identifier: Apache-2.0
#include "render_queue.hpp"

#include <algorithm>
#include <chrono>

namespace relidar::serve {
namespace {

/// How often somebody who waits looks whether the client is still there. What was left in between is noticed before it is begun.
constexpr std::chrono::milliseconds kLook{10};

}  // namespace

RenderQueue::RenderQueue(std::size_t waiting) : places_(waiting + 1), thread_([this] { serve(); }) {}

RenderQueue::~RenderQueue() {
    {
        const std::lock_guard lock(mutex_);
        closed_ = true;
    }
    more_.notify_one();
    thread_.join();
}

std::optional<RenderQueue::Place> RenderQueue::enter() {
    const std::lock_guard lock(mutex_);
    if (taken_ == places_) return {};
    ++taken_;
    return Place(this);
}

RenderQueue::Place::~Place() {
    if (!queue_) return;
    const std::lock_guard lock(queue_->mutex_);
    --queue_->taken_;
}

WorkEnd RenderQueue::Place::run(const std::function<void()>& work, const std::function<bool()>& is_wanted) {
    return run(WorkInTwo{work, {}, 0}, is_wanted);
}

WorkEnd RenderQueue::Place::run(const WorkInTwo& work, const std::function<bool()>& is_wanted) {
    Job job{work, is_wanted};
    std::unique_lock lock(queue_->mutex_);
    queue_->line_.push_back(&job);
    queue_->more_.notify_one();
    queue_->wait(job, lock);
    if (job.failure) std::rethrow_exception(job.failure);
    return job.state == Job::State::done ? WorkEnd::done : WorkEnd::unwanted;
}

void RenderQueue::wait(Job& job, std::unique_lock<std::mutex>& lock) {
    while (job.state == Job::State::waits && !job.changed.wait_for(lock, kLook, [&] { return job.state != Job::State::waits; })) {
        if (job.is_wanted()) continue;
        job.state = Job::State::unwanted;
        line_.erase(std::find(line_.begin(), line_.end(), &job));
    }
    job.changed.wait(lock, [&] { return job.state == Job::State::done || job.state == Job::State::unwanted; });
}

/// The next job that is wanted; null where none is there.
RenderQueue::Job* RenderQueue::next() {
    while (!line_.empty()) {
        Job* job = line_.front();
        line_.pop_front();
        job->state = job->is_wanted() ? Job::State::runs : Job::State::unwanted;
        job->changed.notify_one();
        if (job->state == Job::State::runs) return job;
    }
    return nullptr;
}

/// Does a part of a job, and ends it with the last one, or with what it throws.
void RenderQueue::do_part(Job& job, const std::function<void()>& part, std::unique_lock<std::mutex>& lock) {
    const bool is_last = !job.work.finish || &part == &job.work.finish;
    lock.unlock();
    std::exception_ptr failure;
    try {
        part();
    } catch (...) {
        failure = std::current_exception();
    }
    lock.lock();
    if (!is_last && !failure) return;
    job.failure = failure;
    job.state = Job::State::done;
    job.changed.notify_one();
}

void RenderQueue::serve() {
    std::unique_lock lock(mutex_);
    Job* begun = nullptr;   // the device works for it
    while (true) {
        Job* job = next();
        if (!job && !begun) {
            more_.wait(lock, [&] { return closed_ || !line_.empty(); });
            if (line_.empty()) return;
            continue;
        }
        const bool go_together = job && begun && job->work.finish && job->work.kind == begun->work.kind;
        if (begun && !go_together) do_part(*begun, begun->work.finish, lock), begun = nullptr;
        if (!job) continue;
        do_part(*job, job->work.begin, lock);
        if (job->state != Job::State::runs) job = nullptr;   // it has ended, and goes with who waits for it
        if (begun) do_part(*begun, begun->work.finish, lock);
        begun = job;
    }
}

}  // namespace relidar::serve
