// SPDX-License-Identifier: Apache-2.0
// Parses one record of Waymo Open Perception 1.4. A record is a Frame message, which
// contains the images and labels of all LiDARs.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::waymo {

inline constexpr int kTop = 1;  ///< LaserName of TOP, the long-range LiDAR on the roof

/// Calibration of a Waymo LiDAR. In its frame, x points forward, y left and z up.
struct WaymoLidarCalibration {
    int laser = 0;  ///< number of the LiDAR in Waymo's enum LaserName
    /// Elevation of each row, ascending. If empty, the rows are evenly spaced between the
    /// minimum and the maximum.
    std::vector<double> inclination_rad;
    double min_inclination_rad = 0.0, max_inclination_rad = 0.0;
    Pose vehicle_from_laser;
};

/// Compressed range images of one LiDAR in one frame. The texts are views of the record,
/// so the record must stay in memory.
struct CompressedLidarImages {
    int laser = 0;
    /// images of the first and the second returns; `second` is empty if there are none
    std::string_view first, second;
    /// Compressed image with a vehicle pose for each pixel of `first`, the image of first
    /// returns. Empty if all pixels have the same pose.
    std::string_view pixel_pose;
    /// Compressed image with the object instance and the class of each pixel of `first`,
    /// the image of first returns. Empty if the frame has no point labels.
    std::string_view labels;
};

struct WaymoFrameRecord {
    std::int64_t timestamp_us = 0;              ///< time of TOP's first firing
    Pose world_from_vehicle;                    ///< vehicle pose at about the middle of the sweep
    std::vector<WaymoLidarCalibration> lasers;  ///< sorted by LaserName
    std::vector<CompressedLidarImages> images;  ///< sorted by LaserName
    /// Labelled boxes of vehicles, pedestrians and cyclists. Despite its name,
    /// `world_from_box` is a pose in the vehicle frame here. `time_s` is not set.
    std::vector<BoxLabel> labels;
};
/// Parses one record of a .tfrecord file.
/// @param error_location  name of the file and record number, for error messages
/// @throws DataError with the field
WaymoFrameRecord parse_frame_record(std::string_view record_bytes, const std::string& error_location);

/// A decompressed image. Its dimensions are [rows, columns, channels].
struct DecompressedImage {
    int rows = 0, columns = 0, channels = 0;
    std::vector<float> values;

    const float* get_pixel_values(std::size_t pixel_index) const {
        return &values[pixel_index * std::size_t(channels)];
    }
};
/// Types of the numbers in an image: MatrixFloat or MatrixInt32.
enum class PixelType { real, integer };
/// Decompresses a range image, a pose image or an image of labels.
/// @param compressed_image  image as a zlib stream
/// @throws DataError if the stream is damaged, or if the image has another number of
/// channels
DecompressedImage inflate_image(std::string_view compressed_image, int n_channels,
                                const std::string& error_location, PixelType pixel_type = PixelType::real);

/// Returns the elevation of each row of a range image, from the top row to the bottom
/// row.
std::vector<double> compute_row_elevations_rad(const WaymoLidarCalibration& calibration, int n_rows,
                                               const std::string& error_location);

}  // namespace relidar::waymo
