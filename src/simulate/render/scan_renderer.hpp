// SPDX-License-Identifier: Apache-2.0
// Declares the steps that make a scan: compute the sweep, trace rays, join sub-rays, run
// the network, measure, compute points. ScanRenderPlan decides which steps run. Private
// to render.
#pragma once

#include <deque>

#include <relidar/simulate/device_points.hpp>
#include <relidar/simulate/render.hpp>

#include "simulate/render/points_on_device.hpp"
#include "simulate/render/resident_scene.hpp"
#include "simulate/render/sweep.hpp"

namespace relidar {

struct ScanRenderSettings {
    std::vector<ChannelInfo> channels;
    ObservedVoxelSet coverage = {};
    std::vector<IntensityScatterModel> scatter = {};  ///< [lidars]
    Weather weather = {};
    bool has_views = false;  ///< if true, scans have RenderedScan::actor_views
};

struct ScanRenderPlan {
    SensorConfig beams;
    /// `device`: rays in device memory. `beams`: beams after the host has combined their
    /// sub-rays. `cells`: pixels of the sensor's range image grid.
    enum class RayDropStage { none, device, beams, cells } network = RayDropStage::none;
    /// True if the scan has no sub-rays, grid, channels, weather or random sampling.
    /// Otherwise place_points() computes equal points on the host.
    bool points_on_device = false;

    bool has_sub_rays() const { return beams.sub_rays > 1; }
};

/// Decides which steps a scan needs, and which of them run on the device.
/// @param rays one per beam, before they are split into sub-rays
/// @param network may be null
/// @throws UsageError if the sensor cannot be rendered with these settings
ScanRenderPlan plan_scan(const SimulatedSensor& sensor, const RayTable& rays, const Config& config,
                         const ScanRenderSettings& settings, const RayDropNetwork* network, bool sampled);

bool corrects_drop(const RayDropNetwork* network, const SimulatedSensor& sensor);

struct ChannelInputs;
struct LogObservedSpace;
class ParallelScanResourcePool;
class DeviceSensorRays;
struct ParallelScanResources;

/// Points of a submitted scan that wait_for_points() has not collected yet.
struct PendingPoints {
    std::optional<RenderedPoints> ready = {};  ///< the points, if the host computed them
    std::shared_ptr<DeviceSensorRays> rays = {};
    PoseTrack dataset_from_sensor = {};
    Pose dataset_from_points = {};
    double time_s = 0.0;
    double max_range_m = 0.0;  ///< maximum range of the sensor
    bool is_background_shown = true;
    double step = 0.0;  ///< step to which intensities are rounded (IntensityScatterModel)
    std::shared_ptr<DevicePointComputer::PointReadbackSlot> points = {};
    Renderer* renderer = nullptr;
    /// The points, if they stay on the device.
    std::optional<DevicePoints> on_device = {};
};

/// Instance that spawn() has added. It is free if its actor has no name.
struct SpawnSlot {
    std::uint32_t source = 0;  ///< model that the instance has, or of which it has a copy
    SpawnedActor actor = {};
};

struct ScanRenderer::Impl {
    Device& device;
    const Config config;
    const glm::dvec3 first_origin_m;  ///< origin that first_position() returns
    ScanRenderSettings settings;
    SimulatedSweepBuilder sweeps;
    const std::vector<BoxTrack> standing;  ///< list_standing() of the scene
    ResidentScene scene;
    std::unique_ptr<ParallelScanResourcePool> lanes;
    SurfaceClassMap class_map = {};
    /// Search tree of `class_map`. Null until the first scan with the channel "class".
    std::unique_ptr<const SurfaceClassLookup> class_finder = {};
    std::vector<SpawnSlot> slots = {};  ///< in the order of their instances
    /// Models of assets by the hash of their content.
    std::map<std::uint64_t, std::uint32_t> asset_models = {};
    std::deque<PendingPoints> pending = {};  ///< requested scans, sorted from the oldest to the newest

    Impl(Device& on, const Scene& all, const Config& settings_of_run, const Log& log);
    /// `drops` has the network's drop probabilities, if it ran on the device. They are
    /// valid until the next scan is traced.
    struct TracedScan {
        RenderedScan scan;
        std::span<const float> drops;
    };
    ScanRenderPlan plan_sweep(const SimulatedSweep& sweep, bool sampled) const;
    void prepare_scene(const ParallelScanResources& resources, const SimulatedSweep& sweep);
    std::shared_ptr<DeviceSensorRays> record_trace(ParallelScanResources& lane, const SimulatedSweep& sweep,
                                                   const RayTable& rays, bool with_drop);
    TracedScan trace_rays(const SimulatedSweep& sweep, const RayTable& ray_table, bool with_drop = false);
    RenderedScan trace_footprint(const SimulatedSweep& sweep, SensorConfig beam_config);
    ActorViews count_first_hits(const RenderedScan& scan) const;
    void count_unoccluded(const SimulatedSweep& sweep, const ScanRenderPlan& plan, ActorViews& views);
    ActorViews count_standing(const SimulatedSweep& sweep, const RenderedScan& scan) const;
    void correct_drop(RenderedScan& scan);
    void simulate_weather(RenderedScan& scan, const SimulatedSweep& sweep, std::uint64_t seed);
    void apply_noise(RenderedScan& scan, const SimulatedSweep& sweep, SampleSeed seed);
    RenderedScan render_sweep(const SimulatedSweep& sweep, SampleSeed seed);

    PendingPoints record_points(const SimulatedSweep& sweep, const Pose& dataset_from_points,
                                const ScanRenderPlan& plan, SubmissionTiming timing, PointMemory memory);
    PendingPoints take_pending(PointMemory memory);
    DevicePointComputer::GatheredPoints wait_gathered(PendingPoints& scan);
    RenderedPoints collect_points(PendingPoints& scan, LidarPoints memory = {});
    DevicePoints collect_on_device(PendingPoints& scan);
    DevicePoints upload_points(const RenderedPoints& points);
    void check_new_name(const std::string& name) const;
    std::uint32_t add_model(const Scene& model, const BoxTrack& box);
    ActorHandle fill_slot(std::uint32_t source, SpawnedActor actor);
    void finish_pending();
    void wait_for_device() noexcept;
    bool has_channel(const std::string& name) const;
    LogObservedSpace observed_space_of(const SimulatedSensor& sensor) const;
    ChannelInputs channel_inputs(const SimulatedSweep& sweep);
};

}  // namespace relidar
