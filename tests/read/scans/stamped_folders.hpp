// SPDX-License-Identifier: Apache-2.0
// A vehicle drives a bend through the yard. Every point is measured from the pose at its
// time. Axes, names, times and poses follow each dataset.
#pragma once

#include "support/logs.hpp"

namespace relidar::test {

/// A single firing of a laser.
struct StampedRay {
    double time_s = 0.0;       ///< relative to the first scan
    glm::dvec3 origin_m{0.0};  ///< in the world, like point_m
    glm::dvec3 point_m{0.0};
    glm::vec3 local_m{0.0f};  ///< in the LiDAR's frame, with the dataset's axes
    bool returned = false;
};

/// Simulates a drive on a level road with a tilted vehicle and its LiDAR.
struct StampedDrive {
    double speed_mps = 8.0, rate_rad_s = 0.3, heading_rad = 0.4, pitch_rad = 0.0, roll_rad = 0.0;
    glm::dvec3 start_m{0.0};  ///< start in the yard
    glm::dvec3 world_m{0.0};  ///< position of the yard
    Pose vehicle_from_lidar;  ///< with the dataset's axes
    std::vector<Beam> beams;  ///< highest beam first
    int columns = 0, n_scans = 0;
    /// A turn takes 0.1 s, and the time stamp is in its middle.
    double step_s = 0.1;
    double first_azimuth_rad = kPi;                  ///< in the LiDAR's frame
    std::vector<std::vector<StampedRay>> rays = {};  ///< [scan] column by column

    Pose compute_vehicle_pose(double time_s) const;
    Pose compute_lidar_pose_at(double time_s) const {
        return compute_vehicle_pose(time_s) * vehicle_from_lidar;
    }
    void cast();
    std::size_t count_returns(int scan) const;
};

struct StampedFolder : LogFolder {
    StampedDrive drive;

    using LogFolder::LogFolder;
};

/// Largest errors of returns, and their intensity.
struct StampedTolerance {
    double origin_m, point_m;
    float intensity;
};
/// Checks that every return is at the point where its ray hit the yard, and that no
/// return is lost. Scans are 0.1 s apart.
void expect_truth(const StampedDrive& drive, const Log& log, const StampedTolerance& tolerance);
void expect_elevations(const StampedDrive& drive, const SpinningSensor& sensor);

/// 128 beams. Laser numbers are not sorted by elevation. The LiDAR is turned 42.6 degrees
/// to the right. Poses continue for 40 s after the scans, twice around the yard.
struct BoreasFolder : StampedFolder {
    static constexpr std::int64_t kFirst_us = 1606417097528152;
    static constexpr int kScans = 6;

    /// @param angles rotation order: 0 as Boreas documents it, 1 the common order, 2 and
    /// 3 the same with roll and yaw exchanged
    explicit BoreasFolder(const std::string& name, int angles = 0, int columns = 360);
    static std::int64_t stamp(int scan) { return kFirst_us + scan * 100000; }
    std::filesystem::path scan(int number) const {
        return folder / "lidar" / (std::to_string(stamp(number)) + ".bin");
    }
    std::filesystem::path poses() const { return folder / "applanix/lidar_poses.csv"; }
    std::filesystem::path calibration() const { return folder / "calib/T_applanix_lidar.txt"; }
    static int find_laser(std::size_t beam) { return int(beam * 37 + 11) % 128; }
};

/// 64 x 1024 points, starting backward. The poses do not enclose the first scan.
struct MulranFolder : StampedFolder {
    static constexpr std::int64_t kFirst_ns = 1561000444390857630;
    static constexpr int kScans = 4;

    /// @param by_column true if points in files are ordered by column, otherwise by ring
    explicit MulranFolder(const std::string& name, bool by_column = true);
    static std::int64_t stamp(int scan) { return kFirst_ns + scan * std::int64_t(100000000); }
    std::filesystem::path scan(int number) const {
        return folder / "Ouster" / (std::to_string(stamp(number)) + ".bin");
    }
    std::filesystem::path poses() const { return folder / "global_pose.csv"; }
};

/// 40 beams, two scans per second, without point times.
struct OnceFolder : StampedFolder {
    static constexpr std::int64_t kFirst_ms = 1616535966200;
    static constexpr int kScans = 4;

    /// @param w_first true if w is the first component of quaternions
    explicit OnceFolder(const std::string& name, bool w_first = false, int columns = 900);
    static std::int64_t stamp(int scan) { return kFirst_ms + scan * 500; }
    std::filesystem::path scan(int number) const {
        return folder / "lidar_roof" / (std::to_string(stamp(number)) + ".bin");
    }
    std::filesystem::path json() const { return folder / (folder.filename().string() + ".json"); }
};

double measure_distance_to_yard_m(const glm::dvec3& point_m);

}  // namespace relidar::test
