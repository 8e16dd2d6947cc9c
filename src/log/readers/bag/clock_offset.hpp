// SPDX-License-Identifier: Apache-2.0
// Finds messages whose time stamps come from another clock, for example TAI or GPS time
// instead of UTC. The times of recording, which come from one clock, show the offset.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace relidar::bag {

/// Time stamp and recording time of a message.
struct MessageTimes {
    std::int64_t stamp_ns = 0, log_ns = 0;
};

/// Returns the times of entries that have `stamp_ns` and `log_ns`. Ignores entries
/// without a time stamp.
template <class Entries>
std::vector<MessageTimes> list_message_times(const Entries& entries) {
    std::vector<MessageTimes> times;
    for (const auto& entry : entries)
        if (entry.stamp_ns != 0) times.push_back({entry.stamp_ns, entry.log_ns});
    return times;
}

/// Returns the message that was recorded nearest to a time, or null if there is none.
/// @param messages  in the order of their recording times
const MessageTimes* find_nearest_recorded(const std::vector<MessageTimes>& messages, std::int64_t log_ns);

struct ClockOffset {
    std::int64_t offset_ns = 0;  ///< 0 if the time stamps may come from one clock
    /// Change of the offset from the begin to the end of the recording. 0 if it is small.
    std::int64_t drift_ns = 0;
    /// True if the offset is certain. Otherwise, late messages are also possible.
    bool is_clear = false;

    /// Returns the offset that corrects time stamps: 0 if the offset is not certain.
    std::int64_t correction_ns() const { return is_clear ? offset_ns : 0; }
    /// Returns the offset with its usual cause, for example "37.000 s ahead of the time
    /// stamps of the poses (TAI minus UTC is 37 s)".
    std::string describe(const std::string& reference_name) const;
};

/// Compares two kinds of messages by their time stamps minus their recording times.
/// Delays of some hundred milliseconds give no offset. Recording times that are unrelated
/// to the time stamps also give none.
/// @return time by which the clock of `messages` is ahead of the clock of `reference`
ClockOffset estimate_clock_offset(const std::vector<MessageTimes>& messages,
                                  std::vector<MessageTimes> reference);

}  // namespace relidar::bag
