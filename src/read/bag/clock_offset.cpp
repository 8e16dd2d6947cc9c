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
constexpr std::size_t kMinMessages = 3;  // from which an offset is estimated

/// Rounds an offset to a known difference between clocks: leap seconds since 1999 and
/// time zones. Measured is: offset = difference - delay. The delay is how much later a
/// cloud is recorded than a pose of the same time, -0.05 to 0.25 s. Returns the measured
/// offset if no known difference gives such a delay.
std::int64_t round_offset(std::int64_t measured_ns) {
    constexpr std::int64_t kUsualDelay_ns = 100 * kNsPerMs;
    constexpr std::int64_t kMinDelay_ns = -50 * kNsPerMs, kMaxDelay_ns = 250 * kNsPerMs;
    const std::int64_t whole_s = std::llround(1e-9 * double(measured_ns + kUsualDelay_ns));
    const std::int64_t difference_s = std::abs(whole_s), delay_ns = whole_s * kOffsetUnit_ns - measured_ns;
    // GPS minus UTC is 13 s (1999) to 18 s; TAI minus GPS is 19 s.
    const bool is_gps_difference = difference_s >= 13 && difference_s <= 19;
    const bool is_tai_minus_utc = difference_s >= 32 && difference_s <= 37;
    const bool are_leap_seconds = is_gps_difference || is_tai_minus_utc;
    const bool is_time_zone = difference_s % 900 == 0;  // whole quarters of an hour
    const bool is_known = are_leap_seconds || is_time_zone;
    const bool is_possible_delay = delay_ns >= kMinDelay_ns && delay_ns <= kMaxDelay_ns;
    return is_known && is_possible_delay ? whole_s * kOffsetUnit_ns : measured_ns;
}

