// SPDX-License-Identifier: Apache-2.0
#include "render/selection.hpp"

#include <fstream>
#include <numeric>
#include <sstream>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

std::optional<SpinningSensor> as_spinning(const SensorModel& model) {
    const auto* spinning = std::get_if<SpinningSensor>(&model.pattern);
    return spinning ? std::optional(*spinning) : std::nullopt;
}

std::optional<SpinningSensor> spinning_sensor_of(const std::string& name, const SimulatedSensor& simulated) {
    if (simulated.is_log_lidar || simulated.grid || simulated.pattern) return std::nullopt;
    return as_spinning(find_sensor(name));
}

std::vector<int> all_frames(const Run& run) {
    std::vector<int> positions(run.sequence.frames.size());
    std::iota(positions.begin(), positions.end(), 0);
    return positions;
}

}  // namespace

std::vector<int> select_frames(const Run& run, const std::optional<std::string>& frames_text, bool quiet) {
    if (!frames_text && run.split.test.empty()) {
        if (!quiet)
            print_note(fmt::format("{} has no held-out frames, so all {} frames are rendered instead",
                                   run.folder.string(), run.sequence.frames.size()));
        return all_frames(run);
    }
    const std::string which = frames_text.value_or("test");
    // Empty for a range of frame numbers.
    const std::string name = find_name(which, {"test", "train", "all"}).value_or("");
    std::vector<int> positions;
    if (name == "all") positions = all_frames(run);
    else positions = name == "train" ? run.split.train : run.split.test;
    const int last = run.sequence.frames.back().index;
    if (name.empty()) {
        const FrameRange range = parse_frames(which);
        positions = all_frames(run);
        std::erase_if(positions, [&](int i) {
            const int index = run.sequence.frames[static_cast<std::size_t>(i)].index;
            return index < range.begin || (range.end >= 0 && index >= range.end);
        });
        if (!positions.empty()) note_missing_frames(range, last, run.folder.string());
    }
    if (positions.empty()) {
        fail<UsageError>(
            "--frames {} selects no frame of {}; expected frame numbers from {} to {}, or test, train or all",
            which, run.folder.string(), run.sequence.frames.front().index, last);
    }
    return positions;
}

std::vector<MountedSimulatedSensor> list_sensors(const std::string& name, const SensorRig& rig,
                                                 const Run& run, int lidar) {
    if (name.empty()) return {{"", make_sensor(run.config, run.sequence, lidar), {}}};
    if (!rig) {
        const SimulatedSensor choice = choose_sensor(name, run.config, run.sequence, lidar);
        return {{"", choice, {}, spinning_sensor_of(name, choice)}};
    }
    std::vector<MountedSimulatedSensor> targets;
    for (const MountedSensor& mounted : *rig)
        targets.push_back({mounted.name, simulate_sensor(mounted, lidar), mounted.rig_from_sensor,
                           as_spinning(mounted.sensor)});
    return targets;
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
        for (std::size_t i = 0; i < shown.size(); ++i)
            if (run.scene.instances[i].track == box.id) return !shown[i];
        // No instance has this track, so the actor is not rendered.
        return true;
    });
}

}  // namespace relidar::cli
