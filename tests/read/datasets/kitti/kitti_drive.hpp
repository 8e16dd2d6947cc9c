// SPDX-License-Identifier: Apache-2.0
// A virtual HDL-64E (two optical centres, azimuth and left offsets, encoder ticks of 0.09
// degrees) scans wavy walls. As in KITTI, coordinates are rounded to millimetres and
// stored by ring.
#pragma once

#include "support/logs.hpp"

namespace relidar::test {

/// Encoder positions of the firings: at ticks, at even steps, or at random near them.
enum class Heads { ticks, even, jittered };

struct KittiDrive : LogFolder {
    static constexpr int kFirings = 701;

    std::vector<Beam> beams;          ///< the 64 exact beams
    std::vector<glm::dvec3> dropped;  ///< exact direction of each ray without a return in frame 0
    std::size_t n_points = 0;         ///< in frame 0

    explicit KittiDrive(const std::string& name, Heads heads = Heads::ticks);

    std::filesystem::path file(const std::string& relative) const { return folder / relative; }
    std::filesystem::path scan(int frame) const;
    std::filesystem::path calibration() const { return folder.parent_path() / "calib_imu_to_velo.txt"; }
};

}  // namespace relidar::test
