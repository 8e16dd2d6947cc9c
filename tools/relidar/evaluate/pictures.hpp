// SPDX-License-Identifier: Apache-2.0
// Draws range images for the report. Each picture shows the real image, the rendered
// image and their difference.
#pragma once

#include <string>
#include <vector>

#include <relidar/base/images.hpp>
#include <relidar/score/report.hpp>

namespace relidar {
struct EvaluationResult;
struct RayTable;
struct ScoredFrame;
}  // namespace relidar

namespace relidar::cli {

/// Draws three figures of a frame: range, intensity and ray-drop. Each figure shows the
/// real image, the rendered image and the error. If the log has no intensities, that
/// figure is left out.
/// @param title text before the name of each figure
/// @param real_caption caption of the real images
std::vector<ReportFigure> make_comparison_figures(const ScoredFrame& frame, const std::string& title,
                                                  const std::string& real_caption, double max_range_m);

/// Writes pictures of a frame as FOLDER/{range,intensity,drop}_000123.png. Each picture
/// shows the real image, the rendered image and the error, from top to bottom. If the log
/// has no intensities, that picture is left out.
void write_comparison_pictures(const std::filesystem::path& folder, const ScoredFrame& frame,
                               double max_range_m);

/// Draws the real range image above the rendered range image.
Image draw_stacked_real_and_rendered_range(const ScoredFrame& frame, double max_range_m);

/// Draws the ray pattern of a sensor. Each ray is a dot whose colour shows its firing
/// time. Azimuth increases to the right as seen from the sensor, and elevation increases
/// upwards. If the sensor covers all azimuths, the picture shows only the 40 degrees
/// ahead.
Image draw_rays_as_coloured_dots(const RayTable& rays);

}  // namespace relidar::cli
