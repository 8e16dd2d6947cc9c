// SPDX-License-Identifier: Apache-2.0
// Clocks of the time stamps: offsets between two kinds of messages, and jumps. The times
// of recording, which come from one clock, show both.
#include "read/bag/choose.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>
#include <set>

#include <fmt/format.h>

#include "base/median.hpp"

namespace relidar::bag {
namespace {

constexpr std::int64_t kNsPerMs = 1000000, kOffsetUnit_ns = 1000 * kNsPerMs;
// Smaller offsets may be delays. Offsets below kClear_ns may be delays of slow programs.
constexpr std::int64_t kLeastOffset_ns = 750 * kNsPerMs, kClear_ns = 2 * kOffsetUnit_ns;
// Messages ahead of the recorder by more than this have another clock.
constexpr std::int64_t kMaxAhead_ns = 150 * kNsPerMs, kMinDrift_ns = 200 * kNsPerMs;
// Larger offsets are damaged times. A clock that starts at 0 is about 1.8e9 s behind.
constexpr std::int64_t kMostOffset_ns = 2400000000 * kOffsetUnit_ns;
// Two messages are compared if they were recorded within this time of each other.
constexpr std::int64_t kMaxRecordingGap_ns = kOffsetUnit_ns;
// An offset is steady if 80 % of its measurements are within 10 % of the offset, but at
// least and at most these values.
constexpr double kLeastSpread_ns = 5e8, kMostSpread_ns = 5e9;
// Recording times that pass much faster than the time stamps come from a conversion.
constexpr double kLeastPace = 0.5;

/// Rounds an offset to a known difference between clocks: leap seconds since 1999 and
/// time zones. A cloud is recorded up to 0.25 s later than a pose of the same time, so
/// the measured offset is too small by this delay.
std::int64_t round_offset(std::int64_t measured_ns) {
    const std::int64_t seconds = std::llround(1e-9 * double(measured_ns + 100 * kNsPerMs));
    const std::int64_t n = std::abs(seconds), delay_ns = seconds * kOffsetUnit_ns - measured_ns;
    const bool is_known = (n >= 13 && n <= 19) || (n >= 32 && n <= 37) || n % 900 == 0;
    return is_known && delay_ns >= -50 * kNsPerMs && delay_ns <= 250 * kNsPerMs ? seconds * kOffsetUnit_ns
                                                                                : measured_ns;
}

/// Returns true if most messages have the time stamps of reference messages, as poses
/// that were computed from clouds. Both then have one clock, and messages are late,
/// unless the offset makes even more time stamps equal.
bool share_stamps(const std::vector<MessageTimes>& messages, const std::vector<MessageTimes>& reference,
                  std::int64_t offset_ns) {
    std::set<std::int64_t> stamps;
    for (const MessageTimes& m : reference) stamps.insert(m.stamp_ns);
    const auto count_equal = [&](std::int64_t shift_ns) {
        return std::size_t(std::ranges::count_if(
            messages, [&](const MessageTimes& m) { return stamps.contains(m.stamp_ns - shift_ns); }));
    };
    const std::size_t n_equal = count_equal(0);
    return 2 * n_equal > messages.size() && count_equal(offset_ns) < n_equal;
}

constexpr std::int64_t kMinJump_ns = 500000000, kDay_ns = 86400000000000;
constexpr std::int64_t kMostDelay_ns = 10000000000;  // of a message
constexpr std::size_t kLeastRun = 3;                 // fewer clouds between two jumps have damaged times

/// Clouds [begin, end) between two jumps.
struct ClockRun {
    std::size_t begin = 0, end = 0;
    std::int64_t ahead_ns = 0;     ///< median time by which the clouds are ahead of the reference
    std::int64_t recorder_ns = 0;  ///< median time by which they are ahead of the recorder

