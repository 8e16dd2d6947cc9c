// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/log_time.hpp>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <fmt/format.h>

#include "base/csv.hpp"

namespace relidar {
namespace {

constexpr const char* kStartText = "0 s is ";
constexpr std::int64_t kSecond_ns = 1'000'000'000;

}  // namespace

std::string format_log_start(std::int64_t unix_ns, const std::string& clock) {
    return fmt::format("Time {}{}.{:09} s {}.", kStartText, unix_ns / kSecond_ns,
                       std::abs(unix_ns % kSecond_ns), clock);
}

std::int64_t get_log_start_unix_ns(const LidarSequence& sequence) {
    const std::size_t at = sequence.conventions.find(kStartText);
    if (at == std::string::npos) return 0;
    const std::string text = sequence.conventions.substr(at + std::string(kStartText).size());
    const std::size_t dot = text.find('.'), end = text.find(' ');
    if (dot == std::string::npos || end == std::string::npos || end < dot || end - dot != 10) return 0;
    const auto seconds = parse_number(text.substr(0, dot));
    const auto nanoseconds = parse_number(text.substr(dot + 1, 9));
    constexpr double kLatest_s = 4e9;
    if (!seconds || !nanoseconds || !(*seconds >= 0.0 && *seconds <= kLatest_s)) return 0;
    return std::int64_t(*seconds) * kSecond_ns + std::int64_t(*nanoseconds);
}

std::int64_t compute_time_shift_ns(const LidarSequence& sequence, double first_s) {
    const std::int64_t log_start_ns = get_log_start_unix_ns(sequence);
    for (const LidarFrame& frame : sequence.frames)
        // Rays are fired up to a sweep before the time of their frame. The first packet
        // can begin slightly earlier.
        first_s = std::min(first_s, frame.time_s - 1.01 * sequence.get_lidar(frame).get_sweep_period_s());
    if (!std::isfinite(first_s)) return log_start_ns;
    const double earliest_s = 1e-9 * double(log_start_ns) + first_s;
    return log_start_ns + kSecond_ns * std::int64_t(std::ceil(std::max(0.0, -earliest_s)));
}

std::string format_time_shift_note(const LidarSequence& sequence, std::int64_t time_shift_ns) {
    const std::int64_t added_ns = time_shift_ns - get_log_start_unix_ns(sequence);
    if (added_ns == 0) return {};
    return fmt::format(
        "times of recordings and packets are {} s later than times of the log, because they cannot be "
        "negative",
        added_ns / kSecond_ns);
}

}  // namespace relidar
