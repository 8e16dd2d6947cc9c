// SPDX-License-Identifier: Apache-2.0
// A small KITTI raw drive written by the tests: a virtual HDL-64E (two optical centres,
// azimuth and left offsets, encoder ticks of 0.09 degrees) in a wavy room, coordinates
// rounded to millimetres and stored ring by ring as KITTI does.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sensor.hpp>

namespace relidar::test {

/// Where the heads of the virtual sweeps stand: on encoder ticks, at even steps, or
/// anywhere near even steps.
enum class Heads { ticks, even, jittered };

struct KittiDrive {
    static constexpr int kFirings = 701;

    std::filesystem::path folder;     ///< of the drive
    std::vector<Beam> beams;          ///< truth, 64
    std::vector<glm::dvec3> dropped;  ///< true direction of every ray of frame 0 without a return
    std::size_t n_points = 0;         ///< in frame 0

    /// Writes a drive of three frames into a fresh folder under the tests' temporary one.
    explicit KittiDrive(const std::string& name, Heads heads = Heads::ticks);
    ~KittiDrive();
    KittiDrive(const KittiDrive&) = delete;
    KittiDrive& operator=(const KittiDrive&) = delete;

    std::filesystem::path file(const std::string& relative) const { return folder / relative; }
    std::filesystem::path scan(int frame) const;
    std::filesystem::path calibration() const { return folder.parent_path() / "calib_imu_to_velo.txt"; }
};

void write_text(const std::filesystem::path& path, const std::string& text);
std::string read_text(const std::filesystem::path& path);

}  // namespace relidar::test
