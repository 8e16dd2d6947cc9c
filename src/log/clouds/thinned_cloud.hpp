// SPDX-License-Identifier: Apache-2.0
// Recognises clouds from which a program has removed points. Their missing points are not
// dropped rays.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Returns the reason why points seem to come from a thinned cloud, or an empty string if
/// they do not. Neighbouring points of a complete ring mostly have the same azimuth step.
/// @param scans  some scans with rings, which may have been estimated
/// @param fitted  sensor that was fitted to these scans
std::string why_thinned(const std::vector<Points>& scans, const SpinningSensor& fitted);

}  // namespace relidar
