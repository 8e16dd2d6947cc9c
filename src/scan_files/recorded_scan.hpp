// SPDX-License-Identifier: Apache-2.0
// A scan as recordings of it have it, whatever their messages look like.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/export.hpp>
#include <relidar/math.hpp>

namespace relidar::scan_files {

/// An actor's box at the time of a scan.
struct RecordedActor {
    std::string name;
    Pose world_from_box;
    glm::dvec3 size_m;   ///< length, width, height
};

struct RecordedScan {
    PointCloud cloud;                ///< with ring, time and instance
    bool world = false;              ///< points are in the world, else in the sensor's frame
    std::uint64_t time_ns = 0;       ///< from when times of points count
    double first_time_s = 0.0;       ///< of a ray, from then
    Pose world_from_sensor;          ///< at that time
    Pose world_from_sensor_at_first; ///< when the first ray was fired
    std::vector<RecordedActor> actors;
};

inline constexpr const char* kWorldFrame = "world";
inline constexpr const char* kSensorFrame = "lidar";

}  // namespace relidar::scan_files
