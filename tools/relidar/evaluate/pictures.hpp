// SPDX-License-Identifier: Apache-2.0
// Draws range images for the report. Each picture shows the real image, the rendered
// image and their difference.
#pragma once

#include <string>
#include <vector>

#include <relidar/base/images.hpp>
#include <relidar/score/report.hpp>

namespace relidar {
struct Evaluation;
struct RayTable;
struct ScoredFrame;
}  // namespace relidar

namespace relidar::cli {

/// Draws range, intensity and ray-drop of a frame. Each figure shows the real image, the
/// rendered image and the error. The intensity is left out if the log has none.
/// @param title text before the name of each figure
/// @param real caption of the real images
std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title,
                                             const std::string& real, double max_range_m);

/// Writes the files FOLDER/{range,intensity,drop}_000123.png of a frame. Each file shows
/// the real image, the rendered image and the error, one below the other. The intensity
/// is left out if the log has none.
void write_strips(const std::filesystem::path& folder, const ScoredFrame& frame, double max_range_m);

/// Draws the real range image, and the rendered range image below it.
Image range_pair(const ScoredFrame& frame, double max_range_m);

/// Draws the pattern of a sensor. Each ray is a dot, and its colour is the firing time.
/// Azimuth increases to the right as seen from the sensor, elevation upwards, both at the
/// same scale. If the sensor covers all azimuths, only the 40 degrees ahead are shown.
Image ray_picture(const RayTable& rays);

}  // namespace relidar::cli
