// SPDX-License-Identifier: Apache-2.0
// Data of one scene and its LiDARs from the tables of nuScenes, TruckScenes or Lyft Level
// 5.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::nuscenes {

/// One file of a LiDAR, a keyframe or a sweep between keyframes.
struct SweepRecord {
    std::string token, next;  ///< `next` is empty at the end of the scene
    std::string sample;       ///< keyframe to which the file belongs
    std::string ego_pose, calibration;
    std::string file;          ///< relative to the dataset
    std::int64_t time_us = 0;  ///< timestamp of the revolution
    bool is_keyframe = false;
};

/// A channel LIDAR_* with files in the scene.
struct SceneLidar {
    std::string channel;
    Pose ego_from_lidar;              ///< in the dataset's convention
    std::vector<SweepRecord> sweeps;  ///< in order of time
};

/// Data of a scene.
struct SceneTables {
    std::string name;
    /// At least one: LIDAR_TOP, then the others by name. The first one numbers the
    /// frames.
    std::vector<SceneLidar> lidars;
    std::vector<Pose> world_from_ego;  ///< vehicle poses at the sweeps of the first LiDAR
    /// at keyframes, in the world frame; time_s is relative to the first sweep
    std::vector<BoxLabel> labels;

    /// Returns the seconds after the first sweep.
    double seconds(std::int64_t time_us) const {
        return double(time_us - lidars[0].sweeps[0].time_us) * 1e-6;
    }
};

/// Returns the names of the scenes in the order of the table.
std::vector<std::string> list_scenes(const std::filesystem::path& tables);

/// Reads the data of a scene. Tables of a gigabyte are read record by record.
/// @param tables  folder of the tables
/// @throws DataError with file, record and key
SceneTables read_scene(const std::filesystem::path& tables, const std::string& name);

}  // namespace relidar::nuscenes
