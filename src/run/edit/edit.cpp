// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <cmath>
#include <set>

#include <fmt/ranges.h>

#include <relidar/scene/labels.hpp>

#include "base/fail.hpp"
#include "run/edit/tracks.hpp"

namespace relidar {

namespace {

// seconds or metres, as in the renderer
constexpr double kLargestNumber = 1e10;
constexpr double kMaxTrackSteps = 1e6;  // Maximum number of sweeps in a trajectory.

/// Returns the index of the instance that moves along a track.
/// @throws UsageError that suggests what to do if no instance has this track
std::size_t find_instance(const SceneWithLogView& scene_and_log, const std::string& track_id) {
    std::vector<std::string> actor_ids;
    for (std::size_t i = 0; i < scene_and_log.scene.instances.size(); ++i) {
        const std::string& id = scene_and_log.scene.instances[i].track;
        if (id.empty()) continue;  // the background
        if (id == track_id) return i;
        actor_ids.push_back(id);
    }
    if (find_box(scene_and_log.log, track_id)) {
        // The error suggests a setting that lists all current actors and this track.
        actor_ids.push_back(track_id);
        fail<UsageError>(
            "cannot edit track \"{}\": the log has a box for it, but it moves and has no model, so it is "
            "part of "
            "the background or left out, because its class is not in init.actor_classes, or it has fewer "
            "points than init.actor_min_points; train with init.actor_tracks = {} to make it an actor",
            track_id, fmt::join(actor_ids, ","));
    }
    const std::string message = fmt::format("cannot edit track \"{}\": the run has no such track", track_id);
    if (actor_ids.empty()) throw UsageError(message + ", and its scene has no actors");
    fail<UsageError>("{}{} (actors: {})", message, did_you_mean(track_id, actor_ids, "\""),
                     fmt::join(actor_ids, ", "));
}

SceneWithLogView view_of(const SceneWithLog& scene_and_log) {
    return {scene_and_log.scene, scene_and_log.log};
}

/// Returns the box of a track to change it. Releases a standing object, so that it is an
/// actor.
BoxTrack& mutable_box(SceneWithLog& scene_and_log, const std::string& track_id) {
    scene_and_log = release_standing(std::move(scene_and_log), track_id).edited;
    return const_cast<BoxTrack&>(find_actor_box(view_of(scene_and_log), track_id));
}

/// Removes models that no instance uses. Keeps model 0, which is the background.
void drop_unused_models(Scene& scene) {
    Surfels surfels;
    std::vector<SurfelModel> models;
    std::vector<std::uint32_t> new_index(scene.models.size(), 0);  // [old models]
    for (std::size_t m = 0; m < scene.models.size(); ++m) {
        const SurfelModel& model = scene.models[m];
        const bool is_used =
            std::ranges::find(scene.instances, m, &ModelInstance::model) != scene.instances.end();
        if (m > 0 && !is_used) continue;
        new_index[m] = static_cast<std::uint32_t>(models.size());
        models.push_back(model);
        models.back().first = static_cast<std::uint32_t>(surfels.size());
        surfels.append_surfels(scene.surfels.slice(model.first, model.count));
    }
    for (ModelInstance& instance : scene.instances) instance.model = new_index[instance.model];
    scene.models = std::move(models);
    scene.surfels = std::move(surfels);
}

/// Removes the actors for which `should_keep_track` returns false, and their boxes.
template <class Keep>
void keep_actors(SceneWithLog& scene_and_log, const Keep& should_keep_track) {
    std::erase_if(scene_and_log.scene.instances, [&](const ModelInstance& instance) {
        if (instance.track.empty() || should_keep_track(instance.track)) return false;
        std::erase_if(scene_and_log.log.boxes, [&](const BoxTrack& b) { return b.id == instance.track; });
        return true;
    });
    drop_unused_models(scene_and_log.scene);
}

std::string make_track_id(const SceneWithLog& scene_and_log, const std::string& id_prefix) {
    int n = 1;
    while (find_box(scene_and_log.log, fmt::format("{}-{}", id_prefix, n))) ++n;
    return fmt::format("{}-{}", id_prefix, n);
}

/// Returns a track straight ahead at constant speed, with a pose per sweep of the log.
PoseTrack make_straight_track(const Log& log, const NewActorMotion& start) {
    PoseTrack track;
    const std::vector<double> times_s = list_sweep_times_s(log);
    for (const double time_s : times_s) {
        const double driven_m = start.speed_mps * (time_s - times_s.front());
        Pose pose = start.dataset_from_box;
        // world of the log = world of the dataset - world_offset_m
        pose.translation += pose.rotation * glm::dvec3(driven_m, 0.0, 0.0) - log.world_offset_m;
        track.append(time_s, pose);
    }
    return track;
}

[[noreturn]] void fail_trajectory(const std::string& id, const std::string& found,
                                  const std::string& expected) {
    fail("cannot use the new trajectory of track \"{}\": found {}, expected {}", id, found, expected);
}

/// Throws if a time or pose of a track is not finite or far too large.
void check_finite_poses(const PoseTrack& track, const std::string& track_id) {
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        const glm::dvec3& p = track.pose[i].translation;
        // The length of a quaternion is finite only if all its components are.
        const double rotation_length = glm::length(track.pose[i].rotation);
        for (const double number : {track.time_s[i], p.x, p.y, p.z, rotation_length})
            if (!(std::abs(number) <= kLargestNumber))
                fail_trajectory(
                    track_id, fmt::format("the number {} in entry {}", number, i + 1),
                    fmt::format("finite times, positions and rotations of at most {:.0e}", kLargestNumber));
    }
}

/// Throws unless a new trajectory has at least two finite poses with increasing times.
void check_trajectory(const PoseTrack& track, const std::string& track_id) {
    if (track.pose.size() < 2 || track.pose.size() != track.time_s.size())
        fail_trajectory(track_id,
                        fmt::format("{} poses and {} times", track.pose.size(), track.time_s.size()),
                        "at least two poses, and exactly one time for each pose");
    check_finite_poses(track, track_id);
    for (std::size_t i = 1; i < track.pose.size(); ++i)
        if (!(track.time_s[i] > track.time_s[i - 1]))
            fail_trajectory(track_id,
                            fmt::format("the time {} s in entry {} after {} s in the previous entry",
                                        track.time_s[i], i + 1, track.time_s[i - 1]),
                            "increasing times");
}

/// Returns the model that an earlier edit has made from `model` by completing it, if any.
std::optional<std::uint32_t> find_mirrored_model(const Scene& scene, const SurfelModel& model) {
    ObservedBoxSurface completed = *model.surface;
    completed.is_completed = true;
    const auto copy = std::ranges::find_if(scene.models, [&](const SurfelModel& other) {
        return other.name == model.name && other.surface == completed;
    });
    if (copy == scene.models.end()) return std::nullopt;
    return static_cast<std::uint32_t>(copy - scene.models.begin());
}

/// Replaces the surfels of a model. Shifts later models if the number of surfels changes.
void replace_surfels(Scene& scene, std::uint32_t model_index, const Surfels& new_surfels) {
    SurfelModel& model = scene.models[model_index];
    const std::size_t end = std::size_t(model.first) + model.count;
    Surfels all = scene.surfels.slice(0, model.first);
    all.append_surfels(new_surfels);
    all.append_surfels(scene.surfels.slice(end, scene.surfels.size() - end));
    scene.surfels = std::move(all);
    const auto new_count = static_cast<std::uint32_t>(new_surfels.size());
    for (std::size_t m = model_index + 1; m < scene.models.size(); ++m)
        scene.models[m].first += new_count - model.count;
    model.count = new_count;
}

/// Fills the unobserved sides of a vehicle by symmetry, because after an edit they can
/// face a sensor. Does nothing if the surfels are not in memory.
/// @param needs_copy  true if another actor keeps the incomplete model, so that a copy is
/// completed; false: completes the model itself
void mirror_unseen_sides(SceneWithLog& scene_and_log, ModelInstance& instance, bool needs_copy) {
    Scene& scene = scene_and_log.scene;
    const SurfelModel& model = scene.models[instance.model];  // not used after append_model()
    const bool can_mirror =
        model.surface && !model.surface->is_completed && model.surface->mirrorable_fraction() != 0.0;
    const bool is_in_memory = std::size_t(model.first) + model.count <= scene.surfels.size();
    if (!can_mirror || !is_vehicle(mutable_box(scene_and_log, instance.track)) || !is_in_memory) return;

    const auto earlier_copy = needs_copy ? find_mirrored_model(scene, model) : std::nullopt;
    if (earlier_copy) {
        instance.model = *earlier_copy;
        return;
    }
    // mirror_unobserved() changes both: it appends surfels and marks the completed side.
    Surfels completed = scene.surfels.slice(model.first, model.count);
    ObservedBoxSurface surface = *model.surface;
    const std::size_t n_mirrored = mirror_unobserved(completed, surface);
    if (n_mirrored == 0) return;
    if (needs_copy) instance.model = append_model(scene, scene, instance.model);
    scene.models[instance.model].surface = surface;
    replace_surfels(scene, instance.model, completed);
}

/// Returns true if two tracks are equal except for rounding errors.
bool is_same_track(const PoseTrack& first, const PoseTrack& second) {
    constexpr double kMaxDifference = 1e-9;  // metres, seconds, and components of quaternions
    const auto is_same_time = [](double a, double b) { return std::abs(a - b) <= kMaxDifference; };
    const auto is_same_pose = [](const Pose& a, const Pose& b) {
        // q and -q are the same rotation.
        const double rotation_difference =
            std::min(glm::length(a.rotation - b.rotation), glm::length(a.rotation + b.rotation));
        return glm::distance(a.translation, b.translation) <= kMaxDifference &&
               rotation_difference <= kMaxDifference;
    };
    return std::ranges::equal(first.time_s, second.time_s, is_same_time) &&
           std::ranges::equal(first.pose, second.pose, is_same_pose);
}

/// Returns the track of an object before all edits if its current track is equal, except
/// for rounding errors. For a standing object, this is the median of its labels.
std::optional<PoseTrack> find_equal_track(const BoxTrack& box, const std::vector<BoxTrack>& boxes_before,
                                          const Log& log) {
    const auto before = std::ranges::find(boxes_before, box.id, &BoxTrack::id);
    if (before == boxes_before.end()) return std::nullopt;
    if (is_same_track(box.world_from_box, before->world_from_box)) return before->world_from_box;
    const std::optional<BoxTrack> standing = make_standing(*before, log);
    if (!standing || !is_same_track(box.world_from_box, standing->world_from_box)) return std::nullopt;
    return standing->world_from_box;
}

void add_instance(SceneWithLog& edited, std::uint32_t model, BoxTrack box, const NewActorMotion& start) {
    box.world_from_box = start.dataset_path.pose.empty()
                             ? make_straight_track(edited.log, start)
                             : shift_track(start.dataset_path, -edited.log.world_offset_m);
    check_finite_poses(box.world_from_box, box.id);
    box.n_before = box.n_after = 0;
    edited.scene.instances.push_back({model, box.id});
    edited.log.boxes.push_back(std::move(box));
}

}  // namespace

