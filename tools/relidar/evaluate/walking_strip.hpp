// SPDX-License-Identifier: Apache-2.0
// Draws a walking person in successive frames, with the real points above the simulated
// points.
#pragma once

#include <optional>

#include <relidar/score/report.hpp>

namespace relidar {
class Device;
struct Run;
}  // namespace relidar

namespace relidar::cli {

/// Draws eight successive frames of a walking actor, seen from its right side. Chooses
/// the actor that the log has the most points of.
/// @param run its sequence must hold the scans
/// @return no value if no actor walks or none is visible for eight frames
std::optional<ReportFigure> walking_strip(Device& device, const Run& run);

}  // namespace relidar::cli
