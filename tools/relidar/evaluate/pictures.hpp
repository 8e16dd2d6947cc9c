// SPDX-License-Identifier: Apache-2.0
// Draws range images as pictures: real, rendered and error side by side for the report.
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

/// Draws range, intensity and ray-drop of a frame, each as real, rendered and error
/// image. Intensity is left out if the log has none.
/// @param title text before the name of each figure
/// @param real caption of the real images
std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title,
                                             const std::string& real, double max_range_m);

/// Writes FOLDER/{range,intensity,drop}_000123.png of a frame, with the real, rendered
/// and error images stacked. Intensity is left out if the log has none.
void write_strips(const std::filesystem::path& folder, const ScoredFrame& frame, double max_range_m);

/// Draws the rendered range image below the real one.
Image range_pair(const ScoredFrame& frame, double max_range_m);

/// Draws the pattern of a sensor with one dot per ray, coloured by firing time. Azimuth
/// increases to the right as seen from the sensor, elevation upwards, both at the same
/// scale. Shows only the 40 degrees ahead if the sensor covers all azimuths.
Image ray_picture(const RayTable& rays);

}  // namespace relidar::cli
