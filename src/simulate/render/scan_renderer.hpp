// SPDX-License-Identifier: Apache-2.0
// Declares the steps that make a scan. ScanRenderPlan decides which steps run. Private to
// render.
#pragma once

#include <deque>
#include <exception>
#include <variant>

#include <relidar/simulate/device_points.hpp>
#include <relidar/simulate/render.hpp>

#include "simulate/render/channel_makers.hpp"
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

/// Replaces the values of rays that hit the own vehicle before they hit another surface.
/// Their range is that of an ideal ray. They are dropped unless the body keeps its
/// points. Can be called again after noise or weather have changed values.
/// @param limits a hit outside these limits has no return
void block_rays(RenderedScan& scan, const VehicleBody& body, const RangeLimits& limits);

class DeviceSensorRays;
class RenderLane;
class RenderLanes;

/// Scan of which the device computes the points while the host continues.
struct SubmittedScan {
    std::shared_ptr<DeviceSensorRays> rays;
    Renderer& renderer;
    PoseTrack dataset_from_sensor;
    Pose dataset_from_points;
    double time_s;
    IntensityScatterModel intensity_steps;           ///< has only a step
    std::optional<LogObservedSpace> observed_space;  ///< no value if the background is hidden
    std::optional<DevicePoints> device_points = {};  ///< the points, if they stay on the device
    std::shared_ptr<DevicePointComputer::PointReadback> results = {};
};
/// Requested points that the caller has not collected yet.
using PendingPoints = std::variant<SubmittedScan, RenderedPoints, DevicePoints>;

/// Instance that spawn() has added. It is free if its actor has no name.
struct SpawnSlot {
    std::uint32_t source = 0;  ///< model that the instance has, or of which it has a copy
    SpawnedActor actor = {};   ///< its handle is the index of the instance
};

struct ScanRenderer::Impl {
    Device& device;
    const Config config;
    const glm::dvec3 first_origin_m;  ///< origin that first_position() returns
    ScanRenderSettings settings;
    SimulatedSweepBuilder sweeps;
    const std::vector<BoxTrack> standing;  ///< list_standing() of the scene
    ResidentScene scene;
    std::unique_ptr<RenderLanes> lanes;
    SurfaceClassMap class_map = {};
    /// Search tree of `class_map`. Null until the first scan with the channel "class".
    std::unique_ptr<const SurfaceClassLookup> class_finder = {};
    std::vector<SpawnSlot> slots = {};  ///< in the order of their instances
    /// Models of assets by the hash of their content.
    std::map<std::uint64_t, std::uint32_t> asset_models = {};
    std::deque<PendingPoints> pending = {};  ///< requested scans, sorted from the oldest to the newest

    Impl(Device& gpu, const Scene& full_scene, const Config& run_config, const Log& log);
    /// Waits for the device if an exception leaves the scope. Otherwise the next scan
    /// could replace arrays that recorded commands use.
    struct WaitOnError {
        Impl& renderer;
        const int n_before = std::uncaught_exceptions();
        ~WaitOnError() {
            if (std::uncaught_exceptions() > n_before) renderer.wait_for_device();
        }
    };
    struct TracedScan {
        RenderedScan scan;
        std::vector<float> network_drops = {};  ///< empty if no network ran on the device
    };
    ScanRenderPlan plan_sweep(const SimulatedSweep& sweep, bool sampled) const;
    void prepare_scene(RenderLane& lane, const SimulatedSweep& sweep);
    std::shared_ptr<DeviceSensorRays> record_trace(RenderLane& lane, const SimulatedSweep& sweep,
                                                   const RayTable& ray_table, bool with_network);
    TracedScan trace_rays(const SimulatedSweep& sweep, const RayTable& ray_table,
                          ScanRenderPlan::RayDropStage network);
    RenderedScan trace_footprint(const SimulatedSweep& sweep, const ScanRenderPlan& plan);
    void count_standing(const std::vector<WorldRay>& rays, const RenderedScan& scan, double max_range_m,
                        ActorViews& views) const;
    ActorViews count_views(const SimulatedSweep& sweep, ScanRenderPlan plan, const RenderedScan& scan);
    void simulate_weather(RenderedScan& scan, const SimulatedSweep& sweep, std::uint64_t seed);
    void apply_noise(RenderedScan& scan, const SimulatedSweep& sweep, SampleSeed seed);
    RenderedScan render_sweep(const SimulatedSweep& sweep, SampleSeed seed);

    SubmittedScan submit_sweep(const SimulatedSweep& sweep, const Pose& dataset_from_points,
                               SubmissionTiming timing, PointMemory memory, bool with_network);
    DevicePoints upload_points(const RenderedPoints& points);
    void finish_scan(PendingPoints& request, LidarPoints reused = {});
    void finish_pending();
    PendingPoints take_pending(PointMemory memory, LidarPoints reused = {});
    void check_new_name(const std::string& name) const;
    std::uint32_t add_model(const Scene& model, const BoxTrack& box);
    ActorHandle add_instance(std::uint32_t source, const std::string& name);
    SpawnSlot* find_slot(const std::string& name);
    ActorHandle fill_slot(std::uint32_t source, SpawnedActor actor);
    void wait_for_device() noexcept;
    bool has_channel(const std::string& name) const;
    LogObservedSpace observed_space_of(const SimulatedSensor& sensor) const;
    ChannelInputs channel_inputs(const SimulatedSweep& sweep);
};

}  // namespace relidar