const BoxTrack& find_actor_box(const SceneWithLogView& scene_and_log, const std::string& track_id) {
    // throws if the scene has no such actor
    if (!find_standing(scene_and_log, track_id)) find_instance(scene_and_log, track_id);
    if (const BoxTrack* box = find_box(scene_and_log.log, track_id)) return *box;
    fail(
        "cannot edit track \"{}\": the trained scene has this actor, but the log has no box with this track "
        "id; expected the log that was used for training",
        track_id);
}

std::vector<double> list_sweep_times_s(const Log& log) {
    std::vector<double> times_s;
    for (const Frame& frame : log.frames)
        if (times_s.empty() || frame.time_s > times_s.back()) times_s.push_back(frame.time_s);
    return times_s;
}

PoseTrack densify_track(const PoseTrack& track, double max_step_s) {
    PoseTrack fine;
    for (std::size_t i = 0; i + 1 < track.pose.size(); ++i) {
        const double span_s = track.time_s[i + 1] - track.time_s[i];
        // The small number avoids an extra step because of a rounding error.
        const int n_steps = std::max(1, static_cast<int>(std::ceil(span_s / max_step_s - 1e-9)));
        for (int k = 0; k < n_steps; ++k)
            fine.append(track.time_s[i] + span_s * k / n_steps,
                        interpolate(track.pose[i], track.pose[i + 1], double(k) / n_steps));
    }
    fine.append(track.time_s.back(), track.pose.back());
    return fine;
}

