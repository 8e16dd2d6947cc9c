// SPDX-License-Identifier: Apache-2.0
// Draws a walking person in successive frames. The upper row shows the real points. The
// lower row shows the simulated points.
#pragma once

#include <optional>

#include <relidar/score/report.hpp>

namespace relidar {
class Device;
struct Run;
}  // namespace relidar

namespace relidar::cli {

/// Draws a walking actor in eight successive frames, seen from its right side. Chooses
/// the actor with the most points in the log.
/// @param run run whose log is loaded with all scans
/// @return no value if no walking actor is visible in eight frames
std::optional<ReportFigure> draw_walking_strip(Device& device, const Run& run);

}  // namespace relidar::cli
