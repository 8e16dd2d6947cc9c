// SPDX-License-Identifier: Apache-2.0
// A truck in the yard. Its two LiDARs differ in beams, pose rates and time stamps.
#pragma once

#include "support/logs.hpp"

namespace relidar::test {

/// A single firing of a laser.
struct TruckRay {
    double time_s = 0.0;       ///< relative to the first sweep of LIDAR_LEFT
    glm::dvec3 origin_m{0.0};  ///< in the world, like the other points
    glm::dvec3 point_m{0.0};
    bool returned = false;
};

struct TruckScenesFolder : LogFolder {
    static constexpr int kSweeps = 11;  ///< every fifth sweep is a keyframe
    static constexpr int kMissing = 4;  ///< sweep that LIDAR_TOP_FRONT lacks
    static constexpr int kColumns = 400;
    /// delay of the time stamps of LIDAR_TOP_FRONT relative to LIDAR_LEFT
    static constexpr double kSweep_s = 0.1, kLater_s = 0.007;

    struct Lidar {
        std::string channel;
        Pose mounted;
        std::vector<double> elevations_deg;       ///< highest first
        std::vector<std::vector<TruckRay>> rays;  ///< [sweep] column by column, highest beam first
    };

    std::vector<Lidar> lidars;  ///< LIDAR_LEFT, LIDAR_TOP_FRONT

    explicit TruckScenesFolder(const std::string& name);

    std::filesystem::path table(const std::string& name) const {
        return folder / "v1.2-trainval" / (name + ".json");
    }
    std::filesystem::path sweep(const std::string& channel, int number) const;
    /// Times are relative to the first sweep of LIDAR_LEFT.
    static Pose compute_vehicle_pose(double time_s);
    static Pose box_at(double time_s);

private:
    void write_clouds(Lidar& lidar, double later_s) const;
    void write_tables() const;
};

}  // namespace relidar::test
