// SPDX-License-Identifier: Apache-2.0
#include "traffic.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/assets.hpp>
#include "base/fail.hpp"

#include "frame.hpp"

namespace relidar::view {
namespace {

constexpr double kRadians = kPi / 180.0;

NewActorMotion make_motion_of_copied_actor(const ActorEdits::ActorCopy& copy,
                                           const glm::dvec3& world_offset_m) {
    const auto& at = copy.at;
    NewActorMotion start{
        {make_rotation(at[3] * kRadians, at[4] * kRadians, at[5] * kRadians), {at[0], at[1], at[2]}}, at[6]};
    start.dataset_from_box.translation += world_offset_m;
    return start;
}

SceneWithLog apply_actor_moves_to_tracks(SceneWithLog scene_with_log, const ActorEdits& edits) {
    for (const auto& [track, by] : edits.moves) {
        const Pose pose{make_rotation(by[3] * kRadians, 0.0, 0.0), {by[0], by[1], by[2]}};
        scene_with_log = move_track(std::move(scene_with_log), track, pose);
    }
    return scene_with_log;
}

/// Without scans and surfels.
SceneWithLog copy_tracks_and_instances(const TrainedRun& run) {
    SceneWithLog driving{copy_scene_without_surfels(run.scene), run.sequence};
    for (SurfelModel& model : driving.scene.models) model.first = model.count = 0;
    return driving;
}

const TrainedRun& get_other_run_by_name(const std::string& run_name, const OtherRunsByName& other_runs) {
    const auto match = other_runs.find(run_name);
    if (match == other_runs.end())
        fail<UsageError>("cannot insert an actor from \"{}\": expected a run of `relidar view --insert`",
                         run_name);
    return match->second;
}

/// @param get_scene_with_log_of_run with or without surfels
SceneWithLog copy_actors_from_this_or_other_run(
    SceneWithLog scene_with_log, const OtherRunsByName& other_runs,
    const std::vector<ActorEdits::ActorCopy>& copies,
    SceneWithLog (*get_scene_with_log_of_run)(const TrainedRun&)) {
    for (const ActorEdits::ActorCopy& copy : copies) {
        const NewActorMotion start =
            make_motion_of_copied_actor(copy, scene_with_log.sequence.world_offset_m);
        if (copy.from.empty()) scene_with_log = copy_track(std::move(scene_with_log), copy.of, start);
        else
            scene_with_log = insert_track(
                std::move(scene_with_log),
                get_scene_with_log_of_run(get_other_run_by_name(copy.from, other_runs)), copy.of, start);
    }
    return scene_with_log;
}

void require_tracks_exist(const SceneWithLog& scene_with_log, const std::set<std::string>& track_names) {
    const std::vector<std::string> names(track_names.begin(), track_names.end());
    // Called only for its error, which suggests a similar name if a name is unknown.
    (void)mark_instances_with_names(scene_with_log.scene, names);
}

/// In the form that `relidar edit` writes.
std::vector<EditHistoryEntry> convert_edits_to_history_entries(const TrainedRun& run,
                                                               const OtherRunsByName& other_runs,
                                                               const ActorEdits& edits) {
    const auto folder_of = [](const TrainedRun& r) {
        return std::filesystem::absolute(r.folder).lexically_normal().string();
    };
    const std::string origin = folder_of(run);
    std::vector<EditHistoryEntry> result;
    for (const ActorEdits::ActorCopy& copy : edits.copies) {
        const NewActorMotion start = make_motion_of_copied_actor(copy, run.sequence.world_offset_m);
        const glm::dvec3& p = start.dataset_from_box.translation;
        const std::string what =
            copy.from.empty()
                ? "--copy "
                : fmt::format("--insert {}#", folder_of(get_other_run_by_name(copy.from, other_runs)));
        result.push_back({origin, fmt::format("{}{}@{},{},{},{},{},{}:{}", what, copy.of, p.x, p.y, p.z,
                                              copy.at[3], copy.at[4], copy.at[5], copy.at[6])});
    }
    for (const auto& [track, by] : edits.moves)
        result.push_back({origin, fmt::format("--move {}:{},{},{},{}", track, by[0], by[1], by[2], by[3])});
    for (const std::string& track : edits.removed) result.push_back({origin, "--remove " + track});
    return result;
}

}  // namespace

SceneWithLog add_copied_actors_with_surfels(SceneWithLog scene_with_log, const OtherRunsByName& other_runs,
                                            const std::vector<ActorEdits::ActorCopy>& copies) {
    return copy_actors_from_this_or_other_run(std::move(scene_with_log), other_runs, copies,
                                              [](const TrainedRun& run) { return run.copy_driving_scene(); });
}

ActorEdits::ActorCopy make_actor_copy_on_ground(const TrainedRun& run, const OtherRunsByName& other_runs,
                                                const GroundPoseRequest& request) {
    const TrainedRun& owner = request.from.empty() ? run : get_other_run_by_name(request.from, other_runs);
    const glm::dvec3& offset_m = run.sequence.world_offset_m;
    GroundPlacement placement{{request.at[0] + offset_m.x, request.at[1] + offset_m.y}};
    placement.clearance_m = read_asset_ground_clearance(owner);
    const Pose pose = compute_motion_on_ground({run.scene, run.sequence}, placement,
                                               {owner.scene, owner.sequence}, request.of)
                          .dataset_from_box;
    // yaw, pitch and roll; make_rotation() is the inverse of this conversion
    const glm::dmat3 rotation = glm::mat3_cast(pose.rotation);
    const glm::dvec3 angles_rad{std::atan2(rotation[0][1], rotation[0][0]),
                                std::asin(std::clamp(-rotation[0][2], -1.0, 1.0)),
                                std::atan2(rotation[1][2], rotation[2][2])};
    const glm::dvec3 p = pose.translation - offset_m, angles_deg = angles_rad / kRadians;
    return {request.of, request.from, {p.x, p.y, p.z, angles_deg.x, angles_deg.y, angles_deg.z, 0.0}};
}

EditedTraffic::EditedTraffic(const TrainedRun& run, const OtherRunsByName& other_runs,
                             const ActorEdits& edits)
    : driving_(apply_actor_moves_to_tracks(
          copy_actors_from_this_or_other_run(copy_tracks_and_instances(run), other_runs, edits.copies,
                                             copy_tracks_and_instances),
          edits)),
      edits_(edits) {
    require_tracks_exist(driving_, edits.removed);
    require_tracks_exist(driving_, edits.hidden);
}

ActorTracksByName EditedTraffic::get_poses_of_visible_actors(double time_s) const {
    ActorTracksByName poses;
    for (const BoxTrack& box : driving_.sequence.boxes) {
        const auto has_surfels = [&](const ModelInstance& i) {
            return !i.track.empty() && i.track == box.id;
        };
        if (!is_actor_neither_removed_nor_hidden(box) || !box.is_observed_at_time(time_s) ||
            std::none_of(get_instances().begin(), get_instances().end(), has_surfels))
            continue;
        poses[box.id] = add_offset_to_track_positions(box.world_from_box, driving_.sequence.world_offset_m);
    }
    return poses;
}

nlohmann::json EditedTraffic::list_actors_as_json(double time_s) const {
    nlohmann::json actors = nlohmann::json::array();
    for (const ModelInstance& instance : get_instances()) {
        const BoxTrack* box = find_box_track_by_id(driving_.sequence, instance.track);
        if (!box) continue;
        actors.push_back(
            {{"track", box->id},
             {"category", box->category},
             {"size", {box->size_m.x, box->size_m.y, box->size_m.z}},
             {"present", box->is_observed_at_time(time_s)},
             {"pose", convert_pose_to_column_major_json(box->world_from_box.interpolate_pose(time_s))}});
    }
    return actors;
}

TrainedRun apply_edits_to_copy_of_run(const TrainedRun& run, const OtherRunsByName& other_runs,
                                      const ActorEdits& edits) {
    TrainedRun result = run;
    SceneWithLog driving = apply_actor_moves_to_tracks(
        add_copied_actors_with_surfels({result.scene, result.sequence}, other_runs, edits.copies), edits);
    for (const std::string& track : edits.removed) driving = remove_track(std::move(driving), track);
    result.replace_driving_scene(std::move(driving));
    const std::vector<EditHistoryEntry> done = convert_edits_to_history_entries(run, other_runs, edits);
    result.edits.insert(result.edits.end(), done.begin(), done.end());
    return result;
}

}  // namespace relidar::view
