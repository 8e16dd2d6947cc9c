// SPDX-License-Identifier: Apache-2.0
// Divides a log into blocks, which are trained separately, and joins the trained blocks.
// A surfel belongs to the block whose sweeps are nearest.
#include <relidar/run/blocks.hpp>

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/geometry/nearest_place.hpp"
#include "base/list_text.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

// Farther boxes have hardly any returns.
constexpr double kMaxBoxDistance_m = 100.0;
// Farther boxes have few returns, so the frame does not count for the actor.
constexpr double kMaxActorDistance_m = 60.0;

/// @return [frames] metres, world frame
std::vector<glm::dvec3> list_positions(const Log& log) {
    std::vector<glm::dvec3> positions_m;
    for (const Frame& frame : log.frames)
        positions_m.push_back(log.world_from_vehicle.pose_at(frame.time_s).translation);
    return positions_m;
}

/// Returns true if the box is within `max_distance_m` of the vehicle in a frame.
bool is_near_box(const BoxTrack& box, const Log& log, int frame_index, double max_distance_m) {
    const double time_s = log.frames[std::size_t(frame_index)].time_s;
    return box.is_observed(time_s) &&
           glm::distance(box.world_from_box.pose_at(time_s).translation,
                         log.world_from_vehicle.pose_at(time_s).translation) <= max_distance_m;
}

/// Divides the route into sections of equal length, and returns the frames in each
/// section as a block. Sections without frames are left out.
/// @param driven_m  [frames] distance from the start of the log along the route
/// @param max_length_m  maximum length of a section
std::vector<TrajectoryBlock> divide_route(const std::vector<double>& driven_m, double max_length_m) {
    const double route_m = driven_m.back();
    // The small number avoids an extra section because of a rounding error.
    const double n_sections = std::max(1.0, std::ceil(route_m / max_length_m - 1e-9));
    std::vector<TrajectoryBlock> blocks;
    for (std::size_t i = 0; i < driven_m.size(); ++i) {
        double section = 0.0;  // index; the end of the route belongs to the last section
        if (route_m > 0.0)
            section = std::min(n_sections - 1.0, std::floor(driven_m[i] / route_m * n_sections));
        const double begin_m = route_m * section / n_sections;
        if (blocks.empty() || blocks.back().begin_m < begin_m)
            blocks.push_back({begin_m, route_m * (section + 1.0) / n_sections, {}, {}});
        blocks.back().recorded_frames.push_back(static_cast<int>(i));
    }
    return blocks;
}

}  // namespace

std::vector<TrajectoryBlock> plan_blocks(const Log& log, const Split& split, const BlockConfig& options) {
    const std::vector<glm::dvec3> places_m = list_positions(log);
    std::vector<double> driven_m(places_m.size(), 0.0);
    for (std::size_t i = 1; i < places_m.size(); ++i)
        driven_m[i] = driven_m[i - 1] + glm::distance(places_m[i - 1], places_m[i]);
    std::vector<TrajectoryBlock> blocks = divide_route(driven_m, options.length_m);
    // A block is trained on all training frames within halo_m of its recorded frames.
    for (TrajectoryBlock& block : blocks) {
        const auto is_near_block = [&](int frame) {
            return std::ranges::any_of(block.recorded_frames, [&](int recorded) {
                return glm::distance(places_m[std::size_t(frame)], places_m[std::size_t(recorded)]) <=
                       options.halo_m;
            });
        };
        std::ranges::copy_if(split.train, std::back_inserter(block.train), is_near_block);
        if (block.train.empty())
            fail(
                "cannot divide {} into blocks: within {:g} m of the block that covers metres {:.0f} to "
                "{:.0f} of the trajectory, no frame is used for training; hold out fewer frames there "
                "(settings dataset.test_every and dataset.test_frames)",
                log.name, options.halo_m, block.begin_m, block.end_m);
    }
    return blocks;
}

/// Keeps the background surfels whose nearest sweep belongs to the block `index`, in
/// kd-tree order (neighbours in space are near in memory). Actors keep all surfels.
void keep_block_surfels(Scene& scene, const Log& log, const std::vector<TrajectoryBlock>& blocks,
                        std::size_t index) {
    std::vector<bool> is_block_frame(log.frames.size(), false);
    for (const int frame : blocks[index].recorded_frames) is_block_frame[std::size_t(frame)] = true;
    const NearestPointFinder<double> frame_finder(list_positions(log));
    const std::uint32_t n_background = scene.models.front().count;
    std::vector<glm::vec3> kept_means;
    std::vector<std::uint32_t> kept_surfels, new_order;
    for (std::uint32_t i = 0; i < n_background; ++i) {
        const glm::vec3& mean = scene.surfels.mean[i];
        if (!is_block_frame[frame_finder.nearest_index(glm::dvec3(mean))]) continue;
        kept_surfels.push_back(i);
        kept_means.push_back(mean);
    }
    for (const std::uint32_t i : kd_tree_order(kept_means)) new_order.push_back(kept_surfels[i]);
    for (std::uint32_t i = n_background; i < scene.surfels.size(); ++i) new_order.push_back(i);
    scene.surfels = scene.surfels.reorder(new_order);
    const auto n_removed = static_cast<std::uint32_t>(n_background - kept_surfels.size());
    scene.models.front().count -= n_removed;
    for (std::size_t model = 1; model < scene.models.size(); ++model) scene.models[model].first -= n_removed;
}

