// SPDX-License-Identifier: Apache-2.0
// Trains the actors of a scene in blocks a second time, in front of the joined
// background. Uses only the rays near the boxes of actors and the surfels along these
// rays. An actor in several blocks then learns from all of them in random order.
#include <relidar/train/train.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <set>

#include <relidar/run/run.hpp>
#include <relidar/scene/labels.hpp>

#include "base/parallel.hpp"
#include "train/frames/frame_data.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

constexpr double kBoxMargin_m = 0.5;  // around the box of an actor; rays inside the margin are also used
constexpr double kMaxMotionPerBeam_m = 0.2;    // maximum motion of a sensor while a beam crosses an actor
constexpr double kMaxHalfSweepMotion_m = 2.0;  // maximum distance that a sensor moves during half a sweep
constexpr double kReach_sigmas = 3.5;          // farther from its centre, a surfel is nearly transparent
// Maximum number of surfels in the scene blocks of a section of the log, including
// surfels that no ray to an actor can hit.
constexpr std::size_t kMaxSectionSurfels = 1'500'000;
constexpr float kMaxDropProbability = 0.5f;  // rays that are dropped more often tell nothing about actors

/// An actor in one sweep.
struct ActorSighting {
    glm::dvec3 sensor_m;  ///< position of the sensor when the LiDAR head faces the actor
    InstancePose placed;
    glm::dvec3 half_size_m;

    /// @param time_offset_s  firing time relative to the reference time of the sweep
    bool hits_box(const WorldRay& ray, double time_offset_s) const {
        return hits_enlarged_box(ray, time_offset_s, kBoxMargin_m);
    }
    /// The sphere can be in front of the actor or behind it.
    bool can_hit_sphere(const glm::dvec3& centre_m, double radius_m) const {
        const double driven_length_m = glm::length(placed.motion.velocity_mps) * placed.motion.half_span_s;
        return hits_enlarged_box({sensor_m, glm::normalize(centre_m - sensor_m)}, placed.motion.middle_s,
                                 kBoxMargin_m + kMaxMotionPerBeam_m + driven_length_m + radius_m);
    }

private:
    bool hits_enlarged_box(const WorldRay& ray, double time_offset_s, double margin_m) const {
        const PosedBox box{inverse(placed.motion.pose_at(placed.world_from_model, time_offset_s)),
                           half_size_m};
        const glm::dvec2 inside = box.intersect_m(ray, margin_m);
        return inside.x <= inside.y;
    }
};

struct FrameWithSightings {
    int position = 0;          ///< index into Log::frames
    glm::dvec3 sensor_m{0.0};  ///< at the time of the frame
    double reach_m = 0.0;      ///< range of the farthest return in the frame
    std::vector<ActorSighting> sights;

    bool can_reach(const SceneBlock& block) const {
        return block.count > 0 && block.distance_m(sensor_m) <= reach_m + kMaxHalfSweepMotion_m;
    }
};

/// Frames that are trained together, and the scene blocks that their rays can reach.
struct ActorTrainingSection {
    std::vector<FrameWithSightings> frames;
    std::set<std::size_t> blocks;
};

/// Returns a frame and the actors whose box is within the range of its farthest return.
/// An actor has its pose and that of the sensor at the time when the LiDAR head faces it.
/// @param tracks  [lidars] poses of each sensor in the world
FrameWithSightings find_sightings(const Run& run, int index, const std::vector<PoseTrack>& tracks) {
    const Frame& frame = run.log.frames[std::size_t(index)];
    const PoseTrack& world_from_sensor = tracks[std::size_t(frame.lidar)];
    FrameWithSightings result{.position = index,
                              .sensor_m = world_from_sensor.pose_at(frame.time_s).translation};
    for (const float range_m : frame.scan.range_m) result.reach_m = std::max(result.reach_m, double(range_m));
    const std::vector<InstancePose> placed = pose_instances(run.scene, run.log, timing_of(frame));
    for (std::size_t i = 0; i < run.scene.instances.size(); ++i) {
        const BoxTrack* box = find_box(run.log, run.scene.instances[i].track);
        if (!box || !placed[i].present) continue;  // the background has no box
        const ActorSighting actor{.sensor_m = world_from_sensor.pose_at(placed[i].time_s).translation,
                                  .placed = placed[i],
                                  .half_size_m = 0.5 * box->size_m};
        const double distance_m = glm::distance(actor.sensor_m, placed[i].world_from_model.translation);
        if (distance_m < result.reach_m + 0.5 * glm::length(box->size_m)) result.sights.push_back(actor);
    }
    return result;
}

