// SPDX-License-Identifier: Apache-2.0
// Describes the content of a recording: one line per topic, and problems during the
// recording.
#pragma once

#include <string>
#include <vector>

#include "log/readers/bag/choose.hpp"

namespace relidar::bag {

/// Returns one line per topic: name, type, number of messages, rate; for clouds also
/// frame and fields; and whether the topic is used.
/// @param used  [topics]
std::vector<std::string> topic_lines(const Bag& bag, const Survey& survey, const std::vector<bool>& used);

/// Describes steps between sweeps that are much longer than usual. Returns an empty
/// string if there are none.
std::string gaps_text(const std::vector<double>& times_s, double step_s);
/// Describes jumps of the stamps relative to the recorder's clock, and stamps that
/// decrease. Returns an empty string if there are none.
std::string jumps_text(const CloudTopic& clouds);

}  // namespace relidar::bag
