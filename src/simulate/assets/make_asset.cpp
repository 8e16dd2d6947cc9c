// SPDX-License-Identifier: Apache-2.0
// Extracts an actor of a run as a separate run. Removes surfels that are never visible.
// Completes the unobserved side of vehicles with mirrored surfels.
#include <relidar/simulate/assets.hpp>

#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/run/edit.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/scene/symmetry.hpp>

#include "base/fail.hpp"

namespace relidar {
namespace {

/// Returns the name of an asset, for example "car-3". It contains only characters that
/// are valid in file names. If an object has no class, the name is its track id.
std::string make_asset_name(const BoxTrack& box) {
    std::string name = box.category == kDiscoveredCategory ? box.id : box.category + "-" + box.id;
    for (char& c : name) {
        const auto byte = static_cast<unsigned char>(c);
        if (byte < 0x80 && std::isalnum(byte)) c = char(std::tolower(byte));
        else if (c != '.' && c != '_') c = '-';
    }
    return name.front() == '.' ? "-" + name : name;
}

/// Returns true if a surfel can be visible. Its opacity must reach the blending
/// threshold, and it must lie inside the box of its model.
bool is_useful(const Surfels& surfels, std::size_t i, const SurfelModel& model, const ImageModel& image) {
    const glm::vec3 outside = glm::abs(surfels.mean[i]) - model.half_size_m;
    const bool bounded = model.half_size_m.x > 0.0f;
    if (bounded && (outside.x > 0.0f || outside.y > 0.0f || outside.z > 0.0f)) return false;
    return 1.0f / (1.0f + std::exp(-surfels.opacity_logit[i])) >= image.alpha_min;
}

/// Returns the frames of a log in which an actor is present, without their scans.
Log log_of_actor(const Log& full, const BoxTrack& actor_box) {
    Log log = strip_frames(full);
    log.boxes = {actor_box};
    log.world_from_vehicle = {};
    for (const Frame& frame : full.frames) {
        if (!actor_box.is_observed(frame.time_s)) continue;
        Frame frame_without_scan;
        frame_without_scan.index = frame.index;
        frame_without_scan.time_s = frame.time_s;
        frame_without_scan.lidar = frame.lidar;
        log.frames.push_back(std::move(frame_without_scan));
        PoseTrack& track = log.world_from_vehicle;
        if (!track.time_s.empty() && track.time_s.back() == frame.time_s) continue;
        track.time_s.push_back(frame.time_s);
        track.pose.push_back(full.world_from_vehicle.pose[full.find_pose_index(frame)]);
    }
    return log;
}

}  // namespace

ObservedBoxSurface observed_surface(const glm::dvec3& box_size_m, const ActorObservations& observations) {
    ObservedBoxSurface surface(box_size_m);
    for (std::size_t i = 0; i < observations.points_m.size(); ++i)
        surface.mark_observed(glm::dvec3(observations.points_m[i]), glm::dvec3(observations.directions[i]));
    return surface;
}

ActorAsset extract_asset(const Run& run, const std::string& track, const ActorObservations& observations) {
    SceneWithLog alone = run.driving_scene();
    std::vector<std::string> others;
    for (const ModelInstance& instance : alone.scene.instances)
        if (!instance.track.empty() && instance.track != track) others.push_back(instance.track);
    alone = remove_background(std::move(alone));
    for (const std::string& other : others) alone = remove_track(std::move(alone), other);
    const auto box =
        std::ranges::find_if(alone.sequence.boxes, [&](const BoxTrack& b) { return b.id == track; });
    if (alone.scene.instances.size() != 2 || box == alone.sequence.boxes.end())
        fail<UsageError>("cannot make an asset of \"{}\": the run has no such actor, expected one of: {}",
                         track, fmt::join(others, ", "));

    ObservedBoxSurface surface = observed_surface(box->size_m, observations);
    ActorAsset asset;
    AssetDescription& facts = asset.facts;
    facts = {make_asset_name(*box),
             box->category,
             guess_kind(*box),
             box->size_m,
             run.folder.empty() ? "" : std::filesystem::absolute(run.folder).lexically_normal().string(),
             track,
             run.sequence.lidars.front().sensor.name};
    for (std::size_t s = 0; s < kBoxSides; ++s) facts.seen_sides[s] = surface.observed_fraction(BoxSide(s));
    facts.seen = surface.observed_fraction();
    facts.nearest_m = observations.nearest_m;
    facts.clearance_m = ground_clearance({run.scene, run.sequence}, track).value_or(0.0);

    SurfelModel& model = alone.scene.models[1];
    Surfels& surfels = alone.scene.surfels;
    std::vector<std::uint32_t> shown;
    for (std::uint32_t i = 0; i < surfels.size(); ++i)
        if (is_useful(surfels, i, model, run.config.image)) shown.push_back(i);
    surfels = surfels.reorder(shown);
    if (facts.kind == ObjectKind::vehicle) {
        facts.mirrored = mirror_unobserved(surfels, surface);
        facts.completed = surface.is_completed ? surface.mirrorable_fraction() : 0.0;
    }
    // Sorts neighbours together again, because the mirrored surfels were appended.
    surfels = surfels.reorder(kd_tree_order(surfels.mean));
    facts.surfels = surfels.size();

    BoxTrack named = *box;
    named.id = facts.name;
    model = {facts.name, 0, std::uint32_t(surfels.size()), model.half_size_m, model.stride_m, surface};
    alone.scene.models[0].first = 0;
    alone.scene.instances[1].track = facts.name;
    alone.scene.sensor_drop = {};
    asset.run.config = run.config;
    asset.run.sequence = log_of_actor(alone.sequence, named);
    for (int i = 0; i < int(asset.run.sequence.frames.size()); ++i) asset.run.split.train.push_back(i);
    asset.run.scene = std::move(alone.scene);
    asset.run.edits = run.edits;
    asset.run.edits.push_back({facts.source_run, fmt::format("asset of {}", track)});
    asset.run.refined_poses = run.refined_poses;
    return asset;
}

std::string only_track(const Run& run) {
    std::vector<std::string> tracks;
    for (const ModelInstance& instance : run.scene.instances)
        if (!instance.track.empty()) tracks.push_back(instance.track);
    if (tracks.size() == 1) return tracks.front();
    fail<UsageError>("{} is a run with {} actors, expected an asset, or RUN#TRACK{}", run.folder.string(),
                     tracks.size(),
                     tracks.empty() ? "" : fmt::format(" whose track is one of {}", fmt::join(tracks, ", ")));
}

}  // namespace relidar
