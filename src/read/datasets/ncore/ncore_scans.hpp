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
///   elevation = elevation of beam i,  azimuth = azimuth[j] + azimuth offset of beam i.
struct SpinningModel {
    std::vector<Beam> beams;          ///< [rows]
    std::vector<double> azimuth_rad;  ///< [columns] in the order of firing
    double period_s = 0.1;
    bool is_clockwise = true;

    double turn_sign() const { return is_clockwise ? -1.0 : 1.0; }
    /// Azimuth of a column if the columns were in equal steps, `turn_columns` in a turn.
    double even_azimuth_rad(std::size_t column, int turn_columns) const {
        return azimuth_rad.front() + turn_sign() * 2.0 * kPi * double(column) / turn_columns;
    }
    /// Returns the rows from the highest to the lowest beam, the order in a sensor.
    std::vector<std::size_t> rows_by_height() const;
};

/// Reads the model of a LiDAR, or nothing if the sequence has none.
std::optional<SpinningModel> read_model(const NcoreSequence& sequence, const std::string& lidar_name);

/// Converts a model to a sensor without a name and range limits. Returns nothing if the
/// columns of the model are not in nearly equal steps.
std::optional<SpinningSensor> to_sensor(const SpinningModel& model);

/// Rays and returns of a frame, as they are stored.
struct RayBundle {
    std::vector<glm::dvec3> direction;        ///< [rays] unit vectors in the sensor frame
    std::vector<float> time_offset_s;         ///< [rays] relative to the time of the frame
    std::vector<std::uint16_t> element;       ///< [rays * 2] row and column in the model; may be empty
    std::vector<std::vector<float>> range_m;  ///< [returns][rays] 0: no such return
    std::vector<std::vector<float>> intensity;

    bool has_elements() const { return !element.empty(); }
    std::size_t row_of(std::size_t ray) const { return element[2 * ray]; }
    std::size_t column_of(std::size_t ray) const { return element[2 * ray + 1]; }
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
RayBundle read_ray_bundle(const Component& lidar, const StoredFrame& frame, std::int64_t time_us);

/// Beams that were fitted to returns, and how well they and the model fit.
struct FittedBeams {
    std::vector<Beam> beams;        ///< [rows] those of the model unless the fit is clearly better
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

/// The image of a LiDAR with a model. An element is a pixel (row, column) of the model.
/// The image has the same rows, sorted by elevation, but the columns of a full turn, of
/// which the model may have a part.
struct ModelImage {
    SpinningModel model;
    std::vector<BeamRays> beams;      ///< [rows of the model]
    RayTable rays;                    ///< in image order, without returns
    std::vector<int> ray_of_element;  ///< [row * columns + column] -1: not in the image

    /// Makes the rays of the image and finds the element of each.
    /// @param sensor  the sensor that to_sensor() made of the model
    ModelImage(SpinningModel spinning_model, const SpinningSensor& sensor);
    int ray_of(std::size_t row, std::size_t column) const {
        return ray_of_element[row * model.azimuth_rad.size() + column];
    }
};

/// Converts rays of frames to scans. A LiDAR with a model becomes an image, in which rays
/// that are not stored were dropped. Other LiDARs become points.
class NcoreScans : public read::ScanProvider {
public:
    /// @param models  [lidars] models of LiDARs whose rays become images
    NcoreScans(const Log& log, std::vector<Component> lidars, std::vector<ScanLocation> scans,
               std::vector<std::optional<SpinningModel>> models);

    std::string frame_name(std::size_t frame) const override;
    bool stores_points(std::size_t frame) const override { return !images_[scans_[frame].lidar]; }
    LidarPoints read_points(std::size_t frame) const override;
    Scan read_rays(std::size_t frame) const override;

private:
    std::vector<Component> lidars_;
    std::vector<ScanLocation> scans_;
    std::vector<std::optional<ModelImage>> images_;  ///< [lidars]

    RayBundle read_bundle(std::size_t frame) const;
};

}  // namespace relidar::ncore
