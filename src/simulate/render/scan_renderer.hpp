// SPDX-License-Identifier: Apache-2.0
// Declares the steps that make a scan: compute the sweep, trace rays, join sub-rays, run
// the network, measure, compute points. ScanPlan decides which steps run. Private to
// render.
#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include <relidar/diff/forward.hpp>
#include <relidar/simulate/render.hpp>

#include "simulate/render/points_on_device.hpp"
#include "simulate/render/resident_scene.hpp"
#include "simulate/render/scan_plan.hpp"
#include "simulate/render/seen.hpp"
#include "simulate/render/sweep.hpp"

namespace relidar {

struct ScanContext;
class RenderLanes;
class SensorRays;
struct RenderLane;

/// Points of a submitted scan. The caller has not collected them with wait_for_points()
/// yet.
struct PendingPoints {
    std::optional<RenderedPoints> ready = {};  ///< the points, if the host computed them
    std::shared_ptr<SensorRays> rays = {};
    /// poses of the sensor; a single pose if the sensor does not move
    PoseTrack dataset_from_sensor = {};
    Pose dataset_from_points = {};
    double time_s = 0.0;
    double max_range_m = 0.0;  ///< maximum range of the sensor
    double step = 0.0;         ///< step to which intensities are rounded, see IntensityScatter
    std::shared_ptr<PointsOnDevice::Slot> points = {};
    Renderer* renderer = nullptr;
};

struct ScanRenderer::Impl {
    Device& device;
    const Config config;
    const glm::dvec3 first_origin_m;  ///< origin of the first ray, see get_first_origin()
    ScanSettings settings;
    SweepMaker sweeps;
    ResidentScene scene;
    std::unique_ptr<RenderLanes> lanes;
    ClassMap class_map = {};
    /// Search tree of `class_map`. Null until the first scan with the channel `class`.
    std::unique_ptr<const ClassFinder> class_finder = {};
    std::deque<PendingPoints> pending = {};  ///< requested scans, sorted from the oldest to the newest

    Impl(Device& on, const Scene& all, const Config& settings_of_run, const Sequence& sequence);
    /// A scan of traced rays. `drops` has the drop probabilities of the network if the
    /// network ran on the device. It is valid until the next scan is traced.
    struct TracedScan {
        RenderedScan scan;
        std::span<const float> drops;
    };
    /// Decides which steps run for a sweep.
    ScanPlan plan(const Sweep& sweep, bool is_sampled) const;
    void load_scene(const RenderLane& lane, const Sweep& sweep);
    std::shared_ptr<SensorRays> record(RenderLane& lane, const Sweep& sweep, const RayTable& rays,
                                       bool corrects_drops);
    TracedScan trace(const Sweep& sweep, const RayTable& table, bool corrects_drops = false);
    RenderedScan trace_beams(const Sweep& sweep, SensorConfig beams);
    std::vector<ActorView> count_first_hits(const RenderedScan& scan) const;
    void count_isolated_actor_hits(const Sweep& sweep, const ScanPlan& plan, std::vector<ActorView>& views);
    void correct_drops(RenderedScan& scan);
    void measure(RenderedScan& scan, const Sweep& sweep, std::optional<std::uint64_t> sample);
    RenderedScan render(const Sweep& sweep, std::optional<std::uint64_t> sample);

    PendingPoints record_points(const Sweep& sweep, const Pose& dataset_from_points, const ScanPlan& plan,
                                Send mode);
    RenderedPoints collect(PendingPoints& scan, Points memory = {});
    void finish_pending();
    void wait_for_device() noexcept;
    bool has_channel(const std::string& name) const;
    SeenByLog compute_seen_by_log(const SensorChoice& sensor) const;
    ScanContext make_scan_context(const Sweep& sweep);
};

}  // namespace relidar
