// SPDX-License-Identifier: Apache-2.0
// Requests scans and collects their points. The device renders a scan while the host
// processes an earlier scan.

#include <relidar/simulate/place_points.hpp>

#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "simulate/render/channel_makers.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

/// Copies points that the device has computed. Rounds their intensities to the steps of
/// the sensor.
/// @param points output; its arrays keep their memory
void copy_points(std::span<const shared::ReturnedPoint> returned, const IntensityScatterModel& scatter,
                 LidarPoints& points) {
    constexpr std::size_t kPointsPerTask = 1 << 13;
    static_assert(std::int32_t(RELIDAR_NO_INSTANCE) == -1);  // host value for "no instance"
    const std::size_t n = returned.size();
    points.position_m.resize(n);
    points.intensity.resize(n);
    points.ring.resize(n);
    points.time_offset_s.resize(n);
    points.instance.resize(n);
    parallel_ranges(n, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const shared::ReturnedPoint& point = returned[i];
            points.position_m[i] = point.position;
            points.intensity[i] = scatter.quantise(point.intensity);
            points.ring[i] = std::uint16_t(point.ring);
            points.time_offset_s[i] = point.time_offset_s;
            points.instance[i] = std::int32_t(point.instance);
        }
    });
}

}  // namespace

/// Records GPU commands that render a sweep and compute its points. A scan joins a batch
/// if the device may render several scans in parallel. A lane has the buffers of a scan.
/// @param timing with_next: waits for the next scan before it submits the commands
PendingPoints ScanRenderer::Impl::record_points(const SimulatedSweep& sweep, const Pose& dataset_from_points,
                                                const ScanRenderPlan& plan, SubmissionTiming timing,
                                                PointMemory memory) try {
    // A scene with blocks, which are loaded as the sensor moves, has no copies for lanes.
    const int parallel_limit = sweeps.layout().blocks.empty() ? lanes->parallel_limit() : 1;
    const bool is_in_batch =
        parallel_limit > 1 && (lanes->has_open_batch() || timing == SubmissionTiming::with_next);
    ParallelScanResources& lane = is_in_batch ? lanes->next_lane() : lanes->single_lane();
    prepare_scene(lane, sweep);
    const bool has_network = plan.network == ScanRenderPlan::RayDropStage::device;
    PendingPoints scan{
        .rays = record_trace(lane, sweep, sweep.rays(), has_network),
        .dataset_from_sensor = shift_track(sweep.world_from_sensor, sweeps.sequence().world_offset_m),
        .dataset_from_points = dataset_from_points,
        .time_s = sweep.time_s,
        .max_range_m = observed_space_of(sweep.sensor).max_range_m,
        .is_background_shown = sweeps.is_background_shown(),
        .step = settings.scatter[std::size_t(sweep.sensor.lidar)].step,
        .renderer = &lanes->renderer_of(lane)};
    if (memory == PointMemory::device)
        scan.on_device = {.points = {device, sweep.rays().size(), "points of a scan"},
                          .n_rays = sweep.rays().size(),
                          .dataset_from_points = dataset_from_points,
                          .time_s = sweep.time_s};
    const PoseTrack points_from_sensor = to_frame(scan.dataset_from_sensor, dataset_from_points);
    scan.points = lane.points.record(scan.renderer->stream(), *scan.rays,
                                     {.points_from_sensor = points_from_sensor,
                                      .time_s = sweep.time_s,
                                      .of_image = config.render.points != "median",
                                      .refined = has_network,
                                      .target = scan.on_device ? &scan.on_device->points : nullptr},
                                     scan.renderer->forward_pass().n_truncated_rays());
    if (!is_in_batch) scan.renderer->stream().submit_commands();
    else if (timing == SubmissionTiming::now) lanes->submit_batch();
    return scan;
} catch (...) {
    wait_for_device();  // waits, because the next scan may replace arrays that recorded commands use
    throw;
}

/// Waits until the device has computed the points of a requested scan.
DevicePointComputer::GatheredPoints ScanRenderer::Impl::wait_gathered(PendingPoints& scan) {
    lanes->submit_batch();
    const DevicePointComputer::GatheredPoints gathered =
        DevicePointComputer::wait(scan.renderer->stream(), *scan.points);
    if (gathered.n_capped > 0) scan.renderer->check_truncation();
    return gathered;
}

