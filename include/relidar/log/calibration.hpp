// SPDX-License-Identifier: Apache-2.0
// Estimates noise, range offsets and intensity responses of the LiDARs of a log.
#pragma once

#include <cstddef>
#include <vector>

namespace relidar {

struct Log;

/// Distances of the points from common planes, before and after the calibration.
struct RangeCalibrationResult {
    std::size_t returns = 0;  ///< number of returns that were compared
    double rms_before = 0.0;  ///< Root mean square distance of points from their plane, in metres.
    double rms_after = 0.0;   ///< The same distance (RMS) after adding an offset for each beam.
    bool adopted = false;     ///< True if the offsets were stored in the beams.
};
/// Errors before and after the calibration of intensities.
struct IntensityCalibrationResult {
    std::size_t returns = 0;  ///< number of returns that were compared
    /// RMS difference between intensities and their mean at the same point of a surface.
    double rms_before = 0.0;
    double rms_after = 0.0;  ///< The same difference with the corrections that were adopted.
    bool shared = false;     ///< True if the log now has an IntensityResponse.
    bool beams = false;      ///< True if the beams now have gains and offsets.
};
/// Estimates two models of the intensity by least squares: the dependence on range and
/// incidence (Log::intensity_response), and gain and offset of each beam
/// (Beam). Both are fitted to returns that hit the same 0.1 m of a surface. A model, or
/// both together, is adopted only if it reduces the error by a further 5 %. The mean
/// beam, and a beam that shares no surface with others, has gain 1 and offset 0. (Not in
/// the paper.)
/// @param frame_indices  indices into Log::frames of the frames to use
IntensityCalibrationResult calibrate_intensity(Log& log, const std::vector<int>& frame_indices);
/// Measures the range noise of each LiDAR (Lidar::range_noise) from second differences
/// between neighbouring firings of a beam. The scans must be in image order. A bin with
/// fewer than 200 returns uses the value of the neighbouring bin. (Not in the paper.)
/// @param frame_indices  indices into Log::frames of the frames to use
/// @return number of returns that were used; 0: nothing was measured
std::size_t calibrate_noise(Log& log, const std::vector<int>& frame_indices);
/// Estimates the range offset of each beam (Beam), centimetres in many datasets, from
/// returns on the same planes in cells of 0.3 m. Their mean is 0. Offsets that make the
/// planes less than 3 % thinner are set to 0. (Not in the paper.)
/// @param frame_indices  indices into Log::frames of the frames to use
RangeCalibrationResult calibrate_ranges(Log& log, const std::vector<int>& frame_indices);

}  // namespace relidar
