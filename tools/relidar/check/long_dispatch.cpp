// SPDX-License-Identifier: Apache-2.0
// Checks that the driver allows a GPU dispatch of a quarter of a second, because some
// drivers abort long dispatches. relidar splits longer work into several dispatches.
#include <fmt/format.h>

#include "check/checks.hpp"
#include "gpu/check_device.hpp"

namespace relidar::cli {

Finding check_long_dispatch(CheckedDevice& checked) {
    constexpr double kLong_s = 0.25;
    // Runs the kernel once, so that its compile time is not measured.
    compute_sum_error(checked.device(), true);
    // Each iteration starts four times as many threads as the previous iteration. The
    // loop stops when a dispatch takes 0.25 s, so the last dispatch takes about one
    // second at most.
    for (std::uint32_t n_threads = 1u << 18; n_threads <= 1u << 28; n_threads *= 4) {
        double seconds = 0.0;
        const double error = measure_sum_error_of_kernel(checked.device(), n_threads, seconds);
        if (error != 0.0)
            return make_wrong_finding(
                fmt::format("after {:.2f} s, the sums have an error of {:.1e}", seconds, error));
        if (seconds >= kLong_s) return {Finding::Kind::right, fmt::format("{:.2f} s", seconds)};
    }
    return {Finding::Kind::right, "the GPU needs less than 0.25 s for 268 million threads"};
}

}  // namespace relidar::cli
