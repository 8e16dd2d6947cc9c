// SPDX-License-Identifier: Apache-2.0
// Initialises actors. An actor is the set of surfels of one tracked moving box. The
// surfels are stored in the frame of the box. The pose of the box at the rendered time
// transforms them to the world (paper section 3.2, Eq. 4-5: mean_world = R_t mean_object
// + T_t).
#include <relidar/scene/device_scene.hpp>
#include <relidar/scene/scene.hpp>

#include <algorithm>
#include <cmath>
#include <string_view>
#include <unordered_map>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "base/list_text.hpp"
#include "base/progress_blocks.hpp"
#include "base/random.hpp"
#include "scene/changing_actors.hpp"
#include "scene/point_surfels.hpp"
#include "scene/walked_distance.hpp"

namespace relidar {

namespace {

/// margin added around a labelled box, because labels fit loosely
constexpr double kPointMargin_m = 0.1;
/// Height of the lowest part of a box. Points in this part are removed, because they
/// belong to the ground.
constexpr double kGround_m = 0.15;
constexpr std::string_view kEveryClass = "all";

/// Adds the returns of one scan that lie inside boxes, in the coordinates of the box.
void add_frame(const Sequence& sequence, const Frame& frame, const std::vector<BoxTrack>& boxes,
               bool second_returns, const std::vector<WalkedDistance>& walks,
               std::vector<std::vector<Sample>>& samples) {
    std::vector<std::size_t> present;
    for (std::size_t b = 0; b < boxes.size(); ++b)
        if (boxes[b].is_present(frame.time_s)) present.push_back(b);
    if (present.empty()) return;
    for_each_return(sequence, frame, second_returns, [&](const WorldReturn& world_return) {
        for (const std::size_t b : present) {
            if (!boxes[b].holds(world_return.point_m, world_return.time_s, kPointMargin_m)) continue;
            const Pose box_from_world = inverse(boxes[b].world_from_box.at(world_return.time_s));
            const glm::dvec3 local = box_from_world * world_return.point_m;
            if (local.z < -0.5 * boxes[b].size_m.z + kGround_m) continue;
            samples[b].push_back({glm::vec3(local), world_return.intensity,
                                  glm::vec3(box_from_world.rotation * world_return.direction),
                                  static_cast<float>(walks[b].at(world_return.time_s)), frame.index});
        }
    });
}

/// Collects the LiDAR returns of the training frames that lie inside boxes. Stores each
/// point in the frame of its box.
/// @return [boxes]
std::vector<std::vector<Sample>> collect_box_samples(const Sequence& sequence, const std::vector<int>& train,
                                                     const std::vector<BoxTrack>& boxes,
                                                     const InitialiseOptions& options,
                                                     const Progress& progress) {
    std::vector<WalkedDistance> walks;
    for (const BoxTrack& box : boxes) walks.emplace_back(box.world_from_box);
    std::vector<std::vector<Sample>> samples(boxes.size());
    std::vector<std::vector<std::vector<Sample>>> of_frame(train.size(),
                                                           std::vector<std::vector<Sample>>(boxes.size()));
    for_each_with_progress(train.size(), progress, "points of actors", [&](std::size_t index) {
        add_frame(sequence, sequence.frames[std::size_t(train[index])], boxes, options.second_returns, walks,
                  of_frame[index]);
    });
    for (const std::vector<std::vector<Sample>>& frame : of_frame)
        for (std::size_t b = 0; b < boxes.size(); ++b)
            samples[b].insert(samples[b].end(), frame[b].begin(), frame[b].end());
    return samples;
}

bool contains_word_in_list(const std::string& list, const std::string& word) {
    const std::vector<std::string> words = split_words(list);
    return std::find(words.begin(), words.end(), word) != words.end();
}

bool is_wanted(const BoxTrack& box, const InitialiseOptions& options) {
    if (options.unlabelled_movers == UnlabelledMovers::actors && box.category == kDiscoveredCategory)
        return true;
    if (!options.actor_tracks.empty()) return contains_word_in_list(options.actor_tracks, box.id);
    return options.actor_classes == kEveryClass ||
           contains_word_in_list(options.actor_classes, box.category) ||
           contains_word_in_list(options.actor_classes, get_name(parse_object_kind(box.category)));
}

/// Returns the kind of object in a box (person, cyclist, other). If a box has no label,
/// guesses the kind from the size of the box.
ObjectKind find_kind(const BoxTrack& box) {
    if (box.category != kDiscoveredCategory) return parse_object_kind(box.category);
    const double length = std::max(box.size_m.x, box.size_m.y), width = std::min(box.size_m.x, box.size_m.y);
    if (width > 1.1 || box.size_m.z < 1.2) return ObjectKind::other;
    return length < 1.3 ? ObjectKind::person : length < 2.2 ? ObjectKind::cyclist : ObjectKind::other;
}

bool has_bending_shape(const BoxTrack& box, const InitialiseOptions& options) {
    return options.deform == kEveryClass || contains_word_in_list(options.deform, box.category) ||
           contains_word_in_list(options.deform, get_name(find_kind(box)));
}

/// Checks that the size of a box is positive and that all its poses are finite.
/// @throws DataError if a size or a pose is invalid
void check_box(const BoxTrack& box) {
    const glm::dvec3& s = box.size_m;
    if (!(s.x > 0.0 && s.y > 0.0 && s.z > 0.0) || !std::isfinite(s.x + s.y + s.z))
        throw DataError(fmt::format("box {} has the size {} x {} x {} m, expected three lengths above 0",
                                    box.id, s.x, s.y, s.z));
    for (std::size_t i = 0; i < box.world_from_box.pose.size(); ++i) {
        const Pose& pose = box.world_from_box.pose[i];
        if (!std::isfinite(glm::dot(pose.translation, glm::dvec3(1.0)) +
                           glm::dot(pose.rotation, pose.rotation)))
            throw DataError(fmt::format(
                "box {}: the pose of observation {} is not finite, expected a finite pose", box.id, i));
    }
}

void check_tracks(const Sequence& sequence, const std::string& tracks) {
    std::vector<std::string> known;
    for (const BoxTrack& box : sequence.boxes) known.push_back(box.id);
    for (const std::string& track : split_words(tracks))
        if (std::find(known.begin(), known.end(), track) == known.end())
            throw UsageError(fmt::format("setting init.actor_tracks: found \"{}\"{} (tracks: {})", track,
                                         suggest_name(track, known, "\""), fmt::join(known, ", ")));
}

/// Adds random points inside the box until there are `count` samples. The new points have
/// the mean intensity of the existing samples. Their viewing directions point from
/// outside towards the box centre.
void pad_samples(std::vector<Sample>& samples, std::size_t count, const BoxTrack& box, std::uint64_t seed) {
    double intensity = 0.0;
    for (const Sample& s : samples) intensity += s.intensity / double(samples.size());
    Random random(combine_hashes(seed, combine_hashes(std::hash<std::string>{}(box.id))));
    while (samples.size() < count) {
        const glm::dvec3 p =
            box.size_m * (glm::dvec3(random.uniform(), random.uniform(), random.uniform()) - 0.5);
        samples.push_back(
            {glm::vec3(p), static_cast<float>(intensity), glm::vec3(-p / std::max(glm::length(p), 1e-9))});
    }
}

/// Selects at most `actor_points` samples of an actor from the points in its box. If
/// there are fewer, adds random points. If the box has fewer than `actor_min_points`,
/// adds none.
std::vector<Sample> prepare_actor_samples(std::vector<Sample> samples, const BoxTrack& box,
                                          const InitialiseOptions& options) {
    samples = thin_samples(samples, std::size_t(options.actor_points));
    if (samples.size() >= std::size_t(options.actor_min_points))
        pad_samples(samples, std::size_t(std::min(options.actor_pad_to, options.actor_points)), box,
                    options.seed);
    return samples;
}

/// Returns the parts of a box's surface that LiDAR rays have hit from outside.
BoxSurface compute_visible_surface(const BoxTrack& box, const std::vector<Sample>& samples) {
    BoxSurface surface(box.size_m);
    for (const Sample& s : samples) surface.add(glm::dvec3(s.position), glm::dvec3(s.view));
    return surface;
}

struct ActorStart {
    const InitialiseOptions& options;
    double incidence;  ///< coefficient `incidence` of IntensityResponse
    std::vector<std::string>* notes;
    const Progress& progress;
};

/// Appends an actor to the scene. Does nothing if the box has too few points.
void add_actor(Scene& scene, const BoxTrack& box, const std::vector<Sample>& samples,
               const ActorStart& start) {
    const auto& [options, incidence, notes, progress] = start;
    std::vector<Sample> rigid = prepare_actor_samples(samples, box, options);
    if (rigid.size() < std::size_t(options.actor_min_points)) return;
    ChangingSurfels changing;
    if (has_bending_shape(box, options)) {
        changing =
            make_changing_surfels(samples, options, incidence, std::size_t(options.actor_points), progress);
        const bool is_rigid = !changing.why_rigid.empty();
        if (notes)
            notes->push_back(fmt::format("{} ({}) {}{}", box.id, box.category,
                                         is_rigid ? "is rigid: " : "changes from frame to frame",
                                         changing.why_rigid));
    }
    const Surfels surfels = changing.period_m > 0.0 ? std::move(changing.surfels)
                                                    : make_surfels_from_points(rigid, options, incidence);
    scene.instances.push_back({static_cast<std::uint32_t>(scene.models.size()), box.id});
    scene.models.push_back({box.id, static_cast<std::uint32_t>(scene.surfels.size()),
                            static_cast<std::uint32_t>(surfels.size()),
                            glm::vec3(0.5 * box.size_m + kPointMargin_m),
                            static_cast<float>(changing.period_m), compute_visible_surface(box, samples)});
    scene.surfels.append(surfels);
}

/// Returns the distance in metres that an actor has walked at the start of a new track.
/// Takes the distance at the nearest recorded pose, and adds the way to the new pose.
/// Steps are animated by this distance, so they match the position.
double compute_start_distance_m(const BoxTrack& box, const PoseTrack& track) {
    const Pose& at = track.pose.front();
    const auto place_m = [&](const Pose& pose) { return glm::distance(pose.translation, at.translation); };
    const auto nearest = std::ranges::min_element(box.world_from_box.pose, {}, place_m);
    const double time_s = box.world_from_box.time_s[std::size_t(nearest - box.world_from_box.pose.begin())];
    const glm::dvec3 ahead = at.rotation * glm::dvec3(1.0, 0.0, 0.0);
    return WalkedDistance(box.world_from_box).at(time_s) +
           glm::dot(at.translation - nearest->translation, ahead);
}

/// Returns the poses of the background and of all actors. `track_of` maps the name of an
/// actor to its track. An actor is absent if `track_of` returns null.
template <class TrackOf>
std::vector<InstancePose> place_instances_by(const Scene& scene, const Sequence& sequence,
                                             const SweepMoment& sweep, const TrackOf& track_of) {
    std::vector<InstancePose> placed;
    for (const Instance& instance : scene.instances) {
        if (instance.track.empty()) {
            placed.push_back({});
            continue;
        }
        const PoseTrack* track = track_of(instance.track);
        const Model& model = scene.models[instance.model];
        placed.push_back(track ? compute_pose_in_sweep(sequence, *track, model.half_size_m, sweep)
                               : InstancePose{{}, false});
        const double stride_m = double(model.stride_m);
        if (!track || stride_m <= 0.0) continue;
        const BoxTrack* own = find_box(sequence, instance.track);
        const bool is_own = own && &own->world_from_box == track;
        const double before_m = own && !is_own && !own->world_from_box.pose.empty()
                                    ? compute_start_distance_m(*own, *track)
                                    : 0.0;
        placed.back().phase = (before_m + WalkedDistance(*track).at(placed.back().time_s)) / stride_m;
    }
    return placed;
}

}  // namespace

std::vector<BoxTrack> list_foreground_boxes(const Sequence& sequence, const InitialiseOptions& options) {
    check_tracks(sequence, options.actor_tracks);
    std::vector<BoxTrack> boxes;
    for (const BoxTrack& box : sequence.boxes) {
        check_box(box);
        if (!options.mask_others && !is_wanted(box, options)) continue;
        if (box.is_moving() || contains_word_in_list(options.actor_tracks, box.id)) boxes.push_back(box);
    }
    return boxes;
}

Scene initialise_scene(const Sequence& sequence, const std::vector<int>& train_positions,
                       const InitialiseOptions& options, const Progress& progress,
                       std::vector<std::string>* notes) {
    Scene scene = make_background_scene(initialise_background(sequence, train_positions, options, progress));
    std::vector<BoxTrack> wanted = list_foreground_boxes(sequence, options);
    std::erase_if(wanted, [&](const BoxTrack& box) { return !is_wanted(box, options); });
    std::vector<std::vector<Sample>> in_boxes =
        collect_box_samples(sequence, train_positions, wanted, options, progress);
    for (std::size_t i = 0; i < wanted.size(); ++i) {
        if (progress) progress("actors", double(i) / double(wanted.size()));
        add_actor(scene, wanted[i], in_boxes[i],
                  {options, sequence.intensity_response.incidence, notes, progress});
    }
    return scene;
}

std::vector<BoxTrack> find_masked_boxes(const Scene& scene, const Sequence& sequence,
                                        const InitialiseOptions& options) {
    std::vector<BoxTrack> boxes = list_foreground_boxes(sequence, options);
    std::erase_if(boxes, [&](const BoxTrack& box) {
        return std::any_of(scene.instances.begin(), scene.instances.end(),
                           [&](const Instance& i) { return i.track == box.id; });
    });
    return boxes;
}

std::vector<BoxTrack> find_unselected_boxes(const Sequence& sequence, const InitialiseOptions& options) {
    std::vector<BoxTrack> boxes = list_foreground_boxes(sequence, options);
    std::erase_if(boxes, [&](const BoxTrack& box) { return is_wanted(box, options); });
    return boxes;
}

std::string list_boxes(const std::vector<BoxTrack>& boxes) {
    constexpr std::size_t kMost = 8;
    std::vector<std::string> names;
    for (std::size_t i = 0; i < std::min(kMost, boxes.size()); ++i)
        names.push_back(fmt::format("{} ({})", boxes[i].id, boxes[i].category));
    return fmt::format("{}{}", fmt::join(names, ", "),
                       boxes.size() > kMost ? fmt::format(" and {} more", boxes.size() - kMost) : "");
}

std::vector<InstancePose> place_instances(const Scene& scene, const Sequence& sequence,
                                          const SweepMoment& sweep) {
    // uses a hash map because a log can have a thousand tracks
    std::unordered_map<std::string_view, const PoseTrack*> tracks;
    for (const BoxTrack& box : sequence.boxes)
        if (box.is_present(sweep.time_s)) tracks.emplace(box.id, &box.world_from_box);
    return place_instances_by(scene, sequence, sweep, [&](const std::string& name) {
        const auto track = tracks.find(name);
        return track == tracks.end() ? nullptr : track->second;
    });
}

std::vector<InstancePose> place_instances(const Scene& scene, const Sequence& sequence,
                                          const SweepMoment& sweep, const ActorPoses& world_from_actor) {
    std::vector<std::string> tracks;
    for (const Instance& instance : scene.instances)
        if (!instance.track.empty()) tracks.push_back(instance.track);
    for (const auto& [track, poses] : world_from_actor)
        if (std::find(tracks.begin(), tracks.end(), track) == tracks.end())
            throw UsageError(fmt::format(
                "cannot place actors: found a pose of track \"{}\", expected the name of a track of the "
                "scene{}",
                track, tracks.empty() ? ", which has no actors" : suggest_name(track, tracks, "\"")));
    return place_instances_by(scene, sequence, sweep, [&](const std::string& name) {
        const auto track = world_from_actor.find(name);
        return track == world_from_actor.end() ? nullptr : &track->second;
    });
}

}  // namespace relidar
