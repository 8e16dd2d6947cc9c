// SPDX-License-Identifier: Apache-2.0
// Draws a walking person in successive frames. The upper row shows the real points, the
// lower row the simulated points.
#pragma once

#include <optional>

#include <relidar/score/report.hpp>

namespace relidar {
class Device;
struct Run;
}  // namespace relidar

namespace relidar::cli {

/// Draws eight successive frames of a walking actor, seen from the actor's right side.
/// Chooses the actor with the most points in the log.
/// @param run its sequence must hold the scans
/// @return no value if no walking actor is visible for eight frames
std::optional<ReportFigure> walking_strip(Device& device, const Run& run);

}  // namespace relidar::cli
