// SPDX-License-Identifier: Apache-2.0
// What recordings hold of scans that were taken together, whatever their messages look
// like.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/simulate/point_cloud.hpp>

namespace relidar::scan_files {

inline constexpr const char* kWorldFrame = "world";
inline constexpr const char* kVehicleFrame = "base_link";

struct RecordedSensor {
    std::string topic, frame_id;
    Pose vehicle_from_sensor;
};
struct RecordedRig {
    std::vector<RecordedSensor> sensors;
    bool world = false;  ///< points are in the world, else in their sensor's frame
};

/// How something moves, in its own axes.
struct Velocity {
    glm::dvec3 linear_mps{0.0}, angular_radps{0.0};
};
struct RecordedPose {
    std::uint64_t time_ns;
    Pose world_from_vehicle;
    Velocity velocity;
};
/// Where a box is at a time.
struct BoxState {
    std::uint64_t time_ns;
    Pose world_from_box;
    Velocity velocity;
};
struct RecordedActor {
    std::string name, category;
    glm::dvec3 size_m;  ///< length, width, height
    bool is_parked = false;
    BoxState faced;     ///< when the sensor faces it: a moving box fits the points on the actor only then
    BoxState at_stamp;  ///< at the stamp of the cloud
};
struct RecordedCloud {
    std::uint64_t stamp_ns;  ///< of the first ray
    /// with ring, time from the stamp, and instance; deskewed: in the sensor's frame at
    /// the stamp
    PointCloud cloud;
};
struct RecordedMoment {
    std::uint64_t first_ns, last_ns;    ///< of all rays
    std::vector<RecordedPose> poses;    ///< ascending, behind those of earlier moments
    std::vector<RecordedCloud> clouds;  ///< [sensors]
    std::map<std::uint64_t, std::vector<RecordedActor>> actors;  ///< by the stamps of the clouds
};

}  // namespace relidar::scan_files
