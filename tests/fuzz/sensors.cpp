// SPDX-License-Identifier: Apache-2.0
// Sensors and rigs. The first byte of an input to "sensors" selects the extension.
#include "harness.hpp"

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/log/sensor_files.hpp>

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr const char* kEndings[] = {"csv", "json", "npz"};
constexpr std::size_t kMostMade = 20000;  // maximum number of rays that the test also creates

void make(const SensorModel& sensor) {
    const std::size_t n = summarise_pattern(sensor.pattern).n_rays;
    if (n <= kMostMade) make_rays(sensor, 0.3);
}

void read_sensors(std::string_view input, const fs::path& folder) {
    if (input.empty()) return;
    const fs::path file =
        folder / fmt::format("sensor.{}", kEndings[static_cast<unsigned char>(input[0]) % 3]);
    put(file, input.substr(1));
    make(find_sensor(file.string()));
}

std::string make_npz_seed(const fs::path& folder) {
    const float directions[6] = {1.0f, 0.0f, 0.0f, 0.0f, 1.0f, 0.0f}, times[2] = {0.0f, 0.01f};
    const std::uint16_t ring[2] = {0, 1};
    write_npz(folder / "seed.npz", {make_array("directions", {2, 3}, directions, 6),
                                    make_array("time", {2}, times, 2), make_array("ring", {2}, ring, 2)});
    return read_contents(folder / "seed.npz");
}

std::vector<std::string> make_sensor_seeds(const fs::path& folder) {
    const auto seed = [](char ending, const std::string& bytes) { return ending + bytes; };
    return {
        seed(0, "elevation_deg,azimuth_offset_deg,firing_offset_us\n2.0,-1.5,3\n-3,0.5,0\n"),
        seed(0, "azimuth_deg,elevation_deg,time_s,channel,divergence_mrad\n1,2,0.01,0,3\n2,2,0.02,1,4\n"),
        seed(
            1,
            R"({"directions": [[[1,0,0],[0,1,0]]], "origin": [0,0,0,0,0,1], "time": [0,1], "ring": [0,1], "max_range_m": 9})"),
        seed(
            1,
            R"({"beam_altitude_angles": [3,1], "beam_azimuth_angles": [1,-1], "lidar_origin_to_beam_origin_mm": 15.8,
                        "lidar_mode": "512x10", "prod_line": "OS-1-128"})"),
        seed(
            1,
            R"({"window": {"rows": 3, "columns": 5, "left_deg": 40, "right_deg": -40, "top_deg": 10, "bottom_deg": -10,
                        "period_s": 0.05, "divergence_mrad": 2, "min_range_m": 1, "max_range_m": 90}})"),
        seed(1, R"({"rosette": {"rays": 100, "deflection_deg": 9, "first_hz": 3, "second_hz": -2}})"),
        seed(2, make_npz_seed(folder))};
}

void read_rig(std::string_view input, const fs::path& folder) {
    put(folder / "near.csv", "elevation_deg\n5\n-5\n");
    put(folder / "rig.json", input);
    const auto rig = read_sensor_rig((folder / "rig.json").string());
    for (std::size_t i = 0; rig && i < std::min<std::size_t>(rig->size(), 3); ++i) make((*rig)[i].sensor);
}

std::vector<std::string> make_rig_seeds(const fs::path&) {
    return {
        R"({"sensors": [{"name": "top", "sensor": "VLP-16:90x20"}, {"name": "left", "sensor": "near.csv:36x10", "returns": 2,
                "translation_m": [1, 2, 3], "yaw_pitch_roll_deg": [90, 0, 180]}]})"};
}

}  // namespace

std::vector<Harness> list_sensor_harnesses() {
    return {{"sensors", make_sensor_seeds, read_sensors}, {"rig", make_rig_seeds, read_rig}};
}

}  // namespace relidar::fuzz
