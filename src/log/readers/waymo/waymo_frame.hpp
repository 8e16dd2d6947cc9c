// SPDX-License-Identifier: Apache-2.0
// Parser of one record of Waymo Open Perception 1.4: the LiDARs and their labels in the
// Frame message.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::waymo {

inline constexpr int kTop = 1;  ///< LaserName of the long-range LiDAR on the roof

/// Calibration of a LiDAR. Its frame: x forward, y left, z up.
struct Calibration {
    int laser = 0;                        ///< LaserName
    std::vector<double> inclination_rad;  ///< ascending; empty: even steps between the limits
    double min_inclination_rad = 0.0, max_inclination_rad = 0.0;
    Pose vehicle_from_laser;
};

/// Range images of a LiDAR in one frame, still compressed. The members are views into the
/// record.
struct LaserImages {
    int laser = 0;
    std::string_view first, second;  ///< first and second returns; `second` is empty if there are none
    /// Pixel poses of the first return. Empty if all pixels are in the vehicle frame of
    /// the record.
    std::string_view pixel_pose;
};

struct FrameRecord {
    std::int64_t timestamp_us = 0;    ///< time of TOP's first firing
    Pose world_from_vehicle;          ///< pose at about the middle of the sweep
    std::vector<Calibration> lasers;  ///< sorted by LaserName
    std::vector<LaserImages> images;  ///< sorted by LaserName
    /// Labels in the vehicle frame, without times: vehicles, pedestrians, cyclists.
    std::vector<BoxLabel> labels;
};
/// Parses a record.
/// @param where  file and record for error messages
/// @throws DataError with the field
FrameRecord parse_frame(std::string_view record, const std::string& where);

/// A MatrixFloat with three dimensions, [rows, columns, channels].
struct Image {
    int rows = 0, columns = 0, channels = 0;
    std::vector<float> values;

    const float* pixel(std::size_t at) const { return &values[at * std::size_t(channels)]; }
};
/// Decompresses a range image.
/// @param packed  a zlib stream
/// @throws DataError if the stream is damaged or the number of channels differs
Image inflate_image(std::string_view packed, int channels, const std::string& where);

/// Returns the elevations of the rows of a range image, the highest first.
std::vector<double> row_elevations(const Calibration& calibration, int rows, const std::string& where);

}  // namespace relidar::waymo
