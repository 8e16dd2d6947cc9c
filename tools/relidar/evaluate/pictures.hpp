// SPDX-License-Identifier: Apache-2.0
// Range images as pictures: real, rendered and error side by side for the report.
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

/// Range, intensity and ray-drop of a frame, each real, rendered and error. No intensity
/// if the log has none.
/// @param title in front of each figure's name @param real caption of the real images
std::vector<ReportFigure> comparison_figures(const ScoredFrame& frame, const std::string& title,
                                             const std::string& real, double max_range_m);

/// Writes FOLDER/{range,intensity,drop}_000123.png of a frame: real, rendered and error
/// stacked. No intensity if the log has none.
void write_strips(const std::filesystem::path& folder, const ScoredFrame& frame, double max_range_m);

/// Real and rendered range stacked.
Image range_pair(const ScoredFrame& frame, double max_range_m);

/// A sensor's pattern: azimuth to the right as the sensor looks, elevation upwards, both
/// by the same scale, a dot a ray in the colour of its firing time. Of a sensor that sees
/// all round the 40 degrees ahead.
Image ray_picture(const RayTable& rays);

}  // namespace relidar::cli
