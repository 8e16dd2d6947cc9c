// SPDX-License-Identifier: Apache-2.0
// Computes which parts of its actors a log has observed. Renders the scans of the log
// with the trained scene, so that objects in front of an actor hide the actor.
#include <relidar/simulate/assets.hpp>

#include <relidar/simulate/render.hpp>

namespace relidar {
namespace {

// Replaces a LiDAR of the log whose rays change from scan to scan.
constexpr const char* kStandIn = "HDL-64E";

/// Returns one sensor for each LiDAR of the log.
std::vector<SimulatedSensor> sensors_of_log(const Run& run) {
    std::vector<SimulatedSensor> sensors;
    for (int i = 0; i < int(run.sequence.lidars.size()); ++i) {
        sensors.push_back(choose_sensor("native", run.config, run.sequence, i));
        const SimulatedSensor& log_sensor = sensors.back();
        if (log_sensor.rays.size() == 0 && !log_sensor.pattern)
            sensors.back() = choose_sensor(kStandIn, run.config, run.sequence, i);
    }
    return sensors;
}

/// Returns the training frames in which the log has a box of at least one instance.
std::vector<int> frames_with_actors(const Run& run, const std::vector<const BoxTrack*>& box_per_instance) {
    std::vector<int> positions;
    for (const int i : run.split.train) {
        const double time_s = run.sequence.frames[std::size_t(i)].time_s;
        if (std::ranges::any_of(box_per_instance,
                                [&](const BoxTrack* b) { return b && b->is_observed(time_s); }))
            positions.push_back(i);
    }
    return positions;
}

/// Adds the hits of a scan to the actors, as points and ray directions in the box frame.
void add_observations(const RenderedScan& scan, const Run& run, const std::vector<const BoxTrack*>& boxes,
                      ObservationsByTrack& observed) {
    FiringPoseInterpolator firing(scan);
    for (std::size_t i = 0; i < scan.instance.size(); ++i) {
        const BoxTrack* box = scan.instance[i] > 0 ? boxes[std::size_t(scan.instance[i])] : nullptr;
        if (!box || !(scan.median_range_m[i] > 0.0f) || !(scan.image.drop_prob[i] < 0.5f)) continue;
        const Pose box_from_world =
            inverse(box->world_from_box.pose_at(scan.time_s + double(scan.time_offset_s[i])));
        const Pose& world_from_firing = firing.pose_of(i);
        const glm::dvec3 point_m =
            box_from_world * (world_from_firing * scan.end_of<double>(i) - run.sequence.world_offset_m);
        // Skips returns from surfels that were mirrored to fill an unobserved side of the
        // actor. The log has not observed them.
        const SurfelModel& model = run.scene.models[run.scene.instances[std::size_t(scan.instance[i])].model];
        if (model.surface && model.surface->find_mirrored_side(point_m)) continue;
        ActorObservations& actor = observed[box->id];
        actor.points_m.push_back(glm::vec3(point_m));
        actor.directions.push_back(glm::vec3(box_from_world.rotation * world_from_firing.rotation *
                                             glm::dvec3(scan.image.direction[i])));
        actor.nearest_m = std::min(actor.nearest_m, double(scan.median_range_m[i]));
    }
}

}  // namespace

ObservationsByTrack observe_actors(Device& device, const Run& run, const Progress& progress) {
    std::vector<const BoxTrack*> boxes;
    for (const ModelInstance& instance : run.scene.instances)
        boxes.push_back(find_box(run.sequence, instance.track));
    const std::vector<int> positions = frames_with_actors(run, boxes);
    const std::vector<SimulatedSensor> sensors = sensors_of_log(run);
    ObservationsByTrack sightings;
    ScanRenderer renderer(device, run.scene, run.config, run.sequence);
    for (std::size_t k = 0; k < positions.size(); ++k) {
        if (progress) progress("measuring the visibility of actors", double(k) / double(positions.size()));
        const Frame& frame = run.sequence.frames[std::size_t(positions[k])];
        add_observations(renderer.render(sensors[std::size_t(frame.lidar)], frame.time_s), run, boxes,
                         sightings);
    }
    return sightings;
}

}  // namespace relidar