namespace {

/// Returns the vehicle poses at the times of some frames, and the poses directly before
/// and after each. These are needed to interpolate the motion during a sweep.
PoseTrack cut_track(const Log& log, const std::vector<int>& frame_indices) {
    const PoseTrack& all = log.world_from_vehicle;
    std::vector<bool> is_used(all.time_s.size(), false);
    for (const int frame : frame_indices) {
        const double time_s = log.frames[std::size_t(frame)].time_s;
        const auto pose = std::size_t(std::ranges::lower_bound(all.time_s, time_s) - all.time_s.begin());
        const std::size_t first = pose > 0 ? pose - 1 : 0, last = std::min(pose + 1, is_used.size() - 1);
        for (std::size_t i = first; i <= last; ++i) is_used[i] = true;
    }
    PoseTrack track;
    for (std::size_t i = 0; i < is_used.size(); ++i)
        if (is_used[i]) track.append(all.time_s[i], all.pose[i]);
    return track;
}

/// Removes actors without a box in this part of the log from options.actor_tracks, the
/// user's list. If none remains, also clears options.actor_classes, because with an empty
/// list the classes would select actors.
void drop_missing_tracks(InitOptions& options, const std::vector<BoxTrack>& boxes) {
    if (options.actor_tracks.empty()) return;
    std::vector<std::string> remaining_tracks;
    for (const std::string& track : split_list(options.actor_tracks))
        if (std::ranges::find(boxes, track, &BoxTrack::id) != boxes.end()) remaining_tracks.push_back(track);
    options.actor_tracks = fmt::format("{}", fmt::join(remaining_tracks, ","));
    if (remaining_tracks.empty()) options.actor_classes.clear();
}

}  // namespace

/// Returns the part of the log that a block needs: its training frames, the held-out
/// frames recorded in it, and the poses and boxes near these frames.
/// @param config  settings of the complete training
BlockTrainingLog cut_log(const Log& log, const Split& split, const TrajectoryBlock& block,
                         const Config& config) {
    std::vector<int> frames = block.train;  // indices in the log
    for (const int frame : block.recorded_frames)
        if (std::ranges::find(split.test, frame) != split.test.end()) frames.push_back(frame);
    std::ranges::sort(frames);
    BlockTrainingLog block_log{.log = strip_frames(log), .split = {}, .config = config};
    Log& part = block_log.log;
    part.name = fmt::format("{}, metres {:.0f} to {:.0f}", log.name, block.begin_m, block.end_m);
    part.world_from_vehicle = cut_track(log, frames);
    part.boxes.clear();
    for (const int frame : frames) {
        const bool is_trained = std::ranges::binary_search(block.train, frame);
        std::vector<int>& part_split = is_trained ? block_log.split.train : block_log.split.test;
        part_split.push_back(static_cast<int>(part.frames.size()));
        part.frames.push_back(log.frames[std::size_t(frame)]);
    }
    for (const BoxTrack& box : log.boxes)
        if (std::ranges::any_of(frames,
                                [&](int frame) { return is_near_box(box, log, frame, kMaxBoxDistance_m); }))
            part.boxes.push_back(box);
    block_log.config.blocks.length_m = 0.0;  // the part is not divided again
    drop_missing_tracks(block_log.config.init, part.boxes);
    return block_log;
}

