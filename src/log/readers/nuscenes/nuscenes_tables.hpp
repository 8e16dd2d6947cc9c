// SPDX-License-Identifier: Apache-2.0
// What the tables of nuScenes, TruckScenes and Lyft Level 5 say of one scene and its
// LiDARs.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::nuscenes {

/// One file of a LiDAR, a keyframe or a sweep between keyframes.
struct SweepRecord {
    std::string token, next;  ///< next is empty at the scene's end
    std::string sample;       ///< keyframe it belongs to
    std::string ego_pose, calibration;
    std::string file;          ///< relative to the dataset
    std::int64_t time_us = 0;  ///< stamp of its turn
    bool is_keyframe = false;
};

/// A channel LIDAR_* that has files in the scene.
struct SceneLidar {
    std::string channel;
    Pose ego_from_lidar;              ///< LiDAR as the dataset has it
    std::vector<SweepRecord> sweeps;  ///< in order of time
};

/// A scene.
struct SceneTables {
    std::string name;
    /// at least one: LIDAR_TOP, then the others by name. The first one numbers the frames
    std::vector<SceneLidar> lidars;
    std::vector<Pose> world_from_ego;  ///< at the sweeps of the first LiDAR
    std::vector<BoxLabel> labels;  ///< at keyframes, time_s in seconds after the first sweep; in the world

    /// Seconds after the first sweep.
    double seconds(std::int64_t time_us) const {
        return double(time_us - lidars[0].sweeps[0].time_us) * 1e-6;
    }
};

/// Names of the scenes of some tables, in the order of the table.
std::vector<std::string> list_scenes(const std::filesystem::path& tables);

/// Reads what belongs to a scene. Tables of a gigabyte are passed through record by
/// record.
/// @param tables  the folder of the tables @throws DataError naming file, record and key
SceneTables read_scene(const std::filesystem::path& tables, const std::string& name);

}  // namespace relidar::nuscenes
