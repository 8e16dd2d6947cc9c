// SPDX-License-Identifier: Apache-2.0
// The line in front of the render thread: order, places, those who leave.
#include <atomic>
#include <future>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "render_queue.hpp"

namespace relidar::serve {
namespace {

const auto kWanted = [] { return true; };

/// Work that holds the render thread until it is let go.
class Blocker {
public:
    explicit Blocker(RenderQueue& queue)
        : place_(std::move(*queue.enter())), thread_([this] { place_.run([this] { block(); }, kWanted); }) {
        begun_.get_future().wait();
    }
    ~Blocker() {
        go_.set_value();
        thread_.join();
    }

private:
    std::promise<void> begun_, go_;
    RenderQueue::Place place_;
    std::thread thread_;

    void block() {
        begun_.set_value();
        go_.get_future().wait();
    }
};

TEST(RenderQueue, HasPlacesForThoseWhoWaitAndTheOneWhoIsServed) {
    RenderQueue queue(2);
    std::vector<RenderQueue::Place> places;
    for (int i = 0; i < 3; ++i) {
        std::optional<RenderQueue::Place> place = queue.enter();
        ASSERT_TRUE(place);
        places.push_back(std::move(*place));
    }
    EXPECT_FALSE(queue.enter());
    places.pop_back();
    EXPECT_TRUE(queue.enter()) << "a place is given back";
}

TEST(RenderQueue, DoesAllWorkOnOneThread) {
    RenderQueue queue(8);
    std::thread::id worker;
    queue.enter()->run([&] { worker = std::this_thread::get_id(); }, kWanted);
    EXPECT_NE(worker, std::this_thread::get_id());
    std::atomic<int> elsewhere = 0, done = 0;
    std::vector<std::jthread> clients;
    for (int i = 0; i < 8; ++i)
        clients.emplace_back([&] {
            queue.enter()->run([&] { elsewhere += std::this_thread::get_id() != worker, ++done; }, kWanted);
        });
    clients.clear();
    EXPECT_EQ(done, 8);
    EXPECT_EQ(elsewhere, 0);
}

TEST(RenderQueue, WorkWhoseClientHasLeftIsNeverBegun) {
    RenderQueue queue(4);
    std::atomic<bool> ran = false, wanted = true;
    WorkEnd end = WorkEnd::done;
    {
        Blocker blocker(queue);
        std::jthread client([&] { end = queue.enter()->run([&] { ran = true; }, [&] { return wanted.load(); }); });
        wanted = false;
        client.join();   // while the thread is busy: who leaves does not wait for others
        EXPECT_EQ(end, WorkEnd::unwanted);
    }
    queue.enter()->run([] {}, kWanted);   // whatever was in the line has had its turn
    EXPECT_FALSE(ran);
}

TEST(RenderQueue, LooksOnceMoreBeforeItBegins) {
    RenderQueue queue(4);
    bool ran = false;
    EXPECT_EQ(queue.enter()->run([&] { ran = true; }, [] { return false; }), WorkEnd::unwanted);
    EXPECT_FALSE(ran);
}

TEST(RenderQueue, FailureOfWorkIsItsOwn) {
    RenderQueue queue(4);
    EXPECT_THROW(queue.enter()->run([] { throw std::runtime_error("of this one"); }, kWanted), std::runtime_error);
    EXPECT_EQ(queue.enter()->run([] {}, kWanted), WorkEnd::done);
}

}  // namespace
}  // namespace relidar::serve
