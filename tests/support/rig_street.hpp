// SPDX-License-Identifier: Apache-2.0
// Simulates a drive through the synthetic street with four different LiDARs. The first
// spins. The second scans a window with mirrors. The third scans a rosette. The fourth
// has wide beams and two returns.
#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include <relidar/read/dataset.hpp>

namespace relidar::test {

inline constexpr int kSpinning = 0, kWindow = 1, kRosette = 2, kTwoReturns = 3;

inline std::string write_rig(const std::filesystem::path& folder) {
    std::filesystem::create_directories(folder);
    std::ofstream beams(folder / "top.csv");
    beams << "elevation_deg\n";
    for (int i = 0; i < 24; ++i) beams << 3.0 - 28.0 * i / 23.0 << "\n";
    std::ofstream(folder / "front.json")
        << R"({"window": {"rows": 48, "columns": 240, "left_deg": 60, "right_deg": -60, "top_deg": 8,
        "bottom_deg": -16, "max_range_m": 100}})";
    std::ofstream(folder / "flower.json")
        << R"({"rosette": {"rays": 8000, "deflection_deg": 9.6, "first_hz": 121.57, "second_hz": -77.73,
        "min_range_m": 1, "max_range_m": 200}})";
    std::ofstream(folder / "wide.json")
        << R"({"window": {"rows": 32, "columns": 360, "left_deg": 180, "right_deg": -179, "top_deg": 6,
        "bottom_deg": -20, "divergence_mrad": 9}})";
    std::ofstream(folder / "rig.json") << R"({"sensors": [
        {"name": "top", "sensor": "top.csv:600x10", "translation_m": [0, 0, 0]},
        {"name": "front", "sensor": "front.json", "translation_m": [1.2, 0.3, -0.6]},
        {"name": "flower", "sensor": "flower.json", "translation_m": [1.0, -0.4, -0.2], "yaw_pitch_roll_deg": [15, 2, 0]},
        {"name": "wide", "sensor": "wide.json", "translation_m": [-0.8, 0, -0.3], "yaw_pitch_roll_deg": [-90, 0, 3], "returns": 2}]})";
    return (folder / "rig.json").string();
}

}  // namespace relidar::test
