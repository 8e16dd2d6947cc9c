// SPDX-License-Identifier: Apache-2.0
// Detects clouds from which a program has removed points. The removed points must not be
// treated as dropped rays.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Tests whether a program has removed points from the scans. Returns the reason, or an
/// empty string for complete scans. In a complete ring, most azimuth steps between
/// neighbouring points are equal.
/// @param scans  some scans with rings; the rings may have been estimated
/// @param fitted  sensor that was fitted to these scans
std::string explain_thinning(const std::vector<Points>& scans, const SpinningSensor& fitted);

}  // namespace relidar
