// SPDX-License-Identifier: Apache-2.0
// Tests the order of requests, slots, and cancelled requests.
#include <atomic>
#include <cctype>
#include <functional>
#include <future>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "render_queue.hpp"

namespace relidar::serve {
namespace {

struct FunctionsRequest : QueuedRequest {
    std::function<void(bool is_last)> on_submit = [](bool) {};
    std::function<void()> on_finish = [] {};
    std::function<bool()> cancelled = [] { return false; };

    void submit(bool is_last) override { on_submit(is_last); }
    void finish() override { on_finish(); }
    bool is_cancelled() const override { return cancelled(); }
};
using Outcome = RenderQueue::RequestOutcome;

class Blocker {
public:
    explicit Blocker(RenderQueue& queue)
        : slot_(std::move(*queue.reserve_slot())),
          thread_([this] { slot_.run_function([this] { block(); }); }) {
        begun_.get_future().wait();
    }
    ~Blocker() {
        go_.set_value();
        thread_.join();
    }

private:
    std::promise<void> begun_, go_;
    RenderQueue::QueueSlot slot_;
    std::thread thread_;

    void block() {
        begun_.set_value();
        go_.get_future().wait();
    }
};

TEST(RenderQueue, HasSlotsForPendingRequestsAndTheCurrentOne) {
    RenderQueue queue(2);
    std::vector<RenderQueue::QueueSlot> slots;
    for (int i = 0; i < 3; ++i) {
        std::optional<RenderQueue::QueueSlot> slot = queue.reserve_slot();
        ASSERT_TRUE(slot);
        slots.push_back(std::move(*slot));
    }
    EXPECT_FALSE(queue.reserve_slot());
    slots.pop_back();
    EXPECT_TRUE(queue.reserve_slot()) << "a slot is released";
}

TEST(RenderQueue, RunsAllRequestsOnOneThread) {
    RenderQueue queue(8);
    std::thread::id worker;
    queue.reserve_slot()->run_function([&] { worker = std::this_thread::get_id(); });
    EXPECT_NE(worker, std::this_thread::get_id());
    std::atomic<int> elsewhere = 0, done = 0;
    std::vector<std::jthread> clients;
    for (int i = 0; i < 8; ++i)
        clients.emplace_back([&] {
            queue.reserve_slot()->run_function([&] {
                elsewhere += std::this_thread::get_id() != worker;
                ++done;
            });
        });
    clients.clear();
    EXPECT_EQ(done, 8);
    EXPECT_EQ(elsewhere, 0);
}

/// Runs a render queue with pending requests and returns its actions in order. A
/// lower-case letter marks the submission of a request. A comma follows if the next
/// request is submitted together with this request. A capital letter marks the end of the
/// request.
/// @param line names and scenes; scene 0 stands for a request without a scene
/// @param fails name of the request whose submission fails
std::string list_parts(const std::vector<std::pair<char, std::size_t>>& line, std::size_t together,
                       char fails = ' ') {
    RenderQueue queue(8);
    queue.set_batch_size(together);
    std::string parts;  // accessed only by the queue's thread
    std::vector<std::jthread> clients;
    std::optional<Blocker> blocker(std::in_place, queue);
    std::atomic<int> n_in_line = 0;
    for (const auto& [name, scene] : line) {
        const int before = n_in_line;
        clients.emplace_back([&, name = name, scene = scene] {
            FunctionsRequest request;
            request.on_submit = [&parts, name, fails](bool is_last) {
                if (name == fails) throw std::runtime_error("submit");
                parts += name;
                if (!is_last) parts += ',';
            };
            request.on_finish = [&parts, name] { parts += char(std::toupper(name)); };
            request.cancelled = [&n_in_line, counted = false]() mutable {
                n_in_line += !std::exchange(counted, true);
                return false;
            };
            if (scene > 0) request.scene = scene;
            try {
                queue.reserve_slot()->run_request(request);
            } catch (const std::runtime_error&) {}
        });
        // When the queue has polled whether the request is cancelled, the request is
        // pending.
        while (n_in_line == before) std::this_thread::yield();
    }
    blocker.reset();
    clients.clear();
    return parts;
}

/// The second request for a scene must be submitted before the first request ends, and
/// the order must be preserved. Requests for a different scene, or without a scene, must
/// wait.
TEST(RenderQueue, RequestsOfASceneOverlap) {
    EXPECT_EQ(list_parts({{'a', 1}, {'b', 1}, {'c', 1}, {'d', 2}, {'-', 0}, {'e', 2}}, 1), "abAcBCdD-eE");
}

TEST(RenderQueue, RequestsOfASceneAreSubmittedTogether) {
    EXPECT_EQ(list_parts({{'a', 1}, {'b', 1}, {'c', 1}, {'d', 1}, {'e', 1}, {'f', 2}, {'-', 0}, {'g', 2}}, 2),
              "a,bc,dABeCDEfF-gG");
    EXPECT_EQ(list_parts({{'a', 1}, {'b', 1}, {'c', 2}, {'d', 2}, {'e', 2}, {'f', 2}}, 3), "a,bABc,d,efCDEF");
    EXPECT_EQ(list_parts({{'a', 1}, {'b', 1}, {'c', 1}, {'d', 1}}, 2, 'b'), "a,c,dACD")
        << "b fails, and a was not informed";
}

TEST(RenderQueue, ARequestThatFailsIsNotFinishedAndStopsNoOther) {
    RenderQueue queue(8);
    bool finished = false;
    FunctionsRequest fails;
    fails.scene = 1;
    fails.on_submit = [](bool) { throw std::runtime_error("submit"); };
    fails.on_finish = [&] { finished = true; };
    EXPECT_THROW(queue.reserve_slot()->run_request(fails), std::runtime_error);
    EXPECT_FALSE(finished);
    FunctionsRequest fails_late;
    fails_late.scene = 1;
    fails_late.on_finish = [] { throw std::runtime_error("finish"); };
    EXPECT_THROW(queue.reserve_slot()->run_request(fails_late), std::runtime_error);
    FunctionsRequest works;
    works.scene = 1;
    works.on_finish = [&] { finished = true; };
    EXPECT_EQ(queue.reserve_slot()->run_request(works), Outcome::done) << "nobody comes after it";
    EXPECT_TRUE(finished);
}

TEST(RenderQueue, ACancelledRequestIsNeverSubmitted) {
    RenderQueue queue(4);
    std::atomic<bool> ran = false, cancelled = false;
    Outcome outcome = Outcome::done;
    FunctionsRequest request;
    request.on_submit = [&](bool) { ran = true; };
    request.cancelled = [&] { return cancelled.load(); };
    {
        Blocker blocker(queue);
        std::jthread client([&] { outcome = queue.reserve_slot()->run_request(request); });
        cancelled = true;
        // joins the client while the queue is busy, because a cancelled request must not
        // wait for other requests
        client.join();
        EXPECT_EQ(outcome, Outcome::cancelled);
    }
    queue.reserve_slot()->run_function([] {});  // afterwards, all earlier work has been processed
    EXPECT_FALSE(ran);
}

TEST(RenderQueue, ChecksOnceMoreBeforeItSubmits) {
    RenderQueue queue(4);
    bool ran = false;
    FunctionsRequest request;
    request.on_submit = [&](bool) { ran = true; };
    request.cancelled = [] { return true; };
    EXPECT_EQ(queue.reserve_slot()->run_request(request), Outcome::cancelled);
    EXPECT_FALSE(ran);
}

TEST(RenderQueue, AFailureEndsOnlyItsRequest) {
    RenderQueue queue(4);
    EXPECT_THROW(queue.reserve_slot()->run_function([] { throw std::runtime_error("of this one"); }),
                 std::runtime_error);
    FunctionsRequest request;
    EXPECT_EQ(queue.reserve_slot()->run_request(request), Outcome::done);
}

}  // namespace
}  // namespace relidar::serve
