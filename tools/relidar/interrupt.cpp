// SPDX-License-Identifier: Apache-2.0
// The handler only sets a flag, and is removed by the first signal.
#include "interrupt.hpp"

#include <csignal>

#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

volatile std::sig_atomic_t signal_seen = 0;

extern "C" void remember_signal(int number) {
    signal_seen = 1;
    std::signal(number, SIG_DFL);
}

}  // namespace

void catch_interrupts() {
    std::signal(SIGINT, remember_signal);
    std::signal(SIGTERM, remember_signal);
}

bool interrupted() { return signal_seen != 0; }

void stop_if_interrupted() {
    if (interrupted()) throw Error(ExitCode::interrupted, "interrupted; files already written are complete");
}

}  // namespace relidar::cli
