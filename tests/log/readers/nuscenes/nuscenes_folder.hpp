// SPDX-License-Identifier: Apache-2.0
// A small nuScenes folder written by the tests: two scenes, the second of which is driven
// through with a virtual HDL-32E in a walled yard.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>

namespace relidar::test {

/// One firing of one laser.
struct NuscenesRay {
    double time_s = 0.0;        ///< after the scene's first sweep
    glm::dvec3 origin_m{0.0};   ///< map frame
    glm::dvec3 direction{0.0};  ///< of the LiDAR's frame at that moment: x forward, y left, z up
    glm::dvec3 point_m{0.0};    ///< map frame
    bool returned = false;
};

struct NuscenesFolder {
    static constexpr int kSweeps = 11;  ///< every tenth a keyframe
    static constexpr double kSweep_s = 0.05;

    std::filesystem::path folder;
    int columns = 0;
    std::vector<std::vector<NuscenesRay>> rays;  ///< [sweep] column by column, 32 from the lowest beam up

    /// Writes a folder of its own under the tests' temporary one. @param columns  of a
    /// turn
    explicit NuscenesFolder(const std::string& name, int columns = 360);
    ~NuscenesFolder();
    NuscenesFolder(const NuscenesFolder&) = delete;
    NuscenesFolder& operator=(const NuscenesFolder&) = delete;

    std::filesystem::path table(const std::string& name) const {
        return folder / "v1.0-mini" / (name + ".json");
    }
    std::filesystem::path sweep(int number) const;
    /// Poses in the map's frame; times after the scene's first sweep.
    static Pose vehicle_at(double time_s);
    static Pose box_at(double time_s);
};

}  // namespace relidar::test
