// SPDX-License-Identifier: Apache-2.0
// A small Argoverse 2 log written by the tests: two virtual VLP-32C on a vehicle that
// drives and turns between four walls, their points brought to the time of each sweep as
// the dataset does.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include "base/codecs/feather_writer.hpp"

namespace relidar::test {

/// Rows of a pose table: quaternion and translation columns.
std::vector<FeatherColumn> pose_columns(const std::vector<Pose>& poses);
/// These columns and those of the poses.
std::vector<FeatherColumn> with_poses(std::vector<FeatherColumn> columns, const std::vector<Pose>& poses);

struct Argoverse2Options {
    /// coordinates as the dataset has them; else single precision, so that truth can be
    /// compared
    bool half_precision = false;
    bool lower_half_up = false;  ///< lasers 32..63 are the upper LiDAR's
    int sweeps = 3;
    int firings = 1813;  ///< of each LiDAR in a sweep: more than a turn
    FeatherCodec codec = FeatherCodec::lz4;
};

/// One firing of one laser.
struct Argoverse2Ray {
    double elevation_rad = 0.0;  ///< in the LiDAR's own frame
    double time_s = 0.0;         ///< after the sweep's
    glm::dvec3 origin_m{0.0};    ///< city frame
    glm::dvec3 direction{0.0};   ///< of its LiDAR's frame at that moment
    glm::dvec3 point_m{0.0};     ///< city frame
    bool returned = false;
};

struct Argoverse2Log {
    static constexpr std::int64_t kFirstSweep_ns = 315966265259836000;

    std::filesystem::path folder;
    std::array<Pose, 2> vehicle_from_lidar;                       ///< up, down
    std::vector<std::array<std::vector<Argoverse2Ray>, 2>> rays;  ///< [sweep][up, down] all that were fired

    /// Writes a log into a fresh folder under the tests' temporary one.
    explicit Argoverse2Log(const std::string& name, const Argoverse2Options& options = {});
    ~Argoverse2Log();
    Argoverse2Log(const Argoverse2Log&) = delete;
    Argoverse2Log& operator=(const Argoverse2Log&) = delete;

    static std::int64_t sweep_ns(int sweep) { return kFirstSweep_ns + sweep * 100'252'000; }
    std::filesystem::path sweep(int number) const;
    std::filesystem::path file(const std::string& relative) const { return folder / relative; }
    /// Pose of the vehicle, city frame. @param time_s after the first sweep
    static Pose vehicle_at(double time_s);
    /// The one labelled box: its centre goes with the vehicle's x axis of time 0.
    static Pose box_at(double time_s);
};

}  // namespace relidar::test
