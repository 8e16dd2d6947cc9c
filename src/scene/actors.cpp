// SPDX-License-Identifier: Apache-2.0
// Initialises actors. An actor is the set of surfels of one tracked moving box, in the
// frame of the box (paper section 3.2, Eq. 4-5: mean_world = R_t mean_object + T_t).
#include <relidar/scene/device_scene.hpp>
#include <relidar/scene/labels.hpp>

#include <optional>
#include <unordered_map>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/list_text.hpp"
#include "base/progress_blocks.hpp"
#include "base/random.hpp"
#include "scene/point_surfels.hpp"

namespace relidar {
namespace {

constexpr std::string_view kEveryClass = "all";

/// Adds the returns of a scan inside boxes to `samples` [boxes], in the box frames.
void append_returns(const Log& log, const Frame& frame, const std::vector<BoxTrack>& boxes,
                    bool second_returns, const std::vector<WalkedDistanceTrack>& walked,
                    std::vector<LidarSamples>& samples) {
    std::vector<std::size_t> present;
    for (std::size_t b = 0; b < boxes.size(); ++b)
        if (boxes[b].is_observed(frame.time_s)) present.push_back(b);
    if (present.empty()) return;
    for_each_return(log, frame, second_returns, [&](const WorldReturn& hit) {
        for (const std::size_t b : present) {
            if (!boxes[b].contains_point(hit.point_m, hit.time_s, kObjectMargin_m)) continue;
            const Pose box_from_world = inverse(boxes[b].world_from_box.pose_at(hit.time_s));
            const glm::dvec3 local = box_from_world * hit.point_m;
            if (!is_on_object(local, boxes[b].size_m)) continue;
            samples[b].push_back({.position = glm::vec3(local),
                                  .intensity = hit.intensity,
                                  .view = glm::vec3(box_from_world.rotation * hit.direction),
                                  .walked_m = static_cast<float>(walked[b].walked_m(hit.time_s)),
                                  .frame = frame.index});
        }
    });
}

/// Collects the LiDAR returns of the training frames inside each box, in the box frame.
/// @return [boxes]
std::vector<LidarSamples> collect_samples(const Log& log, const std::vector<int>& frames,
                                          const std::vector<BoxTrack>& boxes, const InitOptions& options,
                                          const Progress& progress) {
    std::vector<WalkedDistanceTrack> walks;  // [boxes] distance walked until each time
    for (const BoxTrack& box : boxes) walks.emplace_back(box.world_from_box);
    // Separate lists per frame, so that the order does not depend on threads.
    std::vector<std::vector<LidarSamples>> by_frame(frames.size(), std::vector<LidarSamples>(boxes.size()));
    progress_for(frames.size(), progress, "collecting the points of actors", [&](std::size_t index) {
        append_returns(log, log.frames[std::size_t(frames[index])], boxes, options.second_returns, walks,
                       by_frame[index]);
    });
    std::vector<LidarSamples> samples(boxes.size());
    for (const std::vector<LidarSamples>& of_frame : by_frame)
        for (std::size_t b = 0; b < boxes.size(); ++b)
            samples[b].insert(samples[b].end(), of_frame[b].begin(), of_frame[b].end());
    return samples;
}

bool has_word(const std::string& word_list, const std::string& word) {
    const std::vector<std::string> words = split_list(word_list);
    return std::find(words.begin(), words.end(), word) != words.end();
}

/// Returns true if a list has the class of a box: its name in the dataset, its name in
/// relidar or its kind.
bool has_class(const std::string& class_list, const BoxTrack& box) {
    return class_list == kEveryClass || has_word(class_list, box.category) ||
           has_word(class_list, name_of(class_of(box))) || has_word(class_list, name_of(guess_kind(box)));
}

bool is_actor(const BoxTrack& box, const InitOptions& options) {
    if (options.unlabelled_movers == UnlabelledMoverPolicy::actors && is_discovered(box)) return true;
    if (!options.actor_tracks.empty()) return has_word(options.actor_tracks, box.id);
    // The class of a mover without a label is a guess, so a list does not select it.
    return options.actor_classes == kEveryClass ||
           (!is_discovered(box) && has_class(options.actor_classes, box));
}

/// Checks that the size of a box is positive and that all its poses are finite.
/// @throws DataError if a size or a pose is invalid
void check_box(const BoxTrack& box) {
    const glm::dvec3& s = box.size_m;
    if (!(s.x > 0.0 && s.y > 0.0 && s.z > 0.0) || !std::isfinite(s.x + s.y + s.z))
        fail("box {} has the size {} x {} x {} m, expected three lengths above 0", box.id, s.x, s.y, s.z);
    for (std::size_t i = 0; i < box.world_from_box.pose.size(); ++i) {
        // The sum over all components is not finite if one of them is not.
        const Pose& pose = box.world_from_box.pose[i];
        if (!std::isfinite(glm::dot(pose.translation, glm::dvec3(1.0)) +
                           glm::dot(pose.rotation, pose.rotation)))
            fail("box {}: the pose of observation {} is not finite, expected a finite pose", box.id, i);
    }
}

void check_track_names(const Log& log, const std::string& track_names) {
    std::vector<std::string> box_ids;
    for (const BoxTrack& box : log.boxes) box_ids.push_back(box.id);
    for (const std::string& track : split_list(track_names))
        if (std::find(box_ids.begin(), box_ids.end(), track) == box_ids.end())
            fail<UsageError>("setting init.actor_tracks: found \"{}\"{} (tracks: {})", track,
                             did_you_mean(track, box_ids, "\""), fmt::join(box_ids, ", "));
}

/// Adds random points inside the box until there are `min_count` samples, with the mean
/// intensity of the existing samples and viewing directions towards the box centre.
void pad_samples(LidarSamples& samples, std::size_t min_count, const BoxTrack& box, std::uint64_t seed) {
    double mean_intensity = 0.0;
    for (const LidarSample& s : samples) mean_intensity += s.intensity / double(samples.size());
    Random random(hash_pair(seed, hash_integer(std::hash<std::string>{}(box.id))));
    while (samples.size() < min_count) {
        // Draws in the order z, y, x. Another order would change the points of a seed.
        glm::dvec3 fraction;
        for (int axis = 2; axis >= 0; --axis) fraction[axis] = random.sample_uniform();
        const glm::dvec3 point_m = box.size_m * (fraction - 0.5);
        samples.push_back({glm::vec3(point_m), static_cast<float>(mean_intensity),
                           glm::vec3(-point_m / std::max(glm::length(point_m), 1e-9))});
    }
}

/// Makes the surfels of an actor that changes its shape, if its class is selected for
/// this. Adds a note for the user with the result.
/// @return nothing if the actor is rigid
std::optional<DeformingActorSurfels> deform_selected(const BoxTrack& box, const LidarSamples& samples,
                                                     const InitOptions& options, double incidence,
                                                     std::vector<std::string>* notes,
                                                     const Progress& progress) {
    if (!has_class(options.deform, box)) return std::nullopt;
    DeformingActorSurfels deforming =
        make_deforming(samples, options, incidence, std::size_t(options.actor_points), progress);
    const bool is_rigid = !deforming.why_rigid.empty();
    if (notes)
        notes->push_back(
            fmt::format("{} ({}) {}{}", box.id, box.category,
                        is_rigid ? "is modelled as rigid, because " : "changes its shape from frame to frame",
                        deforming.why_rigid));
    return is_rigid ? std::nullopt : std::optional(std::move(deforming));
}

/// Appends an actor to the scene: its surfels, a model with them, and an instance of this
/// model. Does nothing if the box has too few points.
/// @param incidence  strength of the dependence on the angle (IntensityResponse)
void append_actor(Scene& scene, const BoxTrack& box, const LidarSamples& samples, const InitOptions& options,
                  double incidence, std::vector<std::string>* notes, const Progress& progress) {
    LidarSamples thinned = thin_samples(samples, std::size_t(options.actor_points));
    if (thinned.size() < std::size_t(options.actor_min_points)) return;
    pad_samples(thinned, std::size_t(std::min(options.actor_pad_to, options.actor_points)), box,
                options.seed);
    std::optional<DeformingActorSurfels> deforming =
        deform_selected(box, samples, options, incidence, notes, progress);
    const Surfels surfels =
        deforming ? std::move(deforming->surfels) : make_surfels(thinned, options, incidence);
    ObservedBoxSurface observed_surface(box.size_m);
    for (const LidarSample& s : samples)
        observed_surface.mark_observed(glm::dvec3(s.position), glm::dvec3(s.view));
    scene.instances.push_back({static_cast<std::uint32_t>(scene.models.size()), box.id});
    scene.models.push_back({.name = box.id,
                            .first = static_cast<std::uint32_t>(scene.surfels.size()),
                            .count = static_cast<std::uint32_t>(surfels.size()),
                            .half_size_m = glm::vec3(0.5 * box.size_m + kObjectMargin_m),
                            .stride_m = deforming ? static_cast<float>(deforming->period_m) : 0.0f,
                            .surface = std::move(observed_surface)});
    scene.surfels.append_surfels(surfels);
}

/// Returns the distance that an actor has walked at the start of a track. If the track is
/// not the logged one, the steps continue the logged steps: the distance is that at the
/// nearest logged pose, plus the way ahead from there to the start.
/// @param logged_box  null or without poses: the log has no such track
double walked_at_start_m(const BoxTrack* logged_box, const PoseTrack& track) {
    if (!logged_box || logged_box->world_from_box.pose.empty() || &logged_box->world_from_box == &track)
        return 0.0;
    const PoseTrack& logged_track = logged_box->world_from_box;
    const Pose& start = track.pose.front();
    const auto distance_m = [&](const Pose& pose) {
        return glm::distance(pose.translation, start.translation);
    };
    const auto nearest = std::ranges::min_element(logged_track.pose, {}, distance_m);
    const double time_s = logged_track.time_s[std::size_t(nearest - logged_track.pose.begin())];
    const glm::dvec3 ahead = start.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return WalkedDistanceTrack(logged_track).walked_m(time_s) +
           glm::dot(start.translation - nearest->translation, ahead);
}

}  // namespace

std::vector<BoxTrack> list_foreground(const Log& log, const InitOptions& options) {
    check_track_names(log, options.actor_tracks);
    std::vector<BoxTrack> boxes;
    for (const BoxTrack& box : log.boxes) {
        check_box(box);
        const bool is_used = options.mask_others || is_actor(box, options);
        const bool is_foreground = box.is_moving() || has_word(options.actor_tracks, box.id);
        if (is_used && is_foreground) boxes.push_back(box);
    }
    return boxes;
}

Scene init_scene(const Log& log, const std::vector<int>& frames, const InitOptions& options,
                 const Progress& progress, std::vector<std::string>* notes) {
    Scene scene = wrap_background(init_background(log, frames, options, progress));
    std::vector<BoxTrack> actor_boxes = list_foreground(log, options);
    std::erase_if(actor_boxes, [&](const BoxTrack& box) { return !is_actor(box, options); });
    std::vector<LidarSamples> samples_per_box = collect_samples(log, frames, actor_boxes, options, progress);
    for (std::size_t i = 0; i < actor_boxes.size(); ++i) {
        if (progress) progress("modelling actors", double(i) / double(actor_boxes.size()));
        append_actor(scene, actor_boxes[i], samples_per_box[i], options, log.intensity_response.incidence,
                     notes, progress);
    }
    return scene;
}

std::vector<BoxTrack> find_unmodelled(const Scene& scene, const Log& log, const InitOptions& options) {
    std::vector<BoxTrack> boxes = list_foreground(log, options);
    std::erase_if(boxes, [&](const BoxTrack& box) {
        return std::ranges::find(scene.instances, box.id, &ModelInstance::track) != scene.instances.end();
    });
    return boxes;
}

std::vector<BoxTrack> find_unselected(const Log& log, const InitOptions& options) {
    std::vector<BoxTrack> boxes = list_foreground(log, options);
    std::erase_if(boxes, [&](const BoxTrack& box) { return is_actor(box, options); });
    return boxes;
}

std::string format_box_list(const std::vector<BoxTrack>& boxes) {
    constexpr std::size_t kMaxListed = 8;
    std::vector<std::string> names;
    for (std::size_t i = 0; i < std::min(kMaxListed, boxes.size()); ++i)
        names.push_back(fmt::format("{} ({})", boxes[i].id, boxes[i].category));
    return fmt::format(
        "{}{}", fmt::join(names, ", "),
        boxes.size() > kMaxListed ? fmt::format(" and {} more", boxes.size() - kMaxListed) : "");
}

std::vector<InstancePose> pose_instances(const Scene& scene, const Log& log, const SweepTiming& sweep) {
    // a hash map, because a log can have a thousand tracks
    std::unordered_map<std::string_view, const PoseTrack*> tracks;  // of the actors that exist now
    for (const BoxTrack& box : log.boxes)
        if (box.is_observed(sweep.time_s)) tracks.emplace(box.id, &box.world_from_box);
    std::vector<const PoseTrack*> world_from_actor;
    for (const ModelInstance& instance : scene.instances) {
        const auto track = tracks.find(instance.track);
        // null: the actor does not exist at this time
        world_from_actor.push_back(track == tracks.end() ? nullptr : track->second);
    }
    return pose_instances(scene, log, sweep, world_from_actor);
}

std::vector<InstancePose> pose_instances(const Scene& scene, const Log& log, const SweepTiming& sweep,
                                         std::span<const PoseTrack* const> world_from_actor) {
    std::vector<InstancePose> placed;
    for (std::size_t i = 0; i < scene.instances.size(); ++i) {
        const ModelInstance& instance = scene.instances[i];
        const bool is_background = instance.track.empty();
        const PoseTrack* track = is_background ? nullptr : world_from_actor[i];
        InstancePose& pose = placed.emplace_back();
        pose.present = is_background || track;
        if (!track) continue;
        const SurfelModel& model = scene.models[instance.model];
        pose = box_pose_in_sweep(log, *track, model.half_size_m, sweep);
        if (model.stride_m <= 0.0f) continue;
        // The phase of the walk, in cycles of the motion.
        const double walked_m = walked_at_start_m(find_box(log, instance.track), *track) +
                                WalkedDistanceTrack(*track).walked_m(pose.time_s);
        pose.phase = walked_m / double(model.stride_m);
    }
    return placed;
}

}  // namespace relidar
