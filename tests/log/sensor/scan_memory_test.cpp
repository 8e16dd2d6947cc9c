// SPDX-License-Identifier: Apache-2.0
// Each test runs in a process, because the file exists as long as its process.
#include <relidar/log/sensor.hpp>

#include <csignal>
#include <cstdlib>
#include <numeric>
#include <random>
#include <thread>

#include <sys/resource.h>

#include <relidar/read/dataset.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

template <class Checks>
void run_in_child_process(const Checks& checks) {
    EXPECT_EXIT(
        {
            checks();
            std::exit(testing::Test::HasFailure() ? 1 : 0);
        },
        testing::ExitedWithCode(0), "");
}

std::uint64_t measure_anonymous_bytes() {
    std::ifstream status("/proc/self/status");
    for (std::string line; std::getline(status, line);)
        if (line.starts_with("RssAnon:")) return 1024 * std::stoull(line.substr(8));
    return 0;
}

TEST(ScanMemory, IsUnlimitedUntilItIsLimited) {
    run_in_child_process([] {
        const ScanArray<float> array(1 << 20, 1.0f);
        EXPECT_EQ(scan_memory_use().in_memory, 4u << 20);
        EXPECT_EQ(scan_memory_use().in_file, 0u);
    });
}

TEST(ScanMemory, ProcessesOfAMachineShareTheDefault) {
    run_in_child_process([] {
        limit_scan_memory(0, fs::temp_directory_path());
        const ScanArray<float> alone(1 << 18, 1.0f);
        EXPECT_EQ(scan_memory_use().in_file, 0u);
        share_scan_memory(10'000'000);  // each may use some kilobytes
        limit_scan_memory(0, fs::temp_directory_path());
        const ScanArray<float> one_of_many(1 << 18, 1.0f);
        EXPECT_EQ(scan_memory_use().in_file, 1u << 20);
        limit_scan_memory(8 << 20, fs::temp_directory_path());
        const ScanArray<float> array_within_limit(1 << 18, 1.0f);
        EXPECT_EQ(scan_memory_use().in_file, 1u << 20) << "what a setting gives is each process's own";
    });
}

TEST(ScanMemory, KeepsWhatIsWrittenWhereverItLies) {
    run_in_child_process([] {
        limit_scan_memory(3 << 20, fs::temp_directory_path());
        std::mt19937 random(1);
        std::vector<ScanArray<std::uint32_t>> arrays;
        std::vector<std::uint32_t> first;
        // Allocates and frees arrays of all sizes. At the end, 40 MB are allocated.
        for (int step = 0; step < 2000; ++step) {
            if (arrays.size() > 20 && random() % 2) {
                const std::size_t which = random() % arrays.size();
                for (std::size_t i = 0; i < arrays[which].size(); ++i)
                    ASSERT_EQ(arrays[which][i], first[which] + i);
                std::swap(arrays[which], arrays.back());
                arrays.pop_back();
                std::swap(first[which], first.back());
                first.pop_back();
            } else {
                first.push_back(random());
                arrays.emplace_back(1 + random() % 100'000);
                std::iota(arrays.back().begin(), arrays.back().end(), first.back());
            }
        }
        std::uint64_t bytes = 0;
        for (std::size_t k = 0; k < arrays.size(); ++k) {
            for (std::size_t i = 0; i < arrays[k].size(); ++i) ASSERT_EQ(arrays[k][i], first[k] + i);
            bytes += arrays[k].size() * sizeof(std::uint32_t);
        }
        const ScanMemoryUse use = scan_memory_use();
        EXPECT_LE(use.in_memory, 3u << 20);
        EXPECT_GT(use.in_file, bytes / 2);
        EXPECT_LT(use.in_memory + use.in_file, bytes + arrays.size() * 65536);
        arrays.clear();
        EXPECT_EQ(scan_memory_use().in_memory, 0u);
        EXPECT_EQ(scan_memory_use().in_file, 0u);
    });
}

TEST(ScanMemory, ServesSeveralThreads) {
    run_in_child_process([] {
        limit_scan_memory(1 << 20, fs::temp_directory_path());
        std::vector<std::thread> threads;
        for (std::uint32_t t = 0; t < 4; ++t)
            threads.emplace_back([t] {
                for (std::uint32_t repetition = 0; repetition < 300; ++repetition) {
                    const ScanArray<std::uint32_t> array(5000 + 997 * ((repetition + t) % 50),
                                                         1000 * t + repetition);
                    for (const std::uint32_t value : array) ASSERT_EQ(value, 1000 * t + repetition);
                }
            });
        for (std::thread& thread : threads) thread.join();
        EXPECT_EQ(scan_memory_use().in_file, 0u);
    });
}

TEST(ScanMemory, ALogThatDoesNotFitIsTheSame) {
#ifdef __SANITIZE_ADDRESS__
    GTEST_SKIP() << "AddressSanitizer keeps freed memory, so the used memory is not comparable";
#endif
    run_in_child_process([] {
        const StreetOptions street{.n_frames = 40, .rows = 32, .columns = 512};
        const Log log_in_memory = make_street_log(street);  // 29 MB
        const std::uint64_t of_scans = scan_memory_use().in_memory, before = measure_anonymous_bytes();
        EXPECT_GT(of_scans, 20u << 20);
        limit_scan_memory(1 << 20, fs::temp_directory_path());
        const Log log = make_street_log(street);
        EXPECT_GT(scan_memory_use().in_file, of_scans * 9 / 10);
        EXPECT_LT(measure_anonymous_bytes(), before + of_scans / 2);
        for (std::size_t k = 0; k < log.frames.size(); ++k) {
            const Scan &a = log_in_memory.frames[k].scan, &b = log.frames[k].scan;
            EXPECT_TRUE(a.range_m == b.range_m && a.intensity == b.intensity &&
                        a.rays.direction == b.rays.direction && a.rays.origin == b.rays.origin &&
                        a.rays.time_offset_s == b.rays.time_offset_s && a.rays.channel == b.rays.channel)
                << "frame " << k;
        }
    });
}

TEST(ScanMemory, AFolderThatCannotTakeThemIsNamed) {
    run_in_child_process([] {
        limit_scan_memory(1, "/proc/nowhere");
        EXPECT_THAT(error_message<DataError>([] { ScanArray<float>(1 << 20); }),
                    test::Names("memory ... '/proc/nowhere'"));
    });
    run_in_child_process([] {
        const rlimit small{8 << 20, 8 << 20};
        ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
        std::signal(SIGXFSZ, SIG_IGN);
        limit_scan_memory(1, fs::temp_directory_path());
        std::vector<ScanArray<float>> arrays;
        arrays.emplace_back(1 << 20, 1.0f);
        EXPECT_THAT(error_message<DataError>([&] { arrays.emplace_back(3 << 20, 2.0f); }),
                    test::Names("File too large"));
        EXPECT_EQ(arrays.size(), 1u);
        EXPECT_EQ(scan_memory_use().in_file, 4u << 20)
            << "what was there stays, what did not fit takes nothing";
        EXPECT_EQ(arrays[0].back(), 1.0f);
    });
}

}  // namespace
}  // namespace relidar
