// SPDX-License-Identifier: Apache-2.0
// A log as a Python object. It also stores the settings with which the log was loaded,
// because training needs them.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/log/log.hpp>
#include <relidar/run/config.hpp>

namespace relidar::python {

struct LoadedLog {
    Log log;
    /// settings; config.dataset and config.sensor.rolling_shutter have the values with
    /// which the log was loaded
    Config config;
};

pybind11::object frame_times(const Log& log);
pybind11::object frame_numbers(const Log& log);
pybind11::object vehicle_path(const Log& log);
pybind11::object world_offset(const Log& log);
pybind11::object mounting_dict(const Log& log);
pybind11::object track_dict(const Log& log, const std::vector<std::string>& track_names);

/// Binds the properties that a log and a run have in common.
/// @param get returns the Log of an Owner
template <class Owner, class Get>
void bind_log_properties(pybind11::class_<Owner>& type, Get get) {
    const auto bind = [&](const char* name, pybind11::object (*value_of)(const Log&), const char* doc) {
        type.def_property_readonly(
            name, [get, value_of](const Owner& owner) { return value_of(get(owner)); }, doc);
    };
    bind("times", frame_times,
         "Times in seconds at which the head of the LiDAR faced forward, [frames] float64.");
    bind("frame_numbers", frame_numbers, "Frame numbers of the dataset, [frames] int32.");
    bind("trajectory", vehicle_path,
         "Trajectory of the vehicle in the dataset's world: (times [n], poses [n,4,4]), float64, metres, in "
         "the form of Run.render(). For a single LiDAR, it is the trajectory of the sensor.");
    bind("world_offset", world_offset,
         "Origin of the scene's frame in the dataset's world, [3] float64, metres. Both have the same axes.");
    bind("mountings", mounting_dict,
         "Mountings of the LiDARs: dict of LiDAR name -> pose vehicle from sensor, [4,4] float64. The poses "
         "of a LiDAR are poses @ mountings[name]. A single LiDAR has an empty name and the identity.");
}

}  // namespace relidar::python