/// Waits for the points of a requested scan. Also computes the share of its rays in space
/// that the log has not observed.
/// @param memory arrays to reuse
RenderedPoints ScanRenderer::Impl::collect_points(PendingPoints& scan, LidarPoints memory) {
    if (scan.ready) return std::move(*scan.ready);
    const DevicePointComputer::GatheredPoints gathered = wait_gathered(scan);
    const RayTable& rays = scan.rays->ray_table();
    IntensityScatterModel rounding;  // only its step is used
    rounding.step = scan.step;
    RenderedPoints result{std::move(memory), rays.size()};
    // Points from the device have none of these optional values.
    result.points.return_number.clear();
    result.points.firing.clear();
    result.points.channels.clear();
    result.points.world_from_points = scan.dataset_from_points;
    result.points.time_s = scan.time_s;
    copy_points(gathered.points, rounding, result.points);
    if (settings.coverage.empty() || !scan.is_background_shown) return result;
    // The device has copied the ranges of a sample of the rays.
    const auto sampled_ray = [&](std::size_t sample) {
        const std::size_t i = DevicePointComputer::sample_ray(sample, rays.size());
        const double time_s = scan.time_s + double(rays.time_offset_s[i]);
        return RayWithSurfaceRange{.dataset_from_firing = scan.dataset_from_sensor.pose_at(time_s),
                                   .origin_m = glm::dvec3(rays.origin[i]),
                                   .direction = glm::dvec3(rays.direction[i]),
                                   .met_m = gathered.sampled_m[sample]};
    };
    const LogObservedSpace space{settings.coverage, sweeps.sequence().world_offset_m, scan.max_range_m};
    result.unseen_share = relidar::unobserved_share(gathered.sampled_m.size(), sampled_ray, space);
    return result;
}

/// Waits for the points of a scan that stay on the device.
DevicePoints ScanRenderer::Impl::collect_on_device(PendingPoints& scan) {
    if (!scan.points) return std::move(*scan.on_device);
    scan.on_device->n_points = wait_gathered(scan).n_points;
    scan.points.reset();
    return std::move(*scan.on_device);
}

/// Copies the points of a scan that only the host can compute to the device.
DevicePoints ScanRenderer::Impl::upload_points(const RenderedPoints& rendered) {
    const LidarPoints& from = rendered.points;
    std::vector<shared::ReturnedPoint> points;
    for (std::size_t i = 0; i < from.position_m.size(); ++i)
        points.push_back({.position = from.position_m[i],
                          .intensity = from.intensity[i],
                          .time_offset_s = from.time_offset_s[i],
                          .ring = from.ring[i],
                          .instance = std::uint32_t(from.instance[i])});
    return {.points = {device, points, "points of a scan"},
            .n_points = points.size(),
            .n_rays = rendered.n_rays,
            .dataset_from_points = from.world_from_points,
            .time_s = from.time_s};
}

void ScanRenderer::Impl::finish_pending() {
    for (PendingPoints& scan : pending) {
        if (scan.on_device) scan.on_device = collect_on_device(scan);
        else scan.ready = collect_points(scan);
    }
}

void ScanRenderer::submit_points(const SimulatedSensor& sensor, const ScanRequest& request,
                                 double points_time_s, SampleSeed seed, SubmissionTiming timing,
                                 PointMemory memory) {
    Impl& renderer = *impl_;
    if (renderer.pending.size() >= kScansInFlight)
        fail<UsageError>(
            "{} requested scans have not been read yet, expected fewer than {}: call wait_for_points()",
            renderer.pending.size(), kScansInFlight);
    const SimulatedSweep sweep = renderer.sweeps.of_request(sensor, request);
    const Pose dataset_from_points = request.dataset_from_sensor.pose_at(points_time_s);
    const ScanRenderPlan plan = renderer.plan_sweep(sweep, seed.has_value());
    // The device computes the points after this call, which does not wait.
    if (plan.points_on_device) {
        renderer.pending.push_back(renderer.record_points(sweep, dataset_from_points, plan, timing, memory));
        return;
    }
    // Otherwise the host computes them now.
    const RenderedScan scan = renderer.render_sweep(sweep, seed);
    RenderedPoints points{place_points(scan, renderer.config, dataset_from_points), scan.image.range_m.size(),
                          scan.unseen_share};
    if (memory == PointMemory::device)
        renderer.pending.push_back({.on_device = renderer.upload_points(points)});
    else renderer.pending.push_back({.ready = std::move(points)});
}

/// Removes the oldest requested scan from the queue.
PendingPoints ScanRenderer::Impl::take_pending(PointMemory memory) {
    if (pending.empty())
        throw UsageError(
            "cannot read the points of a scan: no scan was requested; call submit_points() first");
    if (pending.front().on_device.has_value() != (memory == PointMemory::device))
        throw UsageError(
            "cannot read the points of a scan: they are in the other memory; call wait_for_points() for "
            "PointMemory::host and wait_for_device_points() for PointMemory::device");
    PendingPoints first = std::move(pending.front());
    pending.pop_front();
    return first;
}

RenderedPoints ScanRenderer::wait_for_points(LidarPoints memory) {
    PendingPoints first = impl_->take_pending(PointMemory::host);
    return impl_->collect_points(first, std::move(memory));
}

DevicePoints ScanRenderer::wait_for_device_points() {
    PendingPoints first = impl_->take_pending(PointMemory::device);
    return impl_->collect_on_device(first);
}

/// Waits until the device no longer uses the arrays of this object. First submits
/// commands that are only recorded.
void ScanRenderer::Impl::wait_for_device() noexcept {
    try {
        lanes->submit_batch();
        if (scene.is_loaded()) scene.renderer().stream().submit_and_wait();
    } catch (const Error&) {  // nothing to do, because a lost device no longer writes to memory
    }
}

ScanRenderer::~ScanRenderer() { impl_->wait_for_device(); }

}  // namespace relidar
