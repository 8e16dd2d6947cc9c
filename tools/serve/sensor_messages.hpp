// SPDX-License-Identifier: Apache-2.0
// Reads the sensors of requests, whose values are checked before rays are computed, and
// caches them.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "relidar/v1/render.pb.h"

namespace relidar {
struct Run;
struct SimulatedSensor;
}  // namespace relidar

namespace relidar::serve {

/// A CPU needs seconds even for a scan of this size.
inline constexpr std::size_t kMostRaysOfScan = std::size_t(1) << 20;

SimulatedSensor read_sensor(const v1::SensorSpec& message, const std::string& name);

/// Returns the sensor that a client has named, in upper or lower case:
///   ""              what the setting sensor.grid of the run selects
///   "native"        the LiDAR of the log
///   "kitti360"      the range grid of this name
///   a built-in sensor of list_sensors(), also with columns and rate: "VLP-16:900x20"
/// Rejects all other names, because clients must not read files of the server.
/// @param lidar  index of the LiDAR of the log that the sensor replaces
/// @throws RejectedRequest if the name is unknown or the sensor has too many rays
SimulatedSensor find_known_sensor(const std::string& name, const Run& run, int lidar);

/// In seconds relative to the time of the scan.
struct FiringTimeSpan {
    double first_s = 0.0, last_s = 0.0;
};
FiringTimeSpan firing_span(const SimulatedSensor& sensor);

std::size_t count_rays(const SimulatedSensor& sensor);

using SensorPtr = std::shared_ptr<const SimulatedSensor>;

/// The key is the handle of an uploaded sensor, or the name of a built-in sensor. If the
/// cache is full, the least recently used sensor is removed.
class SensorCache {
public:
    static constexpr std::size_t kMostSensors = 64;
    static constexpr std::size_t kMostRays = std::size_t(1) << 22;

    /// Returns the handle of the sensor, and the sensor.
    std::pair<std::string, SensorPtr> add_upload(SimulatedSensor sensor);
    SensorPtr add_sensor(const std::string& key, SimulatedSensor sensor);
    SensorPtr find_cached(const std::string& key);

private:
    struct CachedSensor {
        SensorPtr sensor;
        std::uint64_t used;
    };
    std::mutex mutex_;
    std::map<std::string, CachedSensor> entries_;
    std::uint64_t clock_ = 0;
    std::atomic<std::uint64_t> n_uploads_ = 0;

    std::size_t cached_rays() const;
};

}  // namespace relidar::serve
