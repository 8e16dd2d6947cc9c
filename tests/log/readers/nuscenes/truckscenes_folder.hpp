// SPDX-License-Identifier: Apache-2.0
// A small TruckScenes folder written by the tests: a truck with two LiDARs of other
// beams, rates of poses and stamps, in a walled yard.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>

namespace relidar::test {

/// One firing of one laser.
struct TruckRay {
    double time_s = 0.0;       ///< after the first sweep of LIDAR_LEFT
    glm::dvec3 origin_m{0.0};  ///< of the world, as all others
    glm::dvec3 point_m{0.0};
    bool returned = false;
};

struct TruckScenesFolder {
    static constexpr int kSweeps = 11;  ///< every fifth a keyframe
    static constexpr int kMissing = 4;  ///< sweep that LIDAR_TOP_FRONT lacks
    static constexpr int kColumns = 400;
    /// LIDAR_TOP_FRONT's stamps after LIDAR_LEFT's
    static constexpr double kSweep_s = 0.1, kLater_s = 0.007;

    struct Lidar {
        std::string channel;
        Pose mounted;
        std::vector<double> elevations_deg;       ///< from the highest down
        std::vector<std::vector<TruckRay>> rays;  ///< [sweep] column by column, beams from the highest down
    };

    std::filesystem::path folder;
    std::vector<Lidar> lidars;  ///< LIDAR_LEFT, LIDAR_TOP_FRONT

    /// Writes a folder of its own under the tests' temporary one.
    explicit TruckScenesFolder(const std::string& name);
    ~TruckScenesFolder();
    TruckScenesFolder(const TruckScenesFolder&) = delete;
    TruckScenesFolder& operator=(const TruckScenesFolder&) = delete;

    std::filesystem::path table(const std::string& name) const {
        return folder / "v1.2-trainval" / (name + ".json");
    }
    std::filesystem::path sweep(const std::string& channel, int number) const;
    /// Poses in the world; times after the first sweep of LIDAR_LEFT.
    static Pose vehicle_at(double time_s);
    static Pose box_at(double time_s);

private:
    void write_clouds(Lidar& lidar, double later_s) const;
    void write_tables() const;
};

}  // namespace relidar::test
