// SPDX-License-Identifier: Apache-2.0
// Checks whether points come from a spinning head, or from a LiDAR that scans a window or
// a rosette.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Returns the reason why points cannot come from a spinning head, or an empty string if
/// they can. Each ring of a spinning head has one elevation. A head with a limited view
/// still needs the time of a full revolution.
/// @param scans  some scans, with rings
/// @param fitted  sensor that was fitted to them
/// @param step_s  time between scans
std::string why_no_head(const std::vector<Points>& scans, const SpinningSensor& fitted, double step_s);

}  // namespace relidar
