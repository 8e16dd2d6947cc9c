// SPDX-License-Identifier: Apache-2.0
// Initialises actors. An actor is the set of surfels of one tracked moving box, in the
// frame of the box (paper section 3.2, Eq. 4-5: mean_world = R_t mean_object + T_t).
#include <relidar/scene/device_scene.hpp>
#include <relidar/scene/scene.hpp>

#include <algorithm>
#include <cmath>
#include <string_view>
#include <unordered_map>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/list_text.hpp"
#include "base/progress_blocks.hpp"
#include "base/random.hpp"
#include "scene/changing_actors.hpp"
#include "scene/point_surfels.hpp"
#include "scene/movers/walked_distance.hpp"

namespace relidar {
namespace {

constexpr double kPointMargin_m = 0.1;  // some labelled boxes are too small
// Points in the lowest part of a box are removed, because they belong to the ground.
constexpr double kGround_m = 0.15;
constexpr std::string_view kEveryClass = "all";

/// Adds the returns of one scan that lie inside boxes, in the frames of the boxes.
void append_returns_inside_boxes(const LidarSequence& sequence, const LidarFrame& frame,
                                 const std::vector<BoxTrack>& boxes, bool include_second_returns,
                                 const std::vector<WalkedDistanceTrack>& walked_distances,
                                 std::vector<std::vector<LidarSample>>& samples_per_box) {
    std::vector<std::size_t> present;
    for (std::size_t b = 0; b < boxes.size(); ++b)
        if (boxes[b].is_observed_at_time(frame.time_s)) present.push_back(b);
    if (present.empty()) return;
    for_each_return(sequence, frame, include_second_returns, [&](const WorldReturn& world_return) {
        for (const std::size_t b : present) {
            if (!boxes[b].contains_point(world_return.point_m, world_return.time_s, kPointMargin_m)) continue;
            const Pose box_from_world =
                inverse(boxes[b].world_from_box.interpolate_pose(world_return.time_s));
            const glm::dvec3 local = box_from_world * world_return.point_m;
            if (local.z < -0.5 * boxes[b].size_m.z + kGround_m) continue;
            samples_per_box[b].push_back(
                {glm::vec3(local), world_return.intensity,
                 glm::vec3(box_from_world.rotation * world_return.direction),
                 static_cast<float>(walked_distances[b].compute_walked_distance_m(world_return.time_s)),
                 frame.index});
        }
    });
}

/// Collects the returns of the training frames that lie inside boxes, [boxes].
std::vector<std::vector<LidarSample>> collect_samples_inside_boxes(
    const LidarSequence& sequence, const std::vector<int>& train_frame_indices,
    const std::vector<BoxTrack>& boxes, const SceneInitialisationOptions& options,
    const ProgressReporter& progress) {
    std::vector<WalkedDistanceTrack> walks;
    for (const BoxTrack& box : boxes) walks.emplace_back(box.world_from_box);
    std::vector<std::vector<LidarSample>> samples(boxes.size());
    std::vector<std::vector<std::vector<LidarSample>>> of_frame(
        train_frame_indices.size(), std::vector<std::vector<LidarSample>>(boxes.size()));
    parallel_for_with_progress(
        train_frame_indices.size(), progress, "collecting the points of actors", [&](std::size_t index) {
            append_returns_inside_boxes(sequence, sequence.frames[std::size_t(train_frame_indices[index])],
                                        boxes, options.second_returns, walks, of_frame[index]);
        });
    for (const std::vector<std::vector<LidarSample>>& frame : of_frame)
        for (std::size_t b = 0; b < boxes.size(); ++b)
            samples[b].insert(samples[b].end(), frame[b].begin(), frame[b].end());
    return samples;
}

bool contains_word_in_list(const std::string& word_list, const std::string& word) {
    const std::vector<std::string> words = split_comma_separated_list(word_list);
    return std::find(words.begin(), words.end(), word) != words.end();
}

bool should_become_actor(const BoxTrack& box, const SceneInitialisationOptions& options) {
    if (options.unlabelled_movers == UnlabelledMoverPolicy::actors && box.category == kDiscoveredCategory)
        return true;
    if (!options.actor_tracks.empty()) return contains_word_in_list(options.actor_tracks, box.id);
    return options.actor_classes == kEveryClass ||
           contains_word_in_list(options.actor_classes, box.category) ||
           contains_word_in_list(options.actor_classes, get_name(parse_object_kind(box.category)));
}

/// Guesses the kind of a box without a label from its size.
ObjectKind guess_object_kind(const BoxTrack& box) {
    if (box.category != kDiscoveredCategory) return parse_object_kind(box.category);
    const double length = std::max(box.size_m.x, box.size_m.y), width = std::min(box.size_m.x, box.size_m.y);
    if (width > 1.1 || box.size_m.z < 1.2) return ObjectKind::other;
    if (length < 1.3) return ObjectKind::person;
    return length < 2.2 ? ObjectKind::cyclist : ObjectKind::other;
}

void require_valid_box_size_and_poses(const BoxTrack& box) {
    const glm::dvec3& s = box.size_m;
    if (!(s.x > 0.0 && s.y > 0.0 && s.z > 0.0) || !std::isfinite(s.x + s.y + s.z))
        fail("box {} has the size {} x {} x {} m, expected three lengths above 0", box.id, s.x, s.y, s.z);
    for (std::size_t i = 0; i < box.world_from_box.pose.size(); ++i) {
        const Pose& pose = box.world_from_box.pose[i];
        if (!std::isfinite(glm::dot(pose.translation, glm::dvec3(1.0)) +
                           glm::dot(pose.rotation, pose.rotation)))
            fail("box {}: the pose of observation {} is not finite, expected a finite pose", box.id, i);
    }
}

void require_track_names_exist(const LidarSequence& sequence, const std::string& track_names) {
    std::vector<std::string> box_ids;
    for (const BoxTrack& box : sequence.boxes) box_ids.push_back(box.id);
    for (const std::string& track : split_comma_separated_list(track_names))
        if (std::find(box_ids.begin(), box_ids.end(), track) == box_ids.end())
            fail<UsageError>("setting init.actor_tracks: found \"{}\"{} (tracks: {})", track,
                             format_name_suggestion(track, box_ids, "\""), fmt::join(box_ids, ", "));
}

/// Adds random points inside the box until there are `min_count` samples, with the mean
/// intensity of the existing samples and viewing directions towards the box centre.
void pad_with_random_samples(std::vector<LidarSample>& samples, std::size_t min_count, const BoxTrack& box,
                             std::uint64_t seed) {
    double intensity = 0.0;
    for (const LidarSample& s : samples) intensity += s.intensity / double(samples.size());
    Random random(hash_integer_pair(seed, hash_integer(std::hash<std::string>{}(box.id))));
    while (samples.size() < min_count) {
        // In the order z, y, x. Another order would change the points.
        glm::dvec3 fraction;
        for (int axis = 2; axis >= 0; --axis) fraction[axis] = random.sample_uniform_number();
        const glm::dvec3 p = box.size_m * (fraction - 0.5);
        samples.push_back(
            {glm::vec3(p), static_cast<float>(intensity), glm::vec3(-p / std::max(glm::length(p), 1e-9))});
    }
}

/// Appends an actor to the scene. Does nothing if the box has too few points.
/// @param incidence  strength of the dependence on the incidence angle
/// (IntensityResponse)
void append_actor_to_scene(Scene& scene, const BoxTrack& box, const std::vector<LidarSample>& samples,
                           const SceneInitialisationOptions& options, double incidence,
                           std::vector<std::string>* notes, const ProgressReporter& progress) {
    std::vector<LidarSample> rigid = select_one_sample_per_voxel(samples, std::size_t(options.actor_points));
    if (rigid.size() < std::size_t(options.actor_min_points)) return;
    pad_with_random_samples(rigid, std::size_t(std::min(options.actor_pad_to, options.actor_points)), box,
                            options.seed);
    const bool is_deformable = options.deform == kEveryClass ||
                               contains_word_in_list(options.deform, box.category) ||
                               contains_word_in_list(options.deform, get_name(guess_object_kind(box)));
    DeformingActorSurfels changing;
    if (is_deformable) {
        changing = make_surfels_of_deforming_actor(samples, options, incidence,
                                                   std::size_t(options.actor_points), progress);
        const bool is_rigid = !changing.why_rigid.empty();
        if (notes)
            notes->push_back(fmt::format(
                "{} ({}) {}{}", box.id, box.category,
                is_rigid ? "is modelled as rigid, because " : "changes its shape from frame to frame",
                changing.why_rigid));
    }
    const Surfels surfels = changing.period_m > 0.0 ? std::move(changing.surfels)
                                                    : make_surfels_from_points(rigid, options, incidence);
    ObservedBoxSurface observed_surface(box.size_m);
    for (const LidarSample& s : samples)
        observed_surface.mark_patch_of_point_as_observed(glm::dvec3(s.position), glm::dvec3(s.view));
    scene.instances.push_back({static_cast<std::uint32_t>(scene.models.size()), box.id});
    scene.models.push_back({box.id, static_cast<std::uint32_t>(scene.surfels.size()),
                            static_cast<std::uint32_t>(surfels.size()),
                            glm::vec3(0.5 * box.size_m + kPointMargin_m),
                            static_cast<float>(changing.period_m), std::move(observed_surface)});
    scene.surfels.append_surfels(surfels);
}

/// Returns the distance that an actor has walked at the start of a new track: the
/// distance at the nearest recorded pose plus the distance from there to the new pose.
double compute_walked_distance_at_track_start_m(const BoxTrack& logged_box, const PoseTrack& new_track) {
    const Pose& at = new_track.pose.front();
    const auto compute_distance_m = [&](const Pose& pose) {
        return glm::distance(pose.translation, at.translation);
    };
    const auto nearest = std::ranges::min_element(logged_box.world_from_box.pose, {}, compute_distance_m);
    const double time_s =
        logged_box.world_from_box.time_s[std::size_t(nearest - logged_box.world_from_box.pose.begin())];
    const glm::dvec3 ahead = at.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return WalkedDistanceTrack(logged_box.world_from_box).compute_walked_distance_m(time_s) +
           glm::dot(at.translation - nearest->translation, ahead);
}

/// @param find_track  returns the track of an actor, or null if the actor is absent
template <class TrackOf>
std::vector<InstancePose> compute_instance_poses_in_sweep(const Scene& scene, const LidarSequence& sequence,
                                                          const SweepTiming& sweep,
                                                          const TrackOf& find_track) {
    std::vector<InstancePose> placed;
    for (const ModelInstance& instance : scene.instances) {
        if (instance.track.empty()) {
            placed.push_back({});
            continue;
        }
        const PoseTrack* track = find_track(instance.track);
        const SurfelModel& model = scene.models[instance.model];
        placed.push_back(track ? compute_box_pose_in_sweep(sequence, *track, model.half_size_m, sweep)
                               : InstancePose{{}, false});
        const double stride_m = double(model.stride_m);
        if (!track || stride_m <= 0.0) continue;
        const BoxTrack* logged_box = find_box_track_by_id(sequence, instance.track);
        const bool is_logged_track = logged_box && &logged_box->world_from_box == track;
        const double before_m = logged_box && !is_logged_track && !logged_box->world_from_box.pose.empty()
                                    ? compute_walked_distance_at_track_start_m(*logged_box, *track)
                                    : 0.0;
        placed.back().phase =
            (before_m + WalkedDistanceTrack(*track).compute_walked_distance_m(placed.back().time_s)) /
            stride_m;
    }
    return placed;
}

}  // namespace

std::vector<BoxTrack> list_foreground_boxes(const LidarSequence& sequence,
                                            const SceneInitialisationOptions& options) {
    require_track_names_exist(sequence, options.actor_tracks);
    std::vector<BoxTrack> boxes;
    for (const BoxTrack& box : sequence.boxes) {
        require_valid_box_size_and_poses(box);
        if (!options.mask_others && !should_become_actor(box, options)) continue;
        if (box.is_moving() || contains_word_in_list(options.actor_tracks, box.id)) boxes.push_back(box);
    }
    return boxes;
}

Scene initialise_scene(const LidarSequence& sequence, const std::vector<int>& train_frame_indices,
                       const SceneInitialisationOptions& options, const ProgressReporter& progress,
                       std::vector<std::string>* notes) {
    Scene scene =
        make_background_scene(initialise_background(sequence, train_frame_indices, options, progress));
    std::vector<BoxTrack> actor_boxes = list_foreground_boxes(sequence, options);
    std::erase_if(actor_boxes, [&](const BoxTrack& box) { return !should_become_actor(box, options); });
    std::vector<std::vector<LidarSample>> samples_per_box =
        collect_samples_inside_boxes(sequence, train_frame_indices, actor_boxes, options, progress);
    for (std::size_t i = 0; i < actor_boxes.size(); ++i) {
        if (progress) progress("modelling actors", double(i) / double(actor_boxes.size()));
        append_actor_to_scene(scene, actor_boxes[i], samples_per_box[i], options,
                              sequence.intensity_response.incidence, notes, progress);
    }
    return scene;
}

std::vector<BoxTrack> find_boxes_without_model(const Scene& scene, const LidarSequence& sequence,
                                               const SceneInitialisationOptions& options) {
    std::vector<BoxTrack> boxes = list_foreground_boxes(sequence, options);
    std::erase_if(boxes, [&](const BoxTrack& box) {
        return std::ranges::find(scene.instances, box.id, &ModelInstance::track) != scene.instances.end();
    });
    return boxes;
}

std::vector<BoxTrack> find_moving_boxes_not_selected_as_actors(const LidarSequence& sequence,
                                                               const SceneInitialisationOptions& options) {
    std::vector<BoxTrack> boxes = list_foreground_boxes(sequence, options);
    std::erase_if(boxes, [&](const BoxTrack& box) { return should_become_actor(box, options); });
    return boxes;
}

std::string format_box_list(const std::vector<BoxTrack>& boxes) {
    constexpr std::size_t kMost = 8;
    std::vector<std::string> names;
    for (std::size_t i = 0; i < std::min(kMost, boxes.size()); ++i)
        names.push_back(fmt::format("{} ({})", boxes[i].id, boxes[i].category));
    return fmt::format("{}{}", fmt::join(names, ", "),
                       boxes.size() > kMost ? fmt::format(" and {} more", boxes.size() - kMost) : "");
}

std::vector<InstancePose> compute_instance_poses(const Scene& scene, const LidarSequence& sequence,
                                                 const SweepTiming& sweep) {
    // a hash map, because a log can have a thousand tracks
    std::unordered_map<std::string_view, const PoseTrack*> tracks;
    for (const BoxTrack& box : sequence.boxes)
        if (box.is_observed_at_time(sweep.time_s)) tracks.emplace(box.id, &box.world_from_box);
    return compute_instance_poses_in_sweep(scene, sequence, sweep, [&](const std::string& name) {
        const auto track = tracks.find(name);
        return track == tracks.end() ? nullptr : track->second;
    });
}

std::vector<InstancePose> compute_instance_poses(const Scene& scene, const LidarSequence& sequence,
                                                 const SweepTiming& sweep,
                                                 const ActorTracksByName& world_from_actor) {
    std::vector<std::string> tracks;
    for (const ModelInstance& instance : scene.instances)
        if (!instance.track.empty()) tracks.push_back(instance.track);
    for (const auto& [track, poses] : world_from_actor)
        if (std::find(tracks.begin(), tracks.end(), track) == tracks.end())
            fail<UsageError>(
                "cannot place actors: found track \"{}\", expected a track of the scene{}", track,
                tracks.empty() ? ", which has no actors" : format_name_suggestion(track, tracks, "\""));
    return compute_instance_poses_in_sweep(scene, sequence, sweep, [&](const std::string& name) {
        const auto track = world_from_actor.find(name);
        return track == world_from_actor.end() ? nullptr : &track->second;
    });
}

}  // namespace relidar
