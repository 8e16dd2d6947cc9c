// SPDX-License-Identifier: Apache-2.0
// Creates notes about a recording: one line per topic, and lines about problems such as
// missing sweeps.
#pragma once

#include <string>
#include <vector>

#include "log/readers/bag/choose.hpp"

namespace relidar::bag {

/// Returns one line per topic. The line has name, type, number of messages, rate, and
/// whether the topic is used. For clouds it also has the frame and the fields.
/// @param used  [topics] true if the topic is loaded
std::vector<std::string> topic_lines(const Bag& bag, const Survey& survey, const std::vector<bool>& used);

/// Describes times at which sweeps are missing: steps between sweeps that are much longer
/// than usual. Returns an empty string if there are no such steps.
std::string gaps_text(const std::vector<double>& times_s, double step_s);
/// Describes jumps of the message stamps relative to the recording times, and stamps that
/// decrease. Returns an empty string if there are none.
std::string jumps_text(const CloudTopic& clouds);

}  // namespace relidar::bag
