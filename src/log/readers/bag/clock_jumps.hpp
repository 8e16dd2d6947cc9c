// SPDX-License-Identifier: Apache-2.0
// Finds clouds whose times are wrong because the clock of the LiDAR was set during the
// recording, or because a single time is damaged.
#pragma once

#include <string>
#include <vector>

#include "log/readers/bag/clock_offset.hpp"
#include "log/readers/bag/survey.hpp"

namespace relidar::bag {

/// Removes clouds whose times differ from those of their neighbours on both sides. If the
/// clock of the time stamps jumps, sets all clouds to the clock of the reference, or else
/// to the clock of most clouds. Ignores messages that may only be late.
/// @param reference  messages on the right clock, for example the poses. If their clock
/// jumps at the same time, nothing is corrected. May be empty
/// @return text about the changes, or an empty text
std::string correct_clock_jumps(std::vector<CloudIndexEntry>& clouds, LogClock clock,
                                std::vector<MessageTimes> reference);

}  // namespace relidar::bag
