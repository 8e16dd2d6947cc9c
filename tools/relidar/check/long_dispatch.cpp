// SPDX-License-Identifier: Apache-2.0
// Checks that the driver allows a GPU dispatch of a quarter of a second, because some
// drivers abort long dispatches. relidar splits longer work into several dispatches.
#include <fmt/format.h>

#include "check/checks.hpp"
#include "gpu/check_device.hpp"

namespace relidar::cli {

CheckResult check_dispatch(CheckedDevice& tested) {
    constexpr double kDispatchTime_s = 0.25;
    // Runs the kernel once, so that its compile time is not measured.
    test_atomic_adds(tested.default_device(), true);
    // Each dispatch has four times as many threads as the previous one. The loop ends at
    // a dispatch of 0.25 s, so the last one takes about one second at most.
    for (std::uint32_t n_threads = 1u << 18; n_threads <= 1u << 28; n_threads *= 4) {
        double seconds = 0.0;
        const double error = test_swap_adds(tested.default_device(), n_threads, seconds);
        if (error != 0.0)
            return failed_check(
                fmt::format("after a computation of {:.2f} s, found sums with a relative error of {:.1e}, "
                            "expected exact sums",
                            seconds, error));
        if (seconds >= kDispatchTime_s)
            return {CheckResult::CheckOutcome::right,
                    fmt::format("exact sums after a computation of {:.2f} s", seconds)};
    }
    return {CheckResult::CheckOutcome::right,
            "exact sums; the longest computation, with 268 million threads, took less than 0.25 s"};
}

}  // namespace relidar::cli
