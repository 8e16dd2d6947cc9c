// SPDX-License-Identifier: Apache-2.0
// Clocks of the time stamps: offsets between two kinds of messages, and jumps. The times
// of recording, which come from one clock, show both.
#include "read/bag/choose.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <iterator>
#include <optional>
#include <ranges>
#include <set>
#include <span>

#include <fmt/format.h>

#include "base/median.hpp"

namespace relidar::bag {
namespace {

constexpr std::int64_t kNsPerMs = 1000000, kSecond_ns = 1000 * kNsPerMs, kDay_ns = 86400 * kSecond_ns;
// Smaller offsets may be delays. Offsets below kClear_ns may be delays of slow programs.
constexpr std::int64_t kLeastOffset_ns = 750 * kNsPerMs, kClear_ns = 2 * kSecond_ns;
// Messages ahead of the recorder by more than this have another clock.
constexpr std::int64_t kMaxAhead_ns = 150 * kNsPerMs, kMinDrift_ns = 200 * kNsPerMs;
// Larger offsets are damaged times. A clock that starts at 0 is about 1.8e9 s behind.
constexpr std::int64_t kMostOffset_ns = 2400000000 * kSecond_ns;
// Two messages are compared if they were recorded within this time of each other.
constexpr std::int64_t kMaxRecordingGap_ns = kSecond_ns;
// An offset is steady if 80 % of its measurements are within 10 % of the offset, but at
// least and at most these values.
constexpr double kLeastSpread_ns = 5e8, kMostSpread_ns = 5e9;
// Recording times that pass much faster than the time stamps come from a conversion.
constexpr double kLeastPace = 0.5;
constexpr std::size_t kMinMessages = 3;  // from which an offset is estimated
constexpr std::int64_t kMinJump_ns = 500 * kNsPerMs;
constexpr std::int64_t kMostDelay_ns = 10 * kSecond_ns;  // of a message
constexpr std::size_t kLeastRun = 3;                     // fewer clouds between two jumps have damaged times

/// Returns the median of a value over all elements of a range.
template <class Range, class Value>
std::int64_t median_of(const Range& range, const Value& value) {
    std::vector<std::int64_t> values;
    for (const auto& element : range) values.push_back(std::invoke(value, element));
    return compute_median(std::move(values));
}

/// Returns the message that was recorded nearest to a time, or null if there is none.
/// @param messages  in the order of their recording times
const MessageTimes* find_nearest(const std::vector<MessageTimes>& messages, std::int64_t log_ns) {
    const auto after = std::ranges::lower_bound(messages, log_ns, {}, &MessageTimes::log_ns);
    if (after == messages.begin()) return messages.empty() ? nullptr : &*after;
    const auto before = std::prev(after);
    const bool is_before_nearer = after == messages.end() || log_ns - before->log_ns < after->log_ns - log_ns;
    return is_before_nearer ? &*before : &*after;
}

/// Returns the known difference between clocks (leap seconds since 1999, or a time zone)
/// that causes a measured offset, or the measured offset if there is none. The offset is
/// the difference minus the delay by which a cloud is recorded later than a pose.
std::int64_t round_offset(std::int64_t measured_ns) {
    constexpr std::int64_t kMinDelay_ns = -50 * kNsPerMs, kUsualDelay_ns = 100 * kNsPerMs,
                           kMaxDelay_ns = 250 * kNsPerMs;
    const std::int64_t difference_s = std::llround(1e-9 * double(measured_ns + kUsualDelay_ns));
    const std::int64_t delay_ns = difference_s * kSecond_ns - measured_ns;
    const auto is_between = [n = std::abs(difference_s)](int least, int most) {
        return n >= least && n <= most;
    };
    // GPS minus UTC is 13 s (1999) to 18 s; TAI minus GPS is 19 s; TAI minus UTC is their
    // sum. Time zones are whole quarters of an hour. So is 0, which means one clock.
    const bool are_leap_seconds = is_between(13, 19) || is_between(32, 37);
    const bool is_time_zone = difference_s % 900 == 0;
    const bool is_possible_delay = delay_ns >= kMinDelay_ns && delay_ns <= kMaxDelay_ns;
    return (are_leap_seconds || is_time_zone) && is_possible_delay ? difference_s * kSecond_ns : measured_ns;
}

/// Returns true if messages and reference have one clock, because most messages have the
/// time stamp of a reference message, such as poses that were computed from clouds. Then
/// fewer stamps are equal after the measured offset, a delay, is subtracted. If as many
/// or more are equal, the offset is the difference of two clocks.
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

/// Clouds between two jumps of the clock.
struct ClockRun {
    std::span<const CloudEntry> clouds;
    std::int64_t ahead_recorder_ns = 0;  ///< median time by which the clouds are ahead of the recorder
    /// the same, minus that of the reference messages that were recorded at these times
    std::int64_t ahead_ns = 0;
};

/// Splits the clouds where their times jump relative to the recording times.
/// @param period_ns  usual time between clouds
/// @param can_use_log  false: the recording times come from a conversion, so that only
/// steps of a day are jumps
std::vector<ClockRun> split_at_jumps(std::span<const CloudEntry> clouds, LogClock clock,
                                     std::int64_t period_ns, bool can_use_log) {
    const auto is_jump = [&](const CloudEntry& before, const CloudEntry& cloud) {
        const std::int64_t step_ns = cloud.time_ns(clock) - before.time_ns(clock);
        const std::int64_t log_step_ns = cloud.log_ns - before.log_ns;
        if (!can_use_log) return std::abs(step_ns) >= kDay_ns;
        if (std::abs(step_ns - log_step_ns) < kMinJump_ns) return false;
        // The steps differ, so the time stamps jump or a message was recorded late. In
        // the second case, the time stamps have the more usual step. They then only
        // decrease if the recording times decrease too.
        const bool is_stamp_regular = std::abs(step_ns - period_ns) <= std::abs(log_step_ns - period_ns);
        const bool is_order_plausible = step_ns > 0 || log_step_ns < 0;
        return !(is_stamp_regular && is_order_plausible);
    };
    std::vector<ClockRun> runs;
    std::size_t begin = 0;
    for (std::size_t i = 1; i <= clouds.size(); ++i) {
        if (i < clouds.size() && !is_jump(clouds[i - 1], clouds[i])) continue;
        runs.push_back({clouds.subspan(begin, i - begin)});
        begin = i;
    }
    return runs;
}

/// Sets by how much the clouds of each run are ahead of the recorder (median of time
/// stamp minus recording time), and by how much more than the messages of the reference
/// that were recorded at the same time.
/// @param can_use_log  false: the recording times come from a conversion, so that both
/// values are the median time stamp
void measure_runs(std::vector<ClockRun>& runs, LogClock clock, const std::vector<MessageTimes>& reference,
                  bool can_use_log) {
    const auto time_ns = [&](const CloudEntry& cloud) { return cloud.time_ns(clock); };
    const auto ahead_recorder_ns = [&](const CloudEntry& cloud) { return time_ns(cloud) - cloud.log_ns; };
    const auto ahead_ns = [&](const CloudEntry& cloud) {
        const MessageTimes* near = find_nearest(reference, cloud.log_ns);
        const std::int64_t reference_ahead_ns = near ? near->stamp_ns - near->log_ns : 0;
        return ahead_recorder_ns(cloud) - reference_ahead_ns;
    };
    for (ClockRun& run : runs) {
        run.ahead_recorder_ns =
            can_use_log ? median_of(run.clouds, ahead_recorder_ns) : median_of(run.clouds, time_ns);
        run.ahead_ns = can_use_log ? median_of(run.clouds, ahead_ns) : run.ahead_recorder_ns;
    }
}

/// Returns by how much the clock of a run is ahead of the clock of the main run. The
/// nearest clouds of both runs are k periods apart, so their step is this time plus k
/// periods. This is more precise than `ahead_ns`, which is only used to find k.
std::int64_t measure_jump_ns(const ClockRun& run, const ClockRun& main, std::int64_t period_ns) {
    const bool is_before = run.clouds.data() < main.clouds.data();
    const std::int64_t step_ns = is_before ? run.clouds.back().stamp_ns - main.clouds.front().stamp_ns
                                           : run.clouds.front().stamp_ns - main.clouds.back().stamp_ns;
    const std::int64_t ahead_ns = run.ahead_ns - main.ahead_ns;
    return step_ns - period_ns * std::llround(double(step_ns - ahead_ns) / double(period_ns));
}

/// Corrects the time stamp of a cloud and its parts.
void correct_stamp(CloudEntry& cloud, std::int64_t ahead_ns) {
    cloud.stamp_ns -= ahead_ns;
    cloud.correction_ns = ahead_ns;
    for (CloudEntry& part : cloud.parts) correct_stamp(part, ahead_ns);
}

/// A message and the reference message that was recorded nearest to it. A message is
/// ahead of the recorder by its time stamp minus its recording time. On the clock of the
/// recorder, this is minus the delay of the message.
struct OffsetSample {
    std::int64_t ahead_ns, reference_ahead_ns;

