// SPDX-License-Identifier: Apache-2.0
// Text files. toml.dict has the tokens of settings and streets.
#include "harness.hpp"

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/edit.hpp>

#include "run/files/example_run.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

void read_config(std::string_view input, const fs::path& folder) {
    put(folder / "config.toml", input);
    Config config;
    apply_file(config, folder / "config.toml");
}

void read_street(std::string_view input, const fs::path& folder) {
    put(folder / "street.toml", input);
    const StreetOptions street = load_street(folder);
    if (double(street.rows) * street.columns > 2000.0 && street.rows <= 256 && street.columns <= 8192) return;
    load_log("synthetic:" + folder.string(), {.frames = {0, 1}});
}

/// The harness "sweeps" reads the azimuths, which depend on the sensor of an input.
Run run_without_sweeps(const fs::path& folder) {
    Run run = make_example_run(folder);
    for (Frame& frame : run.log.frames) frame.azimuth_shift_rad.clear();
    return run;
}

void read_scene(std::string_view input, const fs::path& folder) {
    static const Run run = [&] {
        Run made = run_without_sweeps(folder / "run");
        save_run(made);
        return made;
    }();
    put(run.folder / "scene.json", input);
    const Run read = load_run(run.folder);
    const SpinningSensor& sensor = read.log.lidars[0].sensor;
    if (!sensor.beams.empty() && sensor.beams.size() * std::size_t(sensor.columns) < 10000) make_rays(sensor);
    for (const BoxTrack& box : read.log.boxes) (void)box.is_observed(read.log.frames[0].time_s);
    for (const Lidar& lidar : read.log.lidars)  // creates the rays only if their number is small
        if (lidar.pattern && std::holds_alternative<RayTable>(*lidar.pattern)) make_lidar_rays(lidar, 0.0);
    split_frames(read.log, 10);
}

std::vector<std::string> make_scene_seeds(const fs::path& folder) {
    save_run(run_without_sweeps(folder / "seed_run"));
    std::vector<std::string> seeds{read_contents(folder / "seed_run/scene.json")};
    Run fixed = run_without_sweeps(folder / "seed_run");
    fixed.log.lidars[0].sensor.beams.clear();
    fixed.log.lidars[0].sensor.columns = 0;
    for (const char* name : {"window-128", "rosette"}) {
        fixed.log.lidars[0].pattern = other_pattern(find_sensor(name));
        save_run(fixed);
        seeds.push_back(read_contents(folder / "seed_run/scene.json"));
    }
    return seeds;
}

constexpr const char* kSensorEndings[] = {"csv", "json", "npz"};
constexpr std::size_t kMostMade = 20000;  // maximum number of rays that the test also creates

void make(const SensorModel& sensor) {
    const std::size_t n = summarise_pattern(sensor.pattern).n_rays;
    if (n <= kMostMade) make_rays(sensor, 0.3);
}

void read_sensors(std::string_view input, const fs::path& folder) {
    if (input.empty()) return;
    const fs::path file =
        folder / fmt::format("sensor.{}", kSensorEndings[static_cast<unsigned char>(input[0]) % 3]);
    put(file, input.substr(1));
    make(find_sensor(file.string()));
}

void read_rig(std::string_view input, const fs::path& folder) {
    put(folder / "near.csv", "elevation_deg\n5\n-5\n");
    put(folder / "rig.json", input);
    const auto rig = read_sensor_rig((folder / "rig.json").string());
    for (std::size_t i = 0; rig && i < std::min<std::size_t>(rig->size(), 3); ++i) make((*rig)[i].sensor);
}

void read_track(std::string_view input, const fs::path& folder) {
    put(folder / "way.csv", input);
    const PoseTrack track = read_trajectory(folder / "way.csv");
    (void)track.pose_at(track.time_s.front() + 0.1);
}

}  // namespace

std::vector<Harness> list_text_harnesses() {
    return {
        {"config",
         [](const fs::path&) {
             return std::vector{to_toml(make_preset("quick")),
                                std::string("preset = \"paper\"\n[loss]\ndepth = 0.5\n")};
         },
         read_config},
        {"street", nullptr, read_street},
        {"scene", make_scene_seeds, read_scene},
        {"sensors", nullptr, read_sensors},
        {"rig", nullptr, read_rig},
        {"trajectory", nullptr, read_track},
    };
}

}  // namespace relidar::fuzz
