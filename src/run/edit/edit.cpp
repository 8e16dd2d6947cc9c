// SPDX-License-Identifier: Apache-2.0
// Edits the objects and tracks of a scene. Copying an object to another scene also copies
// its surfels, unless the other scene already contains them. The surfels of a model are
// removed when no instance uses the model any more.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/scene/symmetry.hpp>

namespace relidar {

namespace {

/// Returns the error message for editing a labelled object that has no model. The message
/// explains the reason and names the setting that creates a model.
std::string format_actors_without_surfels(const std::string& track, std::vector<std::string> actors) {
    actors.push_back(track);
    return fmt::format(
        "cannot edit track \"{}\": the log has a box for it, but it is part of the background, "
        "because it is parked, its class is not in init.actor_classes, or it has fewer points "
        "than init.actor_min_points; train with init.actor_tracks = {} to make it an actor",
        track, fmt::join(actors, ","));
}

/// Returns the index of the instance that moves along a track.
std::size_t find_actor(const DrivingScene& driving, const std::string& track) {
    std::vector<std::string> known;
    for (std::size_t i = 0; i < driving.scene.instances.size(); ++i) {
        const std::string& name = driving.scene.instances[i].track;
        if (!name.empty() && name == track) return i;
        if (!name.empty()) known.push_back(name);
    }
    if (find_box(driving.sequence, track)) throw UsageError(format_actors_without_surfels(track, known));
    const std::string message = fmt::format("cannot edit track \"{}\": the run has no such track", track);
    if (known.empty()) throw UsageError(message + ", and its scene has no actors");
    throw UsageError(
        fmt::format("{}{} (actors: {})", message, suggest_name(track, known, "\""), fmt::join(known, ", ")));
}

BoxTrack& get_actor_box(DrivingScene& driving, const std::string& track) {
    find_actor(driving, track);
    std::vector<BoxTrack>& boxes = driving.sequence.boxes;
    if (const BoxTrack* box = find_box(driving.sequence, track))
        return boxes[std::size_t(box - boxes.data())];
    throw DataError(fmt::format(
        "cannot edit track \"{}\": the scene has an instance of it, but the log has no box for it", track));
}

/// Removes models that no instance uses. The model of the background is kept.
void remove_unused_models(Scene& scene) {
    Surfels surfels;
    std::vector<Model> models;
    std::vector<std::uint32_t> moved_to(scene.models.size(), 0);
    for (std::size_t m = 0; m < scene.models.size(); ++m) {
        const Model& model = scene.models[m];
        const bool used = m == 0 || std::any_of(scene.instances.begin(), scene.instances.end(),
                                                [&](const Instance& i) { return i.model == m; });
        if (!used) continue;
        moved_to[m] = static_cast<std::uint32_t>(models.size());
        models.push_back(model);
        models.back().first = static_cast<std::uint32_t>(surfels.size());
        surfels.append(scene.surfels.slice(model.first, model.count));
    }
    for (Instance& instance : scene.instances) instance.model = moved_to[instance.model];
    scene.models = std::move(models);
    scene.surfels = std::move(surfels);
}

/// Removes the actors for which `keep` returns false. Also removes the boxes of these
/// actors.
template <class Keep>
void remove_other_instances(DrivingScene& driving, const Keep& keep) {
    std::vector<Instance> kept;
    for (const Instance& instance : driving.scene.instances) {
        if (instance.track.empty() || keep(instance.track)) kept.push_back(instance);
        else std::erase_if(driving.sequence.boxes, [&](const BoxTrack& b) { return b.id == instance.track; });
    }
    driving.scene.instances = std::move(kept);
    remove_unused_models(driving.scene);
}

bool is_track_id_used(const DrivingScene& driving, const std::string& id) {
    return std::any_of(driving.sequence.boxes.begin(), driving.sequence.boxes.end(),
                       [&](const BoxTrack& b) { return b.id == id; });
}

std::string make_unused_track_id(const DrivingScene& driving, const std::string& stem) {
    int n = 1;
    while (is_track_id_used(driving, fmt::format("{}-{}", stem, n))) ++n;
    return fmt::format("{}-{}", stem, n);
}

/// Returns a track that moves straight ahead at constant speed. It has one pose for each
/// frame of the log.
PoseTrack make_straight_track(const Sequence& sequence, const Start& start) {
    PoseTrack track;
    for (const Frame& frame : sequence.frames) {
        Pose pose = start.dataset_from_box;
        pose.translation +=
            pose.rotation *
                glm::dvec3(start.speed_mps * (frame.time_s - sequence.frames.front().time_s), 0.0, 0.0) -
            sequence.world_offset_m;
        track.time_s.push_back(frame.time_s);
        track.pose.push_back(pose);
    }
    return track;
}

void check_trajectory(const PoseTrack& track, const std::string& id) {
    const auto fail = [&](const std::string& found, const char* expected) {
        throw DataError(fmt::format("cannot use the new trajectory of track \"{}\": found {}, expected {}",
                                    id, found, expected));
    };
    if (track.pose.size() < 2 || track.pose.size() != track.time_s.size())
        fail(fmt::format("{} poses at {} times", track.pose.size(), track.time_s.size()),
             "at least two poses, and as many times as poses");
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        const glm::dvec3& p = track.pose[i].translation;
        if (!std::isfinite(track.time_s[i] + p.x + p.y + p.z + glm::length(track.pose[i].rotation)))
            fail(fmt::format("values in entry {} that are not finite", i + 1), "finite numbers");
        if (i > 0 && !(track.time_s[i] > track.time_s[i - 1]))
            fail(fmt::format("the time {1} s in entry {0} after {2} s in the previous entry", i + 1,
                             track.time_s[i], track.time_s[i - 1]),
                 "increasing times");
    }
}

/// Adds interpolated poses to a track, so that consecutive poses are at most `step_s`
/// apart. A box exists only at times near its poses, so this limits how long it exists
/// before the first and after the last pose.
PoseTrack resample_track(const PoseTrack& track, double step_s) {
    PoseTrack fine;
    for (std::size_t i = 0; i + 1 < track.pose.size(); ++i) {
        const double span = track.time_s[i + 1] - track.time_s[i];
        const int n = std::max(1, static_cast<int>(std::ceil(span / step_s - 1e-9)));
        for (int k = 0; k < n; ++k) {
            fine.time_s.push_back(track.time_s[i] + span * k / n);
            fine.pose.push_back(interpolate(track.pose[i], track.pose[i + 1], double(k) / n));
        }
    }
    fine.time_s.push_back(track.time_s.back());
    fine.pose.push_back(track.pose.back());
    return fine;
}

/// Fills the unobserved sides of a vehicle by symmetry, because its new pose can turn
/// these sides to a sensor. Does nothing if the scene has no surfels in memory or no
/// record of the observed sides.
void complete_sides(DrivingScene& driving, const std::string& track) {
    Scene& scene = driving.scene;
    const std::uint32_t number = scene.instances[find_actor(driving, track)].model;
    Model& model = scene.models[number];
    if (!model.surface || model.surface->is_completed || model.surface->mirrored() == 0.0 ||
        !is_vehicle(get_actor_box(driving, track)) ||
        std::size_t(model.first) + model.count > scene.surfels.size())
        return;
    Surfels completed = scene.surfels.slice(model.first, model.count);
    if (complete_by_symmetry(completed, *model.surface) == 0) return;
    const std::size_t behind = std::size_t(model.first) + model.count;
    Surfels all = scene.surfels.slice(0, model.first);
    all.append(completed);
    all.append(scene.surfels.slice(behind, scene.surfels.size() - behind));
    scene.surfels = std::move(all);
    const std::uint32_t before = model.count;
    model.count = static_cast<std::uint32_t>(completed.size());
    for (std::size_t m = number + 1; m < scene.models.size(); ++m)
        scene.models[m].first += model.count - before;
}

/// Adds an instance of a model to the scene, with a new track.
void add_instance(DrivingScene& driving, std::uint32_t model, BoxTrack box, const Start& start) {
    box.world_from_box = start.dataset_path.pose.empty()
                             ? make_straight_track(driving.sequence, start)
                             : shift_track(start.dataset_path, -driving.sequence.world_offset_m);
    box.n_before = box.n_after = 0;
    driving.scene.instances.push_back({model, box.id});
    driving.sequence.boxes.push_back(std::move(box));
    complete_sides(driving, driving.scene.instances.back().track);
}

}  // namespace

