// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include <relidar/score/report.hpp>

namespace relidar {
class Device;
struct EvaluationResult;
struct TrainedRun;
}  // namespace relidar

namespace relidar::cli {

/// Draws a walking actor in eight successive frames, seen from its right side. Chooses
/// the actor with the most points in the log.
/// @param run run whose log is loaded with all scans
/// @return no value if no walking actor is visible in eight frames
std::optional<ReportFigure> draw_walking_actor_figure(Device& device, const TrainedRun& run);

/// Draws the three actors with the worst scores in held-out frames, as the sensor sees
/// them: the real points, the simulated points, and the distance of each simulated point
/// from the nearest real point. Actors with fewer than 20 real points per frame are left
/// out.
/// @param run run whose log is loaded with the scans of the held-out frames
std::vector<ReportFigure> draw_worst_actor_figures(Device& device, const TrainedRun& run,
                                                   const EvaluationResult& evaluation);

/// Writes the figures of draw_worst_actor_figures() for at most 20 actors as
/// FOLDER/actor_TRACK.png.
void write_worst_actor_pictures(const std::filesystem::path& folder, Device& device, const TrainedRun& run,
                                const EvaluationResult& evaluation);

}  // namespace relidar::cli
