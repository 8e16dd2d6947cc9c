// SPDX-License-Identifier: Apache-2.0
// What recordings hold of scans that were taken together, whatever their messages look
// like.
#pragma once

#include <cmath>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/points.hpp>

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

/// Stamp of a time of the file.
inline std::uint64_t stamp_of(double time_s) { return std::uint64_t(std::llround(1e9 * time_s)); }

struct RecordedMoment {
    std::uint64_t first_ns, last_ns;  ///< of all rays
    std::vector<RecordedPose> poses;  ///< ascending, behind those of earlier moments
    /// [sensors] Points with time_s in the file's time, that of the first ray; deskewed: in
    /// the sensor's frame at time_s
    std::vector<Points> clouds;
    std::map<std::uint64_t, std::vector<RecordedActor>> actors;  ///< by the stamps of the clouds
};

}  // namespace relidar::scan_files
