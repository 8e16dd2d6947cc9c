// SPDX-License-Identifier: Apache-2.0
// What a recording holds, in words: a line a topic, and what went wrong while it was
// recorded.
#pragma once

#include <string>
#include <vector>

#include "log/readers/bag/choose.hpp"

namespace relidar::bag {

/// A line each: name, type, messages, rate; of clouds frame and fields; whether it is
/// used. @param used  [topics]
std::vector<std::string> topic_lines(const Bag& bag, const Survey& survey, const std::vector<bool>& used);

/// Steps between sweeps that are much longer than usual, in words; empty where none is.
std::string gaps_text(const std::vector<double>& times_s, double step_s);
/// Jumps of the stamps against the recorder's clock, and stamps that fall, likewise.
std::string jumps_text(const CloudTopic& clouds);

}  // namespace relidar::bag
