// SPDX-License-Identifier: Apache-2.0
// What the tables of nuScenes say of one scene and its LiDAR.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/reader.hpp>

namespace relidar::nuscenes {

/// One file of LIDAR_TOP, a keyframe or a sweep between keyframes.
struct SweepRecord {
    std::string token, next;  ///< next is empty at the scene's end
    std::string sample;       ///< keyframe it belongs to
    std::string ego_pose, calibration;
    std::string file;          ///< relative to the dataset
    std::int64_t time_us = 0;  ///< end of its turn
    bool is_keyframe = false;
    Pose world_from_ego;
};

/// A scene, its sweeps in order of time.
struct SceneTables {
    std::string name;
    std::vector<SweepRecord> sweeps;
    Pose ego_from_lidar;           ///< LiDAR as nuScenes has it: x right, y forward, z up
    std::vector<BoxLabel> labels;  ///< at keyframes, time_s in seconds after the first sweep; in the world
};

/// Names of the scenes of some tables, in the order of the table.
std::vector<std::string> list_scenes(const std::filesystem::path& tables);

/// Reads what belongs to a scene. Tables of a gigabyte are passed through record by record.
/// @param tables  a folder v1.0-* @throws DataError naming file, record and key
SceneTables read_scene(const std::filesystem::path& tables, const std::string& name);

}  // namespace relidar::nuscenes
