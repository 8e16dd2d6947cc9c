// SPDX-License-Identifier: Apache-2.0
// The signal handler stores the time of the first signal. It ignores signals within the
// next second, because a batch system and mpirun may both send one. A later signal ends
// the program immediately.
#include "interrupt.hpp"

#include <atomic>
#include <csignal>
#include <ctime>

#include <relidar/base/error.hpp>

namespace relidar::cli {
namespace {

constexpr long long kSameSignal_ms = 1000;

// milliseconds; 0 until a signal arrives
std::atomic<long long> first_signal_ms{0};
static_assert(std::atomic<long long>::is_always_lock_free, "a signal handler may not wait for a lock");

extern "C" void handle_signal(int signal_number) {
    timespec now{};
    ::clock_gettime(CLOCK_MONOTONIC, &now);
    const long long now_ms = now.tv_sec * 1000LL + now.tv_nsec / 1'000'000;
    // Stores the time of the first signal. For a later signal, the exchange fails and
    // reads that time instead.
    long long first_ms = 0;
    if (first_signal_ms.compare_exchange_strong(first_ms, now_ms) || now_ms - first_ms < kSameSignal_ms)
        return;
    // The default action ends the program.
    std::signal(signal_number, SIG_DFL);
    std::raise(signal_number);
}

}  // namespace

void install_handlers() {
    std::signal(SIGINT, handle_signal);
    std::signal(SIGTERM, handle_signal);
}

bool is_interrupted() { return first_signal_ms != 0; }

void check_interrupt() {
    if (is_interrupted())
        throw Error(ExitCode::interrupted, "interrupted; the files that were already written are complete");
}

}  // namespace relidar::cli