/// Divides the training frames that show actors into sections, which are trained
/// separately so that their scene blocks fit into memory. Starts a new section if its
/// blocks would have more than kMaxSectionSurfels surfels.
std::vector<ActorTrainingSection> divide_log(const Run& run, const std::vector<PoseTrack>& sensor_tracks) {
    std::vector<ActorTrainingSection> sections(1);
    for (const int position : run.split.train) {
        FrameWithSightings frame = find_sightings(run, position, sensor_tracks);
        if (frame.sights.empty()) continue;
        std::set<std::size_t> blocks_of_frame;
        for (std::size_t i = 0; i < run.scene.blocks.size(); ++i)
            if (frame.can_reach(run.scene.blocks[i])) blocks_of_frame.insert(i);

        // Blocks of the current section with this frame.
        std::set<std::size_t> blocks = sections.back().blocks;
        blocks.insert(blocks_of_frame.begin(), blocks_of_frame.end());
        std::size_t n_surfels = 0;
        for (const std::size_t block : blocks) n_surfels += run.scene.blocks[block].count;
        if (n_surfels > kMaxSectionSurfels && !sections.back().frames.empty()) {
            sections.emplace_back();
            blocks = blocks_of_frame;
        }
        sections.back().frames.push_back(std::move(frame));
        sections.back().blocks = std::move(blocks);
    }
    return sections;
}

/// Returns the rays of a scan that hit the box of an actor, enlarged by kBoxMargin_m, as
/// a list without rows and columns. Leaves out rays that the sensor itself usually drops.
Scan select_actor_rays(const Run& run, const Frame& frame, const PoseTrack& world_from_sensor,
                       const std::vector<ActorSighting>& visible_actors) {
    const Scan& all = frame.scan;
    const auto is_near_actor = [&](std::size_t ray) {
        const WorldRay world_ray =
            make_world_ray(world_from_sensor, frame.time_s, all.rays, ray, run.log.rolling_shutter);
        // Firing time relative to the sweep's reference time. The actor moves meanwhile.
        const double offset_s = run.log.rolling_shutter ? double(all.rays.time_offset_s[ray]) : 0.0;
        return std::ranges::any_of(
            visible_actors, [&](const ActorSighting& actor) { return actor.hits_box(world_ray, offset_s); });
    };
    const BodyTable& own_body = run.log.lidar_of(frame).own_body;
    const auto is_usually_dropped = [&](std::size_t ray) {
        if (own_body.hides(all.rays.direction[ray], all.range_m[ray])) return true;
        const auto beam = run.log.find_global_beam(frame.lidar, all.rays.channel[ray]);
        return beam &&
               run.scene.sensor_drop.probability_of(*beam, all.rays.direction[ray]) > kMaxDropProbability;
    };
    std::vector<std::size_t> selected_rays;
    Scan scan;
    for (std::size_t ray = 0; ray < all.range_m.size(); ++ray) {
        if (!is_near_actor(ray) || is_usually_dropped(ray)) continue;
        selected_rays.push_back(ray);
        scan.range_m.push_back(all.range_m[ray]);
        scan.intensity.push_back(all.intensity[ray]);
    }
    scan.rays = select_rays(all.rays, selected_rays);
    return scan;
}

/// Returns a log with the frames of one section, which contain only rays near actors.
/// Frames without such rays are left out.
Log section_log(const Run& run, const ActorTrainingSection& section, const std::vector<PoseTrack>& tracks) {
    std::vector<Frame> frames(section.frames.size());
    parallel_for(static_cast<int>(frames.size()), [&](int index) {
        const FrameWithSightings& sighted = section.frames[std::size_t(index)];
        const Frame& full_frame = run.log.frames[std::size_t(sighted.position)];
        const PoseTrack& world_from_sensor = tracks[std::size_t(full_frame.lidar)];
        frames[std::size_t(index)] = {
            .index = full_frame.index,
            .time_s = full_frame.time_s,
            .scan = select_actor_rays(run, full_frame, world_from_sensor, sighted.sights),
            .lidar = full_frame.lidar,
            .start = full_frame.start};
    });
    Log log = strip_frames(run.log);
    for (Frame& frame : frames)
        if (frame.scan.rays.columns > 0) log.frames.push_back(std::move(frame));
    return log;
}

/// Returns the surfels that rays to the box of an actor hit, before it or behind it.
Surfels select_surfels(const Surfels& surfels, const std::vector<ActorSighting>& sightings) {
    std::vector<std::uint8_t> is_selected(surfels.size(), 0);
    parallel_blocks(surfels.size(), [&](std::size_t index) {
        const glm::dvec3 mean = surfels.mean[index];
        // A sphere around the surfel. Its scales are standard deviations in metres.
        const float log_scale = std::max(surfels.log_scale[index].x, surfels.log_scale[index].y);
        const double radius_m = kReach_sigmas * std::exp(double(log_scale));
        is_selected[index] = std::ranges::any_of(
            sightings, [&](const ActorSighting& actor) { return actor.can_hit_sphere(mean, radius_m); });
    });
    std::vector<std::uint32_t> selected;
    for (std::uint32_t i = 0; i < is_selected.size(); ++i)
        if (is_selected[i]) selected.push_back(i);
    return surfels.reorder(selected);
}

