// SPDX-License-Identifier: Apache-2.0
// Reads one scene and its LiDARs from the tables of nuScenes, TruckScenes or Lyft Level
// 5.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/read/clouds.hpp>

namespace relidar::nuscenes {

struct SweepRecord {
    /// ids of this record and of the next record of the scene (empty for the last)
    std::string token, next;
    std::string sample;  ///< token of the keyframe that the file belongs to
    std::string ego_pose, calibration;
    std::string file;          ///< relative to the dataset
    std::int64_t time_us = 0;  ///< timestamp of the revolution
    bool is_keyframe = false;
    /// categories of points (nuScenes-lidarseg), relative to the dataset; empty without
    /// labels
    std::string categories_file = {};
};

/// a channel whose name begins with LIDAR_
struct SceneLidar {
    std::string channel;
    Pose ego_from_lidar;              ///< in the dataset's convention
    std::vector<SweepRecord> sweeps;  ///< in order of time
};

struct SceneTables {
    std::string name;
    /// LIDAR_TOP first, others by name. The sweeps of the first LiDAR define the frame
    /// numbers.
    std::vector<SceneLidar> lidars;
    /// Cameras with pictures in the scene, by name. Their rig is the vehicle.
    std::vector<Camera> cameras;
    std::vector<Pose> world_from_ego;  ///< vehicle poses at the times of the first LiDAR's sweeps
    /// labels of keyframes in the world frame; seconds after the first sweep
    std::vector<BoxLabel> labels;
    std::string location;  ///< name of the map; empty if unknown
    /// class of each category index of nuScenes-lidarseg
    std::array<SurfaceClass, 256> classes{};

    double seconds_at(std::int64_t time_us) const {
        return double(time_us - lidars[0].sweeps[0].time_us) * 1e-6;
    }
};

std::vector<std::string> list_scenes(const std::filesystem::path& table_folder);

/// Reads the data of a scene, record by record, because tables can have a gigabyte.
/// @param table_folder  folder that contains the tables
/// @throws DataError with file, record and key
SceneTables read_scene(const std::filesystem::path& table_folder, const std::string& scene_name);

}  // namespace relidar::nuscenes
