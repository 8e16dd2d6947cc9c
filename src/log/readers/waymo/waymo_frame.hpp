// SPDX-License-Identifier: Apache-2.0
// One record of Waymo Open Perception 1.4: the Frame message, as far as LiDARs and their
// labels go.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::waymo {

inline constexpr int kTop = 1;  ///< LaserName of the long-range LiDAR on the roof

/// A LiDAR as the segment calibrates it. Its frame: x forward, y left, z up.
struct Calibration {
    int laser = 0;                        ///< LaserName
    std::vector<double> inclination_rad;  ///< ascending; empty: even steps between the limits
    double min_inclination_rad = 0.0, max_inclination_rad = 0.0;
    Pose vehicle_from_laser;
};

/// Range images of a LiDAR in one frame, still compressed; views into the record.
struct LaserImages {
    int laser = 0;
    std::string_view first, second;  ///< returns; the second is empty where there is none
    /// of the first return; empty where all are in the vehicle's frame of the record
    std::string_view pixel_pose;
};

struct FrameRecord {
    std::int64_t timestamp_us = 0;    ///< first firing of TOP
    Pose world_from_vehicle;          ///< about the middle of the sweep
    std::vector<Calibration> lasers;  ///< by LaserName
    std::vector<LaserImages> images;  ///< by LaserName
    /// in the vehicle's frame, without times: vehicles, pedestrians, cyclists
    std::vector<BoxLabel> labels;
};
/// @param where  names file and record, for messages @throws DataError naming the field
FrameRecord parse_frame(std::string_view record, const std::string& where);

/// A MatrixFloat of three dimensions, [rows, columns, channels].
struct Image {
    int rows = 0, columns = 0, channels = 0;
    std::vector<float> values;

    const float* pixel(std::size_t at) const { return &values[at * std::size_t(channels)]; }
};
/// @param packed  a zlib stream @throws DataError where it is none, or of other channels
Image inflate_image(std::string_view packed, int channels, const std::string& where);

/// Elevations of the rows of a range image, the highest first.
std::vector<double> row_elevations(const Calibration& calibration, int rows, const std::string& where);

}  // namespace relidar::waymo
