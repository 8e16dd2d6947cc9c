// SPDX-License-Identifier: Apache-2.0
// Joins the separately trained blocks of a scene into one run.
#include <relidar/run/blocks.hpp>

#include <algorithm>
#include <map>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "run/blocks/frame_places.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

// A frame shows an actor well if its box is at most this far from the sensor. Boxes
// farther away have few returns.
constexpr double kWellSeen_m = 60.0;

/// Counts the training frames of a block in which a box is near enough to train its
/// actor.
std::size_t count_sightings(const BoxTrack& box, const Sequence& sequence, const Block& block) {
    return std::size_t(std::count_if(block.train.begin(), block.train.end(), [&](int position) {
        return is_within(box, sequence, position, kWellSeen_m);
    }));
}

/// Returns the background surfels of a block and their bounding box.
SceneBlock load_background(const Scene& scene, const fs::path& file) {
    SceneBlock block{file, scene.models.front().count, glm::vec3(0.0f), glm::vec3(0.0f)};
    for (std::uint32_t i = 0; i < block.count; ++i) {
        const glm::vec2 log_scale = scene.surfels.log_scale[i];
        const glm::vec3 reach(3.0f * std::exp(std::max(log_scale.x, log_scale.y))),
            mean = scene.surfels.mean[i];
        block.low_m = i == 0 ? mean - reach : glm::min(block.low_m, mean - reach);
        block.high_m = i == 0 ? mean + reach : glm::max(block.high_m, mean + reach);
    }
    return block;
}

/// Averages the ray-drop probabilities of a sensor that were trained in several blocks of
/// a log. The weight of a block is its number of training frames.
class MeanDrop {
public:
    void add(const DropTable& table, std::size_t n_frames) {
        if (table.empty()) return;
        if (sum_.empty())
            sum_ = {table.channels, table.bins, std::vector<float>(table.probability.size(), 0.0f)};
        for (std::size_t i = 0; i < sum_.probability.size(); ++i)
            sum_.probability[i] += float(n_frames) * table.probability[i];
        n_frames_ += n_frames;
    }
    DropTable mean() const {
        DropTable table = sum_;
        for (float& p : table.probability) p /= float(std::max<std::size_t>(n_frames_, 1));
        return table;
    }

private:
    DropTable sum_;
    std::size_t n_frames_ = 0;
};

/// The model of an actor that was trained in one block of the log. If several blocks
/// contain the actor, the model with the most sightings is used.
struct Candidate {
    std::size_t sightings = 0;
    Model model;
    Surfels surfels;
    BoxTrack box;
};

/// Adds the actors of a block to `best`. If another block has trained the same actor,
/// keeps the model with more training frames near the actor.
void update_best_actors(const Run& part, const Sequence& sequence, const Block& block,
                        std::map<std::string, Candidate>& best) {
    for (const Instance& instance : part.scene.instances) {
        if (instance.track.empty()) continue;
        const BoxTrack* box = find_box(part.sequence, instance.track);
        if (!box)
            throw DataError(fmt::format(
                "{}: the scene has an instance of track \"{}\", but the log has no box with this track id",
                part.folder.string(), instance.track));
        const std::size_t sightings = count_sightings(*box, sequence, block);
        Candidate& candidate = best[instance.track];
        if (candidate.surfels.size() > 0 && sightings <= candidate.sightings) continue;
        const Model& model = part.scene.models[instance.model];
        candidate = {sightings, model, part.scene.surfels.slice(model.first, model.count), *box};
    }
}

/// Copies the vehicle poses of a block's sweeps from the trained run of this block to the
/// track of the full log.
void copy_poses(const Run& part, const Sequence& sequence, const Block& block, PoseTrack& track) {
    for (const int position : block.own) {
        const double time_s = sequence.frames[std::size_t(position)].time_s;
        const PoseTrack& part_track = part.sequence.world_from_vehicle;
        const auto from = std::lower_bound(part_track.time_s.begin(), part_track.time_s.end(), time_s);
        const auto to = std::lower_bound(track.time_s.begin(), track.time_s.end(), time_s);
        // Skips the frame if a track has no pose at exactly this time.
        if (from == part_track.time_s.end() || *from != time_s || to == track.time_s.end() || *to != time_s)
            continue;
        track.pose[std::size_t(to - track.time_s.begin())] =
            part_track.pose[std::size_t(from - part_track.time_s.begin())];
    }
}

}  // namespace

void join_blocks(Run& run, const std::vector<Block>& blocks, const std::vector<fs::path>& folders) {
    Scene scene = make_background_scene({});
    MeanDrop drop;
    std::map<std::string, Candidate> actors;
    PoseTrack poses = run.sequence.world_from_vehicle;
    for (std::size_t k = 0; k < blocks.size(); ++k) {
        const Run part = load_run(folders[k]);
        scene.blocks.push_back(load_background(part.scene, folders[k] / kModelFile));
        drop.add(part.scene.sensor_drop, blocks[k].train.size());
        update_best_actors(part, run.sequence, blocks[k], actors);
        copy_poses(part, run.sequence, blocks[k], poses);
        run.coverage.add(part.coverage);
        add_classes(run.classes, part.classes);
        if (!part.refined_poses.empty()) run.refined_poses = part.refined_poses;
    }
    scene.sensor_drop = drop.mean();
    run.sequence.world_from_vehicle = std::move(poses);
    // Iterates over the boxes of the log, so that the actors have the same order as in a
    // scene without blocks.
    for (BoxTrack& box : run.sequence.boxes) {
        const auto entry = actors.find(box.id);
        if (entry == actors.end()) continue;
        Candidate& actor = entry->second;
        actor.model.first = static_cast<std::uint32_t>(scene.surfels.size());
        scene.instances.push_back({static_cast<std::uint32_t>(scene.models.size()), box.id});
        scene.models.push_back(actor.model);
        scene.surfels.append(actor.surfels);
        box = std::move(actor.box);
    }
    run.scene = std::move(scene);
}

}  // namespace relidar