    std::size_t size() const { return end - begin; }
};

template <class Function>
std::int64_t median_of(std::size_t begin, std::size_t end, const Function& function) {
    std::vector<std::int64_t> values;
    for (std::size_t i = begin; i < end; ++i) values.push_back(function(i));
    return compute_median(std::move(values));
}

/// Splits the clouds where their times jump. A late message is no jump: its time stamp
/// follows the previous one regularly. Without recording times, only days are jumps.
std::vector<ClockRun> split_at_jumps(const std::vector<CloudEntry>& clouds, LogClock clock,
                                     const std::vector<MessageTimes>& reference, std::int64_t period_ns,
                                     bool has_log) {
    std::vector<ClockRun> runs{{}};
    for (std::size_t i = 1; i < clouds.size(); ++i) {
        const std::int64_t step_ns = clouds[i].time_ns(clock) - clouds[i - 1].time_ns(clock),
                           log_ns = clouds[i].log_ns - clouds[i - 1].log_ns;
        const bool is_late =
            std::abs(step_ns - period_ns) <= std::abs(log_ns - period_ns) && (step_ns > 0 || log_ns < 0);
        if (has_log ? std::abs(step_ns - log_ns) < kMinJump_ns || is_late : std::abs(step_ns) < kDay_ns)
            continue;
        runs.back().end = i;
        runs.push_back({i});
    }
    runs.back().end = clouds.size();
    const auto recorder_ns_of = [&](std::size_t i) {
        return clouds[i].time_ns(clock) - (has_log ? clouds[i].log_ns : 0);
    };
    for (ClockRun& run : runs) {
        run.recorder_ns = median_of(run.begin, run.end, recorder_ns_of);
        run.ahead_ns = median_of(run.begin, run.end, [&](std::size_t i) {
            const MessageTimes* near = find_nearest(reference, clouds[i].log_ns);
            return recorder_ns_of(i) - (has_log && near ? near->stamp_ns - near->log_ns : 0);
        });
    }
    return runs;
}

}  // namespace

std::string ClockOffset::describe(const std::string& reference_name) const {
    const char* cause =
        offset_ns % kOffsetUnit_ns == 0 ? "" : " (accurate to the delays of messages, about 0.1 s)";
    // Clocks without leap seconds differ from UTC or each other by these constants.
    if (std::abs(offset_ns) == 37 * kOffsetUnit_ns) cause = " (TAI minus UTC is 37 s)";
    if (std::abs(offset_ns) == 18 * kOffsetUnit_ns) cause = " (GPS time minus UTC is 18 s)";
    if (std::abs(offset_ns) == 19 * kOffsetUnit_ns) cause = " (TAI minus GPS time is 19 s)";
    const std::string drift = drift_ns == 0 ? ""
                                            : fmt::format(" (this changes by {:.3f} s during the recording)",
                                                          1e-9 * double(std::abs(drift_ns)));
    return fmt::format("{:.3f} s {} {}{}{}", 1e-9 * double(std::abs(offset_ns)),
                       offset_ns > 0 ? "ahead of" : "behind", reference_name, cause, drift);
}

const MessageTimes* find_nearest(const std::vector<MessageTimes>& messages, std::int64_t log_ns) {
    auto near = std::ranges::lower_bound(messages, log_ns, {}, &MessageTimes::log_ns);
    if (near != messages.begin() &&
        (near == messages.end() || log_ns - std::prev(near)->log_ns < near->log_ns - log_ns))
        --near;
    return near == messages.end() ? nullptr : &*near;
}

ClockOffset estimate_offset(const std::vector<MessageTimes>& messages, std::vector<MessageTimes> reference) {
    constexpr std::size_t kMinMessages = 3;
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    std::vector<std::int64_t> offsets_ns, ahead_ns, reference_ahead_ns;
    for (const MessageTimes& m : messages) {
        const MessageTimes* near = find_nearest(reference, m.log_ns);
        if (!near || std::abs(near->log_ns - m.log_ns) > kMaxRecordingGap_ns) continue;
        ahead_ns.push_back(m.stamp_ns - m.log_ns);
        reference_ahead_ns.push_back(near->stamp_ns - near->log_ns);
        offsets_ns.push_back(ahead_ns.back() - reference_ahead_ns.back());
    }
    const auto passed_ns = [&](std::int64_t MessageTimes::*time) {
        return std::abs(double(messages.back().*time) - double(messages.front().*time));
    };
    // Recording times from a conversion do not show delays, so they are not compared.
    if (offsets_ns.size() < kMinMessages ||
        passed_ns(&MessageTimes::log_ns) < kLeastPace * passed_ns(&MessageTimes::stamp_ns))
        return {};
    const std::size_t n = offsets_ns.size(), n_tenth = n / 10;
    const auto find_median = [&](const std::vector<std::int64_t>& values, std::size_t begin,
                                 std::size_t end) {
        return compute_median(
            std::vector(values.begin() + std::ptrdiff_t(begin), values.begin() + std::ptrdiff_t(end)));
    };
    // A message is recorded after its time stamp. So no delay explains an offset of
    // messages that are ahead of the recorder, if the others are not.
    const auto is_ahead = [&](std::size_t begin, std::size_t end) {
        return find_median(ahead_ns, begin, end) > kMaxAhead_ns &&
               find_median(reference_ahead_ns, begin, end) < kMaxAhead_ns / 3;
    };
    ClockOffset clock;
    const std::int64_t least_ns = is_ahead(0, n) ? kMaxAhead_ns : kLeastOffset_ns;
    const std::int64_t median_ns = find_median(offsets_ns, 0, n);
    // A drift is the change of the median offset from the first to the last tenth of
    // messages.
    if (n_tenth >= kMinMessages) {
        const std::int64_t first_ns = find_median(offsets_ns, 0, n_tenth),
                           last_ns = find_median(offsets_ns, n - n_tenth, n);
        const bool is_last = std::abs(last_ns) > std::abs(first_ns);
        const bool is_clock = is_last ? is_ahead(n - n_tenth, n) : is_ahead(0, n_tenth);
        // Messages that are late for a while do not change the offset evenly.
        const std::int64_t change_ns = std::abs(last_ns - first_ns);
        const bool is_even = 2 * std::abs(2 * median_ns - first_ns - last_ns) < change_ns;
        if (is_clock ? change_ns >= kMinDrift_ns : is_even && change_ns >= kLeastOffset_ns)
            clock = {is_last ? last_ns : first_ns, last_ns - first_ns};
    }
    std::ranges::sort(offsets_ns);
    // Range of the middle 80 % of the offsets. An offset is used only if it is steady.
    const double spread_ns = double(offsets_ns[n - 1 - n / 10]) - double(offsets_ns[n / 10]);
    if (std::abs(median_ns) > kMostOffset_ns) return {};
    if (spread_ns > std::clamp(0.1 * std::abs(double(median_ns)), kLeastSpread_ns, kMostSpread_ns) ||
        std::abs(median_ns) < least_ns) {
        if (clock.drift_ns == 0) return {};
    } else {
        clock = {round_offset(median_ns), clock.drift_ns, std::abs(median_ns) >= kClear_ns};
    }
    if (share_stamps(messages, reference, clock.offset_ns)) {
        if (clock.drift_ns != 0 && least_ns == kLeastOffset_ns) return {};
        clock.is_clear = false;
    }
    return clock;
}

std::string fix_clock_jumps(std::vector<CloudEntry>& clouds, LogClock clock,
                            std::vector<MessageTimes> reference) {
    if (clouds.size() <= kLeastRun) return "";
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    const auto median_period_ns = [&](LogClock of) {
        return median_of(1, clouds.size(),
                         [&](std::size_t i) { return clouds[i].time_ns(of) - clouds[i - 1].time_ns(of); });
    };
    const std::int64_t period_ns = median_period_ns(clock);
    // Recording times of a conversion differ from the times of measurement.
    const bool has_log = clock == LogClock::stamps && period_ns > 0 &&
                         std::abs(median_period_ns(LogClock::recorder) - period_ns) < period_ns / 4;
    const std::vector<ClockRun> runs = split_at_jumps(clouds, clock, reference, period_ns, has_log);
    // Prefers clouds on the clock of the reference.
    const ClockRun main = *std::ranges::max_element(runs, {}, [](const ClockRun& run) {
        return std::pair(std::abs(run.ahead_ns) <= kMinJump_ns && run.size() >= kLeastRun, run.size());
    });
    if (main.size() < kLeastRun) return "";
    std::vector<CloudEntry> kept;
    std::size_t n_moved = 0;
    std::int64_t moved_ns = 0, out_ns = 0;
    for (const ClockRun& run : runs) {
        const std::int64_t about_ns = run.ahead_ns - main.ahead_ns;
        const bool is_other = std::abs(about_ns) > kMinJump_ns;
        const bool is_unclear =
            std::max(run.recorder_ns, main.recorder_ns) <= kMaxAhead_ns && std::abs(about_ns) < kMostDelay_ns;
        if (is_other && run.size() < kLeastRun && !is_unclear) {
            out_ns = about_ns;
            continue;
        }
        kept.insert(kept.end(), clouds.begin() + std::ptrdiff_t(run.begin),
                    clouds.begin() + std::ptrdiff_t(run.end));
        if (!is_other || !has_log || is_unclear) continue;
        // The nearest clouds of both runs are whole sweeps apart.
        const bool is_before = run.begin < main.begin;
        const std::int64_t step_ns = clouds[is_before ? run.end - 1 : run.begin].stamp_ns -
                                     clouds[is_before ? main.begin : main.end - 1].stamp_ns;
        moved_ns = step_ns - period_ns * std::llround(double(step_ns - about_ns) / double(period_ns));
        n_moved += run.size();
        for (std::size_t i = kept.size() - run.size(); i < kept.size(); ++i) {
            kept[i].stamp_ns -= moved_ns;
            kept[i].correction_ns = moved_ns;
        }
    }
    std::string text;
    if (kept.size() < clouds.size())
        text = fmt::format(
            "{} clouds are left out, because their times are far from their neighbours, for example {:.3f} s",
            clouds.size() - kept.size(), 1e-9 * double(std::abs(out_ns)));
    if (n_moved > 0)
        text += fmt::format(
            "{}the clock of the time stamps jumps, for example by {:.3f} s; the times of {} clouds are "
            "corrected",
            text.empty() ? "" : "; ", 1e-9 * double(std::abs(moved_ns)), n_moved);
    clouds = std::move(kept);
    return text;
}

}  // namespace relidar::bag