/// Returns the actors of the run, and the surfels of the background that rays to actors
/// can hit. Loads one block at a time, because all blocks may not fit into memory.
/// @return the scene, and the mean extent of its blocks (or of the run) in metres
std::pair<Scene, double> section_scene(const Run& run, const ActorTrainingSection& section) {
    // Sightings in the frames that can reach a block; in all frames if `block` is null.
    const auto list_sightings = [&](const SceneBlock* block) {
        std::vector<ActorSighting> sightings;
        for (const FrameWithSightings& frame : section.frames)
            if (!block || frame.can_reach(*block))
                sightings.insert(sightings.end(), frame.sights.begin(), frame.sights.end());
        return sightings;
    };
    // The background that is not in blocks, then the surfels of the blocks.
    const Surfels unblocked = run.scene.surfels.slice(0, run.scene.models.front().count);
    Surfels background = select_surfels(unblocked, list_sightings(nullptr));
    double extent_m = section.blocks.empty() ? scene_extent_m(run.scene) : 0.0;
    for (const std::size_t i : section.blocks) {
        const SceneBlock& place = run.scene.blocks[i];
        const Scene block = wrap_background(load_block(place));
        background.append_surfels(select_surfels(block.surfels, list_sightings(&place)));
        extent_m += scene_extent_m(block) / double(section.blocks.size());
    }
    return {replace_background(run.scene, background), extent_m};
}

/// Returns the settings for training only the actors. Uses all rays, and does not refine
/// poses or change the number of surfels.
Config actor_config(const Config& config, std::size_t n_frames) {
    constexpr std::size_t kMaxIterations = 1'000'000'000;  // so that the number fits into an int
    const std::size_t n_iterations = std::size_t(config.blocks.actor_epochs) * n_frames;
    Config result = config;
    result.train.iterations = static_cast<int>(std::min(n_iterations, kMaxIterations));
    result.train.rays_per_iteration = 0;
    result.train.only_touched = true;
    result.train.sensor_drop = false;  // select_actor_rays() has removed such rays
    result.train.refine_poses = "none";
    result.train.sh_degree_start = result.image.sh_degree;
    result.densify.strategy = DensifyStrategy::none;
    result.loss.intensity_ssim = 0.0f;  // this loss compares neighbouring pixels of an image
    return result;
}

/// Copies the surfels of the trained actors, which follow the background, to the run.
void copy_actors(Run& run, const Scene& trained) {
    const std::size_t n_background = run.scene.models.front().count;
    const std::size_t n_actor_surfels = run.scene.surfels.size() - n_background;
    Surfels surfels = run.scene.surfels.slice(0, n_background);
    surfels.append_surfels(trained.surfels.slice(trained.surfels.size() - n_actor_surfels, n_actor_surfels));
    run.scene.surfels = std::move(surfels);
}

/// Trains the actors in the frames of a section, and copies them to the run.
/// @param after_step  called after each iteration; training stops if it returns false
/// @return false if training was stopped; the run then keeps its actors
bool train_section(Device& device, Run& run, const ActorTrainingSection& section,
                   const std::vector<PoseTrack>& tracks, const std::function<bool()>& after_step) {
    const Log log = section_log(run, section, tracks);
    if (log.frames.empty()) return true;
    Split split;
    split.train.resize(log.frames.size());
    std::iota(split.train.begin(), split.train.end(), 0);
    const auto [scene, extent_m] = section_scene(run, section);
    const Config config = actor_config(run.config, log.frames.size());
    TrainLoop loop(device, log, split, scene, config, scene.models.front().count, extent_m);
    for (int step = 1; step <= config.train.iterations; ++step) {
        loop.run_iteration(step);
        if (!after_step()) return false;
    }
    loop.finish();
    Scene trained = loop.download_scene();
    fade_far_swings(trained, config.image.alpha_min);
    copy_actors(run, trained);
    return true;
}

}  // namespace

TrainingEndReason train_actors(Device& device, Run& run, const ActorTrainingCallbacks& session) {
    const int n_epochs = run.config.blocks.actor_epochs;
    const bool has_actors = run.scene.instances.size() >= 2;
    if (n_epochs == 0 || !has_actors) return TrainingEndReason::finished;
    std::vector<PoseTrack> tracks;  // [lidars] one pose for each sweep of the log
    for (std::size_t lidar = 0; lidar < run.log.lidars.size(); ++lidar)
        tracks.push_back(run.log.lidar_track(static_cast<int>(lidar)));
    const std::vector<ActorTrainingSection> sections = divide_log(run, tracks);
    int n_frames = 0, step = 0;
    for (const ActorTrainingSection& section : sections) n_frames += static_cast<int>(section.frames.size());
    // An iteration uses one frame, so all epochs together have n_epochs * n_frames.
    const auto after_step = [&] {
        if (session.step) session.step(++step, n_epochs * n_frames);
        return !(session.stop && session.stop());
    };
    for (const ActorTrainingSection& section : sections)  // runs all epochs of a section
        if (!train_section(device, run, section, tracks, after_step)) return TrainingEndReason::stopped;
    return TrainingEndReason::finished;
}

}  // namespace relidar
