// SPDX-License-Identifier: Apache-2.0
#include "traffic.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/run/edit.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/assets.hpp>
#include "base/fail.hpp"

#include "frame.hpp"

namespace relidar::view {
namespace {

constexpr double kRadPerDegree = kPi / 180.0;

/// Converts the start of a copy, which is x, y, z, yaw, pitch, roll and speed (see
/// ActorEdits), from relidar's world frame to the dataset's.
NewActorMotion copy_motion(const ActorEdits::ActorCopy& copy, const glm::dvec3& world_offset_m) {
    const auto& at = copy.at;
    NewActorMotion start{{make_rotation(at[3] * kRadPerDegree, at[4] * kRadPerDegree, at[5] * kRadPerDegree),
                          {at[0], at[1], at[2]}},
                         at[6]};
    start.dataset_from_box.translation += world_offset_m;
    return start;
}

SceneWithLog apply_moves(SceneWithLog scene, const ActorEdits& edits) {
    for (const auto& [track, shift] : edits.moves) {
        const Pose pose{make_rotation(shift[3] * kRadPerDegree, 0.0, 0.0), {shift[0], shift[1], shift[2]}};
        scene = move_track(std::move(scene), track, pose);
    }
    return scene;
}

/// Returns the scene and the log of a run without scans and surfels.
SceneWithLog copy_tracks(const Run& run) {
    SceneWithLog driving{strip_surfels(run.scene), run.log};
    for (SurfelModel& model : driving.scene.models) model.first = model.count = 0;
    driving.scene.blocks.clear();
    return driving;
}

const Run& find_other_run(const std::string& run_name, const OtherRunsByName& others) {
    const auto match = others.find(run_name);
    if (match == others.end())
        fail<UsageError>("cannot insert an actor from \"{}\": expected a run of `relidar view --insert`",
                         run_name);
    return match->second;
}

/// Adds a copy of an actor to the scene for each element of `copies`.
/// @param load_source returns the scene of another run, with or without surfels
SceneWithLog copy_actors(SceneWithLog scene, const OtherRunsByName& others,
                         const std::vector<ActorEdits::ActorCopy>& copies,
                         SceneWithLog (*load_source)(const Run&)) {
    for (const ActorEdits::ActorCopy& copy : copies) {
        const NewActorMotion start = copy_motion(copy, scene.log.world_offset_m);
        if (copy.from.empty()) {
            scene = copy_track(std::move(scene), copy.of, start);
        } else {
            const Run& source = find_other_run(copy.from, others);
            scene = insert_track(std::move(scene), load_source(source), copy.of, start);
        }
    }
    return scene;
}

void check_tracks(const SceneWithLog& scene, const std::set<std::string>& track_names) {
    const std::vector<std::string> names(track_names.begin(), track_names.end());
    // Called only for its error, which suggests a similar name if a name is unknown.
    (void)select_instances(scene.scene, names);
}

/// Returns yaw, pitch and roll in radians, the inverse of make_rotation():
/// R = Rz(yaw) Ry(pitch) Rx(roll).
glm::dvec3 rotation_angles(const glm::dquat& rotation) {
    // glm stores matrices by columns: m[c][r] is the element in row r and column c.
    const glm::dmat3 m = glm::mat3_cast(rotation);
    return {std::atan2(m[0][1], m[0][0]), std::asin(std::clamp(-m[0][2], -1.0, 1.0)),
            std::atan2(m[1][2], m[2][2])};
}

/// Converts the edits to the history of a saved run. An entry has the form of an option
/// of `relidar edit`, so that a user can repeat the edits.
std::vector<EditHistoryEntry> make_history(const Run& run, const OtherRunsByName& others,
                                           const ActorEdits& edits) {
    const auto folder_of = [](const Run& any_run) {
        return std::filesystem::absolute(any_run.folder).lexically_normal().string();
    };
    const std::string origin = folder_of(run);
    std::vector<EditHistoryEntry> history;
    for (const ActorEdits::ActorCopy& copy : edits.copies) {
        // Options have positions in the dataset's world frame.
        const glm::dvec3 p = copy_motion(copy, run.log.world_offset_m).dataset_from_box.translation;
        const double yaw_deg = copy.at[3], pitch_deg = copy.at[4], roll_deg = copy.at[5];
        const std::string start = fmt::format("{},{},{},{},{},{}:{}", p.x, p.y, p.z, yaw_deg, pitch_deg,
                                              roll_deg, /*speed_mps*/ copy.at[6]);
        const std::string actor =
            copy.from.empty()
                ? "--copy " + copy.of
                : fmt::format("--insert {}#{}", folder_of(find_other_run(copy.from, others)), copy.of);
        history.push_back({origin, actor + "@" + start});
    }
    for (const auto& [track, by] : edits.moves)
        history.push_back({origin, fmt::format("--move {}:{},{},{},{}", track, by[0], by[1], by[2], by[3])});
    for (const std::string& track : edits.removed) history.push_back({origin, "--remove " + track});
    return history;
}

}  // namespace

SceneWithLog release_edited(SceneWithLog scene, const ActorEdits& edits, std::vector<std::string>* notes) {
    std::set<std::string> tracks = edits.removed;
    tracks.insert(edits.hidden.begin(), edits.hidden.end());
    for (const auto& [track, shift] : edits.moves) tracks.insert(track);
    for (const ActorEdits::ActorCopy& copy : edits.copies)
        if (copy.from.empty()) tracks.insert(copy.of);
    for (const std::string& track : tracks) {
        if (!find_standing({scene.scene, scene.log}, track)) continue;
        ReleasedObject released = release_standing(std::move(scene), track);
        if (notes) notes->push_back(describe_release(released, track));
        scene = std::move(released.edited);
    }
    return scene;
}

SceneWithLog add_copies(SceneWithLog scene, const OtherRunsByName& others,
                        const std::vector<ActorEdits::ActorCopy>& copies) {
    return copy_actors(std::move(scene), others, copies, [](const Run& run) { return run.driving_scene(); });
}

ActorEdits::ActorCopy copy_on_ground(const Run& run, const OtherRunsByName& others,
                                     const GroundPoseRequest& request) {
    const Run& owner = request.from.empty() ? run : find_other_run(request.from, others);
    // Position in the dataset's world frame = position in relidar's world frame + offset.
    const glm::dvec3& offset_m = run.log.world_offset_m;
    GroundPlacement placement{.dataset_m = {request.at[0] + offset_m.x, request.at[1] + offset_m.y}};
    placement.clearance_m = read_clearance(owner);
    const Pose dataset_from_box =
        stand_on_ground({run.scene, run.log}, placement, {owner.scene, owner.log}, request.of)
            .dataset_from_box;
    const glm::dvec3 p = dataset_from_box.translation - offset_m;
    const glm::dvec3 angles_deg = rotation_angles(dataset_from_box.rotation) / kRadPerDegree;
    constexpr double kSpeed_mps = 0.0;
    return {.of = request.of,
            .from = request.from,
            .at = {p.x, p.y, p.z, angles_deg.x, angles_deg.y, angles_deg.z, kSpeed_mps}};
}

EditedTraffic::EditedTraffic(const Run& run, const OtherRunsByName& others, const ActorEdits& edits)
    : driving_(apply_moves(
          copy_actors(release_edited(copy_tracks(run), edits), others, edits.copies, copy_tracks), edits)),
      edits_(edits) {
    check_tracks(driving_, edits.removed);
    check_tracks(driving_, edits.hidden);
}

/// Returns the tracks of all actors that are visible at a time, in the world frame of the
/// dataset. Actors without surfels are left out, because they cannot be rendered.
ActorTracksByName EditedTraffic::visible_poses(double time_s) const {
    ActorTracksByName poses;
    for (const BoxTrack& box : driving_.log.boxes) {
        const bool has_surfels =
            !box.id.empty() && std::ranges::count(instances(), box.id, &ModelInstance::track) > 0;
        if (has_surfels && is_shown(box) && box.is_observed(time_s))
            poses[box.id] = shift_track(box.world_from_box, driving_.log.world_offset_m);
    }
    return poses;
}

/// Returns the actors at a time for the web page. Poses are in relidar's world frame.
nlohmann::json EditedTraffic::actors_json(double time_s) const {
    nlohmann::json actors = nlohmann::json::array();
    for (const ModelInstance& instance : instances()) {
        const BoxTrack* box = find_box(driving_.log, instance.track);
        if (!box) continue;
        actors.push_back({{"track", box->id},
                          {"category", name_of(class_of(*box))},
                          {"size", {box->size_m.x, box->size_m.y, box->size_m.z}},
                          {"present", box->is_observed(time_s)},
                          {"standing", false},
                          {"pose", pose_json(box->world_from_box.pose_at(time_s))}});
    }
    for (const BoxTrack& box : list_standing(driving_.scene, driving_.log, {}))
        actors.push_back({{"track", box.id},
                          {"category", box.category},
                          {"size", {box.size_m.x, box.size_m.y, box.size_m.z}},
                          {"present", true},
                          {"standing", true},
                          {"pose", pose_json(box.world_from_box.pose.front())}});
    return actors;
}

Run apply_edits(const Run& run, const OtherRunsByName& others, const ActorEdits& edits) {
    Run result = run;
    ActorEdits saved = edits;
    saved.hidden.clear();  // hidden standing objects stay in the background
    SceneWithLog driving = apply_moves(
        add_copies(release_edited({result.scene, result.log}, saved), others, edits.copies), edits);
    for (const std::string& track : edits.removed) driving = remove_track(std::move(driving), track);
    result.set_driving_scene(std::move(driving));
    const std::vector<EditHistoryEntry> done = make_history(run, others, edits);
    result.edits.insert(result.edits.end(), done.begin(), done.end());
    return result;
}

}  // namespace relidar::view
