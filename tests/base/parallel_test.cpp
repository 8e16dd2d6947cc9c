// SPDX-License-Identifier: Apache-2.0
#include "base/parallel.hpp"

#include <numeric>
#include <stdexcept>

#include <sys/wait.h>
#include <unistd.h>

#include <gtest/gtest.h>
#include <tbb/global_control.h>
#include <tbb/task_group.h>

#include "base/geometry/cell_numbers.hpp"
#include "base/parallel_sort.hpp"
#include "base/progress_blocks.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

template <class Task>
void with_threads(int count, const Task& task) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, std::size_t(count));
    tbb::task_arena(count).execute(task);
}

TEST(ParallelFor, RunsEveryItemOnce) {
    for (const int n : {0, 1, 2, 1000}) {
        std::vector<std::atomic<int>> runs(std::size_t(n) + 1);
        parallel_for(n, [&](int index) { ++runs[std::size_t(index)]; });
        for (int i = 0; i < n; ++i) EXPECT_EQ(runs[std::size_t(i)], 1) << i << " of " << n;
        EXPECT_EQ(runs[std::size_t(n)], 0);
    }
}

TEST(ParallelFor, LoopsInLoopsAndFromSeveralThreads) {
    std::atomic<int> n{0};
    const auto nested = [&] {
        parallel_for(8, [&](int) { parallel_for(8, [&](int) { parallel_for(3, [&](int) { ++n; }); }); });
    };
    std::vector<std::thread> threads;
    for (int k = 0; k < 4; ++k) threads.emplace_back(nested);
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(n, 4 * 8 * 8 * 3);
}

TEST(ParallelFor, ThrowsTheFirstFailureAndBeginsNothingElse) {
    for (int repeat = 0; repeat < 50; ++repeat) {
        std::atomic<int> n_begun{0}, n_ended{0};
        try {
            parallel_for(100000, [&](int index) {
                ++n_begun;
                if (index == 7) std::this_thread::sleep_for(std::chrono::milliseconds(1));
                ++n_ended;
                if (index >= 7) throw std::runtime_error(std::to_string(index));
            });
            FAIL() << "nothing was thrown";
        } catch (const std::runtime_error& error) {
            EXPECT_STREQ(error.what(), "7");
        }
        EXPECT_EQ(n_begun, n_ended);
        EXPECT_LE(n_begun, 8 + int(max_threads()));
    }
}

