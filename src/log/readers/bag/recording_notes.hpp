// SPDX-License-Identifier: Apache-2.0
// Creates notes about a recording for the user: one line per topic, and lines about
// problems such as missing sweeps.
#pragma once

#include <string>
#include <vector>

#include "log/readers/bag/choose.hpp"

namespace relidar::bag {

/// Returns one line per topic: name, type, number of messages, rate, and whether the
/// topic is loaded. For clouds, the line also contains the frame and the fields.
/// @param is_topic_used  [topics] true if the topic is loaded
std::vector<std::string> format_line_per_topic(const BagRecording& bag, const BagIndex& bag_index,
                                               const std::vector<bool>& is_topic_used);

/// Describes missing sweeps, which cause time steps that are much longer than usual.
/// Returns an empty string if no sweep is missing.
std::string describe_missing_sweeps(const std::vector<double>& sweep_times_s, double sweep_period_s);
/// Describes clouds that have another frame than the first cloud of the topic. Returns an
/// empty string if all have the same frame.
std::string describe_clouds_with_differing_frame_id(const CloudTopic& cloud_topic);
/// Describes time stamps that decrease, or that jump relative to the recording times.
/// Returns an empty string if there are none.
std::string describe_time_jumps(const CloudTopic& cloud_topic);

}  // namespace relidar::bag
