// SPDX-License-Identifier: Apache-2.0
// A log as a Python object. It also stores the settings with which the log was loaded,
// because training needs them.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>

namespace relidar::python {

struct LoadedLog {
    LidarSequence sequence;
    /// settings; config.dataset and config.sensor.rolling_shutter have the values with
    /// which the log was loaded
    Config config;
};

pybind11::object make_frame_time_array(
    const LidarSequence& sequence);  ///< Returns the frame times, [frames] float64.
pybind11::object make_frame_number_array(
    const LidarSequence& sequence);  ///< Returns the frame numbers, [frames] int32.
pybind11::object list_lidar_name_per_frame(
    const LidarSequence& sequence);  ///< Returns the LiDAR name of each frame.
pybind11::object make_vehicle_trajectory(const LidarSequence& sequence);
pybind11::object make_lidar_mounting_dict(const LidarSequence& sequence);
/// Returns a dict from the track name to (times, poses). The poses are poses of the box
/// centre.
pybind11::object make_actor_track_dict(const LidarSequence& sequence,
                                       const std::vector<std::string>& track_names);

}  // namespace relidar::python
