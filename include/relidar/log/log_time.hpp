// SPDX-License-Identifier: Apache-2.0
// Relation between the times of a log, which often start at 0, and the time stamps of
// recordings and packets, which count from 1970 and cannot be negative.
#pragma once

#include <cstdint>
#include <limits>
#include <string>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// Returns the sentence of LidarSequence::conventions that contains the date of the log.
/// @param unix_ns  nanoseconds since 1970 at time 0 of the log
/// @param clock  rest of the sentence, for example "on the clock of the recorder"
std::string format_log_start(std::int64_t unix_ns, const std::string& clock);
/// Returns the nanoseconds since 1970 at time 0 of a log, from the sentence of
/// format_log_start(). Returns 0 for a log without a date.
std::int64_t get_log_start_unix_ns(const LidarSequence& sequence);

/// Returns the nanoseconds that are added to times of a log in recordings and packets.
/// All outputs of a run share this value. It is the date of the log. If a stamp would be
/// negative, the smallest sufficient number of whole seconds is added.
/// @param first_s  earliest time that is written, if it can be before the log
std::int64_t compute_time_shift_ns(const LidarSequence& sequence,
                                   double first_s = std::numeric_limits<double>::infinity());
/// Returns a note if time stamps differ from the times and the date of the log. Otherwise
/// returns an empty text.
std::string format_time_shift_note(const LidarSequence& sequence, std::int64_t time_shift_ns);

}  // namespace relidar
