// SPDX-License-Identifier: Apache-2.0
#include "traffic.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/edit.hpp>
#include <relidar/error.hpp>
#include <relidar/run.hpp>

#include "frame.hpp"

namespace relidar::view {
namespace {

constexpr double kRadians = kPi / 180.0;

Pose upright(const double* xyz, double yaw_deg) { return {rotation_of(yaw_deg * kRadians, 0.0, 0.0), {xyz[0], xyz[1], xyz[2]}}; }

Start start_of(const ActorEdits::Copy& copy, const glm::dvec3& world_offset_m) {
    Start start{upright(copy.at.data(), copy.at[3]), copy.at[4]};
    start.dataset_from_box.translation += world_offset_m;
    return start;
}

DrivingScene with_moves(DrivingScene driving, const ActorEdits& edits) {
    for (const auto& [track, by] : edits.moves) driving = move_track(std::move(driving), track, upright(by.data(), by[3]));
    return driving;
}

/// A run's tracks and instances; its frames have no scans.
DrivingScene layout(const Run& run) { return {layout_of(run.scene), run.sequence}; }

void check_known(const DrivingScene& driving, const std::set<std::string>& tracks) {
    const std::vector<std::string> names(tracks.begin(), tracks.end());
    (void)select_instances(driving.scene, names);   // throws with the nearest name
}

/// Edits as `relidar edit` takes them, for the history of the run.
std::vector<RunEdit> history(const Run& run, const ActorEdits& edits) {
    const std::string origin = std::filesystem::absolute(run.folder).lexically_normal().string();
    std::vector<RunEdit> result;
    for (const ActorEdits::Copy& copy : edits.copies) {
        const Start start = start_of(copy, run.sequence.world_offset_m);
        const glm::dvec3& p = start.dataset_from_box.translation;
        result.push_back({origin, fmt::format("--copy {}@{},{},{},{}:{}", copy.of, p.x, p.y, p.z, copy.at[3], copy.at[4])});
    }
    for (const auto& [track, by] : edits.moves)
        result.push_back({origin, fmt::format("--move {}:{},{},{},{}", track, by[0], by[1], by[2], by[3])});
    for (const std::string& track : edits.removed) result.push_back({origin, "--remove " + track});
    return result;
}

}  // namespace

DrivingScene with_copies(DrivingScene driving, const std::vector<ActorEdits::Copy>& copies) {
    for (const ActorEdits::Copy& copy : copies) {
        const Start start = start_of(copy, driving.sequence.world_offset_m);
        driving = copy_track(std::move(driving), copy.of, start);
    }
    return driving;
}

Traffic::Traffic(const Run& run, const ActorEdits& edits)
    : driving_(with_moves(with_copies(layout(run), edits.copies), edits)), edits_(edits) {
    check_known(driving_, edits.removed);
    check_known(driving_, edits.hidden);
}

ActorPoses Traffic::placed(double time_s) const {
    ActorPoses poses;
    for (const BoxTrack& box : driving_.sequence.boxes) {
        const auto has_surfels = [&](const Instance& i) { return !i.track.empty() && i.track == box.id; };
        if (!is_shown(box) || !box.present(time_s) || std::none_of(instances().begin(), instances().end(), has_surfels)) continue;
        poses[box.id] = shifted_track(box.world_from_box, driving_.sequence.world_offset_m);
    }
    return poses;
}

nlohmann::json Traffic::describe(double time_s) const {
    nlohmann::json actors = nlohmann::json::array();
    for (const Instance& instance : instances()) {
        const auto box = std::find_if(driving_.sequence.boxes.begin(), driving_.sequence.boxes.end(),
                                      [&](const BoxTrack& b) { return !instance.track.empty() && b.id == instance.track; });
        if (box == driving_.sequence.boxes.end()) continue;
        actors.push_back({{"track", box->id},
                          {"category", box->category},
                          {"size", {box->size_m.x, box->size_m.y, box->size_m.z}},
                          {"present", box->present(time_s)},
                          {"pose", matrix_json(box->world_from_box.at(time_s))}});
    }
    return actors;
}

Run edited_run(const Run& run, const ActorEdits& edits) {
    Run result = run;
    DrivingScene driving = with_moves(with_copies({result.scene, result.sequence}, edits.copies), edits);
    for (const std::string& track : edits.removed) driving = remove_track(std::move(driving), track);
    result.replace(std::move(driving));
    const std::vector<RunEdit> done = history(run, edits);
    result.edits.insert(result.edits.end(), done.begin(), done.end());
    return result;
}

}  // namespace relidar::view
