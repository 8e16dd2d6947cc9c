// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/blocks.hpp>

#include <algorithm>
#include <map>

#include "base/fail.hpp"
#include "run/blocks/frame_places.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

// A frame counts for an actor up to this distance, because farther boxes have few
// returns.
constexpr double kMaxActorDistance_m = 60.0;

/// Returns the number of background surfels of a block and their bounding box. A surfel
/// extends to three standard deviations.
SceneBlock make_block(const Scene& scene, const fs::path& model_file) {
    SceneBlock block{model_file, scene.models.front().count, glm::vec3(0.0f), glm::vec3(0.0f)};
    for (std::uint32_t i = 0; i < block.count; ++i) {
        const glm::vec2 log_scale = scene.surfels.log_scale[i];
        const glm::vec3 reach(3.0f * std::exp(std::max(log_scale.x, log_scale.y))),
            mean = scene.surfels.mean[i];
        block.low_m = i == 0 ? mean - reach : glm::min(block.low_m, mean - reach);
        block.high_m = i == 0 ? mean + reach : glm::max(block.high_m, mean + reach);
    }
    return block;
}

/// Average over blocks, weighted by their numbers of training frames.
class MeanRayDropTable {
public:
    void add_table(const RayDropTable& table, std::size_t n_training_frames) {
        if (table.empty()) return;
        if (sum_.empty())
            sum_ = {table.channels, table.bins, std::vector<float>(table.probability.size(), 0.0f)};
        for (std::size_t i = 0; i < sum_.probability.size(); ++i)
            sum_.probability[i] += float(n_training_frames) * table.probability[i];
        n_frames_ += n_training_frames;
    }
    RayDropTable mean_table() const {
        RayDropTable table = sum_;
        for (float& p : table.probability) p /= float(std::max<std::size_t>(n_frames_, 1));
        return table;
    }

private:
    RayDropTable sum_;
    std::size_t n_frames_ = 0;
};

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
void keep_best_models(const Run& block_run, const Log& full_sequence, const TrajectoryBlock& block,
                      std::map<std::string, ActorModelCandidate>& best_actors) {
    for (const ModelInstance& instance : block_run.scene.instances) {
        if (instance.track.empty()) continue;
        const BoxTrack* box = find_box(block_run.sequence, instance.track);
        if (!box)
            fail(
                "{}: the trained scene has an actor with the track id \"{}\", but the log has no box with "
                "this track id; expected the log that was used for training",
                block_run.folder.string(), instance.track);
        const auto sightings =
            std::size_t(std::count_if(block.train.begin(), block.train.end(), [&](int position) {
                return is_near_box(*box, full_sequence, position, kMaxActorDistance_m);
            }));
        ActorModelCandidate& candidate = best_actors[instance.track];
        if (candidate.surfels.size() > 0 && sightings <= candidate.sightings) continue;
        const SurfelModel& model = block_run.scene.models[instance.model];
        candidate = {sightings, model, block_run.scene.surfels.slice(model.first, model.count), *box};
    }
}

/// Copies the vehicle poses at the sweeps of a block to the track of the full log.
void copy_poses(const Run& part, const Log& log, const TrajectoryBlock& block, PoseTrack& track) {
    for (const int position : block.recorded_frames) {
        const double time_s = log.frames[std::size_t(position)].time_s;
        const PoseTrack& part_track = part.sequence.world_from_vehicle;
        const auto from = std::lower_bound(part_track.time_s.begin(), part_track.time_s.end(), time_s);
        const auto to = std::lower_bound(track.time_s.begin(), track.time_s.end(), time_s);
        // Skips frames without a pose at exactly this time.
        if (from == part_track.time_s.end() || *from != time_s || to == track.time_s.end() || *to != time_s)
            continue;
        track.pose[std::size_t(to - track.time_s.begin())] =
            part_track.pose[std::size_t(from - part_track.time_s.begin())];
    }
}

}  // namespace

void join_blocks(Run& run, const std::vector<TrajectoryBlock>& blocks, const std::vector<fs::path>& folders) {
    Scene scene = wrap_background({});
    MeanRayDropTable drop;
    std::map<std::string, ActorModelCandidate> actors;
    PoseTrack poses = run.sequence.world_from_vehicle;
    for (std::size_t k = 0; k < blocks.size(); ++k) {
        const Run part = load_run(folders[k]);
        scene.blocks.push_back(make_block(part.scene, folders[k] / kModelFile));
        drop.add_table(part.scene.sensor_drop, blocks[k].train.size());
        keep_best_models(part, run.sequence, blocks[k], actors);
        copy_poses(part, run.sequence, blocks[k], poses);
        run.coverage.merge(part.coverage);
        merge_class_map(run.classes, part.classes);
        if (!part.refined_poses.empty()) run.refined_poses = part.refined_poses;
    }
    scene.sensor_drop = drop.mean_table();
    run.sequence.world_from_vehicle = std::move(poses);
    // Adds the actors in the order of the log's boxes. A scene that is trained without
    // blocks has the same order.
    for (BoxTrack& box : run.sequence.boxes) {
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
