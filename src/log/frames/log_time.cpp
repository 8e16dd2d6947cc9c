// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/log_time.hpp>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <fmt/format.h>

namespace relidar {
namespace {

constexpr std::int64_t kNsPerSecond = 1'000'000'000;

}  // namespace

void set_log_start(Log& log, std::int64_t unix_ns, const std::string& clock) {
    log.start_unix_ns = unix_ns >= 0 && unix_ns <= kLatestLogStart_ns ? unix_ns : 0;
    log.conventions += fmt::format(" Time 0 s is {}.{:09} s {}.", unix_ns / kNsPerSecond,
                                   std::abs(unix_ns % kNsPerSecond), clock);
}

std::int64_t time_shift_of(const Log& log, double first_s) {
    const std::int64_t log_start_ns = log.start_unix_ns;
    // Rays precede the time of their frame by up to a sweep, packets by slightly more.
    constexpr double kSweepsBeforeFrame = 1.01;
    if (first_s == INFINITY)  // the default
        for (const Frame& frame : log.frames)
            first_s =
                std::min(first_s, frame.time_s - kSweepsBeforeFrame * log.lidar_of(frame).sweep_period_s());
    if (first_s == INFINITY) return log_start_ns;                     // the log has no frames
    const double earliest_s = 1e-9 * double(log_start_ns) + first_s;  // since 1970
    const double missing_s = std::max(0.0, -earliest_s);
    return log_start_ns + kNsPerSecond * std::int64_t(std::ceil(missing_s));
}

std::string time_shift_note(const Log& log, std::int64_t time_shift_ns) {
    const std::int64_t added_ns = time_shift_ns - log.start_unix_ns;
    if (added_ns == 0) return {};
    return fmt::format(
        "times of recordings and packets are {} s later than times of the log, because they cannot be "
        "negative",
        added_ns / kNsPerSecond);
}

}  // namespace relidar
