// SPDX-License-Identifier: Apache-2.0
// First step of a scan: computes the rays of a sensor, the path of the sensor and the
// poses of all instances during a sweep. Private to render.
#pragma once

#include <unordered_map>

#include <relidar/simulate/render.hpp>

namespace relidar {

struct SimulatedSweep {
    const SimulatedSensor& sensor;
    double time_s = 0.0;
    /// set if the pattern changes from scan to scan, or if all rays fire at the same time
    std::optional<RayTable> changed_rays = {};
    PoseTrack world_from_sensor = {};  ///< poses of the sensor; a single pose if the sensor does not move
    Pose pose = {};                    ///< pose of the sensor at `time_s`
    std::vector<InstancePose> instances = {};

    const RayTable& rays() const { return changed_rays ? *changed_rays : sensor.rays; }
};

class SimulatedSweepBuilder {
public:
    /// @param config must outlive this object
    SimulatedSweepBuilder(const Config& config, const Scene& scene, const Log& log);
    /// @throws UsageError if the number of instances is wrong
    void show_instances(const std::vector<bool>& shown);
    /// Copies a sensor with the azimuths that the log's LiDAR measured at `time_s`.
    SimulatedSensor follow_log(const SimulatedSensor& sensor, double time_s) const;
    /// Returns a sweep of a sensor on the vehicle, which drives along its recorded path.
    /// @param sensor must outlive the sweep
    /// @param sensor_offset relative to the recorded mounting
    SimulatedSweep on_recorded_path(const SimulatedSensor& sensor, double time_s, const Pose& sensor_offset);
    /// Returns a sweep with the sensor poses and actor poses of `request`.
    /// @throws DataError if poses or times are invalid
    SimulatedSweep of_request(const SimulatedSensor& sensor, const ScanRequest& request);

    /// Adds a model or an absent instance to the layout.
    /// @return index of the instance
    void add_model(const SurfelModel& model, const BoxTrack& box);
    std::uint32_t add_instance(std::uint32_t model);
    /// Sets the name of an added instance. Without a name, it is always absent.
    void name_instance(std::uint32_t instance, const std::string& name);
    bool has_actor(const std::string& name) const { return instance_of_.contains(name); }
    /// @throws UsageError if the scene has no actor with this name
    std::uint32_t find_actor(const std::string& name) const;

    const Log& log() const { return log_; }
    const Scene& layout() const { return layout_; }
    bool is_background_shown() const {
        return is_shown_.front() && (layout_.models.front().count > 0 || !layout_.blocks.empty());
    }
    /// Returns the probability that a ray is blocked, for example by the vehicle.
    float permanent_drop(const SimulatedSensor& sensor, std::uint16_t channel,
                         const glm::vec3& direction) const;
    RangeLimits limits_of(const SimulatedSensor& sensor) const;

private:
    const Config& config_;
    Scene layout_;  ///< models, instances and sensor drop, without surfels
    Log log_;       ///< the log; during a sweep, its vehicle has the poses of this sweep
    const PoseTrack log_world_from_vehicle_;
    const std::vector<Frame> shifted_;
    const std::size_t n_logged_;  ///< number of instances of the run; others were added
    std::vector<bool> is_shown_;  ///< [instances] false also for a free instance
    /// Actors by name. Instances with the same track have separate entries.
    std::unordered_multimap<std::string, std::uint32_t> instance_of_;
    std::vector<std::optional<std::size_t>> box_of_;  ///< [n_logged_] index in Log::boxes

    /// [instances] null if absent
    using InstanceTracks = std::vector<const PoseTrack*>;
    [[noreturn]] void fail_unknown_actor(const std::string& name) const;
    InstanceTracks logged_tracks(double time_s) const;
    SimulatedSweep along_track(const SimulatedSensor& sensor, double time_s, PoseTrack world_from_sensor,
                               const InstanceTracks& world_from_actor);
};

}  // namespace relidar
