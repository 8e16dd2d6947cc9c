// SPDX-License-Identifier: Apache-2.0
// Reads one scene and its LiDARs from the tables of nuScenes, TruckScenes or Lyft Level
// 5.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::nuscenes {

/// Table record of one LiDAR file, which is a keyframe or a sweep between two keyframes.
struct SweepRecord {
    /// Tokens (ids) of this record and of the next record of the scene. `next` is empty
    /// for the last one.
    std::string token, next;
    std::string sample;  ///< token of the keyframe that the file belongs to
    std::string ego_pose, calibration;
    std::string file;          ///< relative to the dataset
    std::int64_t time_us = 0;  ///< timestamp of the revolution
    bool is_keyframe = false;
    /// File with the category of each point (nuScenes-lidarseg), relative to the dataset.
    /// Empty if the points have no labels.
    std::string categories_file = {};
};

/// A LiDAR of the scene: a channel whose name begins with LIDAR_.
struct SceneLidar {
    std::string channel;
    Pose ego_from_lidar;              ///< in the dataset's convention
    std::vector<SweepRecord> sweeps;  ///< in order of time
};

/// Data of one scene, collected from all tables.
struct SceneTables {
    std::string name;
    /// At least one LiDAR. LIDAR_TOP is first; the other LiDARs are sorted by name. The
    /// sweeps of the first LiDAR define the frame numbers.
    std::vector<SceneLidar> lidars;
    std::vector<Pose> world_from_ego;  ///< vehicle poses at the times of the first LiDAR's sweeps
    /// Box labels of the keyframes in the world frame, with times in seconds after the
    /// first sweep.
    std::vector<BoxLabel> labels;
    /// Class of each category index of nuScenes-lidarseg; `unknown` for an index without
    /// a category.
    std::array<SurfaceClass, 256> classes{};

    /// Converts a time stamp to seconds after the first sweep of the first LiDAR.
    double to_seconds_since_first_sweep(std::int64_t time_us) const {
        return double(time_us - lidars[0].sweeps[0].time_us) * 1e-6;
    }
};

/// Returns the names of the scenes in the order of the table.
std::vector<std::string> list_scene_names(const std::filesystem::path& table_folder);

/// Reads the data of a scene, record by record, because tables can have a gigabyte.
/// @param table_folder  folder that contains the tables
/// @throws DataError with file, record and key
SceneTables read_scene_tables(const std::filesystem::path& table_folder, const std::string& scene_name);

}  // namespace relidar::nuscenes
