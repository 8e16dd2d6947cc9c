// SPDX-License-Identifier: Apache-2.0
// The LiDARs of an NCore sequence and their scans.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <relidar/read/clouds.hpp>

#include "log/sensor/beam_geometry.hpp"
#include "read/datasets/ncore/ncore_sequence.hpp"
#include "read/scans/folder_points.hpp"

namespace relidar::ncore {

/// NCore's model "row-offset-spinning": the ray of row i and column j has
///   elevation = row_elevations[i],  azimuth = column_azimuths[j] + row_azimuth_offsets[i].
struct SpinningModel {
    std::vector<double> elevation_rad, offset_rad;  ///< [rows] highest first
    std::vector<double> azimuth_rad;                ///< [columns] in the order of firing
    double period_s = 0.1;
    bool is_clockwise = true;
    /// [rows] beam of the sensor of the log. Beams are sorted from the highest to the
    /// lowest.
    std::vector<std::size_t> beam_of_row;
};

/// Reads the model of a LiDAR, or nothing if the sequence has none.
std::optional<SpinningModel> read_model(const NcoreSequence& sequence, const std::string& lidar_name);

/// Converts a model to a sensor without a name and range limits. Returns nothing if the
/// columns of the model are not in equal steps. Sets model.beam_of_row, because the
/// sensor has the beams in the order of their elevations.
/// @param beams  [rows] beams of the rows of the model
std::optional<SpinningSensor> to_sensor(SpinningModel& model, const std::vector<Beam>& beams);

/// Rays and returns of a frame, as they are stored.
struct RayBundle {
    std::vector<glm::dvec3> direction;        ///< [rays] unit vectors in the sensor frame
    std::vector<float> time_offset_s;         ///< [rays] relative to the time of the frame
    std::vector<std::uint16_t> element;       ///< [rays * 2] row and column in the model; may be empty
    std::vector<std::vector<float>> range_m;  ///< [returns][rays] 0: no such return
    std::vector<std::vector<float>> intensity;
};

/// A sweep of a LiDAR.
struct StoredFrame {
    std::int64_t start_us = 0, end_us = 0;
    std::int64_t middle_us() const { return start_us + (end_us - start_us) / 2; }
};
/// Lists the sweeps of a LiDAR in the order of their times.
std::vector<StoredFrame> list_stored_frames(const Component& lidar);

/// Reads the rays and returns of a sweep.
/// @param time_us  reference time of the frame in the log
RayBundle read_rays(const Component& lidar, const StoredFrame& frame, std::int64_t time_us);

/// Beams that were fitted to returns, and how well they and the model fit.
struct FittedBeams {
    std::vector<Beam> beams;        ///< [rows] beams of the model unless the fit is clearly better
    double model_misfit_rad = 0.0;  ///< median angle between rays of the model and returns
    double misfit_rad = 0.0;        ///< the same for the fitted beams
    bool is_better = false;
    std::size_t n_returns = 0;  ///< number of returns with an element of the model
};
/// Fits the beam of each row of a model, direction and origin, to the returns of some
/// frames. Keeps the beams of the model if the fit is not clearly better.
FittedBeams fit_beam_origins(const std::vector<RayBundle>& bundles, const SpinningModel& model);

/// Where a scan of the log is stored.
struct ScanLocation {
    std::size_t lidar = 0;  ///< index in Log::lidars
    StoredFrame frame;
    std::int64_t time_us = 0;  ///< reference time of the frame in the log
};

/// Converts rays of frames to scans. A LiDAR with a model becomes an image, in which rays
/// that are not stored were dropped. Other LiDARs become points.
class NcoreScans : public read::ScanProvider {
public:
    /// @param models  [lidars] models of LiDARs whose rays become images
    NcoreScans(const Log& log, std::vector<Component> lidars, std::vector<ScanLocation> scans,
               std::vector<std::optional<SpinningModel>> models);

    std::string frame_name(std::size_t frame) const override;
    bool stores_points(std::size_t frame) const override { return !models_[scans_[frame].lidar]; }
    LidarPoints read_points(std::size_t frame) const override;
    Scan read_rays(std::size_t frame) const override;

private:
    std::vector<Component> lidars_;
    std::vector<ScanLocation> scans_;
    std::vector<std::optional<SpinningModel>> models_;
    std::vector<std::vector<BeamRays>> beams_;  ///< [lidars][beams]
    /// [lidars] rays of the model in image order, without returns
    std::vector<RayTable> images_;
    /// [lidars][row * columns + column] ray of an element; -1 if it is not in the image
    std::vector<std::vector<int>> ray_of_element_;

    /// Computes the rays of a LiDAR's image (images_), and which of them is the ray of an
    /// element of the model (ray_of_element_). Turns the rays of each column to its
    /// azimuth in the model.
    void make_image(std::size_t lidar, const SpinningSensor& sensor);
    RayBundle read_bundle(std::size_t frame) const;
    void place_rays(Scan& scan, const RayBundle& bundle, std::size_t lidar, const std::string& where) const;
    static void place_returns(Scan& scan, std::size_t ray, const RayBundle& bundle, std::size_t stored_ray,
                              const BeamRays& beam);
};

}  // namespace relidar::ncore