SceneWithLog remove_track(SceneWithLog scene_and_log, const std::string& track) {
    scene_and_log = release_standing(std::move(scene_and_log), track).edited;
    find_instance(view_of(scene_and_log), track);
    keep_actors(scene_and_log, [&](const std::string& name) { return name != track; });
    return scene_and_log;
}

SceneWithLog move_track(SceneWithLog edited, const std::string& track, const Pose& old_from_new) {
    PoseTrack& world_from_box = mutable_box(edited, track).world_from_box;
    for (Pose& pose : world_from_box.pose) pose = pose * old_from_new;
    check_finite_poses(world_from_box, track);
    return edited;
}

SceneWithLog classify_track(SceneWithLog edited, const std::string& track, const std::string& category) {
    if (category.empty())
        fail<UsageError>("cannot set the class of track \"{}\": found an empty name", track);
    std::vector<BoxTrack>& boxes = edited.log.boxes;
    const auto box = std::ranges::find(boxes, track, &BoxTrack::id);
    (box == boxes.end() ? mutable_box(edited, track) : *box).category = category;
    return edited;
}

SceneWithLog delay_track(SceneWithLog scene_and_log, const std::string& track, double delay_s) {
    PoseTrack& world_from_box = mutable_box(scene_and_log, track).world_from_box;
    for (double& time_s : world_from_box.time_s) time_s += delay_s;
    check_finite_poses(world_from_box, track);
    return scene_and_log;
}