/// Returns true if most messages have the same time stamps as reference messages, for
/// example poses that were computed from clouds. Then both have one clock, and the
/// measured offset is a delay. Returns false if as many stamps or more are equal after
/// the offset is subtracted, because then it is the real difference of two clocks.
bool share_stamps(const std::vector<MessageTimes>& messages, const std::vector<MessageTimes>& reference,
                  std::int64_t offset_ns) {
    std::set<std::int64_t> stamps;
    for (const MessageTimes& times : reference) stamps.insert(times.stamp_ns);
    const auto count_equal = [&](std::int64_t shift_ns) {
        return std::size_t(std::ranges::count_if(
            messages, [&](const MessageTimes& times) { return stamps.contains(times.stamp_ns - shift_ns); }));
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
    /// Median time by which the clouds are ahead of the reference: time stamp - recording
    /// time, minus the same of the reference message that was recorded at that time.
    std::int64_t ahead_ns = 0;
    std::int64_t ahead_recorder_ns = 0;  ///< median time by which they are ahead of the recorder

    std::size_t size() const { return end - begin; }
};

/// Returns the median of function(i) for the indices [begin, end).
template <class Function>
std::int64_t median_of(std::size_t begin, std::size_t end, const Function& function) {
    std::vector<std::int64_t> values;
    for (std::size_t i = begin; i < end; ++i) values.push_back(function(i));
    return compute_median(std::move(values));
}

/// Splits the clouds where their times jump relative to the recording times. A late
/// message is no jump: its time stamp follows the previous one after about a period, but
/// its recording time does not.
/// @param period_ns  usual time between clouds
/// @param can_use_log  false: the recording times come from a conversion, so that only
/// steps of a day are jumps
std::vector<ClockRun> split_at_jumps(const std::vector<CloudEntry>& clouds, LogClock clock,
                                     std::int64_t period_ns, bool can_use_log) {
    const auto is_jump = [&](const CloudEntry& before, const CloudEntry& cloud) {
        const std::int64_t step_ns = cloud.time_ns(clock) - before.time_ns(clock);
        const std::int64_t log_step_ns = cloud.log_ns - before.log_ns;
        if (!can_use_log) return std::abs(step_ns) >= kDay_ns;
        // true if the step of the time stamps is nearer to the period than the recorder's
        const bool is_regular = std::abs(step_ns - period_ns) <= std::abs(log_step_ns - period_ns);
        // A time stamp that goes back is a jump, unless the recording time goes back too.
        const bool is_late = is_regular && (step_ns > 0 || log_step_ns < 0);
        return std::abs(step_ns - log_step_ns) >= kMinJump_ns && !is_late;
    };
    std::vector<ClockRun> runs{{}};
    for (std::size_t i = 1; i < clouds.size(); ++i) {
        if (!is_jump(clouds[i - 1], clouds[i])) continue;
        runs.back().end = i;
        runs.push_back({.begin = i});
    }
    runs.back().end = clouds.size();
    return runs;
}

/// Sets by how much the clouds of each run (clouds between two jumps of the clock) are
/// ahead of the recorder and of the reference messages. Both are medians over the clouds.
/// @param can_use_log  false: the recording times come from a conversion and count as 0,
/// so that both medians are time stamps
void measure_runs(std::vector<ClockRun>& runs, const std::vector<CloudEntry>& clouds, LogClock clock,
                  const std::vector<MessageTimes>& reference, bool can_use_log) {
    const auto ahead_recorder_ns = [&](std::size_t i) {
        return clouds[i].time_ns(clock) - (can_use_log ? clouds[i].log_ns : 0);
    };
    for (ClockRun& run : runs) {
        run.ahead_recorder_ns = median_of(run.begin, run.end, ahead_recorder_ns);
        run.ahead_ns = median_of(run.begin, run.end, [&](std::size_t i) {
            const MessageTimes* near = find_nearest(reference, clouds[i].log_ns);
            const std::int64_t reference_ahead_recorder_ns =
                can_use_log && near ? near->stamp_ns - near->log_ns : 0;
            return ahead_recorder_ns(i) - reference_ahead_recorder_ns;
        });
    }
}

/// Messages and the reference messages that were recorded nearest to them. A message is
/// recorded after its time stamp, so on the clock of the recorder, "ahead" is minus the
/// delay of the message.
struct OffsetSamples {
    std::vector<std::int64_t> ahead_ns;            ///< time stamp minus recording time of each message
    std::vector<std::int64_t> reference_ahead_ns;  ///< the same of the reference message
    std::vector<std::int64_t> offset_ns;           ///< difference of both
    std::size_t size() const { return offset_ns.size(); }

    /// Returns true if messages [begin, end) are ahead of the recorder, but the reference
    /// is not. Then the messages have another clock, because no delay explains this.
    bool are_ahead(std::size_t begin, std::size_t end) const {
        return median_of(begin, end, [&](std::size_t i) { return ahead_ns[i]; }) > kMaxAhead_ns &&
               median_of(begin, end, [&](std::size_t i) { return reference_ahead_ns[i]; }) < kMaxAhead_ns / 3;
    }
    std::int64_t median_offset_ns(std::size_t begin, std::size_t end) const {
        return median_of(begin, end, [&](std::size_t i) { return offset_ns[i]; });
    }
};

/// Pairs messages by their recording times.
/// @param reference  sorted by recording time
OffsetSamples pair_messages(const std::vector<MessageTimes>& messages,
                            const std::vector<MessageTimes>& reference) {
    OffsetSamples samples;
    for (const MessageTimes& message : messages) {
        const MessageTimes* near = find_nearest(reference, message.log_ns);
        if (!near || std::abs(near->log_ns - message.log_ns) > kMaxRecordingGap_ns) continue;
        samples.ahead_ns.push_back(message.stamp_ns - message.log_ns);
        samples.reference_ahead_ns.push_back(near->stamp_ns - near->log_ns);
        samples.offset_ns.push_back(samples.ahead_ns.back() - samples.reference_ahead_ns.back());
    }
    return samples;
}

/// Returns the drift of a clock: the median offset of the last tenth of the messages
/// minus that of the first tenth, and the larger of these two offsets. Returns 0 if the
/// change is small, or if messages that are late for a while can explain it.
/// @param samples  offsets of messages from a reference, in the order of recording
ClockOffset find_drift(const OffsetSamples& samples) {
    const std::size_t n = samples.size(), n_tenth = n / 10;
    if (n_tenth < kMinMessages) return {};
    const std::int64_t median_ns = samples.median_offset_ns(0, n);
    const std::int64_t first_ns = samples.median_offset_ns(0, n_tenth);
    const std::int64_t last_ns = samples.median_offset_ns(n - n_tenth, n);
    const std::int64_t change_ns = std::abs(last_ns - first_ns);
    const bool is_last_larger = std::abs(last_ns) > std::abs(first_ns);
    // If the larger offset is not a delay, already a small change is a drift.
    const bool has_other_clock =
        is_last_larger ? samples.are_ahead(n - n_tenth, n) : samples.are_ahead(0, n_tenth);
    // At an even drift, the median of all messages is the mean of first and last. If
    // messages are late for a while, it is near one of them. Limit:
    // |median - (first + last) / 2| < change / 4.
    const bool is_even = 2 * std::abs(2 * median_ns - first_ns - last_ns) < change_ns;
    const bool is_drift =
        has_other_clock ? change_ns >= kMinDrift_ns : is_even && change_ns >= kLeastOffset_ns;
    if (!is_drift) return {};
    return {.offset_ns = is_last_larger ? last_ns : first_ns, .drift_ns = last_ns - first_ns};
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
    const auto after = std::ranges::lower_bound(messages, log_ns, {}, &MessageTimes::log_ns);
    if (after == messages.begin()) return messages.empty() ? nullptr : &*after;
    const auto before = std::prev(after);
    const bool is_before_nearer = after == messages.end() || log_ns - before->log_ns < after->log_ns - log_ns;
    return is_before_nearer ? &*before : &*after;
}

ClockOffset estimate_offset(const std::vector<MessageTimes>& messages, std::vector<MessageTimes> reference) {
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    OffsetSamples samples = pair_messages(messages, reference);
    const std::size_t n = samples.size();
    if (n < kMinMessages) return {};
    const auto duration_ns = [&](std::int64_t MessageTimes::*time) {
        return std::abs(double(messages.back().*time) - double(messages.front().*time));
    };
    // Recording times from a conversion pass too fast. They do not show delays.
    const bool is_converted =
        duration_ns(&MessageTimes::log_ns) < kLeastPace * duration_ns(&MessageTimes::stamp_ns);
    if (is_converted) return {};
    const std::int64_t median_ns = samples.median_offset_ns(0, n);
    if (std::abs(median_ns) > kMostOffset_ns) return {};
    const bool are_ahead = samples.are_ahead(0, n);
    ClockOffset clock = find_drift(samples);

    // An offset is used only if it is steady: its middle 80 % are close together.
    std::ranges::sort(samples.offset_ns);
    const double spread_ns = double(samples.offset_ns[n - 1 - n / 10]) - double(samples.offset_ns[n / 10]);
    const double max_spread_ns =
        std::clamp(0.1 * std::abs(double(median_ns)), kLeastSpread_ns, kMostSpread_ns);
    // No delay makes messages ahead of the recorder, so a smaller offset is enough then.
    const bool is_large = std::abs(median_ns) >= (are_ahead ? kMaxAhead_ns : kLeastOffset_ns);
    // Replaces the offset at an end, from find_drift(), by the median if it is steady.
    if (spread_ns <= max_spread_ns && is_large)
        clock = {.offset_ns = round_offset(median_ns),
                 .drift_ns = clock.drift_ns,
                 .is_clear = std::abs(median_ns) >= kClear_ns};
    else if (clock.drift_ns == 0) return {};
    // Equal time stamps show one clock, so a drift is a growing delay, unless messages
    // are ahead of the recorder. Any other offset is uncertain.
    if (share_stamps(messages, reference, clock.offset_ns)) {
        if (clock.drift_ns != 0 && !are_ahead) return {};
        clock.is_clear = false;
    }
    return clock;
}

std::string fix_clock_jumps(std::vector<CloudEntry>& clouds, LogClock clock,
                            std::vector<MessageTimes> reference) {
    if (clouds.size() <= kLeastRun) return "";
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    const auto median_period_ns = [&](LogClock any_clock) {
        return median_of(1, clouds.size(), [&](std::size_t i) {
            return clouds[i].time_ns(any_clock) - clouds[i - 1].time_ns(any_clock);
        });
    };
    const std::int64_t period_ns = median_period_ns(clock);
    // Recording times of a conversion do not have the period of the measurements.
    const bool can_use_log = clock == LogClock::stamps && period_ns > 0 &&
                             std::abs(median_period_ns(LogClock::recorder) - period_ns) < period_ns / 4;
    std::vector<ClockRun> runs = split_at_jumps(clouds, clock, period_ns, can_use_log);
    measure_runs(runs, clouds, clock, reference, can_use_log);
    // The other runs are moved to the clock of the main run: the longest run on the clock
    // of the reference, or if there is none, the longest of all.
    const ClockRun main = *std::ranges::max_element(runs, {}, [](const ClockRun& run) {
        return std::pair(std::abs(run.ahead_ns) <= kMinJump_ns && run.size() >= kLeastRun, run.size());
    });
    if (main.size() < kLeastRun) return "";

    std::vector<CloudEntry> kept;
    std::size_t n_moved = 0;
    std::int64_t moved_ns = 0, left_out_ns = 0;  // of one run, as an example for the user
    for (const ClockRun& run : runs) {
        const std::int64_t ahead_ns = run.ahead_ns - main.ahead_ns;
        const bool is_other_clock = std::abs(ahead_ns) > kMinJump_ns;
        // Neither run is ahead of the recorder, so a delay can explain the difference.
        const bool may_be_late = std::max(run.ahead_recorder_ns, main.ahead_recorder_ns) <= kMaxAhead_ns &&
                                 std::abs(ahead_ns) < kMostDelay_ns;
        if (is_other_clock && run.size() < kLeastRun && !may_be_late) {
            left_out_ns = ahead_ns;
            continue;
        }
        kept.insert(kept.end(), clouds.begin() + std::ptrdiff_t(run.begin),
                    clouds.begin() + std::ptrdiff_t(run.end));
        if (!is_other_clock || !can_use_log || may_be_late) continue;
        // The nearest clouds of both runs are k periods apart: moved = step - k period.
        // This is more precise than `ahead_ns`, from which only k is rounded.
        const bool is_before = run.begin < main.begin;
        const std::int64_t step_ns = clouds[is_before ? run.end - 1 : run.begin].stamp_ns -
                                     clouds[is_before ? main.begin : main.end - 1].stamp_ns;
        moved_ns = step_ns - period_ns * std::llround(double(step_ns - ahead_ns) / double(period_ns));
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
            clouds.size() - kept.size(), 1e-9 * double(std::abs(left_out_ns)));
    if (n_moved > 0)
        text += fmt::format(
            "{}the clock of the time stamps jumps, for example by {:.3f} s; the times of {} clouds are "
            "corrected",
            text.empty() ? "" : "; ", 1e-9 * double(std::abs(moved_ns)), n_moved);
    clouds = std::move(kept);
    return text;
}

}  // namespace relidar::bag
