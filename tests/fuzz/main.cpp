// SPDX-License-Identifier: Apache-2.0
// Usage: relidar_fuzz --harness=NAME [--seeds=FOLDER] CORPUS... or --list
#include "harness.hpp"

#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include <sanitizer/allocator_interface.h>

#include <relidar/base/error.hpp>

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kLongestMessage = 1000;  // includes paths, which are short in the harnesses

// maximum memory that an input may use at any time, absolute and per byte of input
constexpr long long kMostBytes = 64ll << 20, kMostBytesPerByte = 10;

std::atomic<long long> bytes_held{0}, most_bytes_held{0};

void on_malloc(const volatile void*, std::size_t n_bytes) {
    const long long now = bytes_held += static_cast<long long>(n_bytes);
    for (long long most = most_bytes_held; now > most && !most_bytes_held.compare_exchange_weak(most, now);) {
    }
}

void on_free(const volatile void* bytes) {
    if (bytes) bytes_held -= static_cast<long long>(__sanitizer_get_allocated_size(bytes));
}

std::vector<Harness> list_all_harnesses() {
    std::vector<Harness> all = list_binary_harnesses();
    for (const auto& more : {list_text_harnesses(), list_drive_harnesses(), list_dataset_harnesses(),
                             list_request_harnesses(), list_bag_harnesses()})
        all.insert(all.end(), more.begin(), more.end());
    return all;
}

/// Returns a new folder in TMPDIR, which tools/dev/fuzz creates in memory and removes.
fs::path get_scratch_folder() {
    static const fs::path folder = [] {
        std::string pattern = fs::temp_directory_path() / "fuzz-XXXXXX";
        if (!::mkdtemp(pattern.data())) std::abort();
        return fs::path(pattern);
    }();
    return folder;
}

Harness chosen;

/// Adds the seeds of the harness to a folder, and reads all seeds of the folder.
[[noreturn]] void write_seeds(const fs::path& folder) {
    fs::create_directories(folder);
    std::size_t n = 0;
    if (chosen.seeds)
        for (const std::string& seed : chosen.seeds(get_scratch_folder()))
            put(folder / ("seed_" + std::to_string(n++)), seed);
    // no exception may be caught here: the reader must accept the seeds
    for (const auto& seed : fs::directory_iterator(folder))
        if (chosen.seeds_are_good) chosen.read(read_contents(seed.path()), get_scratch_folder());
    std::exit(0);
}

void initialise(const std::vector<std::string>& arguments) {
    std::string name, seeds;
    for (const std::string& argument : arguments) {
        if (argument == "--list") {
            for (const Harness& harness : list_all_harnesses()) std::puts(harness.name);
            std::exit(0);
        }
        if (argument.starts_with("--harness=")) name = argument.substr(10);
        if (argument.starts_with("--seeds=")) seeds = argument.substr(8);
    }
    for (const Harness& harness : list_all_harnesses()) {
        if (name == harness.name) chosen = harness;
    }
    if (!chosen.read) {
        std::fprintf(stderr, "relidar_fuzz: --harness=%s: unknown, expected one that --list names\n",
                     name.c_str());
        std::exit(2);
    }
    if (!seeds.empty()) write_seeds(seeds);
}

void check_memory(std::size_t n_input) {
    const long long most = kMostBytes + kMostBytesPerByte * static_cast<long long>(n_input);
    if (most_bytes_held <= most) return;
    std::fprintf(stderr, "ERROR: an input of %zu bytes took %lld bytes, expected at most %lld\n", n_input,
                 most_bytes_held.load(), most);
    std::abort();
}

void read(std::string_view input) {
    try {
        chosen.read(input, get_scratch_folder());
    } catch (const Error& error) {
        const std::string message = error.what();
        const bool expected = error.code() == ExitCode::data || error.code() == ExitCode::usage;
        if (expected && message.size() <= kLongestMessage) return;
        std::fprintf(stderr, "exit code %d, %zu characters: %.300s\n", static_cast<int>(error.code()),
                     message.size(), message.c_str());
        std::abort();
    }
}

}  // namespace

void put(const fs::path& file, std::string_view bytes) {
    std::ofstream out(file, std::ios::binary);
    if (!out.write(bytes.data(), static_cast<std::streamsize>(bytes.size())).flush()) std::abort();
}

std::string read_contents(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

}  // namespace relidar::fuzz

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
    relidar::fuzz::initialise({*argv, *argv + *argc});
    __sanitizer_install_malloc_and_free_hooks(relidar::fuzz::on_malloc, relidar::fuzz::on_free);
    return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    relidar::fuzz::bytes_held = relidar::fuzz::most_bytes_held = 0;
    relidar::fuzz::read({reinterpret_cast<const char*>(data), size});
    relidar::fuzz::check_memory(size);
    return 0;
}
