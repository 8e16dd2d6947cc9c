// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/clock_offset.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>
#include <set>

#include <fmt/format.h>

namespace relidar::bag {
namespace {

constexpr std::int64_t kMillisecond_ns = 1000000;
// Smaller offsets may be delays. Offsets below kClear_ns may be delays of slow programs.
constexpr std::int64_t kLeastOffset_ns = 750 * kMillisecond_ns, kClear_ns = 2000 * kMillisecond_ns;
// Larger offsets are damaged times. A clock that starts at 0 is about 1.8e18 ns behind.
constexpr std::int64_t kMostOffset_ns = 2400000000000 * kMillisecond_ns;
// Two messages are compared if they were recorded within this time of each other.
constexpr std::int64_t kNearby_ns = 1000 * kMillisecond_ns;
// An offset is steady if 80 % of its measurements are within this interval.
constexpr std::int64_t kSteady_ns = 500 * kMillisecond_ns;
// A cloud is recorded up to this much later than a pose of the same time.
constexpr std::int64_t kMostDelay_ns = 250 * kMillisecond_ns, kLeastDelay_ns = -50 * kMillisecond_ns;

/// Rounds an offset to a known difference between clocks: leap seconds since 1999 (GPS -
/// UTC, TAI - GPS, TAI - UTC) and time zones. The measured offset is too small by the
/// delay of the messages.
std::int64_t round_to_known_offset(std::int64_t measured_ns) {
    const std::int64_t seconds =
        std::llround(1e-9 * double(measured_ns + (kMostDelay_ns + kLeastDelay_ns) / 2));
    const std::int64_t n = std::abs(seconds), delay_ns = seconds * 1000 * kMillisecond_ns - measured_ns;
    const bool is_known = (n >= 13 && n <= 19) || (n >= 32 && n <= 37) || n % 900 == 0;
    return is_known && delay_ns >= kLeastDelay_ns && delay_ns <= kMostDelay_ns ? measured_ns + delay_ns
                                                                               : measured_ns;
}

/// Returns the share of time stamps that are also time stamps of the reference after a
/// shift. Poses that were computed from clouds have the time stamps of the clouds.
double compute_equal_share(const std::vector<MessageTimes>& messages, const std::set<std::int64_t>& reference,
                           std::int64_t shift_ns) {
    const auto n = std::ranges::count_if(
        messages, [&](const MessageTimes& m) { return reference.contains(m.stamp_ns - shift_ns); });
    return double(n) / double(messages.size());
}

}  // namespace

std::string ClockOffset::describe(const std::string& reference_name) const {
    const std::int64_t n = std::abs(offset_ns) / (1000 * kMillisecond_ns);
    const char* cause = "";
    if (offset_ns % (1000 * kMillisecond_ns) == 0)
        cause = n == 37   ? " (TAI minus UTC is 37 s)"
                : n == 18 ? " (GPS time minus UTC is 18 s)"
                : n == 19 ? " (TAI minus GPS time is 19 s)"
                          : "";
    return fmt::format("{:.3f} s {} {}{}", 1e-9 * double(std::abs(offset_ns)),
                       offset_ns > 0 ? "ahead of" : "behind", reference_name, cause);
}

ClockOffset estimate_clock_offset(const std::vector<MessageTimes>& messages,
                                  std::vector<MessageTimes> reference) {
    constexpr std::size_t kLeast = 3;
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    std::vector<std::int64_t> offsets_ns;
    for (const MessageTimes& m : messages) {
        auto near = std::ranges::lower_bound(reference, m.log_ns, {}, &MessageTimes::log_ns);
        if (near != reference.begin() &&
            (near == reference.end() || m.log_ns - std::prev(near)->log_ns < near->log_ns - m.log_ns))
            --near;
        if (near == reference.end() || std::abs(near->log_ns - m.log_ns) > kNearby_ns) continue;
        offsets_ns.push_back((m.stamp_ns - m.log_ns) - (near->stamp_ns - near->log_ns));
    }
    if (offsets_ns.size() < kLeast) return {};
    std::ranges::sort(offsets_ns);
    const std::size_t n = offsets_ns.size();
    const std::int64_t median_ns = offsets_ns[n / 2];
    const double spread_ns = double(offsets_ns[n - 1 - n / 10]) - double(offsets_ns[n / 10]);
    if (spread_ns > double(kSteady_ns) || std::abs(median_ns) < kLeastOffset_ns ||
        std::abs(median_ns) > kMostOffset_ns)
        return {};
    ClockOffset clock{round_to_known_offset(median_ns), std::abs(median_ns) >= kClear_ns};
    std::set<std::int64_t> stamps;
    for (const MessageTimes& m : reference) stamps.insert(m.stamp_ns);
    // Equal time stamps show that the messages have one clock and are only late, unless
    // the offset explains even more of the time stamps.
    const double equal_share = compute_equal_share(messages, stamps, 0);
    if (equal_share > 0.5 && compute_equal_share(messages, stamps, clock.offset_ns) < equal_share)
        clock.is_clear = false;
    return clock;
}

}  // namespace relidar::bag
