// SPDX-License-Identifier: Apache-2.0
// Parses one record of Waymo Open Perception 1.4. A record is a Frame message with the
// images and labels of all LiDARs.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::waymo {

inline constexpr int kTop = 1;  ///< LaserName of the long-range LiDAR on the roof

/// Calibration of a LiDAR. In its frame, x points forward, y left and z up.
struct Calibration {
    int laser = 0;  ///< number of the LiDAR in Waymo's enum LaserName
    /// elevation of each row, ascending; empty: evenly spaced between the limits
    std::vector<double> inclination_rad;
    double min_inclination_rad = 0.0, max_inclination_rad = 0.0;
    Pose vehicle_from_laser;
};

/// Compressed range images of one LiDAR in a frame. The views point into the bytes of the
/// record.
struct LaserImages {
    int laser = 0;
    std::string_view first, second;  ///< first and second returns; `second` is empty if there are none
    /// Vehicle pose of each pixel of the first return. Empty if all pixels are in the
    /// vehicle frame of the record.
    std::string_view pixel_pose;
};

struct FrameRecord {
    std::int64_t timestamp_us = 0;    ///< time of TOP's first firing
    Pose world_from_vehicle;          ///< vehicle pose at about the middle of the sweep
    std::vector<Calibration> lasers;  ///< sorted by LaserName
    std::vector<LaserImages> images;  ///< sorted by LaserName
    /// Labels of vehicles, pedestrians and cyclists in the vehicle frame. Their times are
    /// not set.
    std::vector<BoxLabel> labels;
};
/// Parses a record of a .tfrecord file.
/// @param where  file and record for error messages
/// @throws DataError with the field
FrameRecord parse_frame(std::string_view record, const std::string& where);

/// A decompressed image with the dimensions [rows, columns, channels].
struct Image {
    int rows = 0, columns = 0, channels = 0;
    std::vector<float> values;

    const float* pixel(std::size_t at) const { return &values[at * std::size_t(channels)]; }
};
/// Decompresses a range image or a pose image.
/// @param packed  image as a zlib stream
/// @throws DataError if the stream is damaged or the number of channels differs
Image inflate_image(std::string_view packed, int channels, const std::string& where);

/// Returns the elevation of each row of a range image. The highest row is the first.
std::vector<double> row_elevations(const Calibration& calibration, int rows, const std::string& where);

}  // namespace relidar::waymo
