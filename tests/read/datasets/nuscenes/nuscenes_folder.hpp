// SPDX-License-Identifier: Apache-2.0
// Writes a small nuScenes folder of two scenes. In the second scene, a virtual HDL-32E
// drives through a yard with walls.
#pragma once

#include "support/logs.hpp"

namespace relidar::test {

/// Returns the members "translation" and "rotation" of a record.
std::string format_pose_keys(const Pose& pose);
/// Writes a table of records, without their braces.
void write_records(const std::filesystem::path& table, const std::vector<std::string>& records);

/// A single firing of a laser.
struct NuscenesRay {
    double time_s = 0.0;       ///< relative to the scene's first sweep
    glm::dvec3 origin_m{0.0};  ///< map frame
    /// direction in the LiDAR's frame at the firing time: x forward, y left, z up
    glm::dvec3 direction{0.0};
    glm::dvec3 point_m{0.0};  ///< map frame
    bool returned = false;
};

struct NuscenesFolder : LogFolder {
    static constexpr int kSweeps = 11;  ///< every tenth sweep is a keyframe
    static constexpr double kSweep_s = 0.05;

    int columns = 0;
    std::vector<std::vector<NuscenesRay>> rays;  ///< [sweep] column by column, 32 from the lowest beam up

    /// Writes a new temporary folder.
    /// @param columns columns per turn
    explicit NuscenesFolder(const std::string& name, int columns = 360);

    std::filesystem::path table(const std::string& name) const {
        return folder / "v1.0-mini" / (name + ".json");
    }
    std::filesystem::path sweep(int number) const;
    /// Returns the pose of the vehicle in the map frame. Times are relative to the
    /// scene's first sweep.
    static Pose compute_vehicle_pose(double time_s);
    static Pose box_at(double time_s);
};

}  // namespace relidar::test