namespace {

/// Returns the number of background surfels of a block and their bounding box. A surfel
/// extends to three standard deviations.
SceneBlock make_block(const Scene& scene, const fs::path& model_file) {
    SceneBlock block{model_file, scene.models.front().count, glm::vec3(0.0f), glm::vec3(0.0f)};
    for (std::uint32_t i = 0; i < block.count; ++i) {
        const glm::vec2 log_scale = scene.surfels.log_scale[i];
        const glm::vec3 reach(3.0f * std::exp(std::max(log_scale.x, log_scale.y)));
        const glm::vec3 mean = scene.surfels.mean[i];
        block.low_m = i == 0 ? mean - reach : glm::min(block.low_m, mean - reach);
        block.high_m = i == 0 ? mean + reach : glm::max(block.high_m, mean + reach);
    }
    return block;
}

/// Adds the drop table of a block, weighted by the number of its training frames.
void add_drop_table(RayDropTable& sum, const RayDropTable& table, std::size_t n_training_frames) {
    if (sum.empty()) sum = {table.channels, table.bins, std::vector<float>(table.probability.size(), 0.0f)};
    for (std::size_t i = 0; i < sum.probability.size(); ++i)
        sum.probability[i] += float(n_training_frames) * table.probability[i];
}

/// If several blocks have trained the same actor, the model with the most sightings is
/// used: training frames in which the actor is near the sensor.
struct ActorModelCandidate {
    std::size_t sightings = 0;
    SurfelModel model;
    Surfels surfels;
    BoxTrack box;
};

/// Adds the actors of a block to `best_actors`. If another block has trained the same
/// actor, keeps the model with more training frames near this actor.
void keep_best_models(const Run& block_run, const Log& full_log, const TrajectoryBlock& block,
                      std::map<std::string, ActorModelCandidate>& best_actors) {
    for (const ModelInstance& instance : block_run.scene.instances) {
        if (instance.track.empty()) continue;
        const BoxTrack* box = find_box(block_run.log, instance.track);
        if (!box)
            fail(
                "{}: the trained scene has an actor with the track id \"{}\", but the log has no box with "
                "this track id; expected the log that was used for training",
                block_run.folder.string(), instance.track);
        const auto sightings = std::size_t(std::ranges::count_if(block.train, [&](int position) {
            return is_near_box(*box, full_log, position, kMaxActorDistance_m);
        }));
        ActorModelCandidate& candidate = best_actors[instance.track];
        // It has no surfels if no earlier block has trained this actor.
        if (candidate.surfels.size() > 0 && sightings <= candidate.sightings) continue;
        const SurfelModel& model = block_run.scene.models[instance.model];
        candidate = {sightings, model, block_run.scene.surfels.slice(model.first, model.count), *box};
    }
}

/// Copies the vehicle poses at the sweeps of a block to the track of the full log,
/// because training has refined them.
void copy_poses(const Run& part, const Log& log, const TrajectoryBlock& block, PoseTrack& track) {
    const auto find_pose = [](auto& poses, double time_s) {
        const auto time = std::ranges::lower_bound(poses.time_s, time_s);
        const bool is_found = time != poses.time_s.end() && *time == time_s;
        return is_found ? &poses.pose[std::size_t(time - poses.time_s.begin())] : nullptr;
    };
    for (const int frame : block.recorded_frames) {
        const double time_s = log.frames[std::size_t(frame)].time_s;
        const Pose* trained = find_pose(part.log.world_from_vehicle, time_s);
        Pose* pose = find_pose(track, time_s);
        if (trained && pose) *pose = *trained;
    }
}

}  // namespace

void join_blocks(Run& run, const std::vector<TrajectoryBlock>& blocks, const std::vector<fs::path>& folders) {
    Scene scene = wrap_background({});
    std::size_t n_frames_with_drops = 0;
    std::map<std::string, ActorModelCandidate> actors;
    PoseTrack poses = run.log.world_from_vehicle;
    for (std::size_t k = 0; k < blocks.size(); ++k) {
        const Run part = load_run(folders[k]);
        scene.blocks.push_back(make_block(part.scene, folders[k] / kModelFile));
        if (!part.scene.sensor_drop.empty()) {
            add_drop_table(scene.sensor_drop, part.scene.sensor_drop, blocks[k].train.size());
            n_frames_with_drops += blocks[k].train.size();
        }
        keep_best_models(part, run.log, blocks[k], actors);
        copy_poses(part, run.log, blocks[k], poses);
        run.coverage.merge(part.coverage);
        merge_class_map(run.classes, part.classes);
        if (!part.refined_poses.empty()) run.refined_poses = part.refined_poses;
    }
    for (float& p : scene.sensor_drop.probability) p /= float(n_frames_with_drops);
    run.log.world_from_vehicle = std::move(poses);
    // Adds the actors in the order of the log's boxes. A scene that is trained without
    // blocks has the same order.
    for (BoxTrack& box : run.log.boxes) {
        const auto entry = actors.find(box.id);
        if (entry == actors.end()) continue;
        ActorModelCandidate& actor = entry->second;
        actor.model.first = static_cast<std::uint32_t>(scene.surfels.size());
        scene.instances.push_back({static_cast<std::uint32_t>(scene.models.size()), box.id});
        scene.models.push_back(actor.model);
        scene.surfels.append_surfels(actor.surfels);
        box = std::move(actor.box);
    }
    run.scene = std::move(scene);
}

}  // namespace relidar
