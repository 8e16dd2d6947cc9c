// SPDX-License-Identifier: Apache-2.0
// Two virtual VLP-32C on a vehicle that turns between four walls. As in the dataset,
// points are motion-compensated to the time of each sweep.
#pragma once

#include "base/codecs/feather_writer.hpp"
#include "read/datasets/street/yard.hpp"
#include "support/logs.hpp"

namespace relidar::test {

std::vector<FeatherColumn> set_poses(std::vector<FeatherColumn> columns, const std::vector<Pose>& poses);

struct Argoverse2Options {
    bool lower_half_up = false;  ///< lasers 32..63 belong to the upper LiDAR
    int sweeps = 3;
    int firings = 1813;  ///< number of firings of each LiDAR per sweep, which is more than a turn
    FeatherCodec codec = FeatherCodec::lz4;
};

struct Argoverse2Log : LogFolder {
    static constexpr std::int64_t kFirstSweep_ns = 315966265259836000;

    std::array<Pose, 2> vehicle_from_lidar;  ///< up, down
    std::vector<std::array<std::vector<YardRay>, 2>>
        rays;  ///< [sweep][up, down] all fired rays, time after the sweep

    explicit Argoverse2Log(const std::string& name, const Argoverse2Options& options = {});

    static std::int64_t sweep_ns(int sweep) { return kFirstSweep_ns + sweep * 100'252'000; }
    std::filesystem::path sweep(int number) const;
    std::filesystem::path file(const std::string& relative) const { return folder / relative; }
    /// @param time_s relative to the first sweep
    static Pose compute_vehicle_pose(double time_s);
    /// Its centre moves along the vehicle's x axis of time 0.
    static Pose compute_box_pose(double time_s);
};

}  // namespace relidar::test