SceneWithLog scale_speed(SceneWithLog edited, const std::string& track, double factor) {
    PoseTrack& world_from_box = mutable_box(edited, track).world_from_box;
    if (!(factor > 0.0 && factor <= kLargestNumber))
        fail<UsageError>(
            "cannot change the speed of track \"{}\": found the factor {}, expected a number above 0", track,
            factor);
    const auto is_first = [&](const Pose& pose) {
        return pose.translation == world_from_box.pose.front().translation;
    };
    if (std::ranges::all_of(world_from_box.pose, is_first))
        fail<UsageError>("cannot change the speed of track \"{}\": it stands still; expected a moving actor",
                         track);
    const double start_s = world_from_box.time_s.empty() ? 0.0 : world_from_box.time_s.front();
    // A pose t seconds after the start is now reached after t / factor seconds.
    for (double& time_s : world_from_box.time_s) time_s = start_s + (time_s - start_s) / factor;
    check_finite_poses(world_from_box, track);
    return edited;
}

std::vector<std::string> list_changed_tracks(const SceneWithLogView& edited,
                                             const std::vector<BoxTrack>& boxes_before) {
    std::vector<std::string> changed;
    for (const ModelInstance& instance : edited.scene.instances) {
        const BoxTrack* box = find_box(edited.log, instance.track);
        if (box && !find_equal_track(*box, boxes_before, edited.log)) changed.push_back(instance.track);
    }
    return changed;
}

SceneWithLog complete_actors(SceneWithLog scene_and_log, const std::vector<BoxTrack>& boxes_before) {
    std::set<std::string> changed;  // ids of tracks that were moved or added
    for (BoxTrack& box : scene_and_log.log.boxes) {
        // Without the rounding errors of an actor that was moved there and back.
        if (auto before = find_equal_track(box, boxes_before, scene_and_log.log))
            box.world_from_box = *std::move(before);
        else changed.insert(box.id);
    }
    std::vector<ModelInstance>& instances = scene_and_log.scene.instances;
    for (ModelInstance& instance : instances) {
        if (!changed.contains(instance.track)) continue;
        // Actors can have the same model. Those with unchanged tracks keep it as it is.
        const bool needs_copy = std::ranges::any_of(instances, [&](const ModelInstance& other) {
            return other.model == instance.model && !changed.contains(other.track);
        });
        mirror_unseen_sides(scene_and_log, instance, needs_copy);
    }
    return scene_and_log;
}

