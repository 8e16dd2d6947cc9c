// SPDX-License-Identifier: Apache-2.0
#include "render/selection.hpp"

#include <algorithm>
#include <fstream>
#include <numeric>
#include <sstream>

#include <fmt/format.h>

#include <relidar/simulate/camera.hpp>
#include <relidar/simulate/log_body.hpp>
#include "base/fail.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

std::optional<SpinningSensor> as_spinning(const SensorModel& model) {
    const auto* spinning = std::get_if<SpinningSensor>(&model.pattern);
    return spinning ? std::optional(*spinning) : std::nullopt;
}

/// Returns the beams of a built-in spinning sensor, which packet formats need.
std::optional<SpinningSensor> spinning_sensor_of(const std::string& name, const SimulatedSensor& simulated) {
    if (simulated.is_log_lidar || simulated.grid || simulated.pattern) return std::nullopt;
    return as_spinning(find_sensor(name));
}

std::vector<int> all_frames(const Run& run) {
    std::vector<int> positions(run.log.frames.size());
    std::iota(positions.begin(), positions.end(), 0);
    return positions;
}

}  // namespace

std::vector<int> select_frames(const Run& run, const std::optional<std::string>& frames_text, bool quiet) {
    if (!frames_text && run.split.test.empty()) {
        if (!quiet)
            print_note(fmt::format("{} has no held-out frames, so all {} frames are rendered instead",
                                   run.folder.string(), run.log.frames.size()));
        return all_frames(run);
    }
    const std::string text = frames_text.value_or("test");
    const std::string name = find_name(text, {"test", "train", "all"}).value_or("");
    const std::vector<Frame>& frames = run.log.frames;
    std::vector<int> positions;
    if (name == "test") positions = run.split.test;
    else if (name == "train") positions = run.split.train;
    else positions = all_frames(run);
    if (name.empty()) {
        // The text is a range of frame numbers, without an upper limit if its end is -1.
        const FrameRange range = parse_frames(text);
        std::erase_if(positions, [&](int position) {
            const int number = frames[static_cast<std::size_t>(position)].index;
            return number < range.begin || (range.end >= 0 && number >= range.end);
        });
        if (!positions.empty()) note_missing_frames(range, frames.back().index, run.folder.string());
    }
    if (positions.empty())
        fail<UsageError>(
            "--frames {} selects no frame of {}; expected frame numbers from {} to {}, or test, train or all",
            text, run.folder.string(), frames.front().index, frames.back().index);
    return positions;
}

std::vector<double> times_of(const std::vector<NumberedScanTime>& sweeps) {
    std::vector<double> times_s;
    for (const NumberedScanTime& sweep : sweeps) times_s.push_back(sweep.time_s);
    return times_s;
}

std::vector<NumberedScanTime> sweeps_of_frames(const Run& run, const std::optional<std::string>& frames_text,
                                               int lidar, bool quiet) {
    std::vector<NumberedScanTime> sweeps;
    for (const int position : select_frames(run, frames_text, quiet)) {
        const Frame& frame = run.log.frames[static_cast<std::size_t>(position)];
        if (frame.lidar == lidar) sweeps.push_back({frame.index, frame.time_s});
    }
    if (sweeps.empty())
        fail<UsageError>(
            "--lidar {}: this LiDAR recorded none of the selected frames of the run {}; change --frames",
            run.log.lidars[static_cast<std::size_t>(lidar)].name, run.folder.string());
    return sweeps;
}

std::vector<RenderedSensor> list_sensors(const std::string& name, const SensorRig& rig, const Run& run,
                                         int lidar) {
    if (name.empty()) return {{.sensor = make_sensor(run.config, run.log, lidar)}};
    if (!rig) {
        const SimulatedSensor sensor = choose_sensor(name, run.config, run.log, lidar);
        return {{.sensor = sensor, .spinning = spinning_sensor_of(name, sensor)}};
    }
    std::vector<RenderedSensor> sensors;
    for (const MountedSensor& mounted : *rig)
        sensors.push_back({.folder = mounted.name,
                           .sensor = simulate_sensor(mounted, lidar),
                           .mounting = mounted.rig_from_sensor,
                           .spinning = as_spinning(mounted.sensor)});
    return sensors;
}

std::vector<RenderedSensor> list_cameras(const std::string& name, const Run& run, int lidar) {
    const Camera camera = choose_camera(name, run.log, lidar);
    return {
        {.sensor = camera_sensor(camera, run.config, run.log, lidar), .mounting = camera.rig_from_camera}};
}

std::int64_t largest_time_shift_ns(const Run& run, const std::vector<RenderedSensor>& sensors,
                                   const std::vector<NumberedScanTime>& sweeps) {
    const double first_s = std::ranges::min(sweeps, {}, &NumberedScanTime::time_s).time_s;
    std::int64_t shift_ns = 0;
    for (const RenderedSensor& target : sensors)
        shift_ns = std::max(shift_ns, time_shift_of(run, target.sensor, first_s));
    return shift_ns;
}

void add_log_body(std::vector<RenderedSensor>& sensors, const Run& run, int lidar, const Pose& offset) {
    constexpr double kSamePlace_m = 0.2;
    for (RenderedSensor& target : sensors) {
        if (target.sensor.is_log_lidar) continue;  // its own rays are blocked anyway
        const Pose lidar_from_sensor = offset * target.mounting;
        const VehicleBody seen = find_log_body(run, lidar, lidar_from_sensor);
        target.sensor.body.seen = seen.seen;
        target.sensor.body.seen_from_sensor = seen.seen_from_sensor;
        const double distance_m = glm::length(lidar_from_sensor.translation);
        if (seen.empty()) print_note("vehicle log: nothing blocks the rays of the log's LiDAR");
        else if (distance_m > kSamePlace_m)
            print_note(
                fmt::format("vehicle log: {} is {:.2f} m away from the log's LiDAR, but is blocked in "
                            "the same directions and at the same distances",
                            target.sensor.name, distance_m));
    }
}

std::string describe_inputs(const std::vector<std::string>& names_or_files) {
    std::ostringstream text;
    for (const std::string& name : names_or_files) {
        text << name << '\n';
        if (std::ifstream file(name); file.good() && file.peek() != EOF) text << file.rdbuf();
    }
    return text.str();
}

void remove_hidden_boxes(ScanOutputOptions& output, const Run& run, const std::vector<std::string>& visible) {
    if (visible.empty()) return;
    const std::vector<bool> shown = select_instances(run.scene, visible);
    // The first instance is the background, which contains all standing objects.
    if (!shown.front()) output.standing.clear();
    std::erase_if(output.actors, [&](const BoxTrack& box) {
        const auto& instances = run.scene.instances;
        const auto instance = std::ranges::find(instances, box.id, &ModelInstance::track);
        const bool is_rendered =
            instance != instances.end() && shown[std::size_t(instance - instances.begin())];
        return !is_rendered;
    });
}

}  // namespace relidar::cli