TEST(ParallelFor, WorksInAFork) {
    // starts threads in the parent process; a forked child does not inherit threads
    parallel_for(4, [](int) {});
    const pid_t child = ::fork();
    if (child == 0) {
        std::atomic<int> n{0};
        parallel_for(64, [&](int) { ++n; });
        ::_exit(n == 64 ? 0 : 1);
    }
    int status = 1;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

TEST(ParallelFor, RunsOnTheCallingThreadWhereOneIsAllowed) {
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    EXPECT_EQ(max_threads(), 1u);
    std::vector<int> order;
    std::vector<std::thread::id> threads;
    parallel_for(1000, [&](int index) {
        order.push_back(index);
        threads.push_back(std::this_thread::get_id());
    });
    std::vector<int> ascending(1000);
    std::iota(ascending.begin(), ascending.end(), 0);
    EXPECT_EQ(order, ascending);
    EXPECT_EQ(threads, std::vector(1000, std::this_thread::get_id()));
}

TEST(ParallelFor, NoOuterTaskStartsOnAThreadThatWaitsForAnInnerLoop) {
    std::atomic<int> n_nested{0}, n_inner{0};
    with_threads(8, [&] {
        parallel_for(200, [&](int) {
            thread_local bool is_in_task = false;
            n_nested += is_in_task;
            is_in_task = true;
            parallel_for(8, [&](int) {
                std::this_thread::sleep_for(std::chrono::microseconds(50));
                ++n_inner;
            });
            is_in_task = false;
        });
    });
    EXPECT_EQ(n_nested, 0);
    EXPECT_EQ(n_inner, 200 * 8);
}

TEST(ParallelFor, IsCompleteInACancelledTaskOfTheCaller) {
    std::atomic<int> n{0};
    with_threads(4, [&] {
        tbb::task_group group;
        group.run_and_wait([&] {
            group.cancel();
            parallel_for(1000, [&](int) { ++n; });
        });
    });
    EXPECT_EQ(n, 1000);
}

TEST(ForEachBlock, MeetsEveryItemOnce) {
    for (const std::size_t n : {0, 1, 127, 128, 129, 5000, 1000003}) {
        std::vector<std::atomic<char>> met(n);
        parallel_blocks(n, [&](std::size_t index) { ++met[index]; });
        EXPECT_TRUE(std::ranges::all_of(met, [](const std::atomic<char>& m) { return m == 1; })) << n;
    }
}

TEST(ParallelReduce, AddsPartsInTheirOrder) {
    struct Text {
        std::string text;
        Text& operator+=(const Text& other) {
            text += other.text;
            return *this;
        }
    };
    const Text all = parallel_sum(10, 3, [](std::size_t begin, std::size_t end) {
        Text part;
        for (std::size_t i = begin; i < end; ++i) part.text += std::to_string(i);
        return part;
    });
    EXPECT_EQ(all.text, "0123456789");
    EXPECT_EQ(parallel_sum(0, 3, [](std::size_t, std::size_t) { return 1; }), 0);
}

/// Rounding makes a sum of floats depend on the order of its terms. The result must
/// nevertheless be the same for any number of threads.
TEST(ParallelReduce, IsTheSameForAnyNumberOfThreads) {
    constexpr std::size_t kItems = 100003, kPart = 128;
    std::vector<float> values;
    for (std::size_t i = 0; i < kItems; ++i)
        values.push_back(static_cast<float>(hash_integer(i) % 1000003) / (1.0f + float(i % 97)));
    const auto sum = [&](std::size_t begin, std::size_t end) {
        return std::accumulate(values.begin() + std::ptrdiff_t(begin), values.begin() + std::ptrdiff_t(end),
                               0.0f);
    };
    float expected = sum(0, kPart);
    for (std::size_t begin = kPart; begin < kItems; begin += kPart)
        expected += sum(begin, std::min(begin + kPart, kItems));
    ASSERT_NE(expected, sum(0, kItems)) << "the order should matter here";
    for (const int n_threads : {1, 2, 3, 16})
        for (int repeat = 0; repeat < 10; ++repeat)
            with_threads(n_threads, [&] {
                EXPECT_EQ(max_threads(), std::size_t(n_threads));
                EXPECT_EQ(parallel_sum(kItems, kPart, sum), expected) << n_threads << " threads";
            });
}

TEST(ParallelSort, SortsAsSortDoes) {
    std::vector<std::uint64_t> values;
    for (std::uint64_t i = 0; i < 300000; ++i) values.push_back(hash_integer(i) % 100000);
    std::vector<std::uint64_t> expected = values;
    std::sort(expected.begin(), expected.end());
    parallel_sort(values, std::less<>());
    EXPECT_EQ(values, expected);
}

TEST(ForEachTold, TellsFromTheCallingThreadAndEndsWhereThatThrows) {
    const std::thread::id caller = std::this_thread::get_id();
    double last = -1.0;
    std::atomic<int> n{0};
    progress_for(
        200,
        [&](std::string_view description, double done) {
            EXPECT_EQ(description, "counting");
            EXPECT_EQ(std::this_thread::get_id(), caller);
            EXPECT_TRUE(done >= last && done <= 1.0) << done;
            last = done;
        },
        "counting", [&](std::size_t) { ++n; });
    EXPECT_EQ(n, 200);
    EXPECT_EQ(last, 1.0);
    n = 0;
    const auto stop = [](std::string_view, double done) {
        if (done > 0.0) throw std::runtime_error("enough");
    };
    const auto count_slowly = [&](std::size_t) {
        ++n;
        std::this_thread::sleep_for(std::chrono::microseconds(100));
    };
    EXPECT_THROW(progress_for(1000000, stop, "counting", count_slowly), std::runtime_error);
    EXPECT_LT(n, 1000000);
}

TEST(CellNumbers, CountCellsAsTheyAreFirstNamed) {
    std::vector<std::uint64_t> keys;
    for (std::uint64_t i = 0; i < 200000; ++i) keys.push_back(hash_integer(hash_integer(i) % 30000));
    std::map<std::uint64_t, std::uint32_t> numbers;
    const ItemCellIndices cells = number_cells(keys);
    const CellItemLists items(cells);
    for (std::size_t i = 0; i < keys.size(); ++i) {
        const auto expected =
            numbers.try_emplace(keys[i], static_cast<std::uint32_t>(numbers.size())).first->second;
        ASSERT_EQ(cells.of[i], expected) << "item " << i;
    }
    EXPECT_EQ(cells.n_cells, numbers.size());
    ASSERT_EQ(items.size(), numbers.size());
    std::size_t n = 0;
    for (std::size_t cell = 0; cell < items.size(); ++cell) {
        EXPECT_TRUE(std::ranges::is_sorted(items.items_of(cell)));
        for (const std::uint32_t i : items.items_of(cell)) EXPECT_EQ(cells.of[i], cell);
        n += items.items_of(cell).size();
    }
    EXPECT_EQ(n, keys.size());
    EXPECT_EQ(number_cells({}).n_cells, 0u);
}

}  // namespace
}  // namespace relidar