    std::int64_t offset_ns() const { return ahead_ns - reference_ahead_ns; }
};
using OffsetSamples = std::span<const OffsetSample>;

std::int64_t median_offset_ns(OffsetSamples samples) { return median_of(samples, &OffsetSample::offset_ns); }

/// Returns true if the messages are ahead of the recorder, but the reference is not. Then
/// the messages have another clock, because no delay explains this.
bool are_ahead(OffsetSamples samples) {
    return median_of(samples, &OffsetSample::ahead_ns) > kMaxAhead_ns &&
           median_of(samples, &OffsetSample::reference_ahead_ns) < kMaxAhead_ns / 3;
}

/// Pairs messages by their recording times.
/// @param reference  sorted by recording time
std::vector<OffsetSample> pair_messages(const std::vector<MessageTimes>& messages,
                                        const std::vector<MessageTimes>& reference) {
    std::vector<OffsetSample> samples;
    for (const MessageTimes& message : messages) {
        const MessageTimes* near = find_nearest(reference, message.log_ns);
        if (!near || std::abs(near->log_ns - message.log_ns) > kMaxRecordingGap_ns) continue;
        samples.push_back({message.stamp_ns - message.log_ns, near->stamp_ns - near->log_ns});
    }
    return samples;
}

/// Returns true if recording times pass much faster than time stamps. They come from a
/// conversion and do not show delays.
bool is_converted(const std::vector<MessageTimes>& messages) {
    const auto duration_ns = [&](std::int64_t MessageTimes::*time) {
        return std::abs(double(messages.back().*time) - double(messages.front().*time));
    };
    return duration_ns(&MessageTimes::log_ns) < kLeastPace * duration_ns(&MessageTimes::stamp_ns);
}

/// Returns the drift of a clock: the median offset of the last tenth of the messages
/// minus that of the first tenth, and the larger of these two offsets. Returns 0 if the
/// change is small, or if messages that are late for a while can explain it.
/// @param samples  in the order of recording
ClockOffset find_drift(OffsetSamples samples) {
    const std::size_t n_tenth = samples.size() / 10;
    if (n_tenth < kMinMessages) return {};
    const OffsetSamples begin = samples.first(n_tenth), end = samples.last(n_tenth);
    const std::int64_t first_ns = median_offset_ns(begin), last_ns = median_offset_ns(end);
    const bool is_last_larger = std::abs(last_ns) > std::abs(first_ns);
    const ClockOffset drift{.offset_ns = is_last_larger ? last_ns : first_ns, .drift_ns = last_ns - first_ns};
    const std::int64_t change_ns = std::abs(drift.drift_ns);
    // Messages ahead of the recorder are not late, so already a small change is a drift.
    if (are_ahead(is_last_larger ? end : begin)) return change_ns >= kMinDrift_ns ? drift : ClockOffset{};
    // At an even drift, the median of all messages is the mean of first and last: it
    // differs by less than a quarter of the change. If messages are late, it is near one.
    const std::int64_t twice_difference_ns = std::abs(2 * median_offset_ns(samples) - first_ns - last_ns);
    const bool is_even = 2 * twice_difference_ns < change_ns;
    return is_even && change_ns >= kLeastOffset_ns ? drift : ClockOffset{};
}

/// Returns the median offset if it is large and steady, which means that the middle 80 %
/// of the offsets are close together.
std::optional<ClockOffset> find_steady_offset(OffsetSamples samples) {
    std::vector<std::int64_t> offsets_ns;
    for (const OffsetSample& sample : samples) offsets_ns.push_back(sample.offset_ns());
    std::ranges::sort(offsets_ns);
    const std::size_t n = samples.size();
    const std::int64_t median_ns = offsets_ns[n / 2], size_ns = std::abs(median_ns);
    const double spread_ns = double(offsets_ns[n - 1 - n / 10]) - double(offsets_ns[n / 10]);
    const double max_spread_ns = std::clamp(0.1 * double(size_ns), kLeastSpread_ns, kMostSpread_ns);
    // No delay makes messages ahead of the recorder, so a smaller offset is enough then.
    const std::int64_t min_size_ns = are_ahead(samples) ? kMaxAhead_ns : kLeastOffset_ns;
    if (spread_ns > max_spread_ns || size_ns < min_size_ns) return std::nullopt;
    return ClockOffset{.offset_ns = round_offset(median_ns), .is_clear = size_ns >= kClear_ns};
}

}  // namespace

std::string ClockOffset::describe(const std::string& reference_name) const {
    const char* cause =
        offset_ns % kSecond_ns == 0 ? "" : " (accurate to the delays of messages, about 0.1 s)";
    // Clocks without leap seconds differ from UTC or each other by these constants.
    if (std::abs(offset_ns) == 37 * kSecond_ns) cause = " (TAI minus UTC is 37 s)";
    if (std::abs(offset_ns) == 18 * kSecond_ns) cause = " (GPS time minus UTC is 18 s)";
    if (std::abs(offset_ns) == 19 * kSecond_ns) cause = " (TAI minus GPS time is 19 s)";
    const std::string drift = drift_ns == 0 ? ""
                                            : fmt::format(" (this changes by {:.3f} s during the recording)",
                                                          1e-9 * double(std::abs(drift_ns)));
    return fmt::format("{:.3f} s {} {}{}{}", 1e-9 * double(std::abs(offset_ns)),
                       offset_ns > 0 ? "ahead of" : "behind", reference_name, cause, drift);
}

ClockOffset estimate_offset(const std::vector<MessageTimes>& messages, std::vector<MessageTimes> reference) {
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    const std::vector<OffsetSample> samples = pair_messages(messages, reference);
    if (samples.size() < kMinMessages || is_converted(messages)) return {};
    if (std::abs(median_offset_ns(samples)) > kMostOffset_ns) return {};
    ClockOffset offset = find_drift(samples);
    const bool has_drift = offset.drift_ns != 0;
    const std::optional<ClockOffset> steady = find_steady_offset(samples);
    if (!steady && !has_drift) return {};
    if (steady) {
        offset.offset_ns = steady->offset_ns;
        offset.is_clear = steady->is_clear;
    }
    if (!share_stamps(messages, reference, offset.offset_ns)) return offset;
    // Equal time stamps show one clock, so a drift is a growing delay, unless messages
    // are ahead of the recorder. Any other offset is uncertain.
    if (has_drift && !are_ahead(samples)) return {};
    offset.is_clear = false;
    return offset;
}

std::string fix_clock_jumps(std::vector<CloudEntry>& clouds, LogClock clock,
                            std::vector<MessageTimes> reference) {
    if (clouds.size() <= kLeastRun) return "";
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    const auto median_period_ns = [&](LogClock any_clock) {
        return median_of(std::views::iota(std::size_t(1), clouds.size()), [&](std::size_t i) {
            return clouds[i].time_ns(any_clock) - clouds[i - 1].time_ns(any_clock);
        });
    };
    const std::int64_t period_ns = median_period_ns(clock);
    // Recording times of a conversion do not have the period of the measurements.
    const bool can_use_log = clock == LogClock::stamps && period_ns > 0 &&
                             std::abs(median_period_ns(LogClock::recorder) - period_ns) < period_ns / 4;
    std::vector<ClockRun> runs = split_at_jumps(clouds, clock, period_ns, can_use_log);
    measure_runs(runs, clock, reference, can_use_log);
    // The other runs are moved to the clock of the main run: the longest run on the clock
    // of the reference, or if there is none, the longest of all.
    const ClockRun& main = *std::ranges::max_element(runs, {}, [](const ClockRun& run) {
        const bool has_right_clock = std::abs(run.ahead_ns) <= kMinJump_ns && run.clouds.size() >= kLeastRun;
        return std::pair(has_right_clock, run.clouds.size());
    });
    if (main.clouds.size() < kLeastRun) return "";

    std::vector<CloudEntry> kept;
    std::size_t n_moved = 0;
    std::int64_t moved_ns = 0, left_out_ns = 0;  // of one run, as an example for the user
    for (const ClockRun& run : runs) {
        const std::int64_t ahead_ns = run.ahead_ns - main.ahead_ns;
        // Neither run is ahead of the recorder, so a delay can explain the difference.
        const bool may_be_late = std::max(run.ahead_recorder_ns, main.ahead_recorder_ns) <= kMaxAhead_ns &&
                                 std::abs(ahead_ns) < kMostDelay_ns;
        const bool has_main_clock = std::abs(ahead_ns) <= kMinJump_ns || may_be_late;
        if (!has_main_clock && run.clouds.size() < kLeastRun) {
            left_out_ns = ahead_ns;
            continue;
        }
        const auto first = kept.insert(kept.end(), run.clouds.begin(), run.clouds.end());
        if (has_main_clock || !can_use_log) continue;
        moved_ns = measure_jump_ns(run, main, period_ns);
        n_moved += run.clouds.size();
        std::for_each(first, kept.end(), [&](CloudEntry& cloud) { correct_stamp(cloud, moved_ns); });
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
