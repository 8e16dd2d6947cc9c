// SPDX-License-Identifier: Apache-2.0
// Tests the queue of the render thread: order, slots, and requests that are cancelled.
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

const auto kWanted = [] { return true; };

/// Work that blocks the render thread until the object is destroyed.
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

/// Returns what a queue does with waiting work, in order. A lower-case letter marks the
/// begin of work in two parts, a comma follows if other work begins together with it, and
/// a capital letter marks its end.
/// @param line names and kinds; kind 0 is work in one part
/// @param fails name of the work whose begin fails
std::string parts_of(const std::vector<std::pair<char, std::size_t>>& line, std::size_t together,
                     char fails = ' ') {
    RenderQueue queue(8);
    queue.begin_together(together);
    std::string parts;  // accessed only by the queue's thread
    std::vector<std::jthread> clients;
    std::optional<Blocker> blocker(std::in_place, queue);
    std::atomic<int> n_in_line = 0;
    const auto add = [&](const auto& work) {
        const int before = n_in_line;
        clients.emplace_back([&queue, &n_in_line, work] {
            RenderQueue::Place place = std::move(*queue.enter());
            const auto is_wanted = [&n_in_line, told = false]() mutable {
                return n_in_line += !std::exchange(told, true), true;
            };
            try {
                place.run(work, is_wanted);
            } catch (const std::runtime_error&) {}
        });
        // the queue has asked whether the work is cancelled, so the work is in the queue
        while (n_in_line == before) std::this_thread::yield();
    };
    for (const auto& [name, kind] : line) {
        const auto begin = [&parts, name = name, fails](bool is_last) {
            if (name == fails) throw std::runtime_error("begin");
            parts += name;
            if (!is_last) parts += ',';
        };
        if (kind == 0) add(std::function<void()>([&parts, name = name] { parts += name; }));
        else add(WorkInTwo{begin, [&parts, name = name] { parts += char(std::toupper(name)); }, kind});
    }
    blocker.reset();
    clients.clear();
    return parts;
}

/// The second work of a kind must begin before the first one ends, and the order must be
/// kept. Work of another kind, or in one part, must wait.
TEST(RenderQueue, WorkInTwoOverlapsWithTheNextOfItsKind) {
    EXPECT_EQ(parts_of({{'a', 1}, {'b', 1}, {'c', 1}, {'d', 2}, {'-', 0}, {'e', 2}}, 1), "abAcBCdD-eE");
}

TEST(RenderQueue, WorkInTwoOfOneKindIsBegunTogether) {
    EXPECT_EQ(parts_of({{'a', 1}, {'b', 1}, {'c', 1}, {'d', 1}, {'e', 1}, {'f', 2}, {'-', 0}, {'g', 2}}, 2),
              "a,bc,dABeCDEfF-gG");
    EXPECT_EQ(parts_of({{'a', 1}, {'b', 1}, {'c', 2}, {'d', 2}, {'e', 2}, {'f', 2}}, 3), "a,bABc,d,efCDEF");
    EXPECT_EQ(parts_of({{'a', 1}, {'b', 1}, {'c', 1}, {'d', 1}}, 2, 'b'), "a,c,dACD")
        << "b fails: nobody told a";
}

TEST(RenderQueue, WorkInTwoThatFailsIsNotFinishedAndStopsNoOther) {
    RenderQueue queue(8);
    bool finished = false;
    const WorkInTwo fails{[](bool) { throw std::runtime_error("begin"); }, [&] { finished = true; }, 1};
    EXPECT_THROW(queue.enter()->run(fails, kWanted), std::runtime_error);
    EXPECT_FALSE(finished);
    const WorkInTwo fails_late{[](bool) {}, [] { throw std::runtime_error("finish"); }, 1};
    EXPECT_THROW(queue.enter()->run(fails_late, kWanted), std::runtime_error);
    const WorkInTwo works{[](bool) {}, [&] { finished = true; }, 1};
    EXPECT_EQ(queue.enter()->run(works, kWanted), WorkEnd::done) << "nobody comes after it";
    EXPECT_TRUE(finished);
}

TEST(RenderQueue, WorkWhoseClientHasLeftIsNeverBegun) {
    RenderQueue queue(4);
    std::atomic<bool> ran = false, wanted = true;
    WorkEnd end = WorkEnd::done;
    {
        Blocker blocker(queue);
        std::jthread client(
            [&] { end = queue.enter()->run([&] { ran = true; }, [&] { return wanted.load(); }); });
        wanted = false;
        client.join();  // joins while the thread is busy: a cancelled request must not wait for others
        EXPECT_EQ(end, WorkEnd::unwanted);
    }
    queue.enter()->run([] {}, kWanted);  // afterwards, all earlier work has been processed
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
    EXPECT_THROW(queue.enter()->run([] { throw std::runtime_error("of this one"); }, kWanted),
                 std::runtime_error);
    EXPECT_EQ(queue.enter()->run([] {}, kWanted), WorkEnd::done);
}

}  // namespace
}  // namespace relidar::serve
