// SPDX-License-Identifier: Apache-2.0
// Selects what is rendered: frames, sensors and visible actors.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sensor_files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar::cli {

/// Parses --frames: "first:end" (frame numbers of the dataset), "test", "train" or "all".
/// By default, selects the held-out frames, or all if none is held out.
/// @return positions in the list of frames
/// @throws UsageError if no frame is selected
std::vector<int> select_frames(const Run& run, const std::optional<std::string>& frames_text, bool quiet);

/// `number` is part of the file name, `time_s` the reference time of the sweep.
struct NumberedScanTime {
    int number;
    double time_s;
};
std::vector<double> times_of(const std::vector<NumberedScanTime>& sweeps);
/// Returns the times of the selected frames of a LiDAR, with their frame numbers.
/// @param frames_text, quiet  as in select_frames()
/// @throws UsageError if the LiDAR recorded none of them
std::vector<NumberedScanTime> sweeps_of_frames(const Run& run, const std::optional<std::string>& frames_text,
                                               int lidar, bool quiet);

/// A sensor to simulate, and where its scans are written.
struct RenderedSensor {
    /// Subfolder for the files of this sensor; empty: the output folder itself.
    std::string folder = {};
    SimulatedSensor sensor;
    Pose mounting = {};
    /// No value for the log's sensor, a grid of rays, and sensors that do not spin.
    std::optional<SpinningSensor> spinning = {};
};

using SensorRig = std::optional<std::vector<MountedSensor>>;

/// Returns the sensors to simulate: all of a rig, or one. An empty name selects the
/// sensor of the settings.
std::vector<RenderedSensor> list_sensors(const std::string& name, const SensorRig& rig, const Run& run,
                                         int lidar);

/// Returns a camera by the name or file of choose_camera(), as the only sensor.
std::vector<RenderedSensor> list_cameras(const std::string& name, const Run& run, int lidar);

/// Returns the time shift with which no sensor has a stamp before 1970.
std::int64_t largest_time_shift_ns(const Run& run, const std::vector<RenderedSensor>& sensors,
                                   const std::vector<NumberedScanTime>& sweeps);

/// Lets what blocks the log's LiDAR block the other sensors, too. Prints a note for a
/// sensor at another place.
/// @param offset  pose of the rig or the sensor in the frame of the log's LiDAR
void add_log_body(std::vector<RenderedSensor>& sensors, const Run& run, int lidar, const Pose& offset);

/// Returns the names of sensors and files, and the contents of the files. Another path or
/// sensor of the same name has another text.
std::string describe_inputs(const std::vector<std::string>& names_or_files);

/// Removes the boxes of actors that are not rendered, so that they do not appear in
/// recordings.
/// @param visible  value of --only
void remove_hidden_boxes(ScanOutputOptions& output, const Run& run, const std::vector<std::string>& visible);

}  // namespace relidar::cli
