// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include <relidar/score/report.hpp>

namespace relidar {
class Device;
struct Evaluation;
struct Run;
}  // namespace relidar

namespace relidar::cli {

/// A walking actor in eight successive frames, seen from its right side.
/// @param run run whose log is loaded with all scans
/// @return no value if no walking actor is visible in eight frames
std::optional<ReportFigure> draw_walker(Device& device, const Run& run);

/// The three actors with the worst scores, as the sensor sees them in held-out frames.
/// Actors with fewer than 20 real points per frame are left out.
/// @param run run whose log is loaded with the scans of the held-out frames
std::vector<ReportFigure> draw_worst_actors(Device& device, const Run& run, const Evaluation& result);

/// Writes pictures of the 20 actors with the worst scores, as FOLDER/actor_TRACK.png.
/// Actors with few points are left out.
void write_worst_actors(const std::filesystem::path& folder, Device& device, const Run& run,
                        const Evaluation& result);

}  // namespace relidar::cli
