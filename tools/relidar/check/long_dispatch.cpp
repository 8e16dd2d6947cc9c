// SPDX-License-Identifier: Apache-2.0
// Checks that a dispatch may take half a second. relidar cuts longer launches.
#include <chrono>

#include <fmt/format.h>

#include "check/checks.hpp"
#include "gpu/check_device.hpp"

namespace relidar::cli {

Finding check_long_dispatch(CheckedDevice& checked) {
    constexpr double kLong_s = 0.25;
    using Clock = std::chrono::steady_clock;
    // Compiles the kernel.
    sum_error(checked.device(), true);
    // Each turn has four times as many threads, so the last one takes at most a second.
    for (std::uint32_t n_threads = 1u << 18; n_threads <= 1u << 28; n_threads *= 4) {
        const Clock::time_point start = Clock::now();
        const double error = sum_error_of(checked.device(), n_threads);
        const double seconds = std::chrono::duration<double>(Clock::now() - start).count();
        if (error != 0.0)
            return wrong(fmt::format("sums after {:.2f} s are wrong by {:.1e}", seconds, error));
        if (seconds >= kLong_s) return {Finding::Kind::right, fmt::format("{:.2f} s", seconds)};
    }
    return {Finding::Kind::right, "268 million threads take less than 0.25 s"};
}

}  // namespace relidar::cli
