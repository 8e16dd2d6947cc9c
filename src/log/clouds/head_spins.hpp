// SPDX-License-Identifier: Apache-2.0
// Whether points are those of a spinning head, or of a LiDAR that scans a window or draws
// petals.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Why points cannot be of a spinning head, in words; empty where they may be. Rings of
/// one have an elevation each; where it sees a part of the turn alone, it takes the time
/// of a turn for a turn all the same.
/// @param scans  a few, with rings @param fitted  to them @param step_s  from scan to
/// scan
std::string why_no_head(const std::vector<Points>& scans, const SpinningSensor& fitted, double step_s);

}  // namespace relidar
