// SPDX-License-Identifier: Apache-2.0
// Two scenes. In the second, a virtual HDL-32E drives through the yard.
#pragma once

#include "read/datasets/street/yard.hpp"
#include "support/logs.hpp"

namespace relidar::test {

std::string format_pose_keys(const Pose& pose);
void write_records(const std::filesystem::path& table, const std::vector<std::string>& records);

struct NuscenesFolder : LogFolder {
    static constexpr int kSweeps = 11;  ///< every tenth sweep is a keyframe
    static constexpr double kSweep_s = 0.05;

    int columns = 0;
    std::vector<std::vector<YardRay>> rays;  ///< [sweep] column by column, 32 from the lowest beam up

    explicit NuscenesFolder(const std::string& name, int columns = 360);

    std::filesystem::path table(const std::string& name) const {
        return folder / "v1.0-mini" / (name + ".json");
    }
    std::filesystem::path sweep(int number) const;
    /// Times are relative to the scene's first sweep.
    static Pose compute_vehicle_pose(double time_s);
    static Pose box_at(double time_s);
};

}  // namespace relidar::test