std::string describe_absence(const BoxTrack& original_box, const Log& edited_log) {
    const BoxTrack* box = find_box(edited_log, original_box.id);
    // Numbers of the frames in which the actor is missing after the edit. It is a set,
    // because LiDARs that sweep at the same time share a frame number.
    std::set<int> lost;
    for (const Frame& frame : edited_log.frames)
        if (box && original_box.is_observed(frame.time_s) && !box->is_observed(frame.time_s))
            lost.insert(frame.index);
    if (lost.empty()) return "";
    const std::vector<double>& times_s = box->world_from_box.time_s;
    return fmt::format(
        "track {} is now missing in {} frames between {} and {} in which it was present before, because its "
        "new trajectory lasts only from {:.2f} to {:.2f} s",
        original_box.id, lost.size(), *lost.begin(), *lost.rbegin(), times_s.front(), times_s.back());
}

SceneWithLog replace_track(SceneWithLog edited, const std::string& track, const PoseTrack& dataset_from_box) {
    BoxTrack& box = mutable_box(edited, track);
    check_trajectory(dataset_from_box, track);
    const double step_s = std::max(edited.log.lidars[0].sweep_period_s(), 1e-3);
    const double span_s = dataset_from_box.time_s.back() - dataset_from_box.time_s.front();
    if (span_s > kMaxTrackSteps * step_s)
        fail_trajectory(track, fmt::format("times over {} s", span_s),
                        fmt::format("at most {} s", kMaxTrackSteps * step_s));
    box.n_before = box.n_after = 0;
    // coordinates in the log = coordinates in the dataset - world_offset_m
    box.world_from_box = densify_track(shift_track(dataset_from_box, -edited.log.world_offset_m), step_s);
    return edited;
}

SceneWithLog copy_track(SceneWithLog scene_and_log, const std::string& track, const NewActorMotion& start) {
    BoxTrack box = mutable_box(scene_and_log, track);
    box.id = make_track_id(scene_and_log, track + "-copy");
    const std::size_t instance = find_instance(view_of(scene_and_log), track);
    const std::uint32_t model = scene_and_log.scene.instances[instance].model;
    add_instance(scene_and_log, model, std::move(box), start);
    return scene_and_log;
}

SceneWithLog insert_track(SceneWithLog scene_and_log, const SceneWithLog& source_scene,
                          const std::string& track, const NewActorMotion& start) {
    if (find_standing(view_of(source_scene), track))
        return insert_track(std::move(scene_and_log), release_standing(source_scene, track).edited, track,
                            start);
    BoxTrack box = find_actor_box(view_of(source_scene), track);
    const bool is_id_used = find_box(scene_and_log.log, box.id) != nullptr;
    if (is_id_used) box.id = make_track_id(scene_and_log, track + "-insert");
    const std::size_t instance = find_instance(view_of(source_scene), track);
    const std::uint32_t source_model = source_scene.scene.instances[instance].model;
    const std::uint32_t model = append_model(scene_and_log.scene, source_scene.scene, source_model);
    add_instance(scene_and_log, model, std::move(box), start);
    return scene_and_log;
}

SceneWithLog remove_actors(SceneWithLog scene_and_log) {
    keep_actors(scene_and_log, [](const std::string&) { return false; });
    return scene_and_log;
}

SceneWithLog remove_background(SceneWithLog scene_and_log) {
    Scene& scene = scene_and_log.scene;
    const std::uint32_t background = scene.models.front().count;
    scene.surfels = scene.surfels.slice(background, scene.surfels.size() - background);
    for (SurfelModel& model : scene.models) model.first -= model.first >= background ? background : 0;
    scene.models.front().count = 0;
    scene.blocks.clear();
    return scene_and_log;
}

}  // namespace relidar
