// SPDX-License-Identifier: Apache-2.0
// Relation between the times of a log, which often start at 0, and the time stamps of
// recordings and packets, which count from 1970 and cannot be negative.
#pragma once

#include <cstdint>
#include <limits>
#include <string>

#include <relidar/log/log.hpp>

namespace relidar {

/// Latest date of a log, in the year 2096.
inline constexpr std::int64_t kLatestLogStart_ns = 4'000'000'000'000'000'000;

/// Sets the date of a log, and appends a sentence about it to `conventions`. Dates before
/// 1970 or after kLatestLogStart_ns are only in the sentence.
/// @param unix_ns  nanoseconds since 1970 at time 0 of the log
/// @param clock  rest of the sentence, for example "on the clock of the recorder"
void set_log_start(Log& log, std::int64_t unix_ns, const std::string& clock);

/// Returns the nanoseconds that are added to times of a log in recordings and packets. It
/// is the date of the log. If a stamp would be negative, the smallest sufficient number
/// of whole seconds is added.
/// @param first_s  earliest time that is written; default: the earliest ray of all frames
std::int64_t time_shift_of(const Log& log, double first_s = std::numeric_limits<double>::infinity());
/// Returns a note if time stamps differ from the times and the date of the log. Otherwise
/// returns an empty text.
std::string time_shift_note(const Log& log, std::int64_t time_shift_ns);

}  // namespace relidar