DrivingScene remove_track(DrivingScene driving, const std::string& track) {
    find_actor(driving, track);
    remove_other_instances(driving, [&](const std::string& name) { return name != track; });
    return driving;
}

DrivingScene move_track(DrivingScene driving, const std::string& track, const Pose& box_from_moved) {
    for (Pose& pose : get_actor_box(driving, track).world_from_box.pose) pose = pose * box_from_moved;
    complete_sides(driving, track);
    return driving;
}

DrivingScene retime_track(DrivingScene driving, const std::string& track, double seconds) {
    for (double& time_s : get_actor_box(driving, track).world_from_box.time_s) time_s += seconds;
    complete_sides(driving, track);
    return driving;
}

std::string describe_lost_frames(const BoxTrack& box_before, const Sequence& edited) {
    const BoxTrack* box = find_box(edited, box_before.id);
    // A set, because LiDARs that sweep at the same time have frames with the same number.
    std::set<int> lost;
    for (const Frame& frame : edited.frames)
        if (box && box_before.is_present(frame.time_s) && !box->is_present(frame.time_s))
            lost.insert(frame.index);
    if (lost.empty()) return "";
    const std::vector<double>& times_s = box->world_from_box.time_s;
    return fmt::format(
        "track {} is now missing in {} frames between {} and {} in which it was present before, "
        "because its new trajectory lasts only from {:.2f} to {:.2f} s",
        box_before.id, lost.size(), *lost.begin(), *lost.rbegin(), times_s.front(), times_s.back());
}

