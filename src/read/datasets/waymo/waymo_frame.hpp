// SPDX-License-Identifier: Apache-2.0
// Parses one record of Waymo Open Perception 1.4. A record is a Frame message, which
// contains the images and labels of all LiDARs.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/read/clouds.hpp>

namespace relidar::waymo {

inline constexpr int kTopLaser = 1;  ///< LaserName of TOP, the long-range LiDAR on the roof

/// x forward, y left, z up
struct LaserCalibration {
    int laser = 0;  ///< number of the LiDAR in Waymo's enum LaserName
    /// ascending; empty: evenly spaced between minimum and maximum
    std::vector<double> inclination_rad;
    double min_inclination_rad = 0.0, max_inclination_rad = 0.0;
    Pose vehicle_from_laser;
};

/// Compressed images of a LiDAR in one frame: views of the record.
struct LaserImages {
    int laser = 0;
    /// first and second returns; `second` may be empty
    std::string_view first, second;
    /// vehicle pose of each pixel of `first`; empty if all pixels have the same pose
    std::string_view pixel_pose;
    /// instance and class of each pixel of `first`; empty without labels
    std::string_view labels;
};

struct SegmentFrame {
    std::int64_t timestamp_us = 0;         ///< time of TOP's first firing
    Pose world_from_vehicle;               ///< vehicle pose at about the middle of the sweep
    std::vector<LaserCalibration> lasers;  ///< sorted by LaserName
    std::vector<LaserImages> images;       ///< sorted by LaserName
    /// Despite its name, `world_from_box` is in the vehicle frame here. `time_s` is not
    /// set.
    std::vector<BoxLabel> labels;
};
/// Parses one record of a .tfrecord file: time, vehicle pose, calibrations, compressed
/// images and box labels of all LiDARs.
/// @param where  name of the file and record number, for error messages
/// @throws DataError with the field
SegmentFrame parse_frame(std::string_view record_bytes, const std::string& where);

struct InflatedImage {
    int rows = 0, columns = 0, channels = 0;
    std::vector<float> values;

    const float* pixel_values(std::size_t pixel_index) const {
        return &values[pixel_index * std::size_t(channels)];
    }
};
enum class PixelType { real, integer };
/// Decompresses and parses an image: a protobuf matrix in a zlib stream.
/// @param pixel_type  type of the values in the stream; the image has floats
/// @throws DataError if the stream is damaged, or if the image has another number of
/// channels
InflatedImage inflate_image(std::string_view compressed_image, int n_channels, const std::string& where,
                            PixelType pixel_type = PixelType::real);

/// Returns the elevation of each image row, from the top row to the bottom row. If the
/// calibration has no list of inclinations, the rows are evenly spaced.
/// @throws DataError if the list does not have one inclination per row
std::vector<double> row_elevations_rad(const LaserCalibration& calibration, int n_rows,
                                       const std::string& where);

}  // namespace relidar::waymo
