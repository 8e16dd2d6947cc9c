// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <fmt/format.h>

#include "base/median.hpp"
#include "log/readers/bag/choose.hpp"

namespace relidar::bag {
namespace {

constexpr std::int64_t kJump_ns = 500000000, kDay_ns = 86400000000000;
// A message is not recorded before its time stamp, and delays are shorter than this.
constexpr std::int64_t kMostAhead_ns = 150000000, kMostDelay_ns = 10000000000;
constexpr std::size_t kLeastRun = 3;  // fewer clouds between two jumps have damaged times

/// Clouds [begin, end) between two jumps.
struct ClockRun {
    std::size_t begin = 0, end = 0;
    std::int64_t ahead_ns = 0;     ///< median time by which the clouds are ahead of the reference
    std::int64_t recorder_ns = 0;  ///< median time by which they are ahead of the recorder

    std::size_t size() const { return end - begin; }
};

template <class Function>
std::int64_t compute_median_of(std::size_t begin, std::size_t end, const Function& function) {
    std::vector<std::int64_t> values;
    for (std::size_t i = begin; i < end; ++i) values.push_back(function(i));
    return compute_median(std::move(values));
}

/// Splits the clouds where their times jump. A late message is no jump: its time stamp
/// follows the previous one regularly. Without recording times, only days are jumps.
std::vector<ClockRun> split_at_clock_jumps(const std::vector<CloudIndexEntry>& clouds, LogClock clock,
                                           const std::vector<MessageTimes>& reference, std::int64_t period_ns,
                                           bool has_log) {
    std::vector<ClockRun> runs{{}};
    for (std::size_t i = 1; i < clouds.size(); ++i) {
        const std::int64_t step_ns = clouds[i].get_time_ns(clock) - clouds[i - 1].get_time_ns(clock),
                           log_ns = clouds[i].log_ns - clouds[i - 1].log_ns;
        const bool is_late =
            std::abs(step_ns - period_ns) <= std::abs(log_ns - period_ns) && (step_ns > 0 || log_ns < 0);
        if (has_log ? std::abs(step_ns - log_ns) < kJump_ns || is_late : std::abs(step_ns) < kDay_ns)
            continue;
        runs.back().end = i;
        runs.push_back({i});
    }
    runs.back().end = clouds.size();
    const auto get_recorder_ns = [&](std::size_t i) {
        return clouds[i].get_time_ns(clock) - (has_log ? clouds[i].log_ns : 0);
    };
    for (ClockRun& run : runs) {
        run.recorder_ns = compute_median_of(run.begin, run.end, get_recorder_ns);
        run.ahead_ns = compute_median_of(run.begin, run.end, [&](std::size_t i) {
            const MessageTimes* near = find_nearest_recorded(reference, clouds[i].log_ns);
            return get_recorder_ns(i) - (has_log && near ? near->stamp_ns - near->log_ns : 0);
        });
    }
    return runs;
}

}  // namespace

std::string correct_clock_jumps(std::vector<CloudIndexEntry>& clouds, LogClock clock,
                                std::vector<MessageTimes> reference) {
    if (clouds.size() <= kLeastRun) return "";
    std::ranges::stable_sort(reference, {}, &MessageTimes::log_ns);
    const auto get_period_ns = [&](LogClock of) {
        return compute_median_of(1, clouds.size(), [&](std::size_t i) {
            return clouds[i].get_time_ns(of) - clouds[i - 1].get_time_ns(of);
        });
    };
    const std::int64_t period_ns = get_period_ns(clock);
    // Recording times of a conversion differ from the times of measurement.
    const bool has_log = clock == LogClock::stamps && period_ns > 0 &&
                         std::abs(get_period_ns(LogClock::recorder) - period_ns) < period_ns / 4;
    const std::vector<ClockRun> runs = split_at_clock_jumps(clouds, clock, reference, period_ns, has_log);
    // Prefers clouds on the clock of the reference.
    const ClockRun main = *std::ranges::max_element(runs, {}, [](const ClockRun& run) {
        return std::pair(std::abs(run.ahead_ns) <= kJump_ns && run.size() >= kLeastRun, run.size());
    });
    if (main.size() < kLeastRun) return "";
    std::vector<CloudIndexEntry> kept;
    std::size_t n_moved = 0;
    std::int64_t moved_ns = 0, out_ns = 0;
    for (const ClockRun& run : runs) {
        const std::int64_t about_ns = run.ahead_ns - main.ahead_ns;
        const bool is_other = std::abs(about_ns) > kJump_ns;
        const bool is_unclear = std::max(run.recorder_ns, main.recorder_ns) <= kMostAhead_ns &&
                                std::abs(about_ns) < kMostDelay_ns;
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
            "{} clouds are left out, because their times are far from those of their neighbours, for example "
            "by {:.3f} s",
            clouds.size() - kept.size(), 1e-9 * double(std::abs(out_ns)));
    if (n_moved > 0)
        text += fmt::format(
            "{}the clock of the time stamps jumps, for example by {:.3f} s; the times of {} clouds are "
            "corrected to the clock of the other clouds",
            text.empty() ? "" : "; ", 1e-9 * double(std::abs(moved_ns)), n_moved);
    clouds = std::move(kept);
    return text;
}

}  // namespace relidar::bag