DrivingScene replace_trajectory(DrivingScene driving, const std::string& track,
                                const PoseTrack& dataset_from_box) {
    BoxTrack& box = get_actor_box(driving, track);
    check_trajectory(dataset_from_box, track);
    box.n_before = box.n_after = 0;
    box.world_from_box = resample_track(shift_track(dataset_from_box, -driving.sequence.world_offset_m),
                                        std::max(driving.sequence.lidars[0].period_s(), 1e-3));
    complete_sides(driving, track);
    return driving;
}

DrivingScene copy_track(DrivingScene driving, const std::string& track, const Start& start) {
    BoxTrack box = get_actor_box(driving, track);
    box.id = make_unused_track_id(driving, track + "-copy");
    const std::uint32_t model = driving.scene.instances[find_actor(driving, track)].model;
    add_instance(driving, model, std::move(box), start);
    return driving;
}

DrivingScene insert_track(DrivingScene driving, const DrivingScene& other, const std::string& track,
                          const Start& start) {
    DrivingScene source = other;
    BoxTrack box = get_actor_box(source, track);
    if (is_track_id_used(driving, box.id)) box.id = make_unused_track_id(driving, track + "-insert");
    add_instance(
        driving,
        append_model(driving.scene, other.scene, other.scene.instances[find_actor(other, track)].model),
        std::move(box), start);
    return driving;
}

DrivingScene keep_background(DrivingScene driving) {
    remove_other_instances(driving, [](const std::string&) { return false; });
    return driving;
}

DrivingScene keep_actors(DrivingScene driving) {
    Scene& scene = driving.scene;
    const std::uint32_t background = scene.models.front().count;
    scene.surfels = scene.surfels.slice(background, scene.surfels.size() - background);
    for (Model& model : scene.models) model.first -= model.first >= background ? background : 0;
    scene.models.front().count = 0;
    scene.blocks.clear();
    return driving;
}

}  // namespace relidar
