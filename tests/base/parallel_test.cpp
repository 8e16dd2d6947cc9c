// SPDX-License-Identifier: Apache-2.0
#include "base/parallel.hpp"

#include <atomic>
#include <chrono>
#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <sys/wait.h>
#include <unistd.h>

#include <gtest/gtest.h>

#include "base/cell_numbers.hpp"
#include "base/progress_blocks.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

TEST(RunParallel, RunsEveryItemOnce) {
    for (const int n : {0, 1, 2, 1000}) {
        std::vector<std::atomic<int>> runs(std::size_t(n) + 1);
        run_parallel(n, [&](int i) { ++runs[std::size_t(i)]; });
        for (int i = 0; i < n; ++i) EXPECT_EQ(runs[std::size_t(i)], 1) << i << " of " << n;
        EXPECT_EQ(runs[std::size_t(n)], 0);
    }
}

TEST(RunParallel, LoopsInLoopsAndFromSeveralThreads) {
    std::atomic<int> n{0};
    const auto nested = [&] {
        run_parallel(8, [&](int) { run_parallel(8, [&](int) { run_parallel(3, [&](int) { ++n; }); }); });
    };
    std::vector<std::thread> threads;
    for (int k = 0; k < 4; ++k) threads.emplace_back(nested);
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(n, 4 * 8 * 8 * 3);
}

TEST(RunParallel, ThrowsTheFirstFailureAndBeginsNothingElse) {
    for (int repeat = 0; repeat < 50; ++repeat) {
        std::atomic<int> n_begun{0}, n_ended{0};
        try {
            run_parallel(100000, [&](int i) {
                ++n_begun;
                if (i == 7) std::this_thread::sleep_for(std::chrono::milliseconds(1));
                ++n_ended;
                if (i >= 7) throw std::runtime_error(std::to_string(i));
            });
            FAIL() << "nothing was thrown";
        } catch (const std::runtime_error& error) {
            EXPECT_STREQ(error.what(), "7");
        }
        EXPECT_EQ(n_begun, n_ended);
        EXPECT_LE(n_begun, 8 + int(n_cores()));
    }
}

TEST(RunParallel, WorksInAFork) {
    run_parallel(4, [](int) {});  // starts the worker threads, which a forked process does not have
    const pid_t child = ::fork();
    if (child == 0) {
        std::atomic<int> n{0};
        run_parallel(64, [&](int) { ++n; });
        ::_exit(n == 64 ? 0 : 1);
    }
    int status = 1;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

TEST(ForEachBlock, MeetsEveryItemOnce) {
    for (const std::size_t n : {0, 1, 127, 128, 129, 5000, 1000003}) {
        std::vector<std::atomic<char>> met(n);
        for_each_block(n, [&](std::size_t i) { ++met[i]; });
        EXPECT_TRUE(std::ranges::all_of(met, [](const std::atomic<char>& m) { return m == 1; })) << n;
    }
}

TEST(SumParallel, AddsPartsInTheirOrder) {
    struct Text {
        std::string text;
        Text& operator+=(const Text& other) {
            text += other.text;
            return *this;
        }
    };
    const Text all = sum_parallel(10, 3, [](std::size_t begin, std::size_t end) {
        Text part;
        for (std::size_t i = begin; i < end; ++i) part.text += std::to_string(i);
        return part;
    });
    EXPECT_EQ(all.text, "0123456789");
    EXPECT_EQ(sum_parallel(0, 3, [](std::size_t, std::size_t) { return 1; }), 0);
}

TEST(SortParallel, SortsAsSortDoes) {
    std::vector<std::uint64_t> values;
    for (std::uint64_t i = 0; i < 300000; ++i) values.push_back(hash64(i) % 100000);
    std::vector<std::uint64_t> expected = values;
    std::sort(expected.begin(), expected.end());
    sort_parallel(values, std::less<>());
    EXPECT_EQ(values, expected);
}

TEST(ForEachTold, TellsFromTheCallingThreadAndEndsWhereThatThrows) {
    const std::thread::id caller = std::this_thread::get_id();
    double last = -1.0;
    std::atomic<int> n{0};
    for_each_told(
        200,
        [&](std::string_view what, double done) {
            EXPECT_EQ(what, "counting");
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
    EXPECT_THROW(for_each_told(1000000, stop, "counting", count_slowly), std::runtime_error);
    EXPECT_LT(n, 1000000);
}

TEST(CellNumbers, CountCellsAsTheyAreFirstNamed) {
    std::vector<std::uint64_t> keys;
    for (std::uint64_t i = 0; i < 200000; ++i) keys.push_back(hash64(hash64(i) % 30000));
    std::map<std::uint64_t, std::uint32_t> numbers;
    const CellNumbers cells = number_cells(keys);
    const ItemsOfCells items(cells);
    for (std::size_t i = 0; i < keys.size(); ++i) {
        const auto expected =
            numbers.try_emplace(keys[i], static_cast<std::uint32_t>(numbers.size())).first->second;
        ASSERT_EQ(cells.of[i], expected) << "item " << i;
    }
    EXPECT_EQ(cells.n_cells, numbers.size());
    ASSERT_EQ(items.size(), numbers.size());
    std::size_t n = 0;
    for (std::size_t cell = 0; cell < items.size(); ++cell) {
        EXPECT_TRUE(std::ranges::is_sorted(items.of(cell)));
        for (const std::uint32_t i : items.of(cell)) EXPECT_EQ(cells.of[i], cell);
        n += items.of(cell).size();
    }
    EXPECT_EQ(n, keys.size());
    EXPECT_EQ(number_cells({}).n_cells, 0u);
}

}  // namespace
}  // namespace relidar
