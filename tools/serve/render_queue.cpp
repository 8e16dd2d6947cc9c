// SPDX-License-Identifier: Apache-2.0
#include "render_queue.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

#include <relidar/base/error.hpp>

namespace relidar::serve {
namespace {

/// A waiting call checks at this interval that its client is still connected. It checks
/// once more before its job starts.
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

std::optional<std::string> RenderQueue::device_loss() {
    const std::lock_guard lock(mutex_);
    return device_loss_;
}

void RenderQueue::begin_together(std::size_t n) {
    const std::lock_guard lock(mutex_);
    together_ = n;
}

RenderQueue::Place::~Place() {
    if (!queue_) return;
    const std::lock_guard lock(queue_->mutex_);
    --queue_->taken_;
}

WorkEnd RenderQueue::Place::run(const std::function<void()>& work, const std::function<bool()>& is_wanted) {
    return run(WorkInTwo{[&](bool) { work(); }, {}, 0}, is_wanted);
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
    while (job.state == Job::State::waits &&
           !job.changed.wait_for(lock, kLook, [&] { return job.state != Job::State::waits; })) {
        if (job.is_wanted()) continue;
        job.state = Job::State::unwanted;
        line_.erase(std::find(line_.begin(), line_.end(), &job));
    }
    job.changed.wait(lock,
                     [&] { return job.state == Job::State::done || job.state == Job::State::unwanted; });
}

/// Returns the next job whose client is still connected, or null if there is none.
/// @param before if not null, only a job is returned that may start immediately after
/// this job
RenderQueue::Job* RenderQueue::next(const Job* before) {
    while (!line_.empty()) {
        Job* job = line_.front();
        if (before && !(job->work.finish && job->work.kind == before->work.kind)) return nullptr;
        line_.pop_front();
        job->state = job->is_wanted() ? Job::State::runs : Job::State::unwanted;
        job->changed.notify_one();
        if (job->state == Job::State::runs) return job;
    }
    return nullptr;
}

/// Runs one part of a job. The job ends after its last part, or if the part throws an
/// exception.
void RenderQueue::do_part(Job& job, const std::function<void()>& part, bool is_last,
                          std::unique_lock<std::mutex>& lock) {
    lock.unlock();
    std::exception_ptr failure;
    std::optional<std::string> loss;
    try {
        part();
    } catch (const DeviceLost& error) {
        failure = std::current_exception();
        loss = error.what();
    } catch (...) {
        failure = std::current_exception();
    }
    lock.lock();
    if (loss && !device_loss_) device_loss_ = loss;
    if (!is_last && !failure) return;
    job.failure = failure;
    job.state = Job::State::done;
    job.changed.notify_one();
}

/// Starts a job, and the following jobs that are submitted to the device together with
/// it.
/// @return all started jobs that still have a second part to run
std::vector<RenderQueue::Job*> RenderQueue::begin(Job* job, std::unique_lock<std::mutex>& lock) {
    std::vector<Job*> begun;
    for (std::size_t n = 1; job; ++n) {
        Job* with_it = job->work.finish && n < together_ ? next(job) : nullptr;
        do_part(
            *job, [&] { job->work.begin(!with_it); }, !job->work.finish, lock);
        // A job in another state has ended. The thread that waited for it may already
        // have destroyed the job.
        if (job->state == Job::State::runs) begun.push_back(job);
        job = with_it;
    }
    return begun;
}

void RenderQueue::finish(const std::vector<Job*>& jobs, std::unique_lock<std::mutex>& lock) {
    for (Job* job : jobs) do_part(*job, job->work.finish, true, lock);
}

void RenderQueue::serve() {
    std::unique_lock lock(mutex_);
    std::vector<Job*> begun;  // Jobs that the device is working on.
    while (true) {
        Job* job = next();
        if (!job && begun.empty()) {
            more_.wait(lock, [&] { return closed_ || !line_.empty(); });
            if (line_.empty()) return;
            continue;
        }
        const bool overlap =
            job && !begun.empty() && job->work.finish && job->work.kind == begun.front()->work.kind;
        if (!overlap) finish(std::exchange(begun, {}), lock);
        if (!job) continue;
        const std::vector<Job*> next_ones = begin(job, lock);
        finish(std::exchange(begun, next_ones), lock);
    }
}

}  // namespace relidar::serve
